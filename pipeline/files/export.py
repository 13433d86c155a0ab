"""What an experiment's results can be exported to, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pipeline.files import base_stress, block_export, field_export
from pipeline.files.results import Results


@dataclass(frozen=True)
class Format:
    """A kind of export.

    Attributes
    ----------
    target : file or folder, relative to the experiment's folder of results
    needed : stems of the netCDF files that it is made from
    write : called with the results and the target's path
    help : what it is, in a line
    """

    target: str
    needed: tuple[str, ...]
    write: Callable[[Results, Path], object]
    help: str


FORMATS = {
    "vtk": Format(
        "export/vtk",
        field_export.NEEDED,
        field_export.write_fields,
        "image data with cell values (.vti) for each reading, and their series (.pvd)",
    ),
    "csv": Format(
        "base_stress.csv",
        base_stress.NEEDED,
        base_stress.write_base_stress,
        "base stress by load cell, drawpoint and period: mean, P10, P50, P90 in kPa and MPa",
    ),
    "block_model": Format(
        "export/block_model.csv",
        block_export.NEEDED,
        block_export.write_block_model,
        "blocks with centroids, sizes, density and stress",
    ),
    "vulcan": Format(
        "export/block_model_vulcan.csv",
        block_export.NEEDED,
        partial(block_export.write_block_model, vulcan=True),
        "the same with Vulcan's header lines",
    ),
}


def export(folder: str | Path, to: str, target: str | Path | None = None) -> Path:
    """Export the results in `folder` to one of `FORMATS`; where it went.

    Raises
    ------
    ConfigError
        If the folder or a file that is needed is not there; nothing is written then.
    """
    kind = FORMATS[to]
    target = Path(folder) / kind.target if target is None else Path(target)
    kind.write(Results(folder, kind.needed), target)
    return target
