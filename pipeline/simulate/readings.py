"""The sweeps of a replicate, and what the base and its load cells read of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pipeline.effects import Reading, State
from pipeline.lattice.stress import AT_HOME, BY_CELL, Coupling, read_base, stress_sweep
from pipeline.simulate.setup import Setup, load_cells

KPA = 1e-3
BALANCE_TOLERANCE = 1e-6


class Sweep(NamedTuple):
    """One sweep: what it took, see `stress.stress_sweep`, and the loads that it returned, N."""

    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray
    code: np.ndarray
    relaxation: float
    top_fraction: float
    coupling: Coupling
    load: np.ndarray
    base_load: np.ndarray


# called at each reading with (time index, its sweep, the lattice as effects left it)
Inspector = Callable[[int, Sweep, State], None]


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


class WeightBalanceError(RuntimeError):
    """Weight put in differs from weight carried and shed by more than `BALANCE_TOLERANCE`."""


@dataclass
class Recorder:
    """Runs the sweeps of a replicate and keeps what the base reads."""

    setup: Setup
    keeps_load: bool
    inspect: Inspector | None
    readings: Readings = field(init=False)

    def __post_init__(self):
        times = self.setup.times
        self.readings = Readings(
            vertical_stress=np.zeros((times, len(self.setup.footprints))),
            base_vertical_stress=np.zeros(times),
            base_vertical_stress_std=np.zeros(times),
            weight_balance_error=np.zeros(times),
            negative_s_share=np.nan,
        )
        if self.setup.experiment.keep_fields:
            shape = (times, *self.setup.lattice.shape)
            self.readings.replicate_vertical_stress = np.full(shape, np.nan, dtype=np.float32)

    @property
    def needs_state(self) -> bool:
        """Whether someone wants the lattice as a `State`."""
        return self.inspect is not None or self.setup.acts_on("state")

    def finish(self) -> Readings:
        """The readings, as the sensors give them."""
        readings = self.readings
        readings.vertical_stress = sensed(self.setup, readings.vertical_stress)
        return readings

    def sweep(
        self,
        t,
        cells,
        code,
        relaxation,
        coupling,
        top_fraction,
        state=None,
        moved=AT_HOME,
        ranked=BY_CELL,
    ):
        """One sweep, read at time `t`; returns the carried load (z, y, x) in N where kept."""
        setup, readings = self.setup, self.readings
        fields = readings.replicate_vertical_stress
        keep = self.keeps_load or self.inspect is not None or fields is not None
        shape = code.shape if keep else (0, 0, 0)
        load = np.zeros(shape, dtype=setup.cell_weight.dtype)
        base_load = np.zeros(code.shape[1:])
        weight, shed = stress_sweep(
            *cells, code, relaxation, top_fraction, load, base_load, coupling, moved, ranked
        )
        error = abs(weight - base_load.sum() - shed) / weight
        if not error <= BALANCE_TOLERANCE:
            raise WeightBalanceError(
                f"{setup.experiment.name}: weight balance is off by {error:.3g} of the weight at "
                f"reading {t}; at most {BALANCE_TOLERANCE:g} is allowed"
            )
        kpa = KPA / setup.lattice.cell_area
        mean, std = read_base(
            base_load, setup.base, setup.footprints, kpa, readings.vertical_stress[t]
        )
        readings.base_vertical_stress[t] = mean
        readings.base_vertical_stress_std[t] = std
        readings.weight_balance_error[t] = error
        if fields is not None:
            fields[t, : len(load)] = load / setup.lattice.cell_area * KPA
        if self.inspect is not None:
            self.inspect(
                t, Sweep(*cells, code, relaxation, top_fraction, coupling, load, base_load), state
            )
        return load


def sensed(setup: Setup, stress: np.ndarray) -> np.ndarray:
    """What the load cells read of stresses (time, load_cell) in kPa, through the sensor effects."""
    names = [cell.name for cell in load_cells(setup.experiment)]
    for one in setup.effects:
        if one.effect.readings is not None and not one.is_neutral:
            masses = np.array(setup.masses or np.zeros(setup.times))
            reading = Reading(stress, names.index(one.load_cell), masses)
            stress = one.effect.readings(reading, one.values)
    return stress
