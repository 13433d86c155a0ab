"""Figures of the index page: what the experiments say together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pipeline.report.figures import BLUE, GREEN, MARKERS, ORANGE, Panel
from pipeline.report.index_entries import Entry
from pipeline.report.page import Data, Figure, parts
from pipeline.report.results import THRESHOLD_SD
from pipeline.validate.validation import CALIBRATED, DECLARED, REPRODUCED


def transmission_figure(entries: Sequence[Entry], data: Data) -> Figure | None:
    """E against R_h·H by wall friction angle, as declared and as calibrated (Fig. 10)."""
    if not entries:
        return None
    angles = np.array(
        [e.experiment.walls.friction_angle if e.experiment.walls else math.nan for e in entries]
    )
    given = angles[np.isfinite(angles)]
    low, high = (given.min(), given.max()) if len(given) else (0.0, 1.0)
    low, high = (low, high) if high > low else (low - 1, high + 1)
    calibrated = [e.calibration["parameters"]["E"]["calibrated"] for e in entries]
    materials = list(dict.fromkeys(e.experiment.material.name for e in entries))
    all_E = [e.calibration["parameters"]["E"] for e in entries]
    floor = min(min(E["start"], *(E["interval_90"] or [1.0]), E["value"]) for E in all_E)
    panels = []
    for title, key, shown in (
        ("E as declared (published, where it was)", "start", [True] * len(entries)),
        ("E calibrated here, with its 90 % interval", "value", calibrated),
    ):
        if not any(shown):
            continue
        panel = Panel(
            data,
            "transmission",
            title,
            "R_h·H (m²)",
            "E (–)",
            f"{title} against hydraulic radius times height.",
            (3.0, 2.4),
            bar=bool(len(given)),
        )
        for i, material in enumerate(materials):
            at = [
                j
                for j, e in enumerate(entries)
                if shown[j] and e.experiment.material.name == material
            ]
            if not at:
                continue
            y = np.array([all_E[j][key] for j in at])
            error = None
            if key == "value":
                ends = np.array([all_E[j]["interval_90"] for j in at]).T
                error = np.maximum([y - ends[0], ends[1] - y], 0.0)
            panel.shaded_points(
                material,
                np.array([entries[j].size for j in at]),
                y,
                angles[at],
                "wall friction angle (°)",
                low,
                high,
                list(MARKERS)[i % len(MARKERS)],
                error,
            )
        if len(given):
            panel.color_bar("wall friction angle (°)", low, high)
        panel.axes.set_xscale("log")
        panel.axes.xaxis.set_major_formatter("{x:g}")
        panel.axes.set_ylim(max(0.0, floor - 0.08), 1.02)
        panels.append(panel)
    caption = parts(
        "E against hydraulic radius times height of n = {} experiments, by material (marker) and "
        "wall friction angle (color; hollow: not given). E rises towards 1 in large models and "
        "falls with wall friction where the base is small. E belongs to a cell size: compare "
        "models with the same one, or their ℓ in the table.",
        data.number("transmission", "", "experiments", len(entries)),
    )
    return Figure("transmission", "E against the size of the model", caption, panels)


def published_figure(entries: Sequence[Entry], data: Data) -> Figure | None:
    """Our simulated mean and sd with the published parameters, over the published (Table 5)."""
    entries = [e for e in entries if e.published.get("ours_mean") is not None]
    if not entries:
        return None
    names = [entry.name for entry in entries]
    worst = max((abs(e.published["mean_ratio"] - 1), e.name) for e in entries)
    panel = Panel.of_rows(
        data,
        "published",
        "",
        "ours / published (–)",
        f"Ratio of our simulated mean to the published one; {worst[1]} is off "
        f"by {100 * worst[0]:.0f} %.",
        names,
    )
    panel.span("counts as reproduced", 1 - REPRODUCED, 1 + REPRODUCED, GREEN)
    panel.reference("equal", x=1.0)
    for words, reproduced, color in (
        ("mean over the base, reproduced", True, GREEN),
        ("mean over the base, not reproduced", False, ORANGE),
    ):
        of = [e for e in entries if e.published["mean_reproduced"] is reproduced]
        if of:
            panel.dots(words, [e.published["mean_ratio"] for e in of], [e.name for e in of], color)
    with_std = [e for e in entries if e.published.get("vertical_stress_std")]
    panel.dots(
        "standard deviation between places",
        [e.published["ours_std"] / e.published["vertical_stress_std"] for e in with_std],
        [e.name for e in with_std],
        BLUE,
        "s",
        False,
    )
    caption = parts(
        "With the published parameters and the declared inputs, our simulated stress over the "
        "published simulated stress, n = {} experiments. A mean within {} % counts as reproduced; "
        "the other means do not come out of the published inputs.",
        data.number("published", "", "experiments", len(entries)),
        data.number("published", "", "reproduced within", 100 * REPRODUCED, 0, "%"),
    )
    return Figure("published", "Are the published simulations reproduced?", caption, [panel])


def error_figure(entries: Sequence[Entry], data: Data) -> Figure | None:
    """Error of every value in measured standard deviations, by experiment."""
    entries = [entry for entry in entries if entry.label]
    if not entries:
        return None
    names = [f"{entry.name}" for entry in entries]
    panel = Panel.of_rows(
        data,
        "errors",
        "",
        "model less value (sd of the value)",
        "Errors of each experiment in standard deviations of its data.",
        names,
    )
    panel.span(f"within {THRESHOLD_SD:g} sd", -THRESHOLD_SD, THRESHOLD_SD)
    panel.reference("no error", x=0.0)
    series = {
        "as declared": (GREEN, "D", True),
        "calibrated, value used in the calibration": (BLUE, "o", False),
        "calibrated, value not used": (BLUE, "o", True),
    }
    points: dict[str, list[tuple[float, str]]] = {label: [] for label in series}
    for entry in entries:
        for reading in entry.validation["readings"]:
            declared = reading.get(DECLARED, reading[CALIBRATED])
            points["as declared"].append((declared["error_in_sd"], entry.name))
            if entry.is_calibrated:
                used = "used in the calibration" if reading["used_in_calibration"] else "not used"
                error = reading[CALIBRATED]["error_in_sd"]
                points[f"calibrated, value {used}"].append((error, entry.name))
    largest = max(abs(x) for found in points.values() for x, _ in found)
    for label, found in points.items():
        if found:
            color, marker, filled = series[label]
            offset = -0.17 if label == "as declared" else 0.17
            x, rows = zip(*found, strict=True)
            panel.dots(label, x, rows, color, marker, filled, offset)
    panel.axes.set_xscale("symlog", linthresh=THRESHOLD_SD)
    ticks = [tick for tick in (2, 10, 100, 1000) if tick <= max(1.3 * largest, 5)]
    panel.axes.set_xticks([-t for t in reversed(ticks)] + [0, *ticks])
    panel.axes.set_xlim(-1.3 * max(largest, 3), 1.3 * max(largest, 3))
    panel.axes.xaxis.set_major_formatter("{x:g}")
    panel.axes.xaxis.minorticks_off()
    labels = ", ".join(sorted({entry.label for entry in entries}))
    caption = parts(
        "Error of every value (n = {}), in standard deviations of the value; the scale is linear "
        "up to {} and logarithmic beyond. Data: {}.",
        data.number("errors", "", "values", sum(len(e.validation["readings"]) for e in entries)),
        data.number("errors", "", "linear up to", THRESHOLD_SD, 0, "sd"),
        labels,
    )
    return Figure("errors", "Errors against the data", caption, [panel])
