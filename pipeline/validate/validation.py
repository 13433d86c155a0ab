"""An experiment against its measured rows and against what was published beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.files.netcdf import AS_DECLARED, WITHOUT_ZONE
from pipeline.observe import row_covariance, simulated_rows

CALIBRATED, DECLARED = "calibrated", "as_declared"
SUFFIXES = {CALIBRATED: "", DECLARED: AS_DECLARED, "without_zone": WITHOUT_ZONE}
REPRODUCED = 0.01  # relative difference up to which a published number counts as reproduced
KEY = ("quantity", "load_cell", "fill_height", "mass_drawn")


def validate(
    experiment: Experiment,
    replicates: xr.Dataset,
    calibration: Mapping[str, Any],
    rows: Sequence[MeasuredRow],
) -> dict:
    """Compare every measured row with the simulation, calibrated and as declared.

    Parameters
    ----------
    replicates : content of `replicates.nc`
    calibration : content of `calibration.json`

    Returns
    -------
    dict, the content of `validation.json`: `readings` with one entry for each row and in it one
    for each run (calibrated; as declared, where that differs; without R and E_min in a draw
    experiment); `overall` `bias`, `mean_absolute_error` and `rmse` for each quantity in its
    unit and, with `_in_sd`, in measured standard deviations; `published` numbers beside ours;
    `statements` in words. A row that the calibration was fitted to is marked
    `used_in_calibration`.
    """
    suffixes = {
        run: suffix
        for run, suffix in SUFFIXES.items()
        if f"base_vertical_stress{suffix}" in replicates
    }
    simulated = {
        run: simulated_rows(experiment, replicates, rows, suffix)
        for run, suffix in suffixes.items()
    }
    used = {tuple(target[key] for key in KEY) for target in calibration["targets"]}
    published = _published(experiment, replicates, suffixes)
    readings = [
        _reading(row, {run: values[:, i] for run, values in simulated.items()}, used)
        for i, row in enumerate(rows)
    ]
    return {
        "experiment": experiment.name,
        "schema_version": "1.0",
        "data_label": experiment.data_label,
        "replicate_count": replicates.sizes["replicate"],
        "runs": {
            CALIBRATED: calibration["parameters_used"],
            DECLARED: calibration["declared"],
        },
        "readings": readings,
        "overall": _overall(rows, simulated),
        "published": published,
        "statements": _statements(experiment, replicates, calibration, rows, published),
    }


def _reading(row: MeasuredRow, simulated: Mapping[str, np.ndarray], used: set) -> dict:
    entry = {
        "quantity": row.quantity,
        "unit": QUANTITIES[row.quantity],
        "load_cell": row.load_cell,
        "fill_height": row.fill_height,
        "mass_drawn": row.mass_drawn,
        "measured": row.value,
        "measured_std": row.std,
        "measured_std_shared": row.std_shared,
        "count": row.count,
    }
    entry["used_in_calibration"] = tuple(entry[key] for key in KEY) in used
    for run, values in simulated.items():
        error = values.mean() - row.value
        scatter = np.atleast_2d(values.var(ddof=1) if len(values) > 1 else 0.0)
        total = float(np.sqrt(row_covariance([row], scatter)[0, 0]))
        entry[run] = {
            "mean": values.mean(),
            "std": values.std(ddof=1) if len(values) > 1 else np.nan,
            "standard_error": values.std(ddof=1) / np.sqrt(len(values))
            if len(values) > 1
            else np.nan,
            "p05": np.quantile(values, 0.05),
            "p95": np.quantile(values, 0.95),
            "error": error,
            "error_in_sd": error / total,
        }
        entry["measured_sd"] = total
    return entry


def _overall(rows: Sequence[MeasuredRow], simulated: Mapping[str, np.ndarray]) -> dict:
    """Errors for each run and quantity; each in its unit and in measured sd's."""
    overall: dict[str, dict] = {}
    for run, values in simulated.items():
        overall[run] = {}
        for quantity, unit in QUANTITIES.items():
            of_quantity = [i for i, row in enumerate(rows) if row.quantity == quantity]
            if not of_quantity:
                continue
            measured = np.array([rows[i].value for i in of_quantity])
            std = np.array([np.hypot(rows[i].std, rows[i].std_shared) for i in of_quantity])
            error = values[:, of_quantity].mean(axis=0) - measured
            overall[run][quantity] = {
                "unit": unit,
                "n": len(of_quantity),
                **_errors(error, ""),
                **_errors(error / std, "_in_sd"),
            }
    return overall


def _errors(error: np.ndarray, suffix: str) -> dict[str, float]:
    return {
        f"bias{suffix}": error.mean(),
        f"mean_absolute_error{suffix}": np.abs(error).mean(),
        f"rmse{suffix}": np.sqrt((error**2).mean()),
    }


def _published(
    experiment: Experiment, replicates: xr.Dataset, suffixes: Mapping[str, str]
) -> dict | None:
    """Published simulation beside ours with the declared parameters, for a static experiment.

    Base stress is proportional to the bulk density, so the density at which the published mean
    comes out is exact.
    """
    published = experiment.published
    if published is None:
        return None
    entry: dict[str, Any] = published.model_dump(mode="json")
    if published.vertical_stress_mean is None or experiment.is_draw:
        return entry
    suffix = suffixes.get(DECLARED, "")
    mean = replicates[f"base_vertical_stress{suffix}"].values[:, -1].mean()
    std = replicates[f"base_vertical_stress_std{suffix}"].values[:, -1].mean()
    factor = published.vertical_stress_mean / mean
    entry |= {
        "ours_mean": mean,
        "ours_std": std,
        "mean_ratio": 1.0 / factor,
        "mean_reproduced": bool(abs(1.0 / factor - 1.0) <= REPRODUCED),
        "density_declared": experiment.material.bulk_density,
        "density_that_gives_published_mean": experiment.material.bulk_density * factor,
        "ours_std_at_that_density": std * factor,
    }
    return entry


def _statements(
    experiment: Experiment,
    replicates: xr.Dataset,
    calibration: Mapping[str, Any],
    rows: Sequence[MeasuredRow],
    published: Mapping[str, Any] | None,
) -> list[str]:
    """What a reader must know, in words, each from numbers in the files."""
    statements = list(calibration["messages"])
    if published and "ours_mean" in published:
        ours, theirs = published["ours_mean"], published["vertical_stress_mean"]
        if published["mean_reproduced"]:
            statements.append(
                f"With the published parameters the published simulated mean is reproduced: "
                f"{ours:.4g} kPa, published {theirs:.4g} kPa."
            )
        else:
            density = published["density_that_gives_published_mean"]
            statements.append(
                f"With the published parameters and the declared bulk density "
                f"{published['density_declared']:.4g} kg/m³ the published simulated mean is not "
                f"reproduced: {ours:.4g} kPa, published {theirs:.4g} kPa. A bulk density of "
                f"{density:.4g} kg/m³ would reproduce it, with a spatial standard deviation of "
                f"{published['ours_std_at_that_density']:.3g} kPa."
            )
        if published.get("measured_std_between") == "repeats":
            scatter = replicates["base_vertical_stress"].values[:, -1].std(ddof=1)
            statements.append(
                f"The measured standard deviation {published['measured_std']:.3g} kPa is between "
                f"repeats. The simulated mean over the base does not vary from packing to packing "
                f"(standard deviation {scatter:.1g} kPa): weight is conserved, so s cannot produce "
                f"it. The published simulated standard deviation "
                f"{published['vertical_stress_std']:.3g} kPa stands beside ours between places, "
                f"{published['ours_std']:.2g} kPa at the declared density and "
                f"{published['ours_std_at_that_density']:.2g} kPa at the density above."
            )
    negative = float(replicates["negative_s_share"].mean())
    if negative > 0:
        statements.append(f"{negative:.1%} of the cells have a negative s and spread outwards.")
    for drawpoint, missing in _shortfalls(experiment, replicates):
        statements.append(
            f"Drawpoint {drawpoint} ran empty or hung up: {missing:.3g} kg of its schedule could "
            f"not be drawn on average."
        )
    if not rows:
        statements.append("Nothing was measured: nothing is calibrated or validated.")
    return statements


def _shortfalls(experiment: Experiment, replicates: xr.Dataset) -> list[tuple[str, float]]:
    if "drawpoint_shortfall" not in replicates:
        return []
    missing = replicates["drawpoint_shortfall"].values.mean(axis=0)
    return [
        (point.name, kg) for point, kg in zip(experiment.drawpoints, missing, strict=True) if kg > 0
    ]
