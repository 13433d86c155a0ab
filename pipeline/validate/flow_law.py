"""How an isolated movement zone grows: its width against its height, as a function of bulking.

An ensemble of single drawpoints in wide, undisturbed ground is drawn in steps until the first of
them breaks through. Void diffusion should give a width that grows with the square root of the
height (Nedderman's kinematic theory: 3.42 sqrt(height), in fragment diameters), and a drawn
volume of bulking times the loosened volume. `measure_flow_law` says how far the flow kernel does
so. All lengths are in cells.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from pipeline.lattice.cells import STAGNANT
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    LOOSENED_CELLS,
    climb_chances,
    draw_to,
    new_flow_state,
    zone_geometry,
)
from pipeline.lattice.grid import GRAVITY
from pipeline.montecarlo.streams import FLOW, random_stream

BAND = (0.45, 0.60)  # of the exponent, from BAND_FROM on
BAND_FROM = 0.3
LEAST_HEIGHT = 60
TOLERANCE = 0.03  # of drawn over loosened volume
FILAMENTS = 0.5  # least filament share of what is no zone
KINEMATIC_FACTOR = 3.42
WIDTHS = {"extent": "largest x extent", "diameter": "equal-area diameter"}
QUANTITIES = {
    "drawn": "cells drawn",
    "loosened": "cells loosened",
    "height": "zone height (cells)",
    "extent": "largest x extent of a level (cells)",
    "diameter": "diameter of the circle with the area of the largest level (cells)",
    "filament_share": "share of the height in levels with fewer loosened cells than the drawpoint",
    "hang_ups": "voids parked by a hang-up",
}
FIRST_DRAWN, DRAW_GROWTH = 10, 1.25  # cells drawn at the first reading, and from one to the next
EXPONENT, RATIO, GROWTH = "Exponent of the width", "Drawn over loosened volume", "Growth"


def measure_flow_law(
    bulkings: Sequence[float] = (0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.8),
    replicates: int = 10,
    seed: int = 2022,
    exponent: float = 3.0,
    shape: tuple[int, int, int] = (200, 81, 81),
    opening: int = 3,
) -> dict[str, Any]:
    """Growth of isolated movement zones, and what it says about the flow law.

    All replicates of a bulking are read at the same drawn masses, as long as none of them has
    reached the top or a side of the lattice or run empty. Exponents are slopes of log mean width
    over log mean height, over readings with a mean height of `LEAST_HEIGHT` or more; standard
    errors are jackknifed over replicates.

    Parameters
    ----------
    bulkings : probabilities, above 0 and up to 1, that a void parks where it loosens a cell
    replicates, seed : independent runs of each bulking, two or more; root of their streams
    exponent : flow exponent n
    shape : cells (nz, ny, nx) of the lattice
    opening : cells along a side of the drawpoint, in the middle of the base

    Returns
    -------
    Content of `flow_law.json`: ensemble, criteria, and for each bulking the mean readings and what
    the high ones say: `fitted`, None where they are fewer than three.

    Raises
    ------
    ValueError
        For a bulking out of range, and for a single replicate, which has no standard error.
    """
    if replicates < 2:
        raise ValueError(f"replicates = {replicates}: a standard error needs two or more")
    if not all(0 < bulking <= 1 for bulking in bulkings):
        raise ValueError(f"bulkings = {bulkings}: each must be above 0 and at most 1")
    laws = []
    for bulking in bulkings:
        samples, ended_by = _ensemble(bulking, replicates, seed, exponent, shape, opening)
        laws.append(
            {
                "bulking": bulking,
                "ended_by": ended_by,
                "readings": _named(samples.mean(axis=0)),
                "fitted": _fitted(bulking, samples),
            }
        )
    return {
        "ensemble": {
            "flow_exponent": exponent,
            "replicates": replicates,
            "seed": seed,
            "lattice_cells": dict(zip("zyx", shape, strict=True)),
            "opening_cells": {"y": opening, "x": opening},
        },
        "criteria": {
            "exponent": BAND,
            "exponent_from_bulking": BAND_FROM,
            "least_height": LEAST_HEIGHT,
            "drawn_over_loosened_over_bulking": (1 - TOLERANCE, 1 + TOLERANCE),
            "filament_share": FILAMENTS,
            "kinematic_width_over_sqrt_height": KINEMATIC_FACTOR,
        },
        "quantities": QUANTITIES,
        "bulkings": laws,
    }


def jackknife(statistic: Callable[[np.ndarray], float], samples: np.ndarray) -> dict[str, float]:
    """Value and jackknife standard error of a statistic of the mean of samples.

    ``samples`` has the samples, two or more, on its first axis; ``statistic`` takes their mean.
    Source: Efron & Tibshirani (1993), An Introduction to the Bootstrap, equation 11.5.
    """
    n = len(samples)
    total = samples.sum(axis=0)
    without = np.array([statistic((total - sample) / (n - 1)) for sample in samples])
    variance = (n - 1) / n * np.square(without - without.mean()).sum()
    return {"value": float(statistic(total / n)), "standard_error": float(np.sqrt(variance))}


def _ensemble(bulking, replicates, seed, exponent, shape, opening):
    """Readings (replicate, reading, quantity) that all replicates have, and what ended them."""
    runs = []
    count = math.inf  # none goes on for longer than the shortest
    for replicate in range(replicates):
        rng = random_stream(seed, "flow_law", FLOW, replicate)
        rows, end = _grow(bulking, exponent, shape, opening, count, rng)
        if len(rows) < count:
            count, ended_by = len(rows), end
        runs.append(rows)
    samples = np.array([rows[:count] for rows in runs])
    return samples.reshape(replicates, count, len(QUANTITIES)), ended_by


def _grow(bulking, exponent, shape, opening, count, rng):
    """The first ``count`` readings of one zone, or those until something ended them, and what."""
    nz, ny, nx = shape
    j, i = (ny - opening) // 2, (nx - opening) // 2
    cells = [(0, j + dy, i + dx) for dy in range(opening) for dx in range(opening)]
    state = new_flow_state(np.full(shape, STAGNANT), [cells])
    cell_weight = np.full(state.code.size, GRAVITY)  # of 1 kg
    chances = climb_chances(exponent)
    rows = []
    while len(rows) < count:
        target = FIRST_DRAWN * DRAW_GROWTH ** len(rows)
        shortfall = draw_to(state, cell_weight, 0, target, chances, bulking, rng)
        (height,), (extent,) = zone_geometry(state, 1.0)
        loosened = state.zone[: int(height)] >= 0
        if height == nz:
            return rows, "top"
        if loosened[:, [0, -1]].any() or loosened[:, :, [0, -1]].any():
            return rows, "side"
        if shortfall > 0:
            return rows, "empty drawpoint"
        area = np.count_nonzero(loosened, axis=(1, 2))
        drawn, volume, hang_ups = state.counters[[DRAWN_CELLS, LOOSENED_CELLS, HANG_UPS]]
        diameter = np.sqrt(4 * area.max() / np.pi)
        filament_share = np.mean(area < len(cells))
        rows.append((drawn, volume, height, extent, diameter, filament_share, hang_ups))
    return rows, None


def _named(readings):
    """Readings (reading, quantity) as a list for each quantity."""
    return dict(zip(QUANTITIES, readings.T.tolist(), strict=True))


def _fitted(bulking, samples):
    """What the readings at `LEAST_HEIGHT` and above say; None if they are fewer than three."""
    high = np.array(_named(samples.mean(axis=0))["height"]) >= LEAST_HEIGHT
    if high.sum() < 3:
        return None
    samples = samples[:, high]

    def estimate(statistic):
        return jackknife(
            lambda mean: statistic(**dict(zip(QUANTITIES, mean.T, strict=True))), samples
        )

    exponents, factors = {}, {}
    for width in WIDTHS:
        slope = estimate(
            lambda height, width=width, **m: np.polyfit(np.log(height), np.log(m[width]), 1)[0]
        )
        exponents[width] = slope | _within(slope, BAND, "0.45_0.60")
        factors[width] = estimate(
            lambda height, width=width, **m: np.mean(m[width] / np.sqrt(height))
        )
    ratio = estimate(lambda drawn, loosened, **_: drawn[-1] / loosened[-1] / bulking)
    mean = _named(samples.mean(axis=0))
    first, last = ({name: values[end] for name, values in mean.items()} for end in (0, -1))
    return {
        "readings": len(mean["height"]),
        "height": [first["height"], last["height"]],
        "exponents": exponents,
        "width_over_sqrt_height": factors,
        "drawn_over_loosened_over_bulking": ratio
        | _within(ratio, (1 - TOLERANCE, 1 + TOLERANCE), "3_percent"),
        "hang_ups_per_drawn_cell": last["hang_ups"] / last["drawn"],
        "parked_over_loosened_over_bulking": estimate(
            lambda drawn, loosened, hang_ups, **_: (
                (drawn[-1] - hang_ups[-1]) / loosened[-1] / bulking
            )
        ),
        "filament_share": [first["filament_share"], last["filament_share"]],
        "filaments": first["filament_share"] >= FILAMENTS,
    }


def _within(estimate, limits, name):
    """Whether the value is within the limits, and whether two standard errors reach them."""
    low, high = limits
    reach = 2 * estimate["standard_error"]
    return {
        f"within_{name}": low <= estimate["value"] <= high,
        f"within_{name}_by_two_standard_errors": low - reach <= estimate["value"] <= high + reach,
    }


class _Series(NamedTuple):
    panel: str
    name: str
    x_name: str
    y_name: str
    x: np.ndarray
    y: np.ndarray
    error: np.ndarray | None = None


def _series(law):
    """What the figure shows."""
    fitted = {entry["bulking"]: entry["fitted"] for entry in law["bulkings"] if entry["fitted"]}

    def over_bulking(panel, name, y_name, estimates):
        values, errors = (
            np.array([estimate[key] for estimate in estimates])
            for key in ("value", "standard_error")
        )
        return _Series(panel, name, "bulking", y_name, np.array([*fitted]), values, errors)

    for width, name in WIDTHS.items():
        exponents = [fit["exponents"][width] for fit in fitted.values()]
        yield over_bulking(EXPONENT, name, "exponent of the width over the height", exponents)
    for name, key in {
        "all cells drawn": "drawn_over_loosened_over_bulking",
        "less hang-ups": "parked_over_loosened_over_bulking",
    }.items():
        ratios = [fit[key] for fit in fitted.values()]
        yield over_bulking(RATIO, name, "drawn / (loosened × bulking) cells", ratios)
    for width, name in WIDTHS.items():
        for entry in law["bulkings"]:
            yield _Series(
                f"{GROWTH} of the {name}",
                f"bulking {entry['bulking']:g}",
                "zone height (cells)",
                f"{name} (cells)",
                *(np.array(entry["readings"][quantity]) for quantity in ("height", width)),
            )


def flow_law_table(law: dict[str, Any]) -> str:
    """The numbers of `flow_law_figure` as CSV; y_low to y_high is one standard error each way."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("panel", "series", "x_name", "x", "y_name", "y", "y_low", "y_high"))
    for series in _series(law):
        error = np.full_like(series.y, np.nan) if series.error is None else series.error
        for x, y, e in zip(series.x, series.y, error, strict=True):
            numbers = [f"{v:.10g}" if math.isfinite(v) else "" for v in (x, y, y - e, y + e)]
            writer.writerow((*series[:3], numbers[0], series.y_name, *numbers[1:]))
    return text.getvalue()


INK, MUTED, GRID, COLORS = "#1a1d21", "#5b646e", "#dcdfe3", ("#0067a5", "#c24e00")
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "flow law",
    "font.size": 10,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "legend.frameon": False,
    "legend.fontsize": 9,
}


def flow_law_figure(law: dict[str, Any]) -> str:
    """SVG of exponent and volume ratio over bulking, and of the widths over the height.

    ``law`` is what `measure_flow_law` returns; the same law gives the same bytes.
    """
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        figure = Figure(figsize=(12, 9), layout="constrained")
        FigureCanvasSVG(figure)
        figure.suptitle(_heading(law["ensemble"]), x=0.01, ha="left", fontsize=10)
        series = list(_series(law))
        panels = dict.fromkeys(s.panel for s in series)
        for panel, ax in zip(panels, figure.subplots(2, 2).flat, strict=True):
            shown = [s for s in series if s.panel == panel]
            ax.set(title=panel, xlabel=shown[0].x_name, ylabel=shown[0].y_name)
            if panel == EXPONENT:
                _draw_exponents(ax, shown, law)
            elif panel == RATIO:
                _draw_ratios(ax, shown)
            else:
                _draw_growth(ax, shown)
            ax.legend()
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()


def _heading(ensemble):
    nz, ny, nx = ensemble["lattice_cells"].values()
    opening = " × ".join(map(str, ensemble["opening_cells"].values()))
    return (
        "Void diffusion from one drawpoint: growth of the isolated movement zone before it breaks "
        f"through.\nMeans over {ensemble['replicates']} replicates, bars ± 1 standard error; flow "
        f"exponent n = {ensemble['flow_exponent']:g}, drawpoint of {opening} cells, lattice of "
        f"{nz} × {ny} × {nx} cells (z, y, x)."
    )


def _draw_over_bulking(ax, shown):
    for series, color, marker, shift in zip(shown, COLORS, "so", (-0.004, 0.004), strict=True):
        ax.errorbar(
            series.x + shift,
            series.y,
            series.error,
            fmt=marker,
            color=color,
            capsize=3,
            label=series.name,
        )
    ax.set_xlim(left=0)


def _draw_exponents(ax, shown, law):
    low, high = BAND
    ax.axhspan(low, high, color=MUTED, alpha=0.16, linewidth=0, label=f"{low:.2f} to {high:.2f}")
    ax.axvline(BAND_FROM, color=MUTED, linestyle="dashed")
    ax.text(
        BAND_FROM + 0.01,
        0.97,
        f"expected for bulking ≥ {BAND_FROM:g} →",
        transform=ax.get_xaxis_transform(),
        va="top",
    )
    _draw_over_bulking(ax, shown)
    ax.set_yscale("log")
    ticks = [0.4, 0.5, 0.6, 0.8, 1, 1.5, 2, 3]
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.yaxis.set_minor_formatter(NullFormatter())
    for entry in law["bulkings"]:
        fit = entry["fitted"]
        if fit and fit["filaments"]:
            top = max(exponent["value"] for exponent in fit["exponents"].values())
            ax.annotate(
                f"no zone: filaments\nover {100 * fit['filament_share'][0]:.0f} %\nof the height",
                (entry["bulking"], top),
                (10, 0),
                textcoords="offset points",
                va="center",
            )


def _draw_ratios(ax, shown):
    ax.axhspan(
        1 - TOLERANCE,
        1 + TOLERANCE,
        color=MUTED,
        alpha=0.16,
        linewidth=0,
        label=f"1 ± {100 * TOLERANCE:g} %",
    )
    _draw_over_bulking(ax, shown)


def _draw_growth(ax, shown):
    colors = matplotlib.colormaps["viridis"](np.linspace(0, 0.9, len(shown)))
    for series, color in zip(shown, colors, strict=True):
        ax.plot(series.x, series.y, ".-", color=color, linewidth=1.2, label=series.name)
    ax.axvline(LEAST_HEIGHT, color=MUTED, linestyle="dashed")
    ax.text(LEAST_HEIGHT * 1.03, 0.02, "fitted →", transform=ax.get_xaxis_transform())
    heights = np.array([LEAST_HEIGHT, 200])
    label = f"{KINEMATIC_FACTOR:g} √height: slope 1/2"
    ax.plot(
        heights, KINEMATIC_FACTOR * np.sqrt(heights), color=INK, linestyle="dashed", label=label
    )
    ax.plot(heights, heights / 2, color=INK, linestyle="dotted", label="height / 2: slope 1")
    ax.set(xscale="log", yscale="log")
    for axis, ticks in ((ax.xaxis, (2, 5, 10, 20, 50, 100, 200)), (ax.yaxis, (2, 5, 10, 20, 50))):
        axis.set_ticks(ticks, [str(tick) for tick in ticks])
        axis.set_minor_formatter(NullFormatter())
