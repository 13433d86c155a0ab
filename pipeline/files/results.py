"""The results of one experiment, read back from its folder alone."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.messages import ConfigError, did_you_mean
from pipeline.files.netcdf import read_dataset

RULES = {"block_model": "block_model", "replicates": "replicates", "fields": "replicates"}


class Results:
    """Files of an experiment's folder, each read when first asked for.

    The experiment is the one that the files carry in their attribute `config`, so that a folder
    that was moved or sent is enough.

    Raises
    ------
    ConfigError
        If the folder, or one of the files `needed`, is not there.
    """

    def __init__(self, folder: str | Path, needed: Iterable[str]):
        self.folder = Path(folder)
        needed = tuple(needed)
        if not self.folder.is_dir():
            raise ConfigError([(self.folder, _no_folder(self.folder))])
        missing = [name for name in needed if not self._file(name).is_file()]
        if missing:
            rules = ", ".join(dict.fromkeys(RULES[name] for name in missing))
            raise ConfigError(
                (self._file(name), f"no such file; run the workflow first (rule {rules})")
                for name in missing
            )
        self._read: dict[str, xr.Dataset] = {}
        attributes = self[needed[0]].attrs
        experiment = Experiment.model_validate(json.loads(attributes["config"]))
        self.experiment = experiment.at(self.folder / f"{attributes['experiment']}.yaml")

    def __getitem__(self, name: str) -> xr.Dataset:
        if name not in self._read:
            self._read[name] = read_dataset(self._file(name))
        return self._read[name]

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.nc"


def clock_of(dataset: xr.Dataset) -> tuple[str, np.ndarray]:
    """What tells the readings apart, and its values: `mass_drawn` (kg) or `fill_height` (m)."""
    name = "mass_drawn" if "mass_drawn" in dataset else "fill_height"
    return name, dataset[name].values


def _no_folder(folder: Path) -> str:
    others = [other.name for other in sorted(folder.parent.glob("*/"))]
    return "no such folder of results" + did_you_mean(folder.name, others, "beside it are")
