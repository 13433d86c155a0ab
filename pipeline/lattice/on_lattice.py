"""Variables that a user's netCDF file has on the lattice of an experiment."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.messages import ConfigError, did_you_mean
from pipeline.lattice.grid import Lattice


def read_on_lattice(
    experiment: Experiment, lattice: Lattice, key: str, file: Path, variable: str, name: str
) -> xr.DataArray:
    """A variable on (z, y, x) of a file that the experiment names.

    Parameters
    ----------
    key : dotted key of the experiment's file, for what is wrong with the file
    name : the key under it that names the variable

    Raises
    ------
    ConfigError
        If the file is no netCDF, lacks the variable, or has no numbers or another grid.
    """
    at = f"{name} = {variable}"
    try:
        with xr.open_dataset(file, engine="netcdf4") as dataset:
            known = list(map(str, dataset.data_vars))
            values = dataset[variable].load() if variable in dataset else None
    except OSError as error:
        text = f"{file} is not readable as netCDF: {error.strerror}"
        raise lattice_error(experiment, f"{key}.path", text) from None
    if values is None:
        near = did_you_mean(variable, known, "")
        hint = near if near.endswith("?") else ""
        text = f"{file} has only: {', '.join(known) or 'no variable'}{hint}"
        raise lattice_error(experiment, f"{key}.{at}", text)
    if values.dims != ("z", "y", "x") or values.shape != lattice.shape:
        text = f"its dims are {dict(values.sizes)}; the lattice is (z, y, x) = {lattice.shape}"
        raise lattice_error(experiment, f"{key}.{at}", text)
    if values.dtype.kind not in "iufb":
        raise lattice_error(experiment, f"{key}.{at}", "expected a variable of numbers")
    return values


def lattice_error(experiment: Experiment, key: str, text: str) -> ConfigError:
    """The error of a key whose value does not fit the lattice."""
    return ConfigError([(experiment.path, f"{key}: {text}")])
