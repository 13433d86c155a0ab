"""Measured rows and what a simulation says of each: one place that matches the two."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.simulate.readings import Readings, sensed
from pipeline.simulate.setup import Setup, load_cells

STRESS = ("vertical_stress", "vertical_stress_ratio")
SPREAD = ("vertical_stress_spatial_std",)
GEOMETRY = ("movement_zone_height", "movement_zone_width")


def simulated_rows(
    experiment: Experiment,
    replicates: xr.Dataset,
    rows: Sequence[MeasuredRow],
    suffix: str = "",
) -> np.ndarray:
    """Simulated counterpart of each measured row in each replicate, (replicate, row) float64.

    In the row's unit. `replicates` is the content of `replicates.nc`, read at these rows'
    heights and masses; `suffix` chooses among its variables ("_as_declared").
    """
    names = [cell.name for cell in load_cells(experiment)]
    columns = []
    for row in rows:
        t = reading_index(experiment, replicates, row)
        if row.quantity == "vertical_stress_spatial_std":
            columns.append(replicates[f"base_vertical_stress_std{suffix}"].values[:, t])
        elif row.quantity in GEOMETRY:
            columns.append(replicates[f"{row.quantity}{suffix}"].values[:, t])
        else:
            if row.load_cell is None:
                stress = replicates[f"base_vertical_stress{suffix}"].values
            else:
                cell = names.index(row.load_cell)
                stress = replicates[f"vertical_stress{suffix}"].values[:, :, cell]
            ratio = row.quantity == "vertical_stress_ratio"
            columns.append(stress[:, t] / stress[:, 0] if ratio else stress[:, t])
    return np.column_stack(columns) if columns else np.empty((replicates.sizes["replicate"], 0))


def only_measured(setup: Setup, rows: Sequence[MeasuredRow]) -> Setup:
    """The setup read at nothing but what the rows need (and before draw, for ratios)."""
    height = setup.experiment.geometry.height
    levels = {height if row.fill_height is None else row.fill_height for row in rows}
    masses = {0.0} | {row.mass_drawn for row in rows if row.mass_drawn is not None}
    return replace(
        setup,
        to_the_end=False,
        fill_levels=tuple(h for h in setup.fill_levels if _near(h, levels)),
        true_levels=tuple(
            true
            for h, true in zip(setup.fill_levels, setup.true_levels, strict=True)
            if _near(h, levels)
        ),
        masses=tuple(m for m in setup.masses if _near(m, masses)),
    )


def _near(value: float, wanted: set[float]) -> bool:
    return any(math.isclose(value, other, rel_tol=1e-8) for other in wanted)


def reading_index(experiment: Experiment, replicates: xr.Dataset, row: MeasuredRow) -> int:
    """Index of the reading at a row's mass drawn or fill height."""
    if experiment.is_draw:
        times, wanted = replicates["mass_drawn"].values, row.mass_drawn or 0.0
    else:
        times, wanted = replicates["fill_height"].values, row.fill_height
        wanted = experiment.geometry.height if wanted is None else wanted
    return int(np.argmin(np.abs(times - wanted)))


class RowReader:
    """Reads the counterparts of measured rows straight from a replicate's readings.

    `values` keeps what rows need of a replicate as the ground has it, so that the sensors' effects
    can be applied later, to many replicates at once.
    """

    def __init__(self, setup: Setup, rows: Sequence[MeasuredRow]):
        experiment = setup.experiment
        clock = "mass_drawn" if setup.masses else "fill_height"
        readings = xr.Dataset({clock: ("time", np.array(setup.masses or setup.fill_levels))})
        self.times = np.array([reading_index(experiment, readings, r) for r in rows], dtype=int)
        self.rows = tuple(rows)
        self._shape = setup.times, len(setup.footprints)
        names = [cell.name for cell in load_cells(experiment)]
        self._cell = [names.index(r.load_cell) if r.load_cell else -1 for r in rows]

    def values(self, readings: Readings) -> np.ndarray:
        """Load cells at all times, then the other quantities, each in one (time) block, flat.

        A replicate that stops early has NaN after its last reading.
        """
        whole = np.full((self._shape[0], self._shape[1] + 4), np.nan)
        cells, count = readings.vertical_stress, len(readings.vertical_stress)
        whole[:count, : cells.shape[1]] = cells
        others = (
            readings.base_vertical_stress,
            readings.base_vertical_stress_std,
            readings.movement_zone_height,
            readings.movement_zone_width,
        )
        for column, other in enumerate(others, start=cells.shape[1]):
            if other is not None:
                whole[:count, column] = other
        return whole.ravel()

    def sensed(self, values: np.ndarray, setup: Setup) -> np.ndarray:
        """Rows (replicate, row) of `values` (replicate, flat), as sensors give them."""
        times, cells = self._shape
        whole = values.reshape(len(values), times, cells + 4).copy()
        if setup.effects:
            for one in whole:
                one[:, :cells] = sensed(setup, one[:, :cells])
        places = {"vertical_stress_spatial_std": 1, "movement_zone_height": 2}
        places["movement_zone_width"] = 3
        columns = []
        for row, t, cell in zip(self.rows, self.times, self._cell, strict=True):
            column = cell if cell >= 0 else cells + places.get(row.quantity, 0)
            if row.quantity == "vertical_stress_ratio":
                columns.append(whole[:, t, column] / whole[:, 0, column])
            else:
                columns.append(whole[:, t, column])
        return np.column_stack(columns) if columns else np.empty((len(values), 0))

    @property
    def before_draw(self) -> np.ndarray:
        """Index of a row of the same place and quantity before draw for each row; −1: none."""
        first = {
            (row.load_cell, row.quantity): i
            for i, row in enumerate(self.rows)
            if self.times[i] == 0
        }
        return np.array([first.get((row.load_cell, row.quantity), -1) for row in self.rows])


def row_covariance(rows: Sequence[MeasuredRow], scatter: np.ndarray) -> np.ndarray:
    """Covariance (row, row) of the measured values about the mean of many packings.

    `std`² of each row, `std_shared` products among rows of one load cell and quantity, and for
    rows with a `count` n the replicates' `scatter` (row, row) divided by n.
    """
    covariance = np.diag([row.std**2 for row in rows])
    for i, a in enumerate(rows):
        for j, b in enumerate(rows):
            if (a.load_cell, a.quantity) == (b.load_cell, b.quantity):
                covariance[i, j] += a.std_shared * b.std_shared
            if a.count and b.count:
                covariance[i, j] += scatter[i, j] / np.sqrt(a.count * b.count)
    return covariance
