"""The cubic lattice of an experiment: cell counts, rounding, levels and covered areas."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81  # m s-2


@dataclass(frozen=True)
class Lattice:
    """Cells of side `cell_size` (m); `nx`, `ny`, `nz` of them along x, y and z (up).

    `top_fraction` is the part of the top level that the declared height fills; `notes` says in
    words where a declared length is no whole number of cells.
    """

    cell_size: float
    nx: int
    ny: int
    nz: int
    top_fraction: float
    notes: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return self.nz, self.ny, self.nx

    @property
    def cell_area(self) -> float:
        """Horizontal area of a cell, m²."""
        return self.cell_size**2

    @property
    def cell_volume(self) -> float:
        """Volume of a cell, m³."""
        return self.cell_size**3

    def centers(self, axis: str) -> np.ndarray:
        """Cell centers along "x", "y" or "z", m, float64."""
        count = {"x": self.nx, "y": self.ny, "z": self.nz}[axis]
        return (np.arange(count) + 0.5) * self.cell_size

    def covered_area(self, x: float, y: float, width: float, length: float) -> np.ndarray:
        """Area of each base cell (y, x), m², under a rectangle given by its center and size, m."""
        along_x = _overlap(x - width / 2, x + width / 2, self.nx, self.cell_size)
        along_y = _overlap(y - length / 2, y + length / 2, self.ny, self.cell_size)
        return along_y[:, None] * along_x[None, :]


def make_lattice(width: float, length: float, height: float, cell_size: float) -> Lattice:
    """Lattice for a box of declared lengths, m.

    Width (x) and length (y) become the nearest whole number of cells, halves up; the height
    (z) keeps its value: the top level holds the fraction that is left.
    """
    counts = {}
    notes = []
    for name, extent in (("width", width), ("length", length)):
        cells = _in_cells(extent, cell_size)
        counts[name] = max(1, math.floor(cells + 0.5))
        if counts[name] != cells:
            notes.append(
                f"{name} {extent:g} m is {cells:g} cells of {cell_size:g} m: the lattice has "
                f"{counts[name]} ({counts[name] * cell_size:g} m); wall areas keep {extent:g} m"
            )
    nz, top_fraction = levels_of(height, cell_size)
    if top_fraction != 1.0:
        notes.append(
            f"height {height:g} m is {_in_cells(height, cell_size):g} cells of {cell_size:g} m: "
            f"the top level, number {nz}, carries {top_fraction:g} of its density"
        )
    return Lattice(cell_size, counts["width"], counts["length"], nz, top_fraction, tuple(notes))


def levels_of(height: float, cell_size: float) -> tuple[int, float]:
    """Number of levels up to `height` (m) and the filled fraction of the topmost, in (0, 1]."""
    cells = _in_cells(height, cell_size)
    levels = max(1, math.ceil(cells))
    return levels, 1.0 if cells == levels else cells - (levels - 1)


def _in_cells(extent: float, cell_size: float) -> float:
    """Length in cells, free of the last bits of the division (0.23 m / 0.02 m is 11.5)."""
    return round(extent / cell_size, 9)


def _overlap(low: float, high: float, count: int, cell_size: float) -> np.ndarray:
    """Length of [low, high] inside each of `count` cells along an axis."""
    edges = np.arange(count + 1) * cell_size
    inside = np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1])
    return np.where(inside > 1e-9 * cell_size, inside, 0.0)
