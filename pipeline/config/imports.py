"""What a user may say of mine files that are imported: columns, units, and what they leave out."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.config.fields import Density, FrictionAngle, Length, MineCoordinate, Strict, Text
from pipeline.config.regions import ColumnValues, RegionMaterial
from pipeline.config.stress import Flow, Stress


class Columns(Strict):
    """Names of the block model's columns; those that are not given are looked for by name."""

    x: Text | None = None
    """Easting of a block's center."""
    y: Text | None = None
    """Northing of a block's center."""
    z: Text | None = None
    """Elevation of a block's center."""
    dx: Text | None = None
    """Extent of a block along x."""
    dy: Text | None = None
    """Extent of a block along y."""
    dz: Text | None = None
    """Extent of a block along z."""
    density: Text | None = None
    """Density of a block."""
    ground: Text | None = None
    """What tells ground from what is none: with ``ground_values`` by text, else not 0."""


class Units(Strict):
    """Units of the mine's files."""

    length: Literal["m", "mm", "cm", "km", "ft"] = "m"
    """Unit of coordinates and sizes."""
    density: Literal["kg/m3", "t/m3", "g/cm3"] | None = None
    """Unit of densities; without it t/m3 where all are below 20, else kg/m3."""


class ImportedMaterial(Strict):
    """What the mine's files do not say of the material."""

    name: Text = "rock"
    """Name; experiments with the same one share its parameters in a study."""
    bulk_density: Density | None = None
    """Bulk density, kg m-3; without it the mean over the blocks."""
    particle_density: Density | None = None
    """Density of the particles, kg m-3; without it that of the blocks' solids, or 2700."""
    internal_friction_angle: FrictionAngle | None = None
    """Internal friction angle, degrees."""


class ImportedRegion(RegionMaterial):
    """A region of the experiment, by a column of the block model; later ones override."""

    column: Text
    """Name of the column that tells the region's blocks."""
    values: ColumnValues
    """Values of the column that belong to the region."""


class ImportSettings(Strict):
    """A file beside the mine's files that says how to read them; every key is optional."""

    columns: Columns = Columns()
    """Columns of the block model."""
    ground_values: Annotated[tuple[Text, ...], Field(min_length=1)] | None = None
    """Values of the column ``ground`` that are ground."""
    units: Units = Units()
    """Units of the mine's files."""
    gaps: Literal["refuse", "outside"] = "refuse"
    """What a missing block is: an error, or a place outside the ground."""
    base: MineCoordinate | None = None
    """Elevation (m) of the base; blocks with their centers below are left out."""
    cell_size: Length | None = None
    """Side of the lattice cells, m; without it the largest that divides the blocks."""
    drawpoint_size: Length | None = None
    """Sides of each drawpoint's opening, m; without it one cell."""
    material: ImportedMaterial = ImportedMaterial()
    """What the files do not say of the material."""
    regions: tuple[ImportedRegion, ...] = ()
    """Regions of the experiment, told by the block model's columns."""
    stress: Stress | None = None
    """How cells hand their load down; without it starting values to calibrate."""
    flow: Flow | None = None
    """How voids climb; without it starting values to calibrate."""

    @property
    def kept_columns(self) -> tuple[str, ...]:
        """Columns that regions or their grades name, each once."""
        names = []
        for region in self.regions:
            names += [region.column, *(g.column for g in region.grade.values() if g.column)]
        return tuple(dict.fromkeys(names))
