"""Two draw experiments beside each other: load cell by load cell, reading by reading.

Stress in MPa. Time is the mass drawn, kg: at a steady rate of draw the two are proportional.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.comparison import Comparison
from pipeline.config.experiment import Experiment
from pipeline.config.load import digest
from pipeline.files.units import KPA_IN_MPA
from pipeline.montecarlo.statistics import SUMMARY, stress_percentiles
from pipeline.simulate.setup import load_cells

PEAK_WITHIN = 1e-3  # a stress that stays the same but for this has its peak when it began
SIDES = ("first", "second")
PLACE = ("x_m", "y_m", "width_m", "length_m")
READING_COLUMNS = (
    *(f"{side}_experiment" for side in SIDES),
    *("load_cell", *PLACE, "reading", "mass_drawn_kg"),
    *(f"{side}_{name}_mpa" for side in SIDES for name in SUMMARY),
    *("difference_mpa", "difference_se_mpa", "difference_kpa"),
)
LOAD_CELL_COLUMNS = (
    *(f"{side}_experiment" for side in SIDES),
    *("load_cell", *PLACE),
    *(
        f"{side}_{name}"
        for side in SIDES
        for name in (
            *("peak_mpa", "peak_p10_mpa", "peak_p90_mpa", "peak_at_mass_drawn_kg"),
            *("share_above", "share_above_p10", "share_above_p90"),
        )
    ),
    *("peak_difference_mpa", "share_above_difference"),
    *("largest_difference_mpa", "largest_difference_at_mass_drawn_kg"),
)


def share_of_time_above(stress: np.ndarray, mass: np.ndarray, threshold: float) -> np.ndarray:
    """Share of the mass drawn at which stress is above a threshold, linear between readings.

    Parameters
    ----------
    stress : (..., time, load_cell), in the unit of `threshold`
    mass : (time) kg drawn at the readings, increasing, at least two

    Returns
    -------
    (..., load_cell), 0 to 1; NaN where a stress is
    """
    over = stress - threshold
    before, after = over[..., :-1, :], over[..., 1:, :]
    rise = np.maximum(before, 0.0) + np.maximum(after, 0.0)
    span = np.abs(before) + np.abs(after)
    # of an interval with ends on both sides, the part on the side above; else all or nothing
    part = np.where(span > 0.0, rise / np.where(span > 0.0, span, 1.0), 0.0)
    part = np.where(np.isfinite(span), part, np.nan)
    return np.einsum("...tc,t->...c", part, np.diff(mass)) / (mass[-1] - mass[0])


def compare(
    comparison: Comparison, experiments: Sequence[Experiment], replicates: Sequence[xr.Dataset]
) -> dict[str, Any]:
    """Content of `comparison.json`.

    Parameters
    ----------
    experiments, replicates : of the two, in the order of the comparison; content of their
        `replicates.nc`

    Returns
    -------
    dict: `mass_drawn_kg` of the readings; `base`, the mean over the whole base, and `load_cells`,
    each with its place and for either side the series of mean and percentiles over replicates,
    the peak of the mean and when it was first reached (but for `PEAK_WITHIN` of it), and the
    share of time above the threshold; `difference`, the second's mean less the first's, with its
    standard error, the replicates of the two being independent.
    """
    mass = replicates[0]["mass_drawn"].values
    cells = load_cells(experiments[0])
    stress = [KPA_IN_MPA * one["vertical_stress"].values for one in replicates]
    base = [KPA_IN_MPA * one["base_vertical_stress"].values[:, :, None] for one in replicates]
    threshold = comparison.threshold_mpa
    return {
        "schema_version": "1.0",
        "comparison": comparison.name,
        "title": comparison.title,
        "threshold_mpa": threshold,
        "experiments": [
            _described(experiment, one.sizes["replicate"])
            for experiment, one in zip(experiments, replicates, strict=True)
        ],
        "mass_drawn_kg": mass,
        "base": _entries(base, mass, threshold)[0],
        "load_cells": [
            {"load_cell": cell.name, **_place(cell), **entry}
            for cell, entry in zip(cells, _entries(stress, mass, threshold), strict=True)
        ],
    }


def _described(experiment: Experiment, count: int) -> dict[str, Any]:
    geometry = experiment.geometry
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "label": "simulated",
        "replicates": count,
        "has_data": experiment.measured is not None,
        "assumed": list(experiment.assumed),
        "width_m": geometry.width,
        "length_m": geometry.length,
        "drawpoints": [{"name": one.name, **_place(one)} for one in experiment.drawpoints],
        "config_sha256": digest(experiment),
    }


def _place(area) -> dict[str, float]:
    return {f"{key}_m": getattr(area, key) for key in ("x", "y", "width", "length")}


def _entries(stress: Sequence[np.ndarray], mass: np.ndarray, threshold: float) -> list[dict]:
    """What is said of each load cell; `stress` of the two (replicate, time, load_cell), MPa."""
    means = [one.mean(axis=0) for one in stress]
    error = np.sqrt(sum(_variance(one) / len(one) for one in stress))
    difference = means[1] - means[0]
    sides = [_side(one, mass, threshold) for one in stress]
    entries = []
    for cell in range(difference.shape[1]):
        both = dict(zip(SIDES, (side[cell] for side in sides), strict=True))
        most = _at_most(np.abs(difference[:, cell]))
        entries.append(
            both
            | {
                "difference_mpa": difference[:, cell],
                "difference_se_mpa": error[:, cell],
                "largest_difference_mpa": difference[most, cell],
                "largest_difference_at_mass_drawn_kg": mass[most],
            }
        )
    return entries


def _variance(stress: np.ndarray) -> np.ndarray:
    return stress.var(axis=0, ddof=1) if len(stress) > 1 else np.full(stress.shape[1:], np.nan)


def _side(stress: np.ndarray, mass: np.ndarray, threshold: float) -> list[dict[str, Any]]:
    """Series, peak and share of time above the threshold of each load cell of one side."""
    series = stress_percentiles(stress)
    share = stress_percentiles(share_of_time_above(stress, mass, threshold))
    found = []
    for cell in range(stress.shape[2]):
        peak = _first_at_peak(series["mean"][:, cell])
        found.append(
            {
                **{f"{name}_mpa": series[name][:, cell] for name in SUMMARY},
                "peak_mpa": series["mean"][peak, cell],
                "peak_p10_mpa": series["p10"][peak, cell],
                "peak_p90_mpa": series["p90"][peak, cell],
                "peak_at_mass_drawn_kg": mass[peak],
                "share_above": share["mean"][cell],
                "share_above_p10": share["p10"][cell],
                "share_above_p90": share["p90"][cell],
            }
        )
    return found


def _first_at_peak(values: np.ndarray) -> int:
    """Index of the first value that is the largest but for `PEAK_WITHIN` of it."""
    largest = values[_at_most(values)]
    return int(np.argmax(values >= largest * (1.0 - PEAK_WITHIN)))


def _at_most(values: np.ndarray) -> int:
    """Index of the first largest value; of the first, where none is a number."""
    return int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))


def reading_rows(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Rows of `comparison.csv` under `READING_COLUMNS`; without a load cell, the whole base."""
    for entry in _with_base(document):
        for t, mass in enumerate(document["mass_drawn_kg"]):
            row = _head(document, entry) | {"reading": t, "mass_drawn_kg": mass}
            for side in SIDES:
                row |= {f"{side}_{name}_mpa": entry[side][f"{name}_mpa"][t] for name in SUMMARY}
            difference = entry["difference_mpa"][t]
            row |= {"difference_mpa": difference, "difference_kpa": difference / KPA_IN_MPA}
            yield row | {"difference_se_mpa": entry["difference_se_mpa"][t]}


def load_cell_rows(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Rows of `load_cells.csv` under `LOAD_CELL_COLUMNS`; without a load cell, the whole base."""
    for entry in _with_base(document):
        row = _head(document, entry)
        for side in SIDES:
            numbers = {k: v for k, v in entry[side].items() if f"{side}_{k}" in LOAD_CELL_COLUMNS}
            row |= {f"{side}_{key}": value for key, value in numbers.items()}
        first, second = (entry[side] for side in SIDES)
        row["peak_difference_mpa"] = second["peak_mpa"] - first["peak_mpa"]
        row["share_above_difference"] = second["share_above"] - first["share_above"]
        for key in ("largest_difference_mpa", "largest_difference_at_mass_drawn_kg"):
            row[key] = entry[key]
        yield row


def _with_base(document: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    yield document["base"]
    yield from document["load_cells"]


def _head(document: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    names = [one["experiment"] for one in document["experiments"]]
    head = {f"{side}_experiment": name for side, name in zip(SIDES, names, strict=True)}
    return head | {key: entry.get(key, "") for key in ("load_cell", *PLACE)}
