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
FALLEN = 0.8  # σ_v/σ_v0 below which a load cell counts as fallen
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
    overall = _overall(rows, simulated)
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
        "overall": overall,
        "published": published,
        "statements": _statements(experiment, replicates, calibration, rows, published, overall),
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
        std = values.std(ddof=1) if len(values) > 1 else np.nan
        sd = measured_sd(row, values)
        entry[run] = {
            "mean": values.mean(),
            "std": std,
            "standard_error": std / np.sqrt(len(values)),
            "p05": np.quantile(values, 0.05),
            "p95": np.quantile(values, 0.95),
            "error": error,
            "measured_sd": sd,
            "error_in_sd": error / sd,
        }
    entry["measured_sd"] = entry[CALIBRATED]["measured_sd"]
    return entry


def measured_sd(row: MeasuredRow, values: np.ndarray) -> float:
    """Standard deviation of a measured value about the mean of many packings, in its unit.

    With a `count` it holds the scatter of `values` (replicate) over that number of packings.
    """
    scatter = np.atleast_2d(values.var(ddof=1) if len(values) > 1 else 0.0)
    return float(np.sqrt(row_covariance([row], scatter)[0, 0]))


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
            std = np.array([measured_sd(rows[i], values[:, i]) for i in of_quantity])
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
    if experiment.is_draw:
        entry["facts"] = _facts(experiment, replicates)
        stress = replicates["vertical_stress"].values
        ratio = (stress / stress[:, :1]).mean(axis=0)
        entry["ours_ratio_range"] = [ratio.min(), ratio.max()]
        return entry
    if published.vertical_stress_mean is None:
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
    overall: Mapping[str, Mapping[str, Any]],
) -> list[str]:
    """What a reader must know, in words, each from numbers in the files."""
    statements = list(calibration["messages"])
    if published and published.get("ours_ratio_range") and published["ratio_range"]:
        low, high = published["ours_ratio_range"]
        measured_low, measured_high = published["ratio_range"]
        kept = sum(fact["holds"] for fact in published["facts"])
        statements.append(
            f"Of {len(published['facts'])} published signs and orders {kept} hold. Simulated "
            f"σ_v/σ_v0 runs from {low:.2f} to {high:.2f}, published measurements from "
            f"{measured_low:g} to {measured_high:g}: the highest is {measured_high - high:.2f} "
            f"below the measured one."
        )
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
            mean = replicates["base_vertical_stress"].values[:, -1]
            scatter = mean.std() / mean.mean()
            same = f"{scatter:.1g}" if scatter >= 1e-9 else "less than 1e-9"
            statements.append(
                f"The measured standard deviation {published['measured_std']:.3g} kPa is between "
                f"repeats. The simulated mean over the base does not vary from packing to packing "
                f"({same} of it): weight is conserved, so s cannot produce it. The published "
                f"simulated sd {published['vertical_stress_std']:.3g} kPa stands beside ours "
                f"between places, {published['ours_std']:.2g} kPa at the declared density and "
                f"{published['ours_std_at_that_density']:.2g} kPa at the density above."
            )
    negative = float(replicates["negative_s_share"].mean())
    if negative > 0:
        statements.append(f"{negative:.1%} of the cells have a negative s and spread outwards.")
    if experiment.is_draw:
        statements += _draw_statements(experiment, replicates, rows, overall)
    if not rows:
        statements.append("No measured values are given here: nothing is calibrated or validated.")
    return statements


def _draw_statements(
    experiment: Experiment,
    replicates: xr.Dataset,
    rows: Sequence[MeasuredRow],
    overall: Mapping[str, Mapping[str, Any]],
) -> list[str]:
    """What the draw did, what R and E_min are worth, and what the model lacks (§4)."""
    statements = []
    for drawpoint, missing in _shortfalls(experiment, replicates):
        statements.append(
            f"Drawpoint {drawpoint} ran empty or hung up: {missing:.3g} kg of its schedule could "
            f"not be drawn on average."
        )
    hang_ups = float(replicates["hang_ups"].mean())
    if hang_ups > 0:
        statements.append(f"{hang_ups:.3g} voids hung up below other voids on average.")
    series = [row for row in rows if row.quantity == "vertical_stress" and row.load_cell]
    if not series:
        return statements
    error = {run: entry["vertical_stress"]["mean_absolute_error"] for run, entry in overall.items()}
    before = np.array([row.value for row in series if not row.mass_drawn])
    ratio = error[CALIBRATED] / error["without_zone"]
    text = (
        f"R and E_min change the mean absolute error of the load cells from "
        f"{error['without_zone']:.3g} to {error[CALIBRATED]:.3g} kPa: a factor {ratio:.2f}."
    )
    if len(before) > 1:
        text += (
            f" The {experiment.data_label} values before draw scatter by {before.std(ddof=1):.2g} "
            f"kPa from cell to cell ({before.std(ddof=1) / before.mean():.0%} of their mean)."
        )
    statements.append(text)
    last = max(row.mass_drawn for row in series)
    final = [row for row in series if row.mass_drawn == last]
    if last > 0 and before.size:
        measured = np.mean([row.value for row in final]) / before.mean()
        ours = simulated_rows(experiment, replicates, final).mean()
        first = [row for row in series if not row.mass_drawn]
        simulated = ours / simulated_rows(experiment, replicates, first).mean()
        statements.append(
            f"Over all load cells the {experiment.data_label} load is {measured:.2f} times that "
            f"before draw after {last:.3g} kg, simulated {simulated:.2f} times: in the model the "
            f"load that a movement zone does not pass on leaves the system, and a zone that is no "
            f"longer drawn does not recover."
        )
    return statements


def _facts(experiment: Experiment, replicates: xr.Dataset) -> list[dict]:
    """Published signs and orders of σ_v/σ_v0, checked on the mean over replicates."""
    stress = replicates["vertical_stress"].values
    ratios = stress / stress[:, :1]
    mean = ratios.mean(axis=0)
    error = ratios.std(axis=0, ddof=1) / np.sqrt(len(ratios)) if len(ratios) > 1 else 0 * mean
    mass = replicates["mass_drawn"].values
    names = [cell.name for cell in experiment.load_cells]
    facts = []
    for fact in experiment.published.facts:
        cells = [names.index(name) for name in fact.load_cells]
        ours = mean[:, cells]
        highest = ours.max(axis=0)
        fallen = [
            mass[below[0]] if len(below) else np.inf
            for below in (np.flatnonzero(column < FALLEN) for column in ours.T)
        ]
        clearly_up = (mean - 2 * error > 1.0).any(axis=0)[cells].all()
        holds = {
            "rises": clearly_up,
            "falls": (mean + 2 * error < 1.0)[-1, cells].all(),
            "rises_then_falls": clearly_up and (ours[-1] < highest - 2 * error[-1, cells]).all(),
            "falls_in_order": np.isfinite(fallen).all() and (np.diff(fallen) >= 0).all(),
        }[fact.change]
        facts.append(
            {
                "change": fact.change,
                "load_cells": list(fact.load_cells),
                "source": fact.source,
                "holds": bool(holds),
                "highest": highest,
                "highest_at_mass_drawn": mass[ours.argmax(axis=0)],
                "lowest": ours.min(axis=0),
                "last": ours[-1],
                "falls_below_0.8_at_mass_drawn": fallen,
            }
        )
    return facts


def _shortfalls(experiment: Experiment, replicates: xr.Dataset) -> list[tuple[str, float]]:
    if "drawpoint_shortfall" not in replicates:
        return []
    missing = replicates["drawpoint_shortfall"].values.mean(axis=0)
    return [
        (point.name, kg) for point, kg in zip(experiment.drawpoints, missing, strict=True) if kg > 0
    ]
