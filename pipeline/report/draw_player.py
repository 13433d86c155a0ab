"""The player: section, plan of the base and load cells of a draw, moved by one slider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.report.draw_figures import (
    assumed_words,
    load_cell_figure,
    mark_base,
    mass_drawn_words,
    stress_range,
)
from pipeline.report.figures import Panel, section_size
from pipeline.report.page import Data, Figure, parts
from pipeline.report.plan_figures import areas_of, evenly
from pipeline.report.results import Results

MOST_FRAMES = 40
MOST_CELLS = 400_000  # of all frames together, so that a mine's page stays small
FEWEST_FRAMES = 8
FIGURE, SCALE = "draw_views", "mean stress (kPa)"
EDGE = "edge of the movement zone (in half of the replicates)"


@dataclass
class Player:
    """Figures whose panels have a frame for each of `frames`, the words for a reading."""

    frames: list[str]
    figures: list[Figure]


def draw_player(results: Results, data: Data) -> Player:
    """Section, plan of the base and load cells, with a frame for each reading that is shown."""
    times = shown_times(results)
    count = len(results.clock)
    frames = [
        f"reading {t + 1} of {count}, " + (mass_drawn_words(results, t) if t else "before draw")
        for t in times
    ]
    return Player(
        frames, [view_figure(results, data, times), load_cell_figure(results, data, times)]
    )


def shown_times(results: Results) -> list[int]:
    """Indices of the readings that have a frame: all, or a few evenly where they are many."""
    fields = results.fields.sizes
    cells = fields["x"] * (fields["y"] + fields["z"])
    most = max(FEWEST_FRAMES, min(MOST_FRAMES, MOST_CELLS // cells))
    return evenly(len(results.clock), most)


def view_figure(results: Results, data: Data, times: list[int]) -> Figure:
    """Mean vertical stress in the x-z section and at the base, on one scale for all readings."""
    x, y, z = (results.fields[axis].values for axis in "xyz")
    name = "vertical_stress_mean"
    sections = [results.section(name, t) for t in times]
    bases = [results.base(name, t) for t in times]
    zones = [results.section("movement_zone_probability", t) for t in times]
    high = float(max(np.nanmax(v) for v in (*sections, *bases) if np.isfinite(v).any())) or 1.0
    section = Panel(
        data,
        FIGURE,
        "Vertical section",
        "x (m)",
        "height z (m)",
        "Vertical section of mean stress at the reading that the slider shows. "
        f"All readings have one scale, up to {high:.3g} kPa.",
        section_size(x[-1] + x[0], z[-1] + z[0], (3.6, 3.2)),
        bar=True,
    )
    plan = Panel(
        data,
        FIGURE,
        "Plan of the base",
        "x (m)",
        "y (m)",
        "Plan of mean stress in the lowest cells at the reading that the slider shows, "
        f"on the scale of the section, up to {high:.3g} kPa.",
        section_size(x[-1] + x[0], y[-1] + y[0], (3.6, 2.6)),
        bar=True,
    )
    for frame, t in enumerate(times):
        for panel, vertical, values, stored in (
            (section, z, sections[frame], results.section_in_file(name, t)),
            (plan, y, bases[frame], results.base_in_file(name, t)),
        ):
            panel.image(x, vertical, values, SCALE, 0.0, high, stored=stored, frame=frame)
        section.outline(EDGE, x, z, zones[frame], 0.5, frame)
        section.notes.append(_zone_words(z, zones[frame]))
        plan.notes.append(stress_range(bases[frame]))
    mark_base(section, results)
    plan.outlined_areas("drawpoint, in plan", areas_of(results.experiment.drawpoints))
    if results.experiment.load_cells:
        plan.outlined_areas("load cell, in plan", areas_of(results.load_cells), "dashed")
    caption = parts(
        "Mean vertical stress, n = {} replicates: x–z section at y = {} m, and the lowest level "
        "of cells in plan, on one scale. Blank: no material, or outside the ground. Drawpoints "
        "and load cells are marked{}.{}",
        data.number(FIGURE, "", "replicates", results.count),
        data.number(FIGURE, "", "y", float(y[results.section_row]), unit="m"),
        assumed_words(results),
        _thinned(results, data, times),
    )
    return Figure(FIGURE, "Stress in the ground, reading by reading", caption, [section, plan])


def _thinned(results: Results, data: Data, times: list[int]):
    if len(times) == len(results.clock):
        return ""
    return parts(
        " The slider has {} of the {} readings, evenly; all are in fields.nc.",
        data.number(FIGURE, "", "readings shown", len(times)),
        data.number(FIGURE, "", "readings", len(results.clock)),
    )


def _zone_words(z: np.ndarray, zone: np.ndarray) -> str:
    """How high the movement zone reaches in a section (z, x) of its probability."""
    reach = z[np.nan_to_num(zone).max(axis=1) >= 0.5]
    if not len(reach):
        return "no movement zone"
    return f"movement zone up to {reach.max() + (z[1] - z[0]) / 2 if len(z) > 1 else z[0]:.3g} m"
