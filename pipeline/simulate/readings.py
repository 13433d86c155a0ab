"""What the base and its load cells read in a replicate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.effects import Reading
from pipeline.simulate.setup import Setup, load_cells

KPA = 1e-3


@dataclass
class Readings:
    """What one replicate returns; dims (time, load_cell), (time) or (drawpoint).

    Stresses and their spatial standard deviation over the base (population, over ground
    columns) in kPa, lengths in m, masses in kg; `weight_balance_error` is relative to the weight
    put in; `negative_s_share` is the share of cells with s < 0. In a draw experiment
    `drawn_cell`, `drawn_drawpoint` and `drawn_mass` are the extraction record: which initial
    cell came out of which drawpoint at which drawn mass. `replicate_vertical_stress`
    (time, z, y, x) in kPa is kept where the experiment asks for it.
    """

    vertical_stress: np.ndarray
    base_vertical_stress: np.ndarray
    base_vertical_stress_std: np.ndarray
    weight_balance_error: np.ndarray
    negative_s_share: float
    movement_zone_height: np.ndarray | None = None
    movement_zone_width: np.ndarray | None = None
    replicate_mass_drawn: np.ndarray | None = None
    drawpoint_shortfall: np.ndarray | None = None
    hang_ups: int = 0
    drawn_cell: np.ndarray | None = None
    drawn_drawpoint: np.ndarray | None = None
    drawn_mass: np.ndarray | None = None
    replicate_vertical_stress: np.ndarray | None = None


def sensed(setup: Setup, stress: np.ndarray) -> np.ndarray:
    """What the load cells read of stresses (time, load_cell) in kPa, through the sensor effects."""
    names = [cell.name for cell in load_cells(setup.experiment)]
    for one in setup.effects:
        if one.effect.readings is not None and not one.is_neutral:
            masses = np.array(setup.masses or np.zeros(setup.times))
            reading = Reading(stress, names.index(one.load_cell), masses)
            stress = one.effect.readings(reading, one.values)
    return stress
