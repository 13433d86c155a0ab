"""The box that holds the ground: its lattice, its mask, and where it stands in the mine."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from pipeline.config.fields import Length, MineCoordinate, Strict, Text
from pipeline.config.messages import Found, quantity

MAX_CELLS = 2e9
"""Lattices beyond this number of cells are taken for a mistake of unit."""


class CylinderMask(Strict):
    """An upright cylinder in the middle of the box; outside it there is no ground."""

    type: Literal["cylinder"]
    """Kind of mask."""
    diameter: Length | None = None
    """Diameter, m; without it the smaller of width and length."""


class DrawbellMask(Strict):
    """Solid ground between the drawpoints that rises from their edges to the height."""

    type: Literal["drawbells"]
    """Kind of mask."""
    height: Length
    """Height of the drawbells above the base, m."""
    wall_angle: quantity("an angle in degrees, above 0 and at most 90", gt=0, le=90)
    """Inclination of the drawbell walls from the horizontal, degrees."""


class FileMask(Strict):
    """Ground read from a netCDF file on (z, y, x): 1 where there is granular material."""

    type: Literal["file"]
    """Kind of mask."""
    path: Annotated[str, Field(pattern=r"\.nc$")]
    """NetCDF file (.nc), relative to the experiment's file."""
    variable: Text = "ground"
    """Name of the variable in the file."""


Mask = Annotated[CylinderMask | DrawbellMask | FileMask, Field(discriminator="type")]


def _lattice_fits(width, length, height, cell_size) -> Iterator[Found]:
    sides = {"width": width, "length": length, "height": height}
    least = min(sides, key=sides.get)
    cells = width * length * height / cell_size**3
    if cell_size > sides[least]:
        in_mm = cell_size / 1000 <= sides[least] and cells * 1e9 <= MAX_CELLS
        hint = f"; did you mean {cell_size / 1000:.6g}?" if in_mm else ""
        text = f"expected a cell size in m, at most the {least} ({sides[least]:g} m){hint}"
        yield ("cell_size",), text
    if cells > MAX_CELLS:
        text = (
            f"makes a lattice of {cells:.2g} cells, expected at most {MAX_CELLS:.0g}; "
            "give all lengths in m, or choose larger cells"
        )
        yield ("cell_size",), text


def _mask_fits(width, length, height, mask) -> Iterator[Found]:
    if isinstance(mask, CylinderMask) and (mask.diameter or 0) > min(width, length) * (1 + 1e-9):
        text = f"expected at most the smaller of width and length ({min(width, length):g} m)"
        yield ("mask", "diameter"), text
    if isinstance(mask, DrawbellMask) and mask.height > height * (1 + 1e-9):
        yield ("mask", "height"), f"expected at most geometry.height ({height:g} m)"


class MineOrigin(Strict):
    """Where the model's corner (x = y = z = 0) stands in the mine; x is east, y north, z up."""

    easting: MineCoordinate
    """Easting of the corner, m."""
    northing: MineCoordinate
    """Northing of the corner, m."""
    elevation: MineCoordinate
    """Elevation of the base, m."""


class Geometry(Strict):
    """The box that holds the granular material, and the lattice in it."""

    width: Length
    """Extent along x, m."""
    length: Length
    """Extent along y, m."""
    height: Length
    """Extent along z when full, m."""
    cell_size: Length
    """Side of the cubic lattice cells, m."""
    mask: Mask | None = None
    """Where there is ground inside the box; without it everywhere."""
    origin: MineOrigin | None = Field(None, exclude_if=lambda origin: origin is None)
    """Where the corner of the base stands in the mine's coordinates; results carry it along."""

    checks = (_lattice_fits, _mask_fits)

    @property
    def diameter(self) -> float | None:
        """Diameter (m) of the cylinder mask, its default filled in; None for any other ground."""
        if isinstance(self.mask, CylinderMask):
            return self.mask.diameter or min(self.width, self.length)
        return None

    @property
    def hydraulic_radius(self) -> float:
        """Area over perimeter of the declared base, m."""
        if self.diameter is not None:
            return self.diameter / 4
        return self.width * self.length / (2 * (self.width + self.length))
