"""From a grid of blocks, drawpoints and a schedule to an experiment's file, with its mask."""

from __future__ import annotations

import math
import re
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from pipeline.config.geometry import MAX_CELLS
from pipeline.config.imports import ImportedRegion, ImportSettings
from pipeline.config.load import load_experiment
from pipeline.config.messages import NAME_PATTERN, ConfigError, shown_path
from pipeline.files.atomic import whole_file
from pipeline.files.mine.block_grid import BlockGrid
from pipeline.files.mine.block_table import BlockTable
from pipeline.files.mine.massflow import MineDrawpoint, Schedule
from pipeline.lattice.block_model import build_block_model

# Starting values of what no block model says, to be calibrated; the experiment marks them assumed.
JANSSEN = 3.0  # length over which load is shed, in hydraulic radii: K tan(phi) = 1/3
SPREADING = {"mean": 4, "std": 3}
RELAXATION = 0.29
SHED_IN_MOTION = 5.0  # what flowing ground sheds, relative to ground at rest
FLOW_EXPONENT, BULKING = 7.0, 0.25
SOLIDS = 2700.0  # kg m-3


def describe_experiment(
    blocks: BlockTable,
    grid: BlockGrid,
    settings: ImportSettings,
    drawpoints: tuple[Path, list[MineDrawpoint]] | None = None,
    schedule: Schedule | None = None,
) -> tuple[dict[str, Any], dict[str, xr.Dataset], list[str]]:
    """An experiment as data under the keys of its file, its datasets, and notes for the user.

    The model's corner is the grid's, its cells are the largest cubes that divide the blocks. The
    datasets are `masks`, where the ground does not fill the box, and `blocks`, the columns that
    regions name.

    Raises
    ------
    ConfigError
        If cells do not divide the blocks, no density is known, or a drawpoint or the schedule
        does not fit the blocks.
    """
    path = blocks.table.path
    cell = _cell_size(path, grid, settings.cell_size)
    parts = [round(extent / cell) for extent in grid.size]
    nz, ny, nx = grid.ground.shape
    width, length, height = (
        _neat(n * extent) for n, extent in zip((nx, ny, nz), grid.size, strict=True)
    )
    notes = [*blocks.notes, *grid.notes]
    inside = math.prod(parts)
    notes.append(
        f"{int(grid.ground.sum())} ground blocks of {_sides(grid)} m in a box of {width:g} x "
        f"{length:g} x {height:g} m, {inside} cell{'s' * (inside > 1)} to a block"
    )
    assumed = []
    geometry = {"width": width, "length": length, "height": height, "cell_size": cell}
    geometry["origin"] = dict(zip(("easting", "northing", "elevation"), grid.corner, strict=True))
    material = _material(blocks, grid, settings, notes, assumed)
    content: dict[str, Any] = {"title": "", "source": "", "geometry": geometry}
    content["material"] = material
    if settings.regions:
        content["regions"] = [_region(region) for region in settings.regions]
    radius = width * length / (2 * (width + length))
    if settings.stress is not None:
        stress = settings.stress.model_dump(mode="json", by_alias=True, exclude_none=True)
    else:
        shed = max(JANSSEN * radius, 2 * cell)
        stress = {"attenuation_length": _neat(shed), "s": dict(SPREADING)}
        assumed.append("stress")
        if schedule is not None:
            E_min = max(0.0, 1 - SHED_IN_MOTION * cell / shed)
            stress |= {"R": RELAXATION}
            stress["E_min"] = {"type": "power", "at_height": height / 2, "value": _neat(E_min)}
    content["stress"] = stress
    if drawpoints is not None:
        content["drawpoints"] = _drawpoints(drawpoints, grid, cell, settings.drawpoint_size)
        if settings.drawpoint_size is None:
            assumed.append("drawpoints")
    if schedule is not None:
        content |= _draw(schedule, drawpoints, material["bulk_density"] * cell**3)
        if settings.flow is not None:
            content["flow"] = settings.flow.model_dump(mode="json")
        else:
            bulking = BULKING if blocks.swell is None else _neat(min(blocks.swell, 1.0))
            content["flow"] = {"exponent": FLOW_EXPONENT, "bulking": bulking}
            assumed.append("flow")
    content |= {"calibrate": [], "replicates": 10, "seed": 1, "assumed": assumed}
    datasets = {}
    if not grid.ground.all():
        geometry["mask"] = {"type": "file", "path": ""}
        attributes = {"long_name": "1 where there is ground, 0 where not", "units": "1"}
        ground = {"ground": (grid.ground.astype(np.int8), attributes)}
        datasets["masks"] = _on_cells(ground, parts, cell)
    if grid.kept:
        columns = {_variable(name): _column(name, values) for name, values in grid.kept.items()}
        datasets["blocks"] = _on_cells(columns, parts, cell)
    return content, datasets, notes


def write_experiment(
    name: str,
    content: dict[str, Any],
    datasets: dict[str, xr.Dataset],
    notes: Iterable[str],
    into: str | Path,
    overwrite: bool = False,
) -> list[Path]:
    """Write `NAME.yaml`, and `masks/NAME.nc` and `blocks/NAME.nc` where there are, once checked.

    Raises
    ------
    ConfigError
        If the experiment does not load or its block model cannot be made, or if a file is there
        and is not to be overwritten; nothing is written then.
    """
    into = Path(into)
    if not re.fullmatch(NAME_PATTERN, name):
        text = "the name names the results; expected letters, digits, _ and -"
        raise ConfigError([(into / name, text)])
    target = into / f"{name}.yaml"
    files = {folder: Path(folder) / f"{name}.nc" for folder in datasets}
    targets = [target, *(into / file for file in files.values())]
    there = [path for path in targets if path.exists()]
    if there and not overwrite:
        raise ConfigError(
            (path, "is there already; choose another name, or --overwrite") for path in there
        )
    if "masks" in files:
        content["geometry"]["mask"]["path"] = files["masks"].as_posix()
    for region in content.get("regions", ()):
        region["column"] = {"path": files["blocks"].as_posix()} | region["column"]
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / target.name
        made.write_text(_text(content, notes), encoding="utf-8")
        for kind, dataset in datasets.items():
            (Path(folder) / kind).mkdir()
            plain = {axis: {"_FillValue": None} for axis in dataset.coords}
            dataset.to_netcdf(Path(folder) / files[kind], engine="netcdf4", encoding=plain)
        try:
            build_block_model(load_experiment(made))
        except ConfigError as error:
            raise ConfigError(
                (target, f"not written, it would be wrong: {text}") for _, text in error.problems
            ) from None
        for path in reversed(targets):  # its files first: no experiment without them
            with whole_file(path) as partial:
                shutil.copyfile(Path(folder) / path.relative_to(into), partial)
    return targets


class _Dumper(yaml.SafeDumper):
    """SafeDumper that quotes names such as 12E04, which are numbers to the experiment's reader."""


def _quoted(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = '"' if re.fullmatch(r"[-+.0-9eE]+", text) else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style)


_Dumper.add_representer(str, _quoted)


def _text(content: dict[str, Any], notes: Iterable[str]) -> str:
    head = ["Imported. What was understood, left out or assumed:", *(f"- {note}" for note in notes)]
    if content["assumed"]:
        listed = ", ".join(content["assumed"])
        head.append(f"- no file says {listed}: these are starting values, to calibrate")
    body = yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)
    return "".join(f"# {line}\n" for line in head) + body


# ---------------------------------------------------------------------------------------------


def _sides(grid: BlockGrid) -> str:
    return " x ".join(f"{extent:g}" for extent in grid.size)


def _neat(value: float) -> float:
    return float(f"{value:.10g}")


def _cell_size(path: Path, grid: BlockGrid, wanted: float | None) -> float:
    """Side of the cells, m: the one wanted, or the largest that divides the blocks."""
    in_mm = [round(extent * 1000) for extent in grid.size]
    cell = wanted or math.gcd(*in_mm) / 1000
    sides = _sides(grid)
    for extent in grid.size:
        parts = extent / cell
        if parts < 0.5 or abs(parts - round(parts)) > 1e-6 * parts:
            common = math.gcd(*in_mm) / 1000
            text = f"cell_size = {cell:g}: expected a whole fraction of {common:g} m"
            raise ConfigError([(path, f"{text}, which divides the blocks of {sides} m")])
    cells = grid.ground.size * math.prod(grid.size) / cell**3
    if cells > MAX_CELLS:
        text = (
            f"blocks of {sides} m need cells of {cell:g} m, {cells:.2g} of them; reblock to cubes"
        )
        raise ConfigError([(path, f"{text}, or nearly so, for at most {MAX_CELLS:.0g}")])
    return cell


def _material(blocks, grid, settings, notes, assumed) -> dict[str, Any]:
    given = settings.material
    density = given.bulk_density
    if density is None and grid.density is None:
        raise ConfigError(
            [
                (
                    blocks.table.path,
                    "no column for density; name it with columns.density, or give "
                    "material.bulk_density in the settings",
                )
            ]
        )
    if density is None:
        values = grid.density[grid.ground]
        density = float(f"{values.mean():.6g}")
        if np.ptp(values) > 1e-6 * density:
            notes.append(
                f"densities from {values.min():.6g} to {values.max():.6g} kg/m3: the model takes "
                f"their mean, {density:g} kg/m3, everywhere"
            )
    solids = given.particle_density
    if solids is None and blocks.solids is not None:
        solids = float(f"{blocks.solids.mean():.6g}")
    if solids is None:
        solids = max(SOLIDS, density)
        assumed.append("material.particle_density")
    material = {"name": given.name, "bulk_density": density, "particle_density": solids}
    angle = given.internal_friction_angle
    angle = blocks.friction_angle if angle is None else angle
    return material if angle is None else material | {"internal_friction_angle": _neat(angle)}


def _region(region: ImportedRegion) -> dict[str, Any]:
    """A region under the keys of the experiment's file, but for the path of its column."""
    said = region.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    column = {"name": _variable(said.pop("column")), "values": said.pop("values")}
    for grade in said.get("grade", {}).values():
        if "column" in grade:
            grade["column"] = _variable(grade["column"])
    return {"name": said.pop("name"), "column": column} | said


def _variable(column: str) -> str:
    """Name in a netCDF file of a column, which may hold blanks or slashes."""
    return re.sub(r"[^\w.+-]", "_", column)


def _column(name: str, values: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """A column (z, y, x) as numbers with attributes; texts become flags with their meanings."""
    attributes: dict[str, Any] = {"long_name": f"column {name} of the block model"}
    if values.dtype.kind != "U":
        return values, attributes
    texts, codes = np.unique(values, return_inverse=True)
    meanings = ["_".join(text.split()) or "no_value" for text in texts.tolist()]
    attributes["flag_values"] = np.arange(len(texts), dtype=np.int32)
    attributes["flag_meanings"] = " ".join(meanings)
    return codes.reshape(values.shape).astype(np.int32), attributes


def _on_cells(
    blocks: dict[str, tuple[np.ndarray, dict[str, Any]]], parts: list[int], cell: float
) -> xr.Dataset:
    """Values of blocks on the lattice's cells; `parts` of them to a block along x, y and z."""
    data, shape = {}, ()
    for name, (values, attributes) in blocks.items():
        for axis, count in zip((2, 1, 0), parts, strict=True):
            values = values.repeat(count, axis)
        data[name], shape = (tuple("zyx"), values, attributes), values.shape
    coords = {
        axis: (axis, (np.arange(n) + 0.5) * cell, {"units": "m"})
        for axis, n in zip("zyx", shape, strict=True)
    }
    return xr.Dataset(data, coords=coords)


def _drawpoints(drawpoints, grid: BlockGrid, cell: float, size: float | None) -> list[dict]:
    """Drawpoints in the model's coordinates; an error for each that is not at the blocks' base."""
    path, points = drawpoints
    size = cell if size is None else size
    _, ny, nx = grid.ground.shape
    extents = np.array([nx, ny]) * grid.size[:2]
    base, step = grid.corner[2], grid.size[2]
    off = [p for p in points if abs(p.elevation - base) > step]
    if off:
        low, high = min(p.elevation for p in points), max(p.elevation for p in points)
        raise ConfigError(
            [
                (
                    path,
                    f"line {off[0].line}: {off[0].name} lies at {off[0].elevation:g} m and the "
                    f"blocks' base at {base:g} m (drawpoints: {low:g} to {high:g} m); say base: "
                    f"{base + round((low - base) / step) * step:g} to leave out the blocks below",
                )
            ]
        )
    found, wrong = [], []
    columns = grid.ground.any(axis=0)
    for p in points:
        place = np.array([p.easting, p.northing]) - grid.corner[:2]
        if (place < size / 2 - 1e-6).any() or (place > extents - size / 2 + 1e-6).any():
            (east, north), (to_east, to_north) = grid.corner[:2], grid.corner[:2] + extents
            wrong.append(
                f"line {p.line}: {p.name} at ({p.easting:.10g}, {p.northing:.10g}), an opening "
                f"of {size:g} m, reaches outside the blocks (eastings {east:.10g} to "
                f"{to_east:.10g}, northings {north:.10g} to {to_north:.10g})"
            )
            continue
        i, j = (place / grid.size[:2]).astype(int)
        if not columns[min(j, ny - 1), min(i, nx - 1)]:
            wrong.append(
                f"line {p.line}: {p.name} at ({p.easting:.10g}, {p.northing:.10g}) has no ground "
                "above it"
            )
        x, y = (_neat(round(float(v), 6)) for v in place)
        found.append({"name": p.name, "x": x, "y": y, "width": size, "length": size})
    if wrong:
        raise ConfigError((path, text) for text in wrong)
    return found


def _draw(schedule: Schedule, drawpoints, cell_mass: float) -> dict[str, Any]:
    """Draw lines and readings: in each period drawpoints are drawn evenly, side by side.

    A line draws the same from each of its drawpoints. In a period all of them give what the
    least of them gives, then all but that one the rest of the next, and so on; so what each
    drawpoint gives in each period is the schedule's. One reading ends each period.
    """
    path, points = (schedule.path, []) if drawpoints is None else drawpoints
    known = [point.name for point in points]
    unknown = [
        (schedule.path, f"line {line}: no drawpoint {name} in {shown_path(path)}")
        for name, line in zip(schedule.names, schedule.lines, strict=True)
        if name not in known
    ]
    if unknown:
        raise ConfigError(unknown)
    lines, readings, total = [], [], 0.0
    for period in range(len(schedule.days)):
        left = schedule.mass[:, period].copy()
        while left.any():
            drawn = np.nonzero(left)[0]
            each = float(left[drawn].min())
            left[drawn] -= each
            left[left < 1e-9 * each] = 0.0  # what rounding leaves
            turns = max(1, round(each / cell_mass))
            lines.append(
                {
                    "drawpoints": [schedule.names[place] for place in drawn],
                    "mass": each * len(drawn),
                    "increment": each / turns,
                }
            )
        total += float(schedule.mass[:, period].sum())
        if schedule.mass[:, period].any():
            readings.append(_neat(total))
    return {"draw": lines, "readings": {"at_mass_drawn": readings}}
