"""Measured rows and what a simulation says of each: one place that matches the two."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.simulate import load_cells

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


def reading_index(experiment: Experiment, replicates: xr.Dataset, row: MeasuredRow) -> int:
    """Index of the reading at a row's mass drawn or fill height."""
    if experiment.is_draw:
        times, wanted = replicates["mass_drawn"].values, row.mass_drawn or 0.0
    else:
        times, wanted = replicates["fill_height"].values, row.fill_height
        wanted = experiment.geometry.height if wanted is None else wanted
    return int(np.argmin(np.abs(times - wanted)))


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
