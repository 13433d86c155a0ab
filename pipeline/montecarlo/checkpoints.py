"""Finished parts of an experiment's replicates on disk, to be taken up by a later run.

While replicates run, each finished part is a file; once all are there, one file of all of them
takes their place, for the run that asks for more. What decides a replicate is in the file's name
as a digest: another setting, parameter or line of code finds nothing. The folder may be deleted
at any time.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
import zipfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pipeline.config.load import digest
from pipeline.files.atomic import whole_file
from pipeline.montecarlo.fields import FieldSums
from pipeline.montecarlo.parts import Part
from pipeline.simulate.setup import Setup

WRITING = 1e8  # bytes a second; what is computed sooner than written is not kept
NAME = re.compile(r"([0-9a-f]{16})_(\d+)-(\d+)\.npz")
ANY_NUMBER = {"replicates": 1, "stop_at": None}  # of replicates, of which none hangs on it
SUMS = tuple(field.name for field in fields(FieldSums) if field.name not in ("setup", "count"))

log = logging.getLogger(__name__)


class Checkpoints:
    """The checkpoints of an experiment in a folder of their own.

    `code` is a digest of the code that computes replicates.
    """

    def __init__(self, folder: str | Path, code: str):
        self._folder, self._code = Path(folder), code
        self._shelves: list[Shelf] = []

    def shelf(
        self, setup: Setup, parameters: Any, purposes: tuple[int, int], with_fields: bool
    ) -> Shelf:
        """Where replicates are kept; `parameters` is JSON-able data that decides theirs."""
        experiment = setup.experiment.model_copy(update=ANY_NUMBER)
        said = [self._code, experiment.name, digest(experiment)]
        said += [parameters, purposes, with_fields]
        said += [setup.fill_levels, setup.true_levels, setup.masses]
        said += [np.__version__, numba.__version__]
        key = hashlib.sha256(json.dumps(said).encode())
        for part in (setup.code, setup.cell_weight, setup.footprints, *setup.visits):
            key.update(np.ascontiguousarray(part).data)
        self._shelves.append(Shelf(self._folder, key.hexdigest()[:16], setup))
        return self._shelves[-1]

    def keep_only_whole(self) -> None:
        """Put one file of all replicates in the place of each shelf's parts; remove the rest."""
        keep = {shelf.settle() for shelf in self._shelves}
        if self._folder.is_dir():
            for path in self._folder.iterdir():
                if path not in keep:
                    path.unlink()
            if not any(keep):
                self._folder.rmdir()


class Shelf:
    """Parts of replicates that one `key` decides; `whole` are all of them, once they are there."""

    def __init__(self, folder: Path, key: str, setup: Setup):
        self._folder, self._key, self._setup = folder, key, setup
        self.whole: Part | None = None

    def parts(self, count: int) -> Iterator[Part]:
        """Parts of the first `count` replicates that do not overlap, in order.

        A file that cannot be read is removed, and said in the log.
        """
        reached = 0
        for first, last, path in sorted(self._files(), key=lambda file: (file[0], -file[1])):
            if first < reached or last > count:
                continue
            try:
                part = self._read(path, first, last)
            except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
                log.warning("%s cannot be read (%s): computed again", path, error)
                path.unlink(missing_ok=True)
                continue
            reached = last
            yield part

    def keep(self, part: Part) -> Path | None:
        """Write a part whole; nothing where it is sooner computed than written."""
        if part.seconds < part.nbytes / WRITING:
            return None
        path = self._path(part.first, part.last)
        arrays = {f"readings.{name}": values for name, values in part.readings.items()}
        if part.sums is not None:
            arrays |= {f"sums.{name}": getattr(part.sums, name) for name in SUMS}
            arrays = {name: values for name, values in arrays.items() if values is not None}
        with whole_file(path) as partial, open(partial, "wb") as file:
            np.savez(file, seconds=part.seconds, **arrays)
        return path

    def settle(self) -> Path | None:
        """The file of all replicates, written if need be; None where it is not worth keeping."""
        path = self._path(0, self.whole.last)
        return path if path.is_file() else self.keep(self.whole)

    def _path(self, first: int, last: int) -> Path:
        return self._folder / f"{self._key}_{first}-{last}.npz"

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        for path in self._folder.glob(f"{self._key}_*.npz"):
            if match := NAME.fullmatch(path.name):
                yield int(match[2]), int(match[3]), path

    def _read(self, path: Path, first: int, last: int) -> Part:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        readings = _named(arrays, "readings.")
        if not readings or any(len(values) != last - first for values in readings.values()):
            raise ValueError("it does not hold these replicates")
        sums = None
        if found := _named(arrays, "sums."):
            sums = FieldSums(self._setup, last - first, **found)
        return Part(first, last, readings, sums, float(arrays["seconds"]))


def _named(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {
        name.removeprefix(prefix): values
        for name, values in arrays.items()
        if name.startswith(prefix)
    }
