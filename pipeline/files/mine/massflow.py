"""Itasca MassFlow's files: mine blocks, drawpoints and the draw schedule.

As the public command reference of MassFlow (ITASCA 9.0 and 9.1, `massflow mine-block import`,
`massflow drawpoint import`, `massflow drawpoint import-drawperiod`) describes them:

- mine blocks: CSV; one line of column names, of which those of `MINE_BLOCKS` are mandatory, in
  any order and spelled so; further columns are grades. An older variant is separated by tabs,
  with its names in line 2 and nothing of use in lines 1 and 3.
- drawpoints: CSV; name, easting, northing, elevation, drawbell number and drawbell type in this
  order, whatever the names in line 1.
- draw schedule: CSV, or separated by tabs; line 1 has the days of each period from the second
  column on, each further line a drawpoint's name and its tonnes in each period.

Not said there, and so assumed: solid densities are in t/m3 (examples have 2.6), porosities are
fractions of volume, angles are degrees. Drawbells' shapes are in other files and are not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.config.imports import ImportSettings
from pipeline.config.messages import NAME_PATTERN, did_you_mean, shown
from pipeline.files.mine.block_table import BlockTable, read_density, read_kept
from pipeline.files.mine.tables import Table, read_lines, read_table, split, stop
from pipeline.files.units import FACTORS

MINE_BLOCKS = (
    "Easting",
    "Northing",
    "Elevation",
    "CavePeriod",
    "BlockID",
    "SolidsDen",
    "InSituPor",
    "MaxPor",
    "FricAng",
    "PriFragA",
    "PriFragB",
    "TenStrA",
    "TenStrB",
    "UCS",
    "PercK1",
    "PercK2",
    "PercVMR",
)
"""Columns that mine blocks must have."""
USED = ("Easting", "Northing", "Elevation", "SolidsDen", "InSituPor", "MaxPor", "FricAng")
_DRAWPOINTS = ("DPName", "Easting", "Northing", "Elevation", "DBID", "DBType")


@dataclass(frozen=True)
class MineDrawpoint:
    """A drawpoint in mine coordinates, m."""

    name: str
    easting: float
    northing: float
    elevation: float
    line: int


@dataclass(frozen=True)
class Schedule:
    """What is drawn when.

    Attributes
    ----------
    path : the file
    days : (period) days of each period
    names : drawpoints
    lines : line of each drawpoint
    mass : (drawpoint, period) kg
    """

    path: Path
    days: np.ndarray
    names: tuple[str, ...]
    lines: tuple[int, ...]
    mass: np.ndarray


def read_mine_blocks(path: str | Path, settings: ImportSettings) -> BlockTable:
    """Mine blocks; the density in situ is that of the solids less the porosity in situ.

    The swell is what brings the mean porosity in situ to the largest one.

    Raises
    ------
    ConfigError
        With the columns that are missing, and every row that cannot be read.
    """
    path = Path(path)
    lines = read_lines(path)
    if len(lines) > 2 and "\t" not in lines[0][1] and "\t" in lines[1][1]:
        blank = len(lines) > 2 and "\t" not in lines[2][1]
        lines = [lines[1], *lines[3 if blank else 2 :]]
    table = read_table(path, lines)
    missing = [name for name in MINE_BLOCKS if name not in table.header]
    for name in missing:
        hint = did_you_mean(name, [n for n in table.header if n not in MINE_BLOCKS], "")
        hint = hint if hint.endswith("?") else ""
        table.problems.append(f"line {table.header_line}: column {name} is missing{hint}")
    if missing:
        table.problems.append(f"expected MassFlow's columns {', '.join(MINE_BLOCKS)}")
    table.check()
    unit = settings.units.length
    centers = [table.numbers(name, f"a coordinate in {unit}") for name in USED[:3]]
    everywhere = np.ones(len(table.rows), dtype=bool)
    solids, note = read_density(table, "SolidsDen", settings, everywhere)
    expected = "a porosity, a fraction of volume from 0 to below 1"
    in_situ, largest = (
        table.numbers(name, expected, _porosity) for name in ("InSituPor", "MaxPor")
    )
    angle = table.numbers("FricAng", "an angle in degrees from 0 to below 90", _angle)
    table.say(
        [
            f"line {line}, MaxPor = {most:g}: expected at least InSituPor ({least:g})"
            for line, least, most in zip(table.lines, in_situ, largest, strict=True)
            if most < least
        ]
    )
    kept = read_kept(table, settings)
    table.check()
    return BlockTable(
        table,
        np.column_stack(centers) * FACTORS["length"][unit],
        None,
        USED[:3],
        solids * (1 - in_situ),
        everywhere,
        solids=solids,
        swell=float((1 - in_situ.mean()) / (1 - largest.mean()) - 1),
        friction_angle=float(angle.mean()),
        notes=(note,),
        kept=kept,
    )


def read_drawpoints(path: str | Path, settings: ImportSettings) -> tuple[Path, list[MineDrawpoint]]:
    """Drawpoints, and their file.

    Raises
    ------
    ConfigError
        With every row that cannot be read, and names that are there twice or cannot be ours.
    """
    table = read_table(Path(path))
    if len(table.header) < 4:
        raise stop(
            table.path,
            f"line {table.header_line}: {len(table.header)} columns; expected "
            f"{', '.join(_DRAWPOINTS)} in this order",
        )
    names = [row[0] for row in table.rows]
    _check_names(table, names)
    unit = settings.units.length
    places = [table.numbers(name, f"a coordinate in {unit}") for name in table.header[1:4]]
    table.check()
    factor = FACTORS["length"][unit]
    rows = zip(names, *(place * factor for place in places), table.lines, strict=True)
    return table.path, [
        MineDrawpoint(name, float(e), float(n), float(z), line) for name, e, n, z, line in rows
    ]


def read_schedule(path: str | Path) -> Schedule:
    """A draw schedule, tonnes as kg.

    Raises
    ------
    ConfigError
        With every cell that is no number of days or tonnes, or when nothing is drawn.
    """
    path = Path(path)
    lines = [(n, line) for n, line in read_lines(path) if not line.startswith("#")]
    if not lines:
        raise stop(path, "holds comments alone; expected DPName, then the days of each period")
    first, head = lines[0]
    delimiter = "\t" if "\t" in head else ","
    _, *days = split(path, first, head, delimiter)
    names = ["DPName", *(f"period {n}" for n in range(1, len(days) + 1))]
    if not days:
        raise stop(path, f"line {first}: no periods; expected DPName, then the days of each period")
    header = delimiter.join(names)
    table = read_table(path, [(first, header), *lines[1:]])
    for name, text in zip(names[1:], days, strict=True):
        try:
            good = float(text) > 0
        except ValueError:
            good = False
        if not good:
            table.problems.append(
                f"line {first}, {name} = {shown(text or None)}: expected its days, a number above 0"
            )
    points = [row[0] for row in table.rows]
    _check_names(table, points)
    tonnes = [table.numbers(name, "tonnes, 0 or more", lambda t: t >= 0) for name in names[1:]]
    table.check()
    mass = np.column_stack(tonnes) * FACTORS["mass"]["t"]
    if not mass.any():
        raise stop(path, "draws nothing; expected tonnes above 0 in at least one period")
    return Schedule(path, np.array(days, float), tuple(points), tuple(table.lines), mass)


def _check_names(table: Table, names: list[str]) -> None:
    first: dict[str, int] = {}
    for line, name in zip(table.lines, names, strict=True):
        if not re.fullmatch(NAME_PATTERN, name):
            better = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")
            hint = f"; did you mean {better}?" if better else ""
            table.problems.append(
                f"line {line}, {table.header[0]} = {shown(name or None)}: expected letters, "
                f"digits, _ and -{hint}"
            )
        elif name in first:
            table.problems.append(
                f"line {line}, {table.header[0]} = {name}: line {first[name]} has this name"
            )
        first.setdefault(name, line)


def _porosity(value: float) -> bool:
    return 0 <= value < 1


def _angle(value: float) -> bool:
    return 0 <= value < 90
