"""The ``regions:`` of an experiment: where another material lies, and what grade it has."""

import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field

from pipeline.config.fields import (
    Density,
    FileStem,
    ParticleSize,
    Position,
    Strict,
    Text,
    size_order,
)
from pipeline.config.messages import Found, did_you_mean, quantity

NO_REGION = "no_region"
"""What ground outside every region is called."""
MOST_REGIONS = 126
"""As many as the flags of a signed byte can tell apart, with ``NO_REGION``."""
GRADE_UNITS = {"%": 0.01, "kg/t": 1e-3, "g/t": 1e-6, "ppm": 1e-6}
"""Units of grades, and the mass fraction that one of them is."""


def _two_positions(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("expected two positions in m, from and to: [0, 0.5]")
    return value


def _from_low_to_high(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError("expected the smaller position first, then the larger")
    return value


Span = Annotated[
    tuple[Position, Position], BeforeValidator(_two_positions), AfterValidator(_from_low_to_high)
]


def _some_side(x, y, z) -> Iterator[Found]:
    if x is None and y is None and z is None:
        yield (), "expected at least one of x, y, z, each [from, to] in m"


class Box(Strict):
    """A box in the model's coordinates; a cell is in it when its center is."""

    x: Span | None = None
    """From and to along x, m; without it all of the width."""
    y: Span | None = None
    """From and to along y, m; without it all of the length."""
    z: Span | None = None
    """From and to above the base, m; without it all of the height."""

    checks = (_some_side,)


class RegionMask(Strict):
    """A region read from a netCDF file on (z, y, x): not 0 where a cell is in it."""

    path: Annotated[str, Field(pattern=r"\.nc$")]
    """NetCDF file (.nc), relative to the experiment's file."""
    variable: Text | None = None
    """Name of the variable in the file; without it that of the region."""


def _mask(value: Any) -> Any:
    return {"path": value} if isinstance(value, str) else value


def _as_text(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError("expected a text or a number")
    return f"{value:.10g}" if isinstance(value, float) else str(value)


_Value = Annotated[str, BeforeValidator(_as_text, json_schema_input_type=str | float)]
ColumnValues = Annotated[tuple[_Value, ...], Field(min_length=1)]


class BlockColumn(Strict):
    """Where a column of an imported block model has certain values."""

    path: Annotated[str, Field(pattern=r"\.nc$")]
    """NetCDF file of the block model's columns (.nc), relative to the experiment's file."""
    name: Text
    """Name of the column."""
    values: ColumnValues
    """Values of the column that belong to the region."""


def _one_source_of_grade(value, column) -> Iterator[Found]:
    if (value is None) == (column is None):
        yield (), "expected exactly one of value, column"


def _at_most_pure(unit, value) -> Iterator[Found]:
    most = round(1 / GRADE_UNITS[unit], 6)
    if value is not None and value > most:
        yield ("value",), f"expected at most {most:g} {unit}, which is pure"


class Grade(Strict):
    """Content of a mineral or metal, by mass."""

    unit: Literal["%", "kg/t", "g/t", "ppm"]
    """Unit of the grade, by mass: one of %, kg/t, g/t, ppm."""
    value: quantity("a grade, 0 or more", ge=0) | None = None
    """Grade of every cell of the region."""
    column: Text | None = None
    """In place of value: the column of the region's block model that has it."""

    checks = (_one_source_of_grade, _at_most_pure)


def _grade_name(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch("[A-Za-z][A-Za-z0-9]*", value):
        raise ValueError("expected a name of letters and digits, such as Cu or CuEq")
    return value


def _one_place(box, mask, column) -> Iterator[Found]:
    places = {"box": box, "mask": mask, "column": column}
    given = [key for key, value in places.items() if value is not None]
    if len(given) != 1:
        text = "expected exactly one of box, mask, column; " + (
            f"these are {' and '.join(given)}" if given else "none is given"
        )
        yield (), text


def _grade_columns_are_known(column, grade) -> Iterator[Found]:
    for name, one in grade.items():
        if one.column is not None and column is None:
            yield ("grade", name, "column"), "needs a region that is given by column too"


class RegionMaterial(Strict):
    """What the material of a region is."""

    name: FileStem
    """Name, unique among the regions."""
    bulk_density: Density | None = None
    """Bulk density, kg m-3; without it that of the experiment's material."""
    particle_size: ParticleSize | None = None
    """Smallest and largest particle size, m; without it that of the experiment's material."""
    grade: dict[Annotated[str, BeforeValidator(_grade_name)], Grade] = Field(default_factory=dict)
    """Grades by the name of the mineral or metal; waste may leave them out, and has 0 then."""
    waste: bool = Field(False, strict=True)
    """Whether it dilutes what is drawn (true or false)."""

    checks = (size_order,)


class Region(RegionMaterial):
    """A part of the ground with a material of its own; a later one overrides an earlier one."""

    box: Box | None = None
    """Where it is: a box, in the model's coordinates."""
    mask: Annotated[
        RegionMask | None, BeforeValidator(_mask, json_schema_input_type=str | RegionMask)
    ] = None
    """In place of box: a netCDF file that says where, on the experiment's cells."""
    column: BlockColumn | None = None
    """In place of box: a column of an imported block model, and its values."""

    checks = (*RegionMaterial.checks, _one_place, _grade_columns_are_known)

    def stretched(self, factor: float) -> Self:
        """The region where its box, if it has one, is so many times as high above the base."""
        if self.box is None or self.box.z is None:
            return self
        low, high = self.box.z
        box = self.box.model_copy(update={"z": (low * factor, high * factor)})
        return self.model_copy(update={"box": box})


# ---------------------------------------------------------------------------------------------
# checks across an experiment


def regions_fit(geometry, material, regions) -> Iterator[Found]:
    """What is wrong with sound regions in this experiment, but for their grades."""
    if len(regions) > MOST_REGIONS:
        yield ("regions",), f"expected at most {MOST_REGIONS} regions, these are {len(regions)}"
    names = [region.name for region in regions]
    least = min(geometry.width, geometry.length, geometry.height)
    for place, region in enumerate(regions):
        at = ("regions", place)
        if (first := names.index(region.name)) < place:
            yield (*at, "name"), f"regions[{first}] has this name; give each its own"
        if region.name == NO_REGION:
            yield (*at, "name"), "is what ground outside every region is called; choose another"
        if region.box is not None:
            for axis, side in (("x", "width"), ("y", "length"), ("z", "height")):
                span, limit = getattr(region.box, axis), getattr(geometry, side)
                if span is not None and span[1] > limit * (1 + 1e-9):
                    text = f"reaches outside the model (0 to {limit:g} m along {axis})"
                    yield (*at, "box", axis), text
        solid = material.particle_density
        if region.bulk_density is not None and region.bulk_density > solid:
            text = f"expected at most material.particle_density ({solid:g} kg m-3)"
            yield (*at, "bulk_density"), text
        for order, size in enumerate(region.particle_size or ()):
            if size > least / 2:
                text = f"expected a length in m, at most half the smallest side ({least / 2:g} m)"
                yield (*at, "particle_size", order), text


def grades_fit(regions) -> Iterator[Found]:
    """Where regions do not have the same grades, in the same units."""
    known = units_of(regions)
    first = next((region.name for region in regions if region.grade), None)
    for place, region in enumerate(regions):
        at = ("regions", place, "grade")
        unknown = region.grade.keys() - known.keys()
        for name in sorted(unknown):
            hint = did_you_mean(name, known, "its grades are")
            yield (*at, name), f"region {first} has no such grade{hint}; give all regions the same"
        if unknown or (region.waste and not region.grade):
            continue
        for name, unit in known.items():
            if name not in region.grade:
                yield (*at, name), f"missing; region {first} has it, in {unit}"
            elif region.grade[name].unit != unit:
                yield (*at, name, "unit"), f"region {first} has it in {unit}; use one unit"


def units_of(regions) -> dict[str, str]:
    """Unit of each grade by its name, as the first region with grades has them."""
    grades = next((region.grade for region in regions if region.grade), {})
    return {name: grade.unit for name, grade in grades.items()}
