"""The sweeps of a replicate, read at its base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pipeline.effects import State
from pipeline.lattice.stress import AT_HOME, BY_CELL, Coupling, read_base, stress_sweep
from pipeline.simulate.readings import KPA, Readings, sensed
from pipeline.simulate.setup import Setup

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
