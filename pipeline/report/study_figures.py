"""Figures of a study's page: residuals, what they share, posteriors, held-out predictions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import xarray as xr

from pipeline.loop import SURE
from pipeline.report.figures import BLUE, GREEN, INK, MARKERS, MUTED, ORANGE, PURPLE, Panel
from pipeline.report.page import Data, Figure, decimals_of, parts
from pipeline.report.results import THRESHOLD_SD, quantity_words

WIDE = 15.0  # standard deviations from which their axis turns logarithmic
WIDE_RATIO = 20.0  # of the largest to the smallest value, likewise
STANDARD = "data less model (sd)"
GROUPS = {  # variable of residual.nc: what its values are
    "experiment": "experiment",
    "load_cell": "load cell",
    "material": "material",
    "zone": "ground above the load cell",
}
PLACES = {  # variable of residual.nc: axis
    "mass_drawn": "mass drawn (kg)",
    "fill_height": "fill height (m)",
    "wall_friction_angle": "wall friction angle (°)",
}


def texts(residual: xr.Dataset, name: str) -> list[str]:
    """A variable of text, reading by reading."""
    return [bytes(value).decode() for value in residual[name].values]


def residual_figures(residual: xr.Dataset, label: str, data: Data) -> list[Figure]:
    """What the baseline leaves unexplained; `label` says what the data are."""
    figures = [
        one_to_one_figure(residual, label, data),
        misfit_figure(residual, data),
        standardized_figure(residual, label, data),
    ]
    return [figure for figure in figures if figure]


def one_to_one_figure(residual: xr.Dataset, label: str, data: Data) -> Figure:
    """The calibrated baseline against the data, a panel for each quantity."""
    experiments = np.array(texts(residual, "experiment"))
    quantities = np.array(texts(residual, "quantity"))
    styles = _styles(experiments)
    panels = []
    for quantity in dict.fromkeys(quantities):
        here = quantities == quantity
        simulated, measured, sd = (
            residual[name].values[here]
            for name in ("simulated", "measured", "measured_uncertainty")
        )
        panel = _square(data, "one_to_one", quantity, label, np.append(simulated, measured))
        for name, (color, marker) in styles.items():
            own = experiments[here] == name
            if own.any():
                y, error = measured[own], sd[own]
                panel.points(name, simulated[own], y, y - error, y + error, color, marker)
        panels.append(panel)
    caption = parts(
        "The {} values that the study calibrates on (n = {}), over the calibrated baseline with "
        "nothing added. Bars: ± 1 sd of a reading about the model, packing and instrument "
        "together.",
        label,
        data.number("one_to_one", "", "values", len(quantities)),
    )
    return Figure("one_to_one", "Data over the calibrated baseline", caption, panels)


def standardized_figure(residual: xr.Dataset, label: str, data: Data) -> Figure | None:
    """Standardized residuals by what they might depend on; None where nothing varies."""
    values = residual["standardized_residual"].values
    panels = [*_by_group(residual, values, data), *_by_place(residual, values, data)]
    if not panels:
        return None
    caption = parts(
        "Data ({}, n = {}) less the calibrated baseline, of logarithms where a quantity is "
        "positive, in standard deviations of a reading about the model. Scatter without a pattern "
        "and within {} sd is what a model that lacks nothing leaves.",
        label,
        data.number("standardized", "", "values", len(values)),
        data.number("standardized", "", "threshold", THRESHOLD_SD, 0, "sd"),
    )
    return Figure("standardized", "Where the baseline is off", caption, panels)


def _by_group(residual: xr.Dataset, values: np.ndarray, data: Data) -> Iterator[Panel]:
    for variable, words in GROUPS.items():
        if variable not in residual:
            continue
        names = texts(residual, variable)
        rows = list(dict.fromkeys(filter(None, names)))
        if len(rows) < 2:
            continue
        shown = [(v, name) for v, name in zip(values, names, strict=True) if name]
        panel = Panel.of_rows(
            data,
            "standardized",
            f"By {words}",
            STANDARD,
            f"Standardized residuals by {words}.",
            rows,
        )
        panel.span(f"within {THRESHOLD_SD:g} sd", -THRESHOLD_SD, THRESHOLD_SD)
        panel.reference("no error", x=0.0)
        panel.dots("reading", *zip(*shown, strict=True), BLUE, filled=False)
        _stretch(panel.axes, "x", np.abs(values).max())
        yield panel


def _by_place(residual: xr.Dataset, values: np.ndarray, data: Data) -> Iterator[Panel]:
    experiments = np.array(texts(residual, "experiment"))
    styles = _styles(experiments)
    for variable, axis in PLACES.items():
        if variable not in residual or len(set(_finite(residual, variable))) < 2:
            continue
        place = residual[variable].values
        words = axis.split(" (")[0]
        panel = Panel(
            data,
            "standardized",
            f"Against {words}",
            axis,
            STANDARD,
            f"Standardized residuals against {words}.",
        )
        panel.reference("no error", y=0.0)
        for side in (-THRESHOLD_SD, THRESHOLD_SD):
            panel.reference(f"± {THRESHOLD_SD:g} sd", y=side, dash="dotted")
        for name, (color, marker) in styles.items():
            own = (experiments == name) & np.isfinite(place)
            if own.any():
                panel.points(name, place[own], values[own], color=color, marker=marker)
        _stretch(panel.axes, "y", np.abs(values).max())
        yield panel


def misfit_figure(residual: xr.Dataset, data: Data) -> Figure | None:
    """Each experiment's part of the sum of squares; None for a single experiment."""
    experiments = np.array(texts(residual, "experiment"))
    names = list(dict.fromkeys(experiments))
    squares = residual["whitened_residual"].values ** 2
    if len(names) < 2 or not squares.sum() > 0.0:
        return None
    shares = [100.0 * squares[experiments == name].sum() / squares.sum() for name in names]
    panel = Panel.of_rows(
        data,
        "misfit",
        "",
        "share of the misfit (%)",
        f"Share of the misfit by experiment; {names[int(np.argmax(shares))]} has the most.",
        names,
    )
    panel.bars("share", shares, names)
    panel.axes.set_xlim(0, None)
    caption = parts(
        "Sum of squares of the whitened residuals, without what readings share: {} for {} "
        "readings, and each experiment's share of it.",
        data.number("misfit", "", "sum of squares", squares.sum(), decimals_of(squares.sum())),
        data.number("misfit", "", "readings", len(squares)),
    )
    return Figure("misfit", "Who has the misfit", caption, [panel])


def posterior_figures(found: Mapping[str, Any], data: Data) -> list[Figure]:
    """Posterior by name, for each round that asked."""
    figures = []
    for number, evidence in enumerate(found["evidence"], start=1):
        if evidence is None:
            continue
        probability = {**evidence["by_name"], "nothing missing": evidence["none"]}
        names = list(probability)
        added = {e["name"] for e in found["effects_added"] if e["round"] == number}
        best = max(probability, key=probability.get)
        figure = f"posterior_{number}"
        panel = Panel.of_rows(
            data,
            figure,
            "",
            "posterior probability (–)",
            f"Posterior by name in round {number}; {best} has the most, {probability[best]:.3f}.",
            names,
        )
        for words, is_added, color in (("added", True, GREEN), ("not added", False, MUTED)):
            of = [name for name in names if (name in added) is is_added]
            if of:
                panel.bars(words, [probability[name] for name in of], of, color)
        panel.reference(f"from here one name is added ({SURE:g})", x=SURE)
        panel.axes.set_xlim(0, 1)
        caption = parts(
            "Hypotheses pooled by name, given n = {} values; names with no evidence at all are in "
            "the table. Probabilities of all that could be missing, and of nothing, add up to 1.",
            data.number(figure, "", "values", found["degrees_of_freedom"]["readings"]),
        )
        title = f"Round {number}: what is missing?"
        figures.append(Figure(figure, title, caption, [panel]))
    return figures


def held_out_figure(rows: Sequence[Mapping[str, Any]], label: str, data: Data) -> Figure | None:
    """Data over predictions of what was held out, before and after; None without any."""
    if not rows:
        return None
    panels = []
    for quantity in dict.fromkeys(row["quantity"] for row in rows):
        of = [row for row in rows if row["quantity"] == quantity]
        value = {key: np.array([row[key] for row in of]) for key in ("measured", "before", "after")}
        panel = _square(data, "held_out", quantity, label, np.concatenate([*value.values()]))
        for words, key, style in (
            ("before", "before", (ORANGE, "s", False)),
            ("after", "after", (BLUE, "o", True)),
        ):
            color, marker, filled = style
            panel.points(
                words, value[key], value["measured"], color=color, marker=marker, filled=filled
            )
        panels.append(panel)
    caption = parts(
        "The {} values that were held out (n = {}), over what the model predicts without them. "
        "No bars: the table of errors has their scatter.",
        label,
        data.number("held_out", "", "values", len(rows)),
    )
    return Figure("held_out", "Held-out predictions", caption, panels)


def fold_figure(folds: Sequence[Mapping[str, Any]], data: Data) -> Figure | None:
    """Error of each held-out part before and after; None for fewer than two."""
    errors = {
        fold["name"]: [fold["error"][when]["rms_log"] for when in ("before", "after")]
        for fold in folds
        if fold["error"] and fold["error"]["before"]["rms_log"] is not None
    }
    if len(errors) < 2:
        return None
    panel = Panel.of_rows(
        data,
        "folds",
        "",
        "held-out error, rms of logarithms (–)",
        "Held-out error before and after, by what was held out.",
        errors,
    )
    before, after = zip(*errors.values(), strict=True)
    panel.dots("before", before, errors, ORANGE, "s", False)
    panel.dots("after", after, errors, BLUE)
    panel.axes.set_xlim(0, None)
    caption = parts(
        "n = {} parts that were held out, each predicted by the model that a loop without it came "
        "to; how many values each has is in the table.",
        data.number("folds", "", "parts", len(errors)),
    )
    return Figure("folds", "Error of each held-out part", caption, [panel])


def _square(data: Data, figure: str, quantity: str, label: str, values: np.ndarray) -> Panel:
    """Axes of a model's values and the data, with the line on which they are equal."""
    words = quantity_words(quantity)
    name, _, unit = words.partition(" (")
    panel = Panel(
        data,
        figure,
        name.capitalize(),
        f"model{unit and f' ({unit}'}",
        f"{label}{unit and f' ({unit}'}",
        f"Data ({label}) on {words}, over the model's values.",
        (2.7, 2.7),
    )
    values = values[np.isfinite(values)]
    low, high = values.min(), values.max()
    room = 0.06 * (high - low or abs(high) or 1.0)
    ends = [low - room, high + room]
    if low > 0.0 and high > WIDE_RATIO * low:
        ends = [low / 1.2, high * 1.2]
        for axis in ("x", "y"):
            getattr(panel.axes, f"set_{axis}scale")("log")
            getattr(panel.axes, f"{axis}axis").set_major_formatter("{x:g}")
    panel.curve("equal", ends, ends, color=MUTED, dash="dashed")
    return panel


def _styles(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Color and marker of each name."""
    pairs = zip(cycle((BLUE, ORANGE, GREEN, PURPLE, INK)), cycle(MARKERS), strict=False)
    return dict(zip(dict.fromkeys(names), pairs, strict=False))


def _finite(residual: xr.Dataset, variable: str) -> np.ndarray:
    values = residual[variable].values
    return values[np.isfinite(values)]


def _stretch(axes, which: str, largest: float) -> None:
    """Limits around 0; logarithmic beyond the threshold where values lie far out."""
    largest = 1.3 * max(largest, THRESHOLD_SD)
    if largest > WIDE:
        getattr(axes, f"set_{which}scale")("symlog", linthresh=THRESHOLD_SD)
        ticks = [tick for tick in (2, 10, 100, 1000, 10000) if tick <= largest]
        getattr(axes, f"set_{which}ticks")([*(-t for t in reversed(ticks)), 0, *ticks])
        axis = getattr(axes, f"{which}axis")
        axis.set_major_formatter("{x:g}")
        axis.minorticks_off()
    getattr(axes, f"set_{which}lim")(-largest, largest)
