"""Base stress of each load cell at each reading, for planners: percentiles over replicates."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np
import xarray as xr

PERCENTILES = (10, 50, 90)
MPA = 1e-3  # of a kPa
COLUMNS = (
    "load_cell",
    "x_m",
    "y_m",
    "width_m",
    "length_m",
    "reading",
    "mass_drawn_kg",
    "fill_height_m",
    "replicates",
    *(f"{name}_{unit}" for unit in ("kpa", "mpa") for name in ("mean", "p10", "p50", "p90")),
)


def stress_percentiles(stress: np.ndarray) -> dict[str, np.ndarray]:
    """Mean and percentiles over the first axis (replicate) of any stress, in its unit.

    Percentiles are interpolated linearly between the ordered replicates.
    """
    low, middle, high = np.percentile(stress, PERCENTILES, axis=0)
    return {"mean": stress.mean(axis=0), "p10": low, "p50": middle, "p90": high}


def load_cell_names(replicates: xr.Dataset) -> list[str]:
    """Names of the load cells in `replicates.nc`, in order."""
    return [name.decode() for name in replicates["load_cell_name"].values.astype("S")]


def base_stress_rows(replicates: xr.Dataset) -> Iterator[dict[str, float | str]]:
    """A row under `COLUMNS` for each load cell and reading of `replicates.nc`."""
    statistics = stress_percentiles(replicates["vertical_stress"].values)
    clock = "mass_drawn" if "mass_drawn" in replicates else "fill_height"
    unit = "kg" if clock == "mass_drawn" else "m"
    places = {
        f"{key}_m": replicates[f"load_cell_{key}"].values for key in ("x", "y", "width", "length")
    }
    for i, name in enumerate(load_cell_names(replicates)):
        for t, at in enumerate(replicates[clock].values):
            row = dict.fromkeys(COLUMNS, "") | {"load_cell": name, "reading": t}
            row |= {key: values[i] for key, values in places.items()}
            row |= {f"{clock}_{unit}": at, "replicates": replicates.sizes["replicate"]}
            for key, values in statistics.items():
                row |= {f"{key}_kpa": values[t, i], f"{key}_mpa": MPA * values[t, i]}
            yield row


def as_csv(columns, rows) -> str:
    """Rows (dicts) as CSV with a header; numbers with ten significant digits, NaN left empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    return text.getvalue()


def _cell(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return f"{value:.10g}" if np.isfinite(value) else ""
