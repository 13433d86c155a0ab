"""What it means that E was carried from another experiment to other cells."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.config.experiment import Experiment
from pipeline.lattice.closed_form import closed_form_stress
from pipeline.parameters import Parameters

SATURATED = 3.0  # attenuation lengths below which a column's stress hardly grows: 1 - e^-3 = 95 %


def carried_statements(
    experiment: Experiment, source: Mapping[str, Any], declared: Parameters
) -> Iterator[str]:
    """Statements for a reader where E comes from an experiment on cells of another size.

    `source` is the content of that experiment's `calibration.json`, `declared` what was made of
    it for this one.
    """
    used = Parameters.from_document(source["parameters_used"])
    if used.cell_size == declared.cell_size:
        return
    length, height = declared.attenuation_length, experiment.geometry.height
    cells = height / declared.cell_size
    share = float(closed_form_stress(1.0, 1.0, 1.0, declared.E, cells) / cells)
    text = (
        f"E = {used.E:.4g} of {source['experiment']}, on cells of {used.cell_size:g} m, is carried "
        f"to cells of {declared.cell_size:g} m at equal base stress of this column: "
        f"E = {declared.E:.4g}, ℓ = {length:.3g} m (there {used.attenuation_length:.3g} m). "
        f"At rest {share:.2g} of the column's weight reaches the base."
    )
    if height > SATURATED * length:
        text += (
            f" Its stress is saturated: what lies more than {SATURATED * length:.3g} m above the "
            f"base adds less than {math.exp(-SATURATED):.0%} of it."
        )
    yield text
    there = source["derived"]["hydraulic_radius"]["value"]
    here = experiment.geometry.hydraulic_radius
    if math.isfinite(length):
        yield (
            f"This ℓ is that of the other model's walls. By Janssen's law ℓ is proportional to the "
            f"hydraulic radius, {there:.3g} m there and {here:.3g} m here: ℓ would be "
            f"{used.attenuation_length * here / there:.4g} m. Nothing measured here decides."
        )
    if source["parameters"]["E"].get("interval_open"):
        yield f"The data of {source['experiment']} do not bound E: its 90 % interval is open."
