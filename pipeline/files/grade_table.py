"""Grade and dilution curves of an experiment as a table: by drawpoint and mass drawn."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import xarray as xr

from pipeline.files.atomic import write_text
from pipeline.files.tables import as_csv
from pipeline.files.units import KG_IN_T
from pipeline.montecarlo.statistics import SUMMARY

COLUMNS = (
    "experiment",
    "drawpoint",
    "bin",
    "mass_from_kg",
    "mass_to_kg",
    "mass_from_t",
    "mass_to_t",
    "quantity",
    "unit",
    *SUMMARY,
    *(f"cumulative_{statistic}" for statistic in SUMMARY),
    "replicates",
)


def write_grade_table(curves: xr.Dataset, experiment: str, path: str | Path) -> None:
    """Write the table of `grade_rows` as CSV, whole."""
    write_text(path, as_csv(COLUMNS, grade_rows(curves, experiment)))


def grade_rows(curves: xr.Dataset, experiment: str) -> Iterator[dict[str, Any]]:
    """A row for each drawpoint, bin of the mass drawn there, and quantity: a grade or dilution.

    Mean and percentiles are over `replicates`, those in which something was drawn in the bin: of
    what was drawn in it, and of all that was drawn until its end. `curves` are those of
    `montecarlo.grade.grade_curves`; `unit` is the grade's, 1 for dilution (share by mass).
    """
    for place, name in enumerate(curves["drawpoint_name"].values):
        for k in range(curves.sizes["mass_bin"]):
            at = {"drawpoint": place, "mass_bin": k}
            ends = {key: float(curves[key][at]) for key in ("mass_from", "mass_to")}
            shared = {"experiment": experiment, "drawpoint": name.decode(), "bin": k + 1}
            shared |= {f"{key}_kg": mass for key, mass in ends.items()}
            shared |= {f"{key}_t": mass * KG_IN_T for key, mass in ends.items()}
            for quantity, variable in quantities(curves).items():
                unit = curves[f"drawn_{variable}_mean"].attrs.get("units", "1")
                row = shared | {"quantity": quantity, "unit": unit}
                for statistic in SUMMARY:
                    row[statistic] = float(curves[f"drawn_{variable}_{statistic}"][at])
                    until = float(curves[f"cumulative_{variable}_{statistic}"][at])
                    row[f"cumulative_{statistic}"] = until
                yield row | {"replicates": int(curves["replicates_in_bin"][at])}


def quantities(curves: xr.Dataset) -> dict[str, str]:
    """Variable of each quantity, without its prefix and suffix: the grades, then dilution."""
    ends = "drawn_grade_", "_mean"
    grades = [
        str(name).removeprefix(ends[0]).removesuffix(ends[1])
        for name in curves
        if str(name).startswith(ends[0]) and str(name).endswith(ends[1])
    ]
    return {name: f"grade_{name}" for name in grades} | {"dilution": "dilution"}
