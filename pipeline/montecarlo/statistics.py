"""Statistics over replicates: mean, sd, standard error, quantiles and the count."""

from __future__ import annotations

import numpy as np
import xarray as xr

PERCENTILES = (10, 50, 90)  # that planners ask for
SUMMARY = ("mean", *(f"p{percent}" for percent in PERCENTILES))
SKIPPED = {"extraction", "x", "y", "z"}  # variables on these dims stay with the replicates


def replicate_statistics(replicates: xr.Dataset) -> xr.Dataset:
    """Reduce `replicates.nc` over its replicates.

    Each variable NAME on (replicate, ...) becomes `NAME_mean`, `_std` (n − 1), `_se`
    (std / √n), `_p05`, `_p50` and `_p95` on the remaining dims, float64, beside
    `replicate_count`; variables without the dim stay. With one replicate std and se are NaN.
    """
    n = replicates.sizes["replicate"]
    data = {"replicate_count": ((), np.int32(n))}
    for name, variable in replicates.data_vars.items():
        if SKIPPED & set(variable.dims):
            continue
        if "replicate" not in variable.dims:
            data[name] = variable
            continue
        dims, values = variable.dims[1:], variable.values
        std = values.std(axis=0, ddof=1) if n > 1 else np.full(values.shape[1:], np.nan)
        p05, p50, p95 = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
        parts = {
            "mean": values.mean(axis=0),
            "std": std,
            "se": std / np.sqrt(n),
            "p05": p05,
            "p50": p50,
            "p95": p95,
        }
        data |= {f"{name}_{suffix}": (dims, value) for suffix, value in parts.items()}
    coords = {
        name: value
        for name, value in replicates.coords.items()
        if not (SKIPPED | {"replicate"}) & set(value.dims)
    }
    coords["realization"] = ((), np.int32(0))
    return xr.Dataset(data, coords=coords)


def stress_percentiles(stress: np.ndarray) -> dict[str, np.ndarray]:
    """Mean and `PERCENTILES` over the first axis (replicate) of any stress, in its unit.

    Percentiles are interpolated linearly between the ordered replicates.
    """
    found = np.percentile(stress, PERCENTILES, axis=0)
    named = {f"p{percent}": values for percent, values in zip(PERCENTILES, found, strict=True)}
    return {"mean": stress.mean(axis=0)} | named
