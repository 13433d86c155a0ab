"""Base stress of an experiment as a table: by load cell, by drawpoint, and by period."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.experiment import BaseArea
from pipeline.files.atomic import write_text
from pipeline.files.results import Results, clock_of
from pipeline.files.tables import as_csv
from pipeline.files.units import KG_IN_T, KPA_IN_MPA
from pipeline.lattice.block_model import STATE_OUTSIDE, corner_of, lattice_of
from pipeline.montecarlo.statistics import PERCENTILES, stress_percentiles
from pipeline.simulate.setup import load_cells

NEEDED = ("block_model", "replicates", "fields")
_STATISTICS = ("mean", "std", *(f"p{p}" for p in PERCENTILES))
COLUMNS = (
    "experiment",
    "period",
    "mass_drawn_kg",
    "mass_drawn_t",
    "fill_height_m",
    "place",
    "name",
    "x_m",
    "y_m",
    "width_m",
    "length_m",
    "easting_m",
    "northing_m",
    *(f"{statistic}_kpa" for statistic in _STATISTICS),
    *(f"{statistic}_mpa" for statistic in _STATISTICS),
    "replicates",
    "drawn_from_here_t",
)


def write_base_stress(results: Results, path: str | Path) -> None:
    """Write the table of `base_stress_rows` as CSV, whole."""
    write_text(path, as_csv(COLUMNS, base_stress_rows(results)))


def base_stress_rows(results: Results) -> Iterator[dict[str, Any]]:
    """Vertical stress on the base: rows by period, in it the whole base, load cells, drawpoints.

    A period ends with a reading; period 0 is the reading before draw, or the lowest fill level.
    Mean, standard deviation (n − 1) and P10, P50, P90 are over replicates, in kPa and MPa, of
    the stress averaged over the place. Of drawpoints, percentiles and the standard deviation
    need the fields of every replicate (`keep_fields: true`) and are empty without them;
    `drawn_from_here_t` is the mean mass that came out of a drawpoint until then, in t. Eastings
    and northings are empty where the experiment does not say where it stands in the mine.
    """
    replicates, experiment = results["replicates"], results.experiment
    clock, times = clock_of(replicates)
    count = replicates.sizes["replicate"]
    g = experiment.geometry
    cells = load_cells(experiment) if experiment.load_cells else ()
    ground = results["block_model"]["state"].values != STATE_OUTSIDE
    has_ground, lowest = ground.any(axis=0), np.argmax(ground, axis=0)
    openings = [_Opening(results, one, has_ground, lowest) for one in experiment.drawpoints]
    drawn = _drawn_from(results)
    for period, time in enumerate(times.tolist()):
        shared = {"experiment": experiment.name, "period": period, "replicates": count}
        shared[f"{clock}_{'kg' if clock == 'mass_drawn' else 'm'}"] = time
        if clock == "mass_drawn":
            shared["mass_drawn_t"] = time * KG_IN_T
        whole = {"x_m": g.width / 2, "y_m": g.length / 2, "width_m": g.width, "length_m": g.length}
        base = replicates["base_vertical_stress"].values[:, period]
        yield shared | {"place": "base", "name": "base"} | whole | _statistics(base)
        for place, cell in enumerate(cells):
            stress = replicates["vertical_stress"].values[:, period, place]
            yield shared | _where(results, "load_cell", cell) | _statistics(stress)
        for place, opening in enumerate(openings):
            row = shared | _where(results, "drawpoint", opening.point) | opening.stress(period)
            if drawn is not None:
                row["drawn_from_here_t"] = drawn[period, place] * KG_IN_T
            yield row


class _Opening:
    """A drawpoint's opening: the `lowest` ground cells that it covers, with the areas covered."""

    def __init__(self, results: Results, point: BaseArea, has_ground, lowest):
        self.point, self.results = point, results
        lattice = lattice_of(results.experiment)
        area = lattice.covered_area(point.x, point.y, point.width, point.length)
        area = np.where(has_ground, area, 0.0)
        y, x = np.nonzero(area)
        self.cells = lowest[y, x], y, x
        self.share = area[y, x] / area.sum()

    def stress(self, period: int) -> dict[str, float]:
        """Its stress at a reading; a void bears none."""
        replicates, fields = self.results["replicates"], self.results["fields"]
        z, y, x = self.cells
        if "replicate_vertical_stress" in replicates:
            kept = replicates["replicate_vertical_stress"].values[:, period, z, y, x]
            return _statistics(np.nan_to_num(kept.astype(np.float64)) @ self.share)
        mean = fields["vertical_stress_mean"].values[period, z, y, x].astype(np.float64)
        granular = 1.0 - fields["void_probability"].values[period, z, y, x]
        mean = float(np.nan_to_num(mean * granular) @ self.share)
        return {"mean_kpa": mean, "mean_mpa": mean * KPA_IN_MPA}


def _statistics(values: np.ndarray) -> dict[str, float]:
    """Columns of the stresses (kPa) of all replicates; no scatter from a single one."""
    found = {name: float(value) for name, value in stress_percentiles(values).items()}
    if len(values) > 1:
        found["std"] = float(values.std(ddof=1))
    in_mpa = {f"{name}_mpa": value * KPA_IN_MPA for name, value in found.items()}
    return {f"{name}_kpa": value for name, value in found.items()} | in_mpa


def _where(results: Results, place: str, area: BaseArea) -> dict[str, Any]:
    row = {"place": place, "name": area.name, "x_m": area.x, "y_m": area.y}
    row |= {"width_m": area.width, "length_m": area.length}
    if results.experiment.geometry.origin is not None:
        east, north, _ = corner_of(results.experiment)
        row |= {"easting_m": east + area.x, "northing_m": north + area.y}
    return row


def _drawn_from(results: Results) -> np.ndarray | None:
    """Mean mass (time, drawpoint) in kg that came out of each drawpoint until each reading."""
    replicates = results["replicates"]
    if "drawn_mass" not in replicates:
        return None
    after = np.nan_to_num(replicates["drawn_mass"].values, nan=-1.0)
    point = np.nan_to_num(replicates["drawn_drawpoint"].values, nan=-1.0)
    until = replicates["replicate_mass_drawn"].values
    mass = np.diff(after, axis=1, prepend=0.0)
    drawn = np.zeros((until.shape[1], len(results.experiment.drawpoints)))
    for t in range(len(drawn)):
        out = (after >= 0) & (after <= until[:, t, None] * (1 + 1e-9))
        for d in range(drawn.shape[1]):
            drawn[t, d] = np.where(out & (point == d), mass, 0.0).sum() / len(after)
    return drawn
