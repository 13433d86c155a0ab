"""From an experiment's regions to what each cell is: its region, density, size and grades."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.regions import BlockColumn, Box, Region
from pipeline.lattice.grid import Lattice
from pipeline.lattice.on_lattice import lattice_error, read_on_lattice


@dataclass(frozen=True)
class Regions:
    """Regions on the lattice, arrays (z, y, x).

    Attributes
    ----------
    index : int8, number of the region in the experiment's file counted from 1, 0 in no region;
        with regions -1 outside the ground
    bulk_density : kg m-3
    d50 : m, the middle of the particle sizes, NaN where none is declared
    grades : by name, in the experiment's `grade_units`; NaN outside the ground
    """

    index: np.ndarray
    bulk_density: np.ndarray
    d50: np.ndarray
    grades: dict[str, np.ndarray]


def regions_on(experiment: Experiment, lattice: Lattice, ground: np.ndarray) -> Regions:
    """What the regions make of each cell; later ones override earlier ones.

    Raises
    ------
    ConfigError
        If a file of a region does not fit the lattice, a region holds no ground, or a ground cell
        has no grade although regions have.
    """
    regions, material = experiment.regions, experiment.material
    d50 = np.float64(_middle(material.particle_size))
    if not regions:
        everywhere = np.int8(0), np.float64(material.bulk_density), d50
        return Regions(*(np.broadcast_to(value, lattice.shape) for value in everywhere), {})
    index = np.where(ground, np.int8(0), np.int8(-1))
    density = np.full(lattice.shape, material.bulk_density)
    d50 = np.full(lattice.shape, d50)
    units = experiment.grade_units
    grades = {name: np.full(lattice.shape, np.nan) for name in units}
    for place, region in enumerate(regions):
        inside = ground & _cells_of(experiment, lattice, region, place)
        if not inside.any():
            raise lattice_error(experiment, f"regions[{place}]", f"{region.name} holds no cell")
        index[inside] = place + 1
        density[inside] = region.bulk_density or material.bulk_density
        d50[inside] = _middle(region.particle_size or material.particle_size)
        for name, values in grades.items():
            values[inside] = _grade(experiment, lattice, region, place, name)[inside]
    for name, values in grades.items():
        _refuse_unknown(experiment, index, name, np.isnan(values) & ground)
    return Regions(index, density, d50, grades)


def _middle(sizes: tuple[float, float] | None) -> float:
    return np.nan if sizes is None else 0.5 * (sizes[0] + sizes[1])


def _cells_of(experiment: Experiment, lattice: Lattice, region: Region, place: int) -> np.ndarray:
    """Cells (z, y, x) bool of a region, whether they are ground or not."""
    key = f"regions[{place}]"
    if region.box is not None:
        return _in_box(experiment, lattice, region.box)
    if region.mask is not None:
        file = experiment.files["regions", place, "mask", "path"]
        name = region.mask.variable or region.name
        found = read_on_lattice(experiment, lattice, f"{key}.mask", file, name, "variable")
        return np.nan_to_num(found.values) != 0
    file = experiment.files["regions", place, "column", "path"]
    column = region.column
    found = read_on_lattice(experiment, lattice, f"{key}.column", file, column.name, "name")
    return _has_values(experiment, f"{key}.column.values", found, column)


def _in_box(experiment: Experiment, lattice: Lattice, box: Box) -> np.ndarray:
    """Cells whose centers lie in a box: on its lower sides, not on its upper ones.

    So boxes that meet share no cell. A side at the end of the geometry takes the lattice's rest.
    """
    g, off = experiment.geometry, 1e-9 * lattice.cell_size
    inside = []
    for axis, limit in (("z", g.height), ("y", g.length), ("x", g.width)):
        low, high = getattr(box, axis) or (0.0, limit)
        high = np.inf if high >= limit - off else high
        centers = lattice.centers(axis)
        inside.append((centers >= low - off) & (centers < high - off))
    z, y, x = inside
    return z[:, None, None] & y[:, None] & x


def _has_values(
    experiment: Experiment, key: str, found: xr.DataArray, column: BlockColumn
) -> np.ndarray:
    """Where a column has one of the region's values; its texts are flags with meanings."""
    if {"flag_meanings", "flag_values"} <= found.attrs.keys():
        codes = np.ravel(found.attrs["flag_values"])
        known = dict(zip(found.attrs["flag_meanings"].split(), codes, strict=False))
        wanted = ["_".join(value.split()) for value in column.values]
    else:
        known = {f"{v:.10g}": v for v in np.unique(found.values[np.isfinite(found.values)])}
        wanted = [_number_text(value) for value in column.values]
    numbers = [known.get(text) for text in wanted]
    for text, number in zip(column.values, numbers, strict=True):
        if number is None:
            first = ", ".join(list(known)[:8]) + (", ..." if len(known) > 8 else "")
            text = f"column {column.name} has no value {text}; its values are {first}"
            raise lattice_error(experiment, key, text)
    return np.isin(found.values, numbers)


def _number_text(text: str) -> str:
    """A number in the spelling in which numbers are compared; other text as it is."""
    try:
        return f"{float(text):.10g}"
    except ValueError:
        return text


def _grade(
    experiment: Experiment, lattice: Lattice, region: Region, place: int, name: str
) -> np.ndarray:
    """A grade of a region, (z, y, x); 0 where waste leaves it out."""
    grade = region.grade.get(name)
    if grade is None or grade.column is None:
        return np.full(lattice.shape, 0.0 if grade is None else grade.value)
    file = experiment.files["regions", place, "column", "path"]
    key = f"regions[{place}].grade.{name}"
    found = read_on_lattice(experiment, lattice, key, file, grade.column, "column")
    values = found.values.astype(np.float64)
    if "flag_meanings" in found.attrs or (values < 0).any():
        text = "expected a column of numbers, 0 or more"
        raise lattice_error(experiment, f"{key}.column = {grade.column}", text)
    return values


def _refuse_unknown(
    experiment: Experiment, index: np.ndarray, name: str, unknown: np.ndarray
) -> None:
    count = int(unknown.sum())
    if not count:
        return
    for place, region in enumerate(experiment.regions):
        here = int((unknown & (index == place + 1)).sum())
        if here:
            text = f"{here} of its cells have no value in column {region.grade[name].column}"
            raise lattice_error(experiment, f"regions[{place}].grade.{name}", text)
    text = (
        f"{count} ground cells lie in no region, so that their grade {name} is not known; begin "
        "with a region that is as large as the model"
    )
    raise lattice_error(experiment, "regions", text)
