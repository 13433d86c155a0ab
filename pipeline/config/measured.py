"""The table of measured values beside an experiment: CSV, or netCDF with the same names.

Read while the workflow is parsed, so only the standard library is imported (netCDF4 for a .nc
table alone). One row is one value of one quantity at one place and time, in ``COLUMNS``.
"""

import csv
import difflib
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

COLUMNS = {
    "experiment": "name of the experiment that the row belongs to",
    "load_cell": "name of the load cell; empty: mean over the whole base",
    "fill_height": "m; empty: full",
    "mass_drawn": "kg from all drawpoints together; empty: before draw or static",
    "quantity": "what the value is of; it gives the unit",
    "value": "in the unit of its quantity",
    "std": "one standard deviation of what is independent from reading to reading",
    "std_shared": "one of what all readings of that load cell share; empty: 0",
    "count": "number of packings averaged; empty: std already holds their scatter",
}
"""Columns and what stands in them."""
REQUIRED_COLUMNS = ("experiment", "quantity", "value", "std")
QUANTITIES = {
    "vertical_stress": "kPa",
    "vertical_stress_ratio": "1",
    "vertical_stress_spatial_std": "kPa",
    "movement_zone_height": "m",
    "movement_zone_width": "m",
}
"""Quantities and their units."""

_OF_THE_BASE = ("vertical_stress_spatial_std", "movement_zone_height", "movement_zone_width")
_OF_DRAW = ("vertical_stress_ratio", "movement_zone_height", "movement_zone_width")
_LARGEST_STRESS = 1e5  # kPa; no granular model bears more, so such a value is in Pa
_COMMENT = ("#", '"#')  # spreadsheets put a comment that holds a comma in quotes
_MERGE = 1e-9  # relative distance within which two readings are one


class MeasuredError(ValueError):
    """All that is wrong with a measured table: ``path``, and ``problems``, one text each."""

    def __init__(self, path: Path, problems: Iterable[str]):
        self.path = Path(path)
        self.problems = tuple(problems)
        super().__init__("\n  ".join((str(path), *self.problems)))

    def __reduce__(self):
        return type(self), (self.path, self.problems)


@dataclass(frozen=True)
class MeasuredRow:
    """One measured value; std and std_shared have the value's unit."""

    load_cell: str | None
    """Load cell; None: mean over the whole base."""
    fill_height: float | None
    """Fill height, m; None: full."""
    mass_drawn: float | None
    """Mass drawn before the reading, kg (0 before draw); None in a static experiment."""
    quantity: str
    value: float
    std: float
    std_shared: float
    count: int | None
    """Number of packings averaged; None when std already holds their scatter."""
    line: int
    """Line of the CSV, or place in the netCDF (from 1)."""


def read_measured(path: Path, experiment) -> tuple[MeasuredRow, ...]:
    """The rows of a measured table that belong to an experiment, in the table's order.

    Parameters
    ----------
    path
        CSV, or netCDF (.nc) whose one-dimensional variables have the CSV's column names.
    experiment
        The ``pipeline.config`` experiment: its name selects the rows, its load cells, height and
        draw say which of them can be.

    Raises
    ------
    MeasuredError
        With every problem of the table, or when no row belongs to the experiment.
    """
    path = Path(path)
    table = _read(path)
    problems: list[str] = []
    rows: list[MeasuredRow] = []
    first: dict[tuple, int] = {}
    others: list[str] = []
    for line, cells in table:
        if isinstance(cells, str):
            problems.append(cells)
            continue
        name = cells["experiment"]
        if name != experiment.name:
            if _folded(name) == _folded(experiment.name) or not name:
                problems.append(
                    f"line {line}, experiment = {name or '(empty)'}: expected a "
                    f"name, did you mean {experiment.name}?"
                )
            elif name not in others:
                others.append(name)
            continue
        reader = _RowReader(line, cells, experiment)
        row = reader.read()
        problems += reader.problems
        if row is None:
            continue
        key = (
            row.quantity,
            row.load_cell,
            _rounded(experiment.geometry.height if row.fill_height is None else row.fill_height),
            _rounded(row.mass_drawn or 0.0),
        )
        if key in first:
            problems.append(
                f"line {line}: the same reading as line {first[key]}; keep one, or give their "
                "mean with its count"
            )
        first.setdefault(key, line)
        rows.append(row)
    if not rows and not problems:
        found = f"its experiments are {_listed(others)}" if others else "it holds no rows"
        problems.append(f"no rows for experiment {experiment.name}; {found}")
    if problems:
        raise MeasuredError(path, problems)
    return tuple(rows)


def rows_by_name(path: Path) -> dict[str, int]:
    """Number of rows of each experiment that a measured table names, in the table's order.

    Raises
    ------
    MeasuredError
        When it cannot be read as a table, or names no experiment.
    """
    rows = [cells for _, cells in _read(Path(path))]
    names = Counter(cells["experiment"] for cells in rows if not isinstance(cells, str))
    if not any(names):
        problems = [cells for cells in rows if isinstance(cells, str)]
        raise MeasuredError(path, problems or ["no row names its experiment"])
    return dict(names)


def fill_levels(experiment, rows: Iterable[MeasuredRow] = ()) -> tuple[float, ...]:
    """Fill heights (m) at which an experiment is read, increasing; the full height is the last."""
    height = experiment.geometry.height
    declared = experiment.filling.levels if experiment.filling else ()
    measured = [row.fill_height for row in rows if row.fill_height is not None]
    return _merged([height, *declared, *measured])


def reading_masses(experiment, rows: Iterable[MeasuredRow] = ()) -> tuple[float, ...]:
    """Masses drawn (kg) at which an experiment is read, increasing from 0; () when static.

    Declared are the multiples of ``readings.every`` up to the scheduled mass, which is the last,
    or ``readings.at_mass_drawn``; measured masses join them.
    """
    if not experiment.is_draw:
        return ()
    every, total = experiment.readings.every, experiment.mass_scheduled
    if every is None:
        declared = list(experiment.readings.at_mass_drawn)
    else:
        multiples = math.floor(total / every * (1 + _MERGE))
        declared = [total, *(float(f"{every * n:.12g}") for n in range(1, multiples + 1))]
    measured = [row.mass_drawn for row in rows if row.mass_drawn is not None]
    return _merged([0.0, *declared, *measured])


# ---------------------------------------------------------------------------------------------
# one row


class _RowReader:
    """Reads one row of an experiment, and collects what is wrong with it."""

    def __init__(self, line: int, cells: dict[str, str], experiment):
        self.line, self.cells, self.experiment = line, cells, experiment
        self.problems: list[str] = []

    def read(self) -> MeasuredRow | None:
        quantity = self._quantity()
        row = MeasuredRow(
            load_cell=self._load_cell(quantity),
            fill_height=self._fill_height(),
            mass_drawn=self._mass_drawn(quantity),
            quantity=quantity,
            value=self._value(quantity),
            std=self._positive("std", "a standard deviation above 0, in the value's unit"),
            std_shared=self._std_shared(),
            count=self._count(),
            line=self.line,
        )
        return None if self.problems else row

    def _say(self, column: str, text: str) -> None:
        self.problems.append(
            f"line {self.line}, {column} = {_short(self.cells[column]) or '(empty)'}: {text}"
        )

    def _number(self, column: str, expected: str) -> float | None:
        text = self.cells[column]
        try:
            number = float(text)
        except ValueError:
            comma = text.replace(",", ".", 1)
            try:
                float(comma)
                self._say(column, f"expected {expected}; did you mean {comma}?")
            except ValueError:
                self._say(column, f"expected {expected}; write a bare number")
            return None
        if not math.isfinite(number):
            self._say(
                column, f"expected {expected}; it must be finite; a row without a value is left out"
            )
            return None
        return number

    def _positive(self, column: str, expected: str) -> float | None:
        if not self.cells[column]:
            self._say(column, f"expected {expected}")
            return None
        number = self._number(column, expected)
        if number is not None and number <= 0:
            self._say(column, f"expected {expected}")
        return number

    def _quantity(self) -> str | None:
        quantity = self.cells["quantity"]
        if quantity in QUANTITIES:
            return quantity
        self._say("quantity", f"unknown quantity{_nearest(quantity, QUANTITIES, 'known:')}")
        return None

    def _load_cell(self, quantity: str | None) -> str | None:
        name = self.cells["load_cell"]
        if not name:
            return None
        known = [cell.name for cell in self.experiment.load_cells]
        if quantity in _OF_THE_BASE:
            self._say("load_cell", f"{quantity} belongs to the whole model; leave load_cell empty")
        elif name not in known:
            hint = _nearest(name, known, "known:") or (
                f"; {self.experiment.name} declares none, leave it empty for the mean of the base"
            )
            self._say("load_cell", f"unknown load cell{hint}")
        return name

    def _fill_height(self) -> float | None:
        if not self.cells["fill_height"]:
            return None
        height = self.experiment.geometry.height
        expected = f"a height in m, above 0 and at most the model's ({height:g} m)"
        level = self._number("fill_height", expected)
        if level is None:
            return None
        if self.cells["mass_drawn"]:
            self._say("fill_height", "given with mass_drawn; a drawn model is read full, leave one")
        elif not 0 < level <= height * (1 + _MERGE):
            hint = f"; did you mean {level / 1000:g}?" if 0 < level / 1000 <= height else ""
            self._say("fill_height", f"expected {expected}{hint}")
        elif self.experiment.is_draw and level < height * (1 - _MERGE):
            self._say(
                "fill_height",
                "a draw experiment is read with the model full; put fill "
                "levels into a static experiment of their own",
            )
        return level

    def _mass_drawn(self, quantity: str | None) -> float | None:
        experiment = self.experiment
        if not experiment.is_draw:
            if self.cells["mass_drawn"]:
                self._say("mass_drawn", f"{experiment.name} has no draw; leave it empty")
            elif quantity in _OF_DRAW:
                self._say("quantity", f"needs draw, and {experiment.name} has none")
            return None
        if not self.cells["mass_drawn"]:
            return 0.0
        total = experiment.mass_scheduled
        expected = f"a mass in kg from 0 to the scheduled {total:g} kg"
        mass = self._number("mass_drawn", expected)
        if mass is not None and not 0 <= mass <= total * (1 + _MERGE):
            self._say("mass_drawn", f"expected {expected}")
        return mass

    def _value(self, quantity: str | None) -> float | None:
        unit = QUANTITIES.get(quantity, "its unit")
        if unit == "m":
            expected = "a length in m, 0 or more"
            value = self._number("value", expected)
            longest = 2 * max(
                self.experiment.geometry.height,
                self.experiment.geometry.width,
                self.experiment.geometry.length,
            )
            if value is not None and value < 0:
                self._say("value", f"expected {expected}")
            elif value is not None and value > longest:
                self._say("value", f"expected {expected}; did you mean {value / 1000:g}?")
            return value
        expected = "a ratio above 0" if unit == "1" else f"a number in {unit}, above 0"
        value = self._positive("value", expected)
        if unit == "kPa" and value is not None and value > _LARGEST_STRESS:
            self._say(
                "value", f"expected {expected}; this looks like Pa, did you mean {value / 1000:g}?"
            )
        return value

    def _std_shared(self) -> float | None:
        if not self.cells["std_shared"]:
            return 0.0
        expected = "a standard deviation, 0 or more, in the value's unit"
        number = self._number("std_shared", expected)
        if number is not None and number < 0:
            self._say("std_shared", f"expected {expected}")
        return number

    def _count(self) -> int | None:
        if not self.cells["count"]:
            return None
        expected = "a whole number of packings, 1 or more, or empty"
        number = self._number("count", expected)
        if number is None:
            return None
        if number < 1 or not number.is_integer():
            self._say("count", f"expected {expected}")
            return None
        return int(number)


# ---------------------------------------------------------------------------------------------
# the table


def _read(path: Path) -> Iterator[tuple[int, dict[str, str] | str]]:
    return _read_netcdf(path) if path.suffix.lower() == ".nc" else _read_csv(path)


def _read_csv(path: Path) -> Iterator[tuple[int, dict[str, str] | str]]:
    """(line, cells by column) of each row; in place of the cells, what is wrong with the row."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise MeasuredError(
            path, [f"line {line}: not UTF-8 text; save the file with UTF-8 encoding"]
        ) from None
    except OSError as error:
        raise MeasuredError(path, [f"cannot be read: {error.strerror}"]) from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(_COMMENT)
    ]
    if not lines:
        raise MeasuredError(path, [f"empty; expected the columns {_listed(COLUMNS)}"])
    if ";" in lines[0][1] and "," not in lines[0][1]:
        raise MeasuredError(
            path,
            [
                f"line {lines[0][0]}: columns are separated by semicolons; separate them by "
                "commas, with a point in decimal numbers"
            ],
        )
    try:
        fields = list(csv.reader((line for _, line in lines), strict=True))
    except csv.Error as error:
        raise MeasuredError(path, [f"not readable as CSV: {error}"]) from None
    if len(fields) != len(lines):
        raise MeasuredError(path, ["not readable as CSV: a quote is not closed on its line"])
    header = [name.strip() for name in fields[0]]
    _check_columns(path, f"line {lines[0][0]}", header)
    for (number, _), cells in zip(lines[1:], fields[1:], strict=True):
        if len(cells) != len(header):
            counts = f"{len(cells)} fields, expected {len(header)}"
            yield number, f"line {number}: {counts} as in the first line"
        else:
            given = dict(zip(header, (cell.strip() for cell in cells), strict=True))
            yield number, {column: given.get(column, "") for column in COLUMNS}


def _read_netcdf(path: Path) -> Iterator[tuple[int, dict[str, str] | str]]:
    """As ``_read_csv``; missing values and NaN are empty."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as dataset:
            _check_columns(path, "variables", list(dataset.variables))
            columns = {name: _texts(dataset[name]) for name in COLUMNS if name in dataset.variables}
    except OSError as error:
        raise MeasuredError(path, [f"not readable as netCDF: {error}"]) from None
    lengths = {name: len(texts) for name, texts in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise MeasuredError(path, [f"variables differ in length ({listed}); use one dimension"])
    for place in range(lengths["experiment"]):
        yield place + 1, {name: columns[name][place] if name in columns else "" for name in COLUMNS}


def _texts(variable) -> list[str]:
    """Values of a netCDF variable (strings, characters or numbers) as the CSV would have them."""
    import netCDF4

    values = variable[...]
    if values.dtype.kind == "S" and values.ndim > 1:
        values = netCDF4.chartostring(values)
    values = values.tolist()  # masked values become None
    values = values if isinstance(values, list) else [values]
    texts = [value.decode() if isinstance(value, bytes) else value for value in values]
    return ["" if text is None or text != text else str(text).strip() for text in texts]


def _check_columns(path: Path, where: str, header: list[str]) -> None:
    problems = [
        f"{where}: column {name} appears {header.count(name)} times"
        for name in dict.fromkeys(header)
        if header.count(name) > 1
    ]
    problems += [
        f"{where}: unknown column {name or '(empty)'}{_nearest(name, COLUMNS, 'known:')}"
        for name in dict.fromkeys(header)
        if name not in COLUMNS
    ]
    problems += [
        f"{where}: column {name} is missing; expected {_listed(COLUMNS)}"
        for name in REQUIRED_COLUMNS
        if name not in header
    ]
    if problems:
        raise MeasuredError(path, problems)


# ---------------------------------------------------------------------------------------------


def _merged(values: Iterable[float]) -> tuple[float, ...]:
    """Sorted values; of those within 1e-9 relative of each other, the one that came first."""
    kept: list[float] = []
    for value in values:
        if not any(math.isclose(value, other, rel_tol=_MERGE) for other in kept):
            kept.append(value)
    return tuple(sorted(kept))


def _rounded(number: float) -> str:
    return f"{number:.9g}"


def _folded(name: str) -> str:
    return name.casefold().replace("-", "_").replace(" ", "_")


def _listed(names: Iterable[str]) -> str:
    return _short(", ".join(names), 200)


def _short(text: str, most: int = 40) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _nearest(word: str, known: Iterable[str], otherwise: str) -> str:
    names = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), names, n=1)
    if near:
        return f"; did you mean {names[near[0]]}?"
    return f"; {otherwise} {_listed(names.values())}" if names else ""
