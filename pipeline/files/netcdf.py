"""NetCDF as the contract asks for it: CF metadata and encoding from `variables.yaml`."""

from __future__ import annotations

import json
import platform
import re
import subprocess
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from pipeline import __version__
from pipeline.config.experiment import Experiment
from pipeline.config.load import digest, resolved
from pipeline.config.study import Study
from pipeline.files.atomic import whole_file

FORMAT_VERSION = "1.0"
REFERENCES = "Gómez & Castro 2022, IJRMMS 154, 105124, doi:10.1016/j.ijrmms.2022.105124"
COORDINATES = ("x", "y", "z", "time", "replicate")
STATISTICS = {  # suffix: (words, cell method over replicates)
    "mean": ("mean over replicates", "realization: mean"),
    "std": ("standard deviation over replicates", "realization: standard_deviation"),
    "se": ("standard error of the mean over replicates", None),
    "p05": ("5th percentile over replicates", None),
    "p10": ("10th percentile over replicates", None),
    "p50": ("median over replicates", "realization: median"),
    "p90": ("90th percentile over replicates", None),
    "p95": ("95th percentile over replicates", None),
}
_NAMED = re.compile(r"(\w*grade)_([A-Za-z][A-Za-z0-9]*)(_\w+)?")  # as grade_NAME in the table
OWN = "own"  # in the table: what the variable itself brings
AS_DECLARED, WITHOUT_ZONE = "_as_declared", "_without_zone"
PACKING_ONLY, EFFECTS_IMPLIED = "_packing_only", "_effects_implied"
VARIANTS = {  # suffix of readings of the same replicates with other parameters: words
    AS_DECLARED: "with the parameters as declared",
    WITHOUT_ZONE: "with R = 1 and E_min = E, the movement zone as stagnant ground",
    PACKING_ONLY: "with parameters and effects at their best values",
    EFFECTS_IMPLIED: "with parameters drawn, and effects as these imply",
}


@cache
def variable_table() -> dict[str, dict[str, Any]]:
    """Metadata of each variable by name, from `variables.yaml`."""
    text = files(__package__).joinpath("variables.yaml").read_text("utf-8")
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # faster


def describe(name: str, statistics: bool = False) -> dict[str, Any]:
    """Metadata of a variable, of one of its statistics, or of a variant of either.

    With `statistics`, a suffix of `STATISTICS` is read as such first: `base_vertical_stress_std`
    is the scatter between places in `replicates.nc` and that between replicates in
    `statistics.nc`.

    Raises
    ------
    KeyError
        If neither `variables.yaml` nor the statistics of what is there know the name.
    """
    table = variable_table()
    base, _, suffix = name.rpartition("_")
    if name in table and not (statistics and base in table and suffix in STATISTICS):
        return dict(table[name])
    named = _NAMED.fullmatch(name)
    if named and named[2] != "NAME":
        entry = describe(f"{named[1]}_NAME{named[3] or ''}", statistics)
        entry["long_name"] = entry["long_name"].replace("NAME", named[2])
        entry["ancillary"] = [
            other.replace("NAME", named[2]) for other in entry.get("ancillary", ())
        ]
        return entry
    for variant, words in VARIANTS.items():
        if variant in name:
            entry = describe(name.replace(variant, ""), statistics)
            return entry | {
                "long_name": f"{entry['long_name']}, {words}",
                "ancillary": [
                    other
                    if other == "replicate_count"
                    else f"{variant}_".join(other.rsplit("_", 1))
                    for other in entry.get("ancillary", ())
                ],
            }
    if base not in table or suffix not in STATISTICS:
        raise KeyError(f"{name} is not in variables.yaml")
    words, method = STATISTICS[suffix]
    entry = dict(table[base])
    methods = [m for m in (entry.pop("cell_methods", None), method) if m]
    entry |= {"long_name": f"{entry['long_name']}: {words}", "dtype": "float64"}
    if methods:
        entry["cell_methods"] = " ".join(methods)
    if suffix == "mean":
        entry["ancillary"] = [f"{base}_std", f"{base}_se", "replicate_count"]
    return entry


def write_dataset(
    path: str | Path,
    dataset: xr.Dataset,
    settings: Experiment | Study,
    rule: str,
    title: str,
    inputs: Iterable[str | Path] = (),
    statistics: bool = False,
    attributes: Mapping[str, Any] | None = None,
) -> None:
    """Write a dataset whole, with metadata, encoding and provenance.

    `inputs` are the netCDF files that it was made from: their history lines come first.
    Metadata of a variable comes from `describe`, which raises KeyError for an unknown name.
    """
    dataset = dataset.copy()
    for axis in ("x", "y", "z"):
        if axis in dataset.dims:
            dataset[f"{axis}_bnds"] = ((axis, "bnds"), _bounds(dataset[axis].values))
    encoding = {}
    for name in list(dataset.variables):
        if str(name).endswith("_bnds"):
            dataset[name].attrs = {}
            dataset[name].encoding = {"coordinates": None}
            encoding[name] = {"_FillValue": None, "dtype": "float64"}
            continue
        entry = describe(str(name), statistics)
        dataset[name].attrs = _attributes(str(name), entry, dataset)
        encoding[name] = _encoding(str(name), entry, dataset[name])
    dataset.attrs = _provenance(settings, rule, title, inputs) | dict(attributes or {})
    with whole_file(path) as partial:
        dataset.to_netcdf(
            partial, engine="netcdf4", format="NETCDF4", encoding=encoding, unlimited_dims=()
        )


def read_dataset(path: str | Path) -> xr.Dataset:
    """A file of the pipeline, loaded; `time` stays a number."""
    with xr.open_dataset(path, engine="netcdf4", decode_times=False) as dataset:
        return dataset.load()


def _bounds(centers: np.ndarray) -> np.ndarray:
    half = 0.5 * (centers[1] - centers[0] if len(centers) > 1 else 2 * centers[0])
    return np.column_stack([centers - half, centers + half])


def _attributes(name: str, entry: dict[str, Any], dataset: xr.Dataset) -> dict[str, Any]:
    skip = ("dtype", "fill", "flags", "ancillary", "in")
    own = dataset[name].attrs
    attrs = {k: own[k] if value == OWN else value for k, value in entry.items() if k not in skip}
    if "flags" in entry:
        flags = own["flag_meanings"].split() if entry["flags"] == OWN else entry["flags"]
        attrs["flag_values"] = np.arange(len(flags), dtype=np.int8)
        attrs["flag_meanings"] = " ".join(flags)
    present = [other for other in entry.get("ancillary", ()) if other in dataset]
    if present:
        attrs["ancillary_variables"] = " ".join(present)
    if name in ("x", "y", "z"):
        attrs["bounds"] = f"{name}_bnds"
    return attrs


def _encoding(name: str, entry: dict[str, Any], variable: xr.DataArray) -> dict[str, Any]:
    if "dtype" not in entry:
        return {"dtype": "S1"} if variable.dtype.kind in "US" else {}
    encoding: dict[str, Any] = {"dtype": entry["dtype"], "_FillValue": entry.get("fill")}
    if variable.ndim >= 2 and variable.size > 1000:
        sizes = variable.sizes
        chunks = tuple(1 if dim in ("time", "replicate") else sizes[dim] for dim in variable.dims)
        if "z" not in variable.dims:
            chunks = variable.shape
        encoding |= {"zlib": True, "complevel": 4, "shuffle": True, "chunksizes": chunks}
    return encoding


def _provenance(
    settings: Experiment | Study, rule: str, title: str, inputs: Iterable[str | Path]
) -> dict[str, Any]:
    history = []
    for path in inputs:
        with xr.open_dataset(path, engine="netcdf4", decode_cf=False) as source:
            history += [
                line
                for line in str(source.attrs.get("history", "")).splitlines()
                if line not in history
            ]
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    history.append(f"{now} {rule}: pipeline {__version__}")
    return {
        "Conventions": "CF-1.11",
        "title": f"{title}: {settings.title}",
        "source": f"pipeline {__version__}, Python {platform.python_version()}",
        "history": "\n".join(history),
        "references": REFERENCES,
        **_identity(settings),
        "config": json.dumps(resolved(settings), ensure_ascii=False),
        "config_sha256": digest(settings),
        "git_revision": git_revision(),
        "random_generator": "numpy PCG64, SeedSequence(seed, (experiment, purpose, replicate))",
        "format_version": FORMAT_VERSION,
    }


def _identity(settings: Experiment | Study) -> dict[str, str | float]:
    if isinstance(settings, Study):
        return {"study": settings.name}
    identity = {
        "experiment": settings.name,
        "data_label": settings.data_label,
        "root_seed": str(settings.seed),
    }
    if (origin := settings.geometry.origin) is not None:
        identity |= {f"origin_{key}": value for key, value in origin.model_dump().items()}
        identity["origin_comment"] = (
            "mine coordinates (m) of the corner x = y = z = 0; x is east, y north, z up"
        )
    return identity


@cache
def git_revision() -> str:
    """Revision of the source, with -dirty if it was changed; "unknown" outside a checkout."""
    try:
        return subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
