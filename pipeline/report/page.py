"""A page: text, tables and figures in a template, and every number it shows in long format."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

COLUMNS = ("figure", "panel", "series", "x_name", "x", "y_name", "y", "y_low", "y_high")
MISSING = "–"


def plain(value: Any) -> str:
    """A value as the data file holds it: ten significant digits, empty if there is none."""
    if value is None or isinstance(value, str):
        return value or ""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, bool | int):
        return str(int(value))
    return f"{value:.10g}" if math.isfinite(value) else ""


def decimals_of(scale: float, significant: int = 4) -> int:
    """Decimals that show a number of this size with so many significant digits."""
    if not scale or not math.isfinite(scale):
        return significant - 1
    return max(0, significant - 1 - math.floor(math.log10(abs(scale))))


@dataclass(frozen=True)
class Number:
    """A number on a page; its HTML keeps the value that the data file holds.

    Shown with fixed `decimals`, or with four significant digits where they are None.
    """

    value: float | None
    decimals: int | None = None

    def __html__(self) -> Markup:
        stored = plain(self.value)
        if not stored:
            return Markup(MISSING)
        return Markup('<data value="{}">{}</data>').format(stored, self.shown())

    def shown(self) -> str:
        """The number as a reader sees it."""
        text = format(self.value, ".4g" if self.decimals is None else f".{self.decimals}f")
        if not float(text):
            text = text.lstrip("-")
        return text.replace("-", "−")


@dataclass(frozen=True)
class Badge:
    """A short label in a colored frame; `kind` is one of good, bad, warn, note."""

    text: str
    kind: str = "note"

    def __html__(self) -> Markup:
        return Markup('<span class="badge {}">{}</span>').format(self.kind, self.text)


@dataclass(frozen=True)
class Link:
    """A link to a page beside this one; `path` is relative."""

    text: str
    path: str

    def __html__(self) -> Markup:
        return Markup('<a href="{}">{}</a>').format(quote(self.path), self.text)


class Data:
    """What a page shows, in the columns of `COLUMNS`."""

    def __init__(self):
        self.rows: list[tuple[str, ...]] = []

    def add(self, figure, panel, series, x_name, x, y_name, y, low=None, high=None) -> None:
        """Add one row for each entry of `y`; `x`, `low` and `high` are like it, or None."""
        y = np.ravel(np.asarray(y, dtype=np.float64)).tolist()
        columns = [
            [None] * len(y) if values is None else np.ravel(np.asarray(values)).tolist()
            for values in (x, low, high)
        ]
        for place, value, below, above in zip(columns[0], y, *columns[1:], strict=True):
            cells = (x_name, place, y_name, value, below, above)
            self.rows.append((figure, panel, series, *map(plain, cells)))

    def number(
        self, figure: str, panel: str, series: str, value, decimals=None, unit: str = ""
    ) -> Number:
        """Record a number that stands in a text or a table, and return it for the page."""
        if plain(value):
            self.rows.append((figure, panel, series, "", "", unit, plain(value), "", ""))
        return Number(value, decimals)

    def to_csv(self) -> str:
        """The rows as CSV with a header."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(self.rows)
        return text.getvalue()

    def to_records(self) -> list[dict[str, Any]]:
        """The rows as dicts; numbers are numbers, and empty cells are left out."""
        return [
            {
                name: _number_or_text(cell) if name in ("x", "y", "y_low", "y_high") else cell
                for name, cell in zip(COLUMNS, row, strict=True)
                if cell
            }
            for row in self.rows
        ]


def _number_or_text(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


@dataclass
class Table:
    """A table; a cell is a text, a `Number`, a `Badge`, or a list of them.

    Neighboring columns named "GROUP: NAME" stand under a common head.
    """

    name: str
    caption: Any
    columns: Sequence[str]
    data: Data
    rows: list[list[Any]] = field(default_factory=list)

    def number(self, row: str, column: str, value, decimals=None, unit: str = "") -> Number:
        """A number for the cell of this row and column, recorded."""
        return self.data.number(self.name, row, column, value, decimals, unit)

    def add_numbers(self, name: str, numbers: Sequence[tuple[Any, int | None]]) -> None:
        """Add a row: its name and, for each other column, a value and its decimals."""
        cells = zip(self.columns[1:], numbers, strict=True)
        self.rows.append([name, *(self.number(name, column, *number) for column, number in cells)])

    @property
    def has_data(self) -> bool:
        """Whether the data have any number of it."""
        return any(row[0] == self.name for row in self.data.rows)

    @property
    def heads(self) -> list[tuple[str, list[str]]]:
        """(group, names of its columns), in order; the group is empty for a column of its own."""
        heads: list[tuple[str, list[str]]] = []
        for column in self.columns:
            group, _, name = column.rpartition(": ")
            if group and heads and heads[-1][0] == group:
                heads[-1][1].append(name)
            else:
                heads.append((group, [name]))
        return heads

    def has_numbers(self, group: str, name: str) -> bool:
        """Whether a column has numbers, which are aligned at its right."""
        place = self.columns.index(f"{group}: {name}" if group else name)
        return any(isinstance(row[place], Number) for row in self.rows)

    def without_empty_columns(self) -> Table:
        """The table less the columns in which no row has anything."""
        kept = [
            i for i in range(len(self.columns)) if any(not _is_empty(row[i]) for row in self.rows)
        ]
        self.columns = [self.columns[i] for i in kept]
        self.rows = [[row[i] for i in kept] for row in self.rows]
        return self


def _is_empty(cell: Any) -> bool:
    if isinstance(cell, Number):
        return not plain(cell.value)
    return not cell


@dataclass
class Figure:
    """Panels that belong together, with a legend in words and a caption."""

    name: str
    title: str
    caption: Any
    panels: list[Any]

    @property
    def legend(self) -> list[tuple[str, Markup]]:
        """(label, swatch) of each thing that the panels show, once."""
        entries = {}
        for panel in self.panels:
            entries |= panel.legend
        return list(entries.items())


def parts(template: str, *values: Any) -> Markup:
    """Text with numbers and user's words in its braces; the values are escaped."""
    return Markup(template).format(*values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader(__package__, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(template: str, **context: Any) -> str:
    """HTML of a page: `template` in this folder, with the style sheet inside.

    `context` has `numbers`, the file that holds the page's numbers, relative to the page.
    """
    return _environment().get_template(template).render(style=resource("style.css"), **context)


def resource(name: str) -> Markup:
    """Text of a file in this folder, for a page as it is."""
    return Markup(files(__package__).joinpath(name).read_text("utf-8"))
