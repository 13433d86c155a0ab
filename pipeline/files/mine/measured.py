"""Stress measured in a mine, by date, to the table of measured values beside an experiment.

The mine's table has a row for each reading of a sensor. Its columns, in any order (UNIT is one of
mpa, kpa, pa, bar):

========================  ====================================================================
date                      YYYY-MM-DD, with a time of day or without
load_cell                 a load cell of the experiment; empty: mean over the whole base
stress_UNIT               vertical stress, or
stress_change_UNIT        its change since before draw, compression positive
std_UNIT                  one standard deviation of the value as given, of that reading alone
initial_UNIT              with a change: the stress before draw
initial_std_UNIT          with a change: its standard deviation, shared by the sensor's readings
========================  ====================================================================
"""

from __future__ import annotations

import csv
import io
import math
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.config.measured import COLUMNS, MeasuredError, read_measured
from pipeline.config.messages import ConfigError, did_you_mean, shown
from pipeline.files.atomic import write_text
from pipeline.files.mine.massflow import Schedule
from pipeline.files.mine.tables import Table, above_0, folded, read_table
from pipeline.files.units import FACTORS, KG_IN_T

_UNITS = {unit.lower(): unit for unit in FACTORS["stress"]}
_QUANTITIES = ("stress", "stress_change", "std", "initial", "initial_std")
_DAY = timedelta(days=1)


@dataclass(frozen=True)
class Calendar:
    """Mass drawn by date, kg, all drawpoints together, straight between the dates.

    Attributes
    ----------
    path : where it comes from
    dates : increasing
    mass : (date) kg
    """

    path: Path
    dates: tuple[datetime, ...]
    mass: np.ndarray

    def mass_on(self, date: datetime) -> float:
        """Mass drawn until a date, kg: none before the first, NaN after the last."""
        days = [(other - self.dates[0]) / _DAY for other in self.dates]
        return float(np.interp((date - self.dates[0]) / _DAY, days, self.mass, right=math.nan))


def calendar_of(schedule: Schedule, start: datetime) -> Calendar:
    """The calendar of a schedule whose first period starts on a date; draw is even in a period."""
    ends = [0.0, *np.cumsum(schedule.days).tolist()]
    mass = np.concatenate([[0.0], np.cumsum(schedule.mass.sum(axis=0))])
    return Calendar(schedule.path, tuple(start + day * _DAY for day in ends), mass)


def read_calendar(path: str | Path) -> Calendar:
    """The calendar in a CSV with the columns date and mass_drawn_t (t, summed up since the start).

    Raises
    ------
    ConfigError
        With every row that cannot be read, or is earlier or less than the one before it.
    """
    table = read_table(Path(path))
    date, mass = (_need(table, name) for name in ("date", "mass_drawn_t"))
    table.check()
    dates = _dates(table, date)
    values = table.numbers(mass, "the mass drawn since the start in t, 0 or more", lambda m: m >= 0)
    table.check()
    rows = list(zip(table.lines, dates, values, strict=True))
    for (_, before, less), (line, after, more) in pairwise(rows):
        if after <= before:
            table.problems.append(
                f"line {line}, date = {after:%Y-%m-%d}: expected later than the row before"
            )
        if more < less:
            table.problems.append(
                f"line {line}, mass_drawn_t = {more:g}: expected at least the {less:g} t of the "
                "row before; the mass is summed up since the start"
            )
    table.check()
    return Calendar(table.path, tuple(dates), values / KG_IN_T)


def convert(path: str | Path, experiment: Experiment, calendar: Calendar | None) -> list[dict]:
    """Rows of the measured table (kPa, kg) from the mine's table.

    A mine is one packing, so `count` is 1 and the replicates' scatter is added to the std. Before
    the calendar's first date nothing was drawn. Of a static experiment, dates are not read.

    Raises
    ------
    ConfigError
        With every row that cannot be read, is of no load cell, or outside the calendar.
    """
    table = read_table(Path(path))
    found = _quantity_columns(table)
    dates = [None] * len(table.rows)
    if experiment.is_draw:
        column = _need(table, "date")
        table.check()
        dates = _dates(table, column)
    table.check()
    cells = table.texts("load_cell") if "load_cell" in table.header else [""] * len(table.rows)
    known = [cell.name for cell in experiment.load_cells]
    for line, cell in zip(table.lines, cells, strict=True):
        if cell and cell not in known:
            hint = (
                did_you_mean(cell, known, "known load cells:")
                or "; it declares none: add load_cells to it, or leave this empty"
            )
            table.problems.append(
                f"line {line}, load_cell = {shown(cell)}: not in {experiment.name}{hint}"
            )
    std = _in_kpa(table, found["std"], "a standard deviation above 0", above_0)
    shared = np.zeros(len(table.rows))
    if "stress" in found:
        stress = _in_kpa(table, found["stress"], "a stress above 0", above_0)
    else:
        change = _in_kpa(table, found["stress_change"], "a change of stress")
        stress = change + _in_kpa(table, found["initial"], "a stress above 0", above_0)
        shared = _in_kpa(
            table, found["initial_std"], "a standard deviation, 0 or more", _at_least_0
        )
        table.say(
            [
                f"line {line}: a change of {by:g} kPa leaves {left:g} kPa; expected above 0, with "
                "compression positive"
                for line, by, left in zip(table.lines, change, stress, strict=True)
                if left <= 0
            ]
        )
    masses = [None] * len(dates)
    if experiment.is_draw:
        masses = _masses(table, dates, experiment, calendar)
    _refuse_repeated(table, cells, masses)
    table.check()
    return [
        {
            "experiment": experiment.name,
            "load_cell": cell,
            "mass_drawn": "" if mass is None else f"{mass:.10g}",
            "quantity": "vertical_stress",
            "value": f"{value:.10g}",
            "std": f"{own:.10g}",
            "std_shared": f"{common:.10g}" if common else "",
            "count": "1",
        }
        for cell, mass, value, own, common in zip(cells, masses, stress, std, shared, strict=True)
    ]


def write_measured(
    rows: Iterable[dict], experiment: Experiment, path: str | Path, overwrite: bool = False
) -> None:
    """Write the measured table whole, once the experiment has read it.

    Raises
    ------
    ConfigError
        If the table would not be valid, or is there and is not to be overwritten.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise ConfigError([(path, "is there already; choose another --out, or --overwrite")])
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "measured.csv"
        trial.write_text(text.getvalue(), encoding="utf-8")
        try:
            read_measured(trial, experiment)
        except MeasuredError as error:
            raise ConfigError((path, f"not written: {one}") for one in error.problems) from None
    write_text(path, text.getvalue())


# ---------------------------------------------------------------------------------------------


def _need(table: Table, name: str) -> str:
    column = table.find(None, [folded(name)])
    if column is None:
        table.problems.append(
            f"line {table.header_line}: no column {name}; its columns are {', '.join(table.header)}"
        )
        return name
    return column


def _quantity_columns(table: Table) -> dict[str, tuple[str, str]]:
    """(column, unit) of each quantity; problems where one is missing or has no unit."""
    found = {}
    for column in table.header:
        quantity, _, unit = column.lower().rpartition("_")
        if quantity in _QUANTITIES and unit in _UNITS:
            found[quantity] = (column, _UNITS[unit])
        elif column.lower() in _QUANTITIES:
            table.problems.append(
                f"line {table.header_line}: column {column} has no unit; expected {column}_mpa, "
                f"{column}_kpa, {column}_pa or {column}_bar"
            )
    if not table.problems and ("stress" in found) == ("stress_change" in found):
        table.problems.append(
            f"line {table.header_line}: expected one of stress_mpa, stress_change_mpa (or _kpa, "
            f"_pa, _bar); its columns are {', '.join(table.header)}"
        )
    needed = ("std",) if "stress" in found else ("std", "initial", "initial_std")
    for quantity in needed if not table.problems else ():
        if quantity not in found:
            table.problems.append(
                f"line {table.header_line}: no column {quantity}_mpa (or _kpa, _pa, _bar); a "
                f"{'stress' if 'stress' in found else 'change of stress'} needs {', '.join(needed)}"
            )
    return found


def _in_kpa(table: Table, column: tuple[str, str], expected: str, ok=lambda _: True) -> np.ndarray:
    name, unit = column
    return table.numbers(name, f"{expected}, in {unit}", ok) * FACTORS["stress"][unit]


def _dates(table: Table, column: str) -> list[datetime]:
    dates, wrong = [], []
    for line, text in zip(table.lines, table.texts(column), strict=True):
        try:
            dates.append(datetime.fromisoformat(text).replace(tzinfo=None))
        except ValueError:
            wrong.append(
                f"line {line}, {column} = {shown(text or None)}: expected a date as 2025-12-31"
            )
    table.say(wrong)
    table.check()
    return dates


def _masses(table, dates, experiment, calendar) -> list[float]:
    masses = [calendar.mass_on(date) for date in dates]
    last, total = calendar.dates[-1], experiment.mass_scheduled
    table.say(
        [
            f"line {line}, date = {date:%Y-%m-%d}: after the end of {calendar.path.name} "
            f"({last:%Y-%m-%d})"
            for line, date, mass in zip(table.lines, dates, masses, strict=True)
            if math.isnan(mass)
        ]
    )
    table.say(
        [
            f"line {line}, date = {date:%Y-%m-%d}: {mass * KG_IN_T:g} t were drawn by then, more "
            f"than the {total * KG_IN_T:g} t that {experiment.name} draws"
            for line, date, mass in zip(table.lines, dates, masses, strict=True)
            if mass > total * (1 + 1e-9)
        ]
    )
    return masses


def _refuse_repeated(table: Table, cells, masses) -> None:
    first: dict[tuple, int] = {}
    wrong = []
    for line, cell, mass in zip(table.lines, cells, masses, strict=True):
        key = (cell, "" if mass is None else f"{mass:.9g}")
        if key in first:
            when = "" if mass is None else f" at {mass * KG_IN_T:g} t drawn"
            wrong.append(
                f"line {line}: {cell or 'the base'}{when} again, as in line {first[key]}; keep one "
                "reading, or their mean"
            )
        first.setdefault(key, line)
    table.say(wrong)


def _at_least_0(value: float) -> bool:
    return value >= 0
