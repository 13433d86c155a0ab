"""The page that compares two draw experiments, from `comparison.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from pipeline.compare.comparison import SIDES
from pipeline.files.atomic import write_text
from pipeline.report.figures import (
    BLUE,
    DIFFERENCE_COLORS,
    ORANGE,
    SHARE_COLORS,
    Panel,
    panel_style,
)
from pipeline.report.page import Data, Figure, Link, Table, decimals_of, parts, render
from pipeline.report.plan_figures import MOST_MAPS, Area, evenly, mass_unit, plan

BAND = "P10–P90 of replicates"
STRESS, DIFFERENCE = "stress (MPa)", "difference (MPa)"
COLORS = {"first": (BLUE, "solid"), "second": (ORANGE, "dashed")}
MOST_SERIES = 5  # load cells whose series are shown, those that differ most


class Document:
    """`comparison.json` with what its figures and tables ask of it."""

    def __init__(self, content: Mapping[str, Any]):
        self.content = content
        self.entries: Sequence[Mapping[str, Any]] = content["load_cells"]
        self.names = [one["experiment"] for one in content["experiments"]]
        self.factor, self.unit = mass_unit(content["mass_drawn_kg"][-1])
        self.mass = self.factor * np.array(content["mass_drawn_kg"])
        self.load_cells = [(entry["load_cell"], *_place(entry)) for entry in self.entries]
        widths = ((one["width_m"], one["length_m"]) for one in content["experiments"])
        self.extent = tuple(max(side) for side in zip(*widths, strict=True))

    def values(self, *keys: str) -> np.ndarray:
        """An entry of each load cell, (load_cell, ...) float64; NaN where there is none."""
        found = []
        for entry in self.entries:
            for key in keys:
                entry = entry[key]
            found.append(entry)
        return np.array(found, dtype=np.float64)

    def drawpoints(self, side: str) -> list[Area]:
        """Drawpoints of one side."""
        described = self.content["experiments"][SIDES.index(side)]
        return [(one["name"], *_place(one)) for one in described["drawpoints"]]

    @property
    def threshold(self) -> float:
        """MPa."""
        return self.content["threshold_mpa"]

    @property
    def replicates_words(self) -> str:
        """How many replicates each has."""
        counts = [f"{one['replicates']}" for one in self.content["experiments"]]
        return f"n = {counts[0] if len({*counts}) == 1 else ' and '.join(counts)} replicates"

    @property
    def difference_words(self) -> str:
        """Which less which."""
        return f"{self.names[1]} less {self.names[0]}"


def _place(entry: Mapping[str, Any]) -> tuple[float, float, float, float]:
    return tuple(entry[f"{key}_m"] for key in ("x", "y", "width", "length"))


def write_comparison_report(
    content: Mapping[str, Any], report: str | Path, data_file: str | Path
) -> None:
    """Write the page of a comparison (content of its JSON) and the data that it shows."""
    data, document = Data(), Document(content)
    with panel_style():
        page = render(
            "comparison.html.j2",
            title=content["title"] or content["comparison"],
            name=content["comparison"],
            verdict=verdict(document, data),
            experiments=experiment_table(document, data),
            assumed={
                one["experiment"]: one["assumed"]
                for one in content["experiments"]
                if one["assumed"]
            },
            without_data=[
                one["experiment"] for one in content["experiments"] if not one["has_data"]
            ],
            series=series_figure(document, data),
            differences=difference_figure(document, data),
            maps=[
                *(map_figure(document, data, side) for side in SIDES),
                peak_figure(document, data),
                share_figure(document, data),
            ],
            load_cells=load_cell_table(document, data),
            numbers=Path(data_file).name,
            files=["comparison.json", "comparison.csv", "load_cells.csv", Path(data_file).name],
        )
    write_text(data_file, data.to_csv())
    write_text(report, page)


def verdict(document: Document, data: Data) -> list[Markup]:
    """The answer in a few sentences."""
    sentences = []
    for side, name in zip(SIDES, document.names, strict=True):
        peaks, share = document.values(side, "peak_mpa"), document.values(side, "share_above")
        if not np.isfinite(peaks).any():
            continue
        top = int(np.nanargmax(peaks))
        at = document.factor * document.entries[top][side]["peak_at_mass_drawn_kg"]
        sentences.append(
            parts(
                "<strong>{}</strong>: the highest mean stress is {} MPa, on {} {}. On average over "
                "the load cells stress is above {} MPa for {} % of the time.",
                name,
                data.number("verdict", name, "highest mean stress", peaks[top], 3, "MPa"),
                document.entries[top]["load_cell"],
                parts(
                    "after {} {}",
                    data.number("verdict", name, "at mass drawn", at, unit=document.unit),
                    document.unit,
                )
                if at
                else "before draw",
                data.number("verdict", name, "threshold", document.threshold, unit="MPa"),
                data.number("verdict", name, "share above", 100 * np.nanmean(share), 1, "%"),
            )
        )
    largest = document.values("largest_difference_mpa")
    if np.isfinite(largest).any():
        most = int(np.nanargmax(np.abs(largest)))
        entry = document.entries[most]
        at = document.factor * entry["largest_difference_at_mass_drawn_kg"]
        sentences.append(
            parts(
                "They differ most on {}: {} MPa ({}) after {} {}.",
                entry["load_cell"],
                data.number("verdict", "difference", "largest", largest[most], 3, "MPa"),
                document.difference_words,
                data.number("verdict", "difference", "at mass drawn", at, unit=document.unit),
                document.unit,
            )
        )
    return sentences


def experiment_table(document: Document, data: Data) -> Table:
    """The two experiments, with links to their pages."""
    table = Table(
        "experiments",
        parts(
            "What is compared. Time is the mass drawn. The threshold, {} MPa, is a choice of the "
            "comparison's file, not a strength.",
            data.number("experiments", "", "threshold", document.threshold, unit="MPa"),
        ),
        ["Experiment", "Title", "Stress is", "Replicates", "Load cells", "Drawpoints"],
        data,
    )
    for one in document.content["experiments"]:
        name = one["experiment"]
        counts = (one["replicates"], len(document.entries), len(one["drawpoints"]))
        table.rows.append(
            [
                Link(name, f"../../experiments/{name}/report.html"),
                one["title"],
                one["label"],
                *(
                    table.number(name, column, count, 0)
                    for column, count in zip(table.columns[3:], counts, strict=True)
                ),
            ]
        )
    return table


def series_figure(document: Document, data: Data) -> Figure:
    """Both series, on the whole base and on the load cells that differ most."""
    largest = np.abs(document.values("largest_difference_mpa"))
    ranked = np.argsort(-np.where(np.isfinite(largest), largest, -1.0), kind="stable")
    shown = [(None, document.content["base"])]
    shown += [
        (entry["load_cell"], entry) for entry in (document.entries[i] for i in ranked[:MOST_SERIES])
    ]
    tops = [
        value
        for _, entry in shown
        for side in SIDES
        for value in entry[side]["p90_mpa"]
        if value is not None
    ]
    top = max([document.threshold, *tops])
    panels = []
    for name, entry in shown:
        ends = ", ".join(
            f"{experiment} from {_words(entry[side]['mean_mpa'][0])} to "
            f"{_words(entry[side]['mean_mpa'][-1])} MPa"
            for side, experiment in zip(SIDES, document.names, strict=True)
        )
        title = "Mean over the whole base" if name is None else f"Load cell {name}"
        panel = Panel(
            data,
            "series",
            title,
            f"mass drawn ({document.unit})",
            STRESS,
            f"{title}: stress against mass drawn, {ends}.",
            (2.7, 2.0),
        )
        panel.reference(
            f"threshold {document.threshold:g} MPa", y=document.threshold, dash="dotted"
        )
        for side, experiment in zip(SIDES, document.names, strict=True):
            color, dash = COLORS[side]
            mean, low, high = (
                np.array(entry[side][f"{part}_mpa"], dtype=np.float64)
                for part in ("mean", "p10", "p90")
            )
            label = f"{experiment}, simulated mean"
            panel.curve(label, document.mass, mean, low, high, color, dash, f"{experiment}, {BAND}")
        panel.axes.set(ylim=(0, 1.08 * top), xlim=(0, document.mass[-1]))
        panels.append(panel)
    caption = parts(
        "Simulated stress against the mass drawn, {}; all panels have the same axes. Beside the "
        "whole base, the {} load cells where the two differ most at a reading. Curves are "
        "straight between the readings.",
        document.replicates_words,
        data.number("series", "", "load cells", len(shown) - 1),
    )
    return Figure("series", "The two side by side", caption, panels)


def _words(value: float | None) -> str:
    return "no value" if value is None else f"{value:.3g}"


def _readings(document: Document) -> list[int]:
    """Readings shown as maps: during draw, at most `MOST_MAPS`."""
    return [1 + i for i in evenly(len(document.mass) - 1, MOST_MAPS)]


def _at(document: Document, reading: int) -> str:
    return f"{document.mass[reading]:.4g} {document.unit} drawn"


def difference_figure(document: Document, data: Data) -> Figure:
    """Difference of the mean stress on each load cell, reading by reading, in plan."""
    values = document.values("difference_mpa")
    most = _largest(values)
    panels = [
        plan(
            data,
            "difference_maps",
            _at(document, t),
            document.extent,
            document.load_cells,
            values[:, t],
            DIFFERENCE,
            (-most, most),
            document.drawpoints("first"),
            document.difference_words,
            DIFFERENCE_COLORS,
        )
        for t in _readings(document)
    ]
    caption = parts(
        "Difference of the mean stress on each load cell, {}, at the same mass drawn, {}: red "
        "where the second carries more, blue where the first does. Standard errors are in the "
        "files.",
        document.difference_words,
        document.replicates_words,
    )
    return Figure("difference_maps", "Where and when they differ", caption, panels)


def _largest(values: np.ndarray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if known.size and known.max() > 0 else 1.0


def map_figure(document: Document, data: Data, side: str) -> Figure:
    """Mean stress on each load cell of one side in plan, reading by reading."""
    name = document.names[SIDES.index(side)]
    values = document.values(side, "mean_mpa")
    high = max(_largest(document.values(one, "mean_mpa")) for one in SIDES)
    panels = [
        plan(
            data,
            f"stress_maps_{side}",
            _at(document, t),
            document.extent,
            document.load_cells,
            values[:, t],
            STRESS,
            (0.0, high),
            document.drawpoints(side),
            f"mean stress, {name},",
        )
        for t in _readings(document)
    ]
    caption = parts(
        "Simulated mean stress on each load cell at the readings during draw of {}, {}; the scale "
        "is that of both experiments. Percentiles are in the files.",
        name,
        document.replicates_words,
    )
    return Figure(f"stress_maps_{side}", f"Stress in plan: {name}", caption, panels)


def peak_figure(document: Document, data: Data) -> Figure:
    """Peak of the mean stress on each load cell, and the mass drawn at it."""
    panels = []
    peaks = {side: document.values(side, "peak_mpa") for side in SIDES}
    high = max(_largest(value) for value in peaks.values())
    for side, name in zip(SIDES, document.names, strict=True):
        when = document.factor * document.values(side, "peak_at_mass_drawn_kg")
        for title, values, scale_name, scale in (
            (f"{name}, peak", peaks[side], STRESS, (0.0, high)),
            (
                f"{name}, when",
                when,
                f"mass drawn ({document.unit})",
                (0.0, float(document.mass[-1])),
            ),
        ):
            panels.append(
                plan(
                    data,
                    "peak_maps",
                    title,
                    document.extent,
                    document.load_cells,
                    values,
                    scale_name,
                    scale,
                    document.drawpoints(side),
                    "values",
                )
            )
    caption = parts(
        "Highest mean stress of each load cell among the readings, {}, and the mass drawn at "
        "which it was first reached (but for 0.1 %); 0 is before draw.",
        document.replicates_words,
    )
    return Figure("peak_maps", "Peak stress, and when", caption, panels)


def share_figure(document: Document, data: Data) -> Figure:
    """Share of time above the threshold of each load cell, of both and its difference."""
    shares = {side: 100 * document.values(side, "share_above") for side in SIDES}
    difference = shares["second"] - shares["first"]
    most = _largest(difference)
    rows = [
        (name, shares[side], "share of time (%)", (0.0, 100.0), SHARE_COLORS, side)
        for side, name in zip(SIDES, document.names, strict=True)
    ]
    rows.append(
        (
            document.difference_words,
            difference,
            "difference (%)",
            (-most, most),
            DIFFERENCE_COLORS,
            "first",
        )
    )
    panels = [
        plan(
            data,
            "share_maps",
            title,
            document.extent,
            document.load_cells,
            values,
            name,
            scale,
            document.drawpoints(side),
            "share of time above the threshold",
            colors,
        )
        for title, values, name, scale, colors, side in rows
    ]
    caption = parts(
        "Share of the time, counted as mass drawn, for which the stress on a load cell is above "
        "{} MPa: mean over {}, each straight between its readings.",
        data.number("share_maps", "", "threshold", document.threshold, unit="MPa"),
        document.replicates_words,
    )
    title = f"Share of time above {document.threshold:g} MPa"
    return Figure("share_maps", title, caption, panels)


def load_cell_table(document: Document, data: Data) -> Table:
    """Peak, when, and share of time above the threshold of each load cell, of both."""
    kinds = ("peak (MPa)", f"at ({document.unit})", "above (%)", "P10 (%)", "P90 (%)")
    table = Table(
        "load_cells",
        parts(
            "Each load cell: peak of the mean stress and the mass drawn at it, share of time above "
            "{} MPa (mean, P10 and P90 over replicates), and the largest difference at a reading, "
            "{}. More in load_cells.csv.",
            data.number("load_cells", "", "threshold", document.threshold, unit="MPa"),
            document.difference_words,
        ),
        [
            "Load cell",
            "x (m)",
            "y (m)",
            *(f"{name}: {kind}" for name in document.names for kind in kinds),
            "Difference: largest (MPa)",
            f"Difference: at ({document.unit})",
        ],
        data,
    )
    for entry in document.entries:
        numbers: list[tuple[Any, int | None]] = [(entry["x_m"], None), (entry["y_m"], None)]
        for side in SIDES:
            one = entry[side]
            numbers += [
                (one["peak_mpa"], decimals_of(document.threshold, 3)),
                (document.factor * one["peak_at_mass_drawn_kg"], None),
            ]
            shares = (one[f"share_above{suffix}"] for suffix in ("", "_p10", "_p90"))
            numbers += [(None if share is None else 100 * share, 1) for share in shares]
        numbers += [
            (entry["largest_difference_mpa"], decimals_of(document.threshold, 3)),
            (document.factor * entry["largest_difference_at_mass_drawn_kg"], None),
        ]
        table.add_numbers(entry["load_cell"], numbers)
    return table
