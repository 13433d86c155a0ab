"""Plan views of the base: stress on each load cell, among the drawpoints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.config.experiment import BaseArea
from pipeline.report.figures import STRESS_COLORS, Panel, section_size
from pipeline.report.page import Data

Area = tuple[str, float, float, float, float]  # name; x, y of the center, width, length in m

MAP_SIZE = (2.3, 2.3)  # most of a map's axes, inches
MOST_MAPS = 6


def plan(
    data: Data,
    figure: str,
    title: str,
    extent: tuple[float, float],
    load_cells: Sequence[Area],
    values: np.ndarray,
    name: str,
    scale: tuple[float, float],
    drawpoints: Sequence[Area],
    words: str,
    colors: str = STRESS_COLORS,
) -> Panel:
    """A plan of a base of `extent` (width, length; m), load cells colored by `values`.

    `name` is that of the scale from `scale[0]` to `scale[1]`; `words` say what is colored.
    """
    known = [(value, area[0]) for value, area in zip(values, load_cells, strict=True)]
    known = [pair for pair in known if np.isfinite(pair[0])]
    ends = "no value"
    if known:
        (least, at_least), (most, at_most) = min(known), max(known)
        ends = f"from {least:.3g} ({at_least}) to {most:.3g} ({at_most})"
    panel = Panel(
        data,
        figure,
        title,
        "x (m)",
        "y (m)",
        f"Plan of the base, {title}: {words} {ends}, {name}.",
        section_size(*extent, MAP_SIZE),
        bar=True,
    )
    panel.shaded_areas(load_cells, values, name, *scale, colors)
    if drawpoints:
        panel.outlined_areas("drawpoint", drawpoints)
    panel.axes.set(xlim=(0, extent[0]), ylim=(0, extent[1]))
    return panel


def areas_of(areas: Sequence[BaseArea]) -> list[Area]:
    """Drawpoints or load cells as a plan takes them."""
    return [(area.name, area.x, area.y, area.width, area.length) for area in areas]


def evenly(count: int, most: int) -> list[int]:
    """At most so many indices of `count` things, evenly from the first to the last."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, most))})


def mass_unit(total: float) -> tuple[float, str]:
    """Factor from kg and unit in which a mass (kg) reads well: kg, t or kt."""
    for least, unit in ((1e7, "kt"), (1e4, "t")):
        if total >= least:
            return {"kt": 1e-6, "t": 1e-3}[unit], unit
    return 1.0, "kg"
