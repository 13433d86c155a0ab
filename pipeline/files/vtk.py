"""VTK's XML files: image data with one value for each cell, and a series of them over time.

Written by hand, because all that is needed of VTK is two small headers around compressed arrays.
The layout is that of "VTK XML File Formats": values in x-fastest order, appended as base64 of
zlib blocks, little-endian, each array led by the number and the sizes of its blocks.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from pipeline.files.atomic import write_text

HIDDEN_CELL = 32
"""Flag in the cell array `vtkGhostType` by which VTK's filters and views leave a cell out."""

_TYPES = {  # of an array that VTK can hold, as NumPy names it
    "int8": "Int8",
    "uint8": "UInt8",
    "int32": "Int32",
    "float32": "Float32",
    "float64": "Float64",
}
_BLOCK = 1 << 20  # bytes compressed at a time
_HEADER = (
    '<?xml version="1.0"?>\n'
    '<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    ' compressor="vtkZLibDataCompressor">\n'
)


@dataclass(frozen=True)
class Grid:
    """A regular grid of cells: its lowest corner and its cells' sides, (x, y, z) in m."""

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]


def write_image_data(
    path: str | Path,
    grid: Grid,
    cells: Mapping[str, np.ndarray],
    facts: Mapping[str, float] | None = None,
) -> None:
    """Write a .vti file whole.

    Parameters
    ----------
    path : where to
    grid : where the cells stand, m
    cells : cell arrays by name, each on (z, y, x) with x fastest, all of one shape
    facts : numbers of the whole file by name; `TimeValue` is what viewers show as time
    """
    nz, ny, nx = next(iter(cells.values())).shape
    extent = f"0 {nx} 0 {ny} 0 {nz}"
    arrays, appended, offset = [], [], 0
    for name, values in cells.items():
        if values.shape != (nz, ny, nx):
            raise ValueError(f"{name} has shape {values.shape}, the others {(nz, ny, nx)}")
        arrays.append(
            f'        <DataArray type="{_TYPES[values.dtype.name]}" Name={quoteattr(name)}'
            f' format="appended" offset="{offset}"/>\n'
        )
        appended.append(_encoded(values))
        offset += len(appended[-1])
    write_text(
        path,
        _HEADER.format(kind="ImageData")
        + f'  <ImageData WholeExtent="{extent}" Origin="{_numbers(grid.origin)}"'
        f' Spacing="{_numbers(grid.spacing)}">\n'
        + _field_data(facts or {})
        + f'    <Piece Extent="{extent}">\n      <CellData>\n'
        + "".join(arrays)
        + "      </CellData>\n    </Piece>\n  </ImageData>\n"
        + '  <AppendedData encoding="base64">\n_'
        + "".join(appended)
        + "\n  </AppendedData>\n</VTKFile>\n",
    )


def write_series(path: str | Path, steps: Iterable[tuple[float, str]]) -> None:
    """Write a .pvd file whole: the files of a series, each with its time.

    Parameters
    ----------
    path : where to
    steps : time and file, relative to the series' folder
    """
    entries = "".join(
        f'    <DataSet timestep="{time!r}" group="" part="0" file={quoteattr(file)}/>\n'
        for time, file in steps
    )
    write_text(
        path,
        '<?xml version="1.0"?>\n'
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
        f"  <Collection>\n{entries}  </Collection>\n</VTKFile>\n",
    )


def _field_data(facts: Mapping[str, float]) -> str:
    if not facts:
        return ""
    arrays = "".join(
        f'      <DataArray type="Float64" Name={quoteattr(name)} NumberOfTuples="1"'
        f' format="ascii">{float(value)!r}</DataArray>\n'
        for name, value in facts.items()
    )
    return f"    <FieldData>\n{arrays}    </FieldData>\n"


def _encoded(values: np.ndarray) -> str:
    """Base64 of [blocks, bytes in a block, bytes in a last partial one, compressed sizes], data."""
    data = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    blocks = [zlib.compress(data[at : at + _BLOCK]) for at in range(0, len(data), _BLOCK)]
    sizes = [len(blocks), _BLOCK, len(data) % _BLOCK, *map(len, blocks)]
    head = np.array(sizes, dtype="<u8").tobytes()
    return (base64.b64encode(head) + base64.b64encode(b"".join(blocks))).decode()


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
