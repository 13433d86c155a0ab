"""CSV block models: centroids, sizes and attributes, as several mining packages write them.

Read are plain CSV, Vulcan's (lines 2 to 4 hold the variables' descriptions, types and defaults)
and Leapfrog's (comment lines with the block model's definition, then plain CSV).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.imports import ImportSettings
from pipeline.config.messages import ConfigError
from pipeline.files.mine.tables import Table, above_0, read_lines, read_table, split
from pipeline.files.units import FACTORS

ROLES = {  # how other programs call a column, spelled as by `folded`
    role: names.split()
    for role, names in {
        "x": "centroidx xcentroid xc xcentre xcenter xmid midx easting east x",
        "y": "centroidy ycentroid yc ycentre ycenter ymid midy northing north y",
        "z": "centroidz zcentroid zc zcentre zcenter zmid midz elevation elev rl z",
        "dx": "dimx xdim dx xl xlength lengthx xsize sizex xinc",
        "dy": "dimy ydim dy yl ylength lengthy ysize sizey yinc",
        "dz": "dimz zdim dz zl zlength lengthz zsize sizez zinc",
        "density": "bulkdensity bulkdensitykgm3 density dens sg specificgravity rho",
    }.items()
}
NAMES = {"x": "easting", "y": "northing", "z": "elevation"}
_VULCAN = re.compile(r"^\s*\"?variable[ _]?(description|type|default)s?\b", re.IGNORECASE)
_ANGLE = re.compile(r"^(azimuth|dip|pitch|plunge|rotation)\b\D*?(-?\d+(?:\.\d*)?)", re.IGNORECASE)


@dataclass
class BlockTable:
    """Blocks of a table, one in each row.

    Attributes
    ----------
    table : what they were read from; problems are said of its lines
    centers : (block, 3) easting, northing and elevation of the centers, m
    sizes : (block, 3) extents along x, y and z, m; None where the table has none
    columns : the names of the columns of x, y and z
    density : (block) kg m-3, in situ; None where the table has none
    solids : (block) kg m-3, density of the solids; None where the table has none
    ground : (block) bool
    swell : volume that loosening adds, relative to the volume in situ; None where not said
    friction_angle : mean internal friction angle, degrees; None where not said
    notes : what was understood, for the user
    kept : columns that regions name, (block): numbers, NaN where empty, or texts
    """

    table: Table
    centers: np.ndarray
    sizes: np.ndarray | None
    columns: tuple[str, str, str]
    density: np.ndarray | None
    ground: np.ndarray
    solids: np.ndarray | None = None
    swell: float | None = None
    friction_angle: float | None = None
    notes: tuple[str, ...] = ()
    kept: dict[str, np.ndarray] = field(default_factory=dict)


def read_block_table(path: str | Path, settings: ImportSettings) -> BlockTable:
    """The blocks of a CSV block model in any of the flavors.

    Raises
    ------
    ConfigError
        With every row that cannot be read, or the columns that are missing.
    """
    path = Path(path)
    table, flavor = _read_flavor(path)
    factor = FACTORS["length"][settings.units.length]
    unit = settings.units.length
    wanted = settings.columns
    found = {role: table.find(getattr(wanted, role), known) for role, known in ROLES.items()}
    for role in "xyz":
        if found[role] is None and getattr(wanted, role) is None:
            table.problems.append(
                f"line {table.header_line}: no column for the {NAMES[role]} of a block's center; "
                f"its columns are {', '.join(table.header)}; name it with columns.{role}"
            )
    table.check()
    centers = np.column_stack(
        [table.numbers(found[role], f"a coordinate in {unit}") for role in "xyz"]
    )
    sizes = None
    given = [role for role in ("dx", "dy", "dz") if found[role] is not None]
    if len(given) == 3:
        expected = f"an extent in {unit}, above 0"
        sizes = np.column_stack([table.numbers(found[r], expected, above_0) for r in given])
        sizes *= factor
    elif given:
        missing = ", ".join(sorted({"dx", "dy", "dz"} - set(given)))
        table.problems.append(
            f"line {table.header_line}: sizes along {', '.join(given)} alone; "
            f"name the columns of {missing} with columns, or none"
        )
    density, notes = None, [flavor] if flavor else []
    ground = _ground(table, settings)
    if found["density"] is not None:
        density, note = read_density(table, found["density"], settings, ground)
        notes.append(note)
    _refuse_rotation(table)
    kept = read_kept(table, settings)
    table.check()
    columns = tuple(found[role] for role in "xyz")
    return BlockTable(
        table, centers * factor, sizes, columns, density, ground, notes=tuple(notes), kept=kept
    )


def read_kept(table: Table, settings: ImportSettings) -> dict[str, np.ndarray]:
    """Columns that the settings' regions name: numbers where all cells are, or else texts."""
    kept = {}
    for name in settings.kept_columns:
        if table.find(name, ()) is None:
            continue
        texts = table.texts(name)
        try:
            kept[name] = np.array([float(text) if text else np.nan for text in texts])
        except ValueError:
            kept[name] = np.array(texts)
    return kept


def read_density(
    table: Table, column: str, settings: ImportSettings, ground: np.ndarray
) -> tuple[np.ndarray, str]:
    """Densities (kg m-3) of a column, checked where there is ground, and how they were read."""
    values = table.numbers(column, "a density")
    unit = settings.units.density
    largest = np.nanmax(values, initial=0.0)
    note = f"{column}: read as {unit}"
    if unit is None:
        unit = "t/m3" if largest < 20 else "kg/m3"
        note = f"{column}: its unit is not said; values up to {largest:g} were read as {unit}"
    factor = FACTORS["density"][unit]
    expected = f"expected a density from 100 to 10000 kg/m3 ({100 / factor:g} to {10000 / factor:g}"
    table.say(
        [
            f"line {line}, {column} = {value:g}: {expected} {unit}); is it a code for missing, or "
            "not ground?"
            for line, value, inside in zip(table.lines, values, ground, strict=True)
            if inside and not np.isnan(value) and not 100 <= value * factor <= 10000
        ]
    )
    return values * factor, note


def _read_flavor(path: Path) -> tuple[Table, str]:
    """The table without the header lines that are a flavor's own, and what was left out."""
    lines = read_lines(path)
    data = [(n, line) for n, line in lines if not line.lstrip().startswith("#")]
    extra = [(n, line) for n, line in data[1:4] if _VULCAN.match(line)]
    if extra:
        numbers = {n for n, _ in extra}
        names = split(path, *data[0], ",")
        for number, line in extra:
            split(path, number, line, ",")
        lines = [(n, line) for n, line in lines if n not in numbers]
        table = read_table(path, lines)
        return table, f"{len(names)} columns under Vulcan's header of {len(extra) + 1} lines"
    table = read_table(path, lines)
    return table, f"{len(table.comments)} comment lines left out" if table.comments else ""


def _ground(table: Table, settings: ImportSettings) -> np.ndarray:
    """Whether each block is ground."""
    name, values = settings.columns.ground, settings.ground_values
    if name is None:
        if values is not None:
            raise ConfigError(
                [(table.path, "ground_values are given without columns.ground; name the column")]
            )
        return np.ones(len(table.rows), dtype=bool)
    column = table.find(name, ())
    table.check()
    if values is None:
        expected = "a number, 0 where there is no ground; name texts with ground_values"
        return table.numbers(column, expected) != 0
    texts = table.texts(column)
    ground = np.array([text in values for text in texts])
    if not ground.any():
        found = ", ".join(sorted(set(texts))[:8])
        table.problems.append(
            f"no block has {column} among {', '.join(values)}; its values are {found}"
        )
    return ground


def _refuse_rotation(table: Table) -> None:
    """A rotation that the comments declare."""
    for comment in table.comments:
        found = _ANGLE.match(comment)
        if found and float(found[2]) % 90 != 0:
            table.problems.append(
                f"its comments declare {found[1].lower()} {found[2]}°; export the model unrotated, "
                "in its own axes"
            )
