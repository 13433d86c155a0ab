"""Delimited text of other programs, with the line of each row kept for what is wrong with it."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.messages import ConfigError, did_you_mean, shown

MOST_SHOWN = 5  # problems of one kind


@dataclass
class Table:
    """Rows under a header; `problems` collects what is wrong with them until `check`.

    Attributes
    ----------
    path : the file
    header : names of the columns
    header_line : line of the header
    lines : line of each row
    rows : cells of each row, as many as the header has
    comments : lines that start with #, without it
    """

    path: Path
    header: list[str]
    header_line: int
    lines: list[int]
    rows: list[list[str]]
    comments: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def find(self, wanted: str | None, known: Iterable[str]) -> str | None:
        """Name of a column: the one `wanted`, or the first that is spelled like one of `known`.

        A column that is wanted and not there is a problem.
        """
        if wanted is not None:
            if wanted in self.header:
                return wanted
            hint = did_you_mean(wanted, self.header, "its columns are")
            self.problems.append(f"line {self.header_line}: no column {wanted}{hint}")
            return None
        spelled = {folded(name): name for name in reversed(self.header)}
        return next((spelled[name] for name in known if name in spelled), None)

    def texts(self, column: str) -> list[str]:
        """Cells of a column, without blanks around them."""
        place = self.header.index(column)
        return [row[place] for row in self.rows]

    def numbers(
        self, column: str, expected: str, ok: Callable[[float], bool] = lambda _: True
    ) -> np.ndarray:
        """Cells of a column as numbers, NaN and a problem where one is not what is `expected`."""
        values, wrong = np.full(len(self.rows), np.nan), []
        for place, (line, text) in enumerate(zip(self.lines, self.texts(column), strict=True)):
            number = _number(text)
            if number is None or not ok(number):
                comma = re.fullmatch(r"[-+]?\d+,\d+", text)
                hint = f"; did you mean {text.replace(',', '.')}?" if comma else ""
                wrong.append(
                    f"line {line}, {column} = {shown(text or None)}: expected {expected}{hint}"
                )
            else:
                values[place] = number
        self.say(wrong)
        return values

    def say(self, problems: Sequence[str]) -> None:
        """Add problems of one kind, the first few in full and the number of the others."""
        self.problems += some_of(problems)

    def check(self) -> None:
        """Raise ConfigError with all that was found wrong."""
        if self.problems:
            raise ConfigError((self.path, text) for text in self.problems)


def some_of(problems: Sequence[str]) -> Iterator[str]:
    """The first few problems of one kind, and how many more there are."""
    yield from problems[:MOST_SHOWN]
    if len(problems) > MOST_SHOWN:
        yield f"... and {len(problems) - MOST_SHOWN} more rows like these"


def above_0(value: float) -> bool:
    """What most numbers of a table have to be."""
    return value > 0


def folded(name: str) -> str:
    """A column's name as it is looked for: letters and digits alone, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def stop(path: Path, text: str) -> ConfigError:
    """The error of a file that cannot be read at all."""
    return ConfigError([(path, text)])


def read_lines(path: Path) -> list[tuple[int, str]]:
    """Lines of a text file with their numbers, blank ones left out.

    Raises
    ------
    ConfigError
        If there is no such file, or it is not UTF-8 text, or empty.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
        text = data.decode("utf-8-sig")
    except FileNotFoundError:
        others = [other.name for other in path.parent.glob("*") if other.is_file()]
        raise stop(path, "no such file" + did_you_mean(path.name, others, "")) from None
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        text = f"line {line}: not UTF-8 text; save the file as CSV with UTF-8 encoding"
        raise stop(path, text) from None
    except OSError as error:
        raise stop(path, f"cannot be read: {error.strerror}") from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        raise stop(path, "the file is empty; expected a line of column names, then rows")
    return lines


def read_table(path: Path, lines: Sequence[tuple[int, str]] | None = None) -> Table:
    """A table of comma- or tab-separated text; lines that start with # are comments.

    `lines` are those to read, where the file has more than the table.

    Raises
    ------
    ConfigError
        If the file is not such a table, with every row that is too long or too short.
    """
    path = Path(path)
    lines = read_lines(path) if lines is None else list(lines)
    comments = [line.lstrip().lstrip("#").strip() for _, line in lines if _is_comment(line)]
    lines = [(n, line) for n, line in lines if not _is_comment(line)]
    if not lines:
        raise stop(path, "holds comments alone; expected a line of column names, then rows")
    (first, head), *others = lines
    if ";" in head and "," not in head:
        text = "columns are separated by semicolons; separate them by commas, with decimal points"
        raise stop(path, f"line {first}: {text}")
    delimiter = "\t" if "\t" in head and "," not in head else ","
    header = split(path, first, head, delimiter)
    repeated = [n for n in dict.fromkeys(header) if n and header.count(n) > 1]
    if repeated:
        raise stop(
            path, f"line {first}: column {repeated[0]} appears {header.count(repeated[0])} times"
        )
    table = Table(path, header, first, [], [], comments)
    wrong = []
    for number, line in others:
        cells = split(path, number, line, delimiter)
        if len(cells) != len(header):
            wrong.append(
                f"line {number}: {len(cells)} fields, expected {len(header)} as in line {first}"
            )
        table.lines.append(number)
        table.rows.append(cells)
    table.say(wrong)
    table.check()
    if not table.rows:
        raise stop(path, f"line {first}: no rows follow the column names")
    return table


def split(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    """Cells of a line, without blanks around them."""
    try:
        (cells,) = csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=True)
    except csv.Error as error:
        raise stop(path, f"line {number}: not readable as CSV: {error}") from None
    return [cell.strip() for cell in cells]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
