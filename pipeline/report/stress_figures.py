"""Figures of an experiment at rest, in the manner of Figs 2, 3B and 7-9 of Gómez & Castro 2022."""

from __future__ import annotations

import numpy as np

from pipeline.files.netcdf import AS_DECLARED
from pipeline.lattice.closed_form import closed_form_stress
from pipeline.lattice.grid import GRAVITY
from pipeline.lattice.spreading import spreading_weights
from pipeline.report.figures import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    SPREAD_COLORS,
    STRESS_COLORS,
    Panel,
    section_size,
)
from pipeline.report.page import Data, Figure, parts
from pipeline.report.results import Results
from pipeline.sensitivity import FOOTPRINT_REPLICATES
from pipeline.simulate.readings import KPA

STRESS = "vertical stress (kPa)"


def stress_figures(results: Results, data: Data) -> list[Figure]:
    """Sections, profile, filling, spreading weights, lattice influence and convergence."""
    figures = [section_figure(results, data), profile_figure(results, data)]
    if not results.experiment.is_draw and len(results.clock) > 1:
        figures.append(filling_figure(results, data))
    if "load_cell_footprint" in results.replicates:
        figures.append(footprint_figure(results, data))
    figures.append(spreading_figure(results, data))
    figures.append(lattice_figure(results, data))
    figures.append(convergence_figure(results, data))
    return figures


def section_figure(results: Results, data: Data) -> Figure:
    """Mean and standard deviation over replicates: x-z section and plan view at the base."""
    fields, time = results.fields, results.at_rest
    x, y, z = (fields[axis].values for axis in "xyz")
    width, length, height = x[-1] + x[0], y[-1] + y[0], z[-1] + z[0]
    views = [("section", "height z (m)", z, results.section, section_size(width, height))]
    size = section_size(width, length, (2.1, 2.1))
    views.append(("base", "y (m)", y, results.base, size))
    panels = []
    for view, vertical, centers, values_of, size in views:
        for name, words, words_of_scale, colors in (
            ("vertical_stress_mean", "mean", "mean stress", STRESS_COLORS),
            ("vertical_stress_std", "sd", "sd of stress", SPREAD_COLORS),
        ):
            values = values_of(name, time)
            if not np.isfinite(values).any():
                continue
            where = "Vertical section" if view == "section" else "Plan view of the base"
            title = f"{where}, {'mean over' if words == 'mean' else 'sd between'} replicates"
            high = float(np.nanmax(values))
            panel = Panel(
                data,
                "sections",
                title,
                "x (m)",
                vertical,
                f"{title}: {words} of vertical stress up to {high:.3g} kPa.",
                size,
                bar=True,
            )
            in_file = results.section_in_file if view == "section" else results.base_in_file
            scale = f"{words_of_scale} (kPa)", 0.0, high or 1.0, colors
            panel.image(x, centers, values, *scale, in_file(name, time))
            panels.append(panel)
    one = one_packing(results, data)
    caption = parts(
        "The vertical section is the x–z plane at y = {} m; the plan view is the lowest level of "
        "cells. Mean and standard deviation (sd) are over n = {} replicates, each a different "
        "random packing{}. {} Places outside the ground are blank.",
        data.number("sections", "section", "y", float(y[results.section_row]), unit="m"),
        data.number("sections", "section", "replicates", results.count),
        ", before anything is drawn" if results.experiment.is_draw else "",
        "The mean over replicates smooths the packing away: in a single packing stress differs "
        "from cell to cell by about the sd shown."
        if results.count > 1
        else "One replicate has no sd.",
    )
    return Figure("sections", "Vertical stress in the model", caption, panels + one)


def one_packing(results: Results, data: Data) -> list[Panel]:
    """The first replicate's own section: what a single packing looks like (Fig. 8)."""
    first = results.fields["vertical_stress_first"]
    values = first.isel(time=results.at_rest, y=results.section_row).values
    x, z = results.fields["x"].values, results.fields["z"].values
    high = float(np.nanmax(values))
    title = "Vertical section of one packing (the first replicate)"
    panel = Panel(
        data,
        "sections",
        title,
        "x (m)",
        "height z (m)",
        f"{title}: vertical stress up to {high:.3g} kPa, uneven from cell to cell.",
        section_size(x[-1] + x[0], z[-1] + z[0]),
        bar=True,
    )
    stored = results.section_in_file("vertical_stress_first", results.at_rest)
    panel.image(x, z, values, STRESS, 0.0, high or 1.0, stored=stored)
    return [panel]


def footprint_figure(results: Results, data: Data) -> Figure:
    """Where the stress on each load cell comes from: its adjoint times the weights."""
    shares = 100.0 * results.replicates["load_cell_footprint"].values
    x, z = results.fields["x"].values, results.fields["z"].values
    panels = []
    for i in results.shown_load_cells:
        cell, share = results.load_cells[i], shares[i]
        high = float(np.nanmax(share))
        panel = Panel(
            data,
            "footprints",
            f"Load cell {cell.name}",
            "x (m)",
            "height z (m)",
            f"Where the stress on load cell {cell.name} comes from: up to {high:.2g} % from one "
            "place, mostly from the ground above it.",
            section_size(x[-1] + x[0], z[-1] + z[0]),
            bar=True,
        )
        stored = f"replicates.nc: load_cell_footprint[load_cell={i}]"
        scale = "share of the reading (%)", 0.0, high or 1.0, SPREAD_COLORS
        panel.image(x, z, share, *scale, stored)
        panels.append(panel)
    caption = parts(
        "Each place's own weight adds its share to the reading{}; the shares of a load cell add "
        "up to 100 %. Summed over y, averaged over the first n = {} replicates.{}",
        " before anything is drawn" if results.experiment.is_draw else " when full",
        data.number(
            "footprints", "", "replicates", min(FOOTPRINT_REPLICATES, results.experiment.replicates)
        ),
        results.words_of_shown,
    )
    return Figure("footprints", "Where each load cell's stress comes from", caption, panels)


def profile_figure(results: Results, data: Data) -> Figure:
    """Mean over each level and its scatter, against depth, beside the overburden."""
    time, lattice = results.at_rest, results.lattice
    mean, std = (
        results.fields[f"vertical_stress_{name}"].isel(time=time).values.astype(np.float64)
        for name in ("mean", "std")
    )
    level_mean = np.nanmean(mean, axis=(1, 2))
    places = np.nanvar(mean, axis=(1, 2))
    packings = np.zeros_like(places) if results.count == 1 else np.nanmean(std**2, axis=(1, 2))
    scatter = np.sqrt(places + packings)
    height = results.experiment.geometry.height
    surface = lattice.cell_size * (lattice.nz - 1 + lattice.top_fraction)
    depth = surface - lattice.cell_size * np.arange(lattice.nz)
    panel = Panel(
        data,
        "profile",
        "",
        "depth below the surface (m)",
        STRESS,
        f"Vertical stress against depth: {level_mean[0]:.3g} kPa at the base, "
        f"{depth[0]:.3g} m down.",
        (3.6, 3.0),
        upright=True,
    )
    weight = overburden(results, surface - depth, surface)
    panel.curve("overburden ρ g z", depth, weight, color=MUTED, dash="dotted")
    panel.curve(
        "model, mean over the level",
        depth,
        level_mean,
        level_mean - scatter,
        level_mean + scatter,
        band="± 1 sd between places and packings",
    )
    base = [r for r in results.readings("vertical_stress") if r["fill_height"] in (None, height)]
    rows = [r for r in base if r["mass_drawn"] in (None, 0.0)]
    measured_points(panel, results, rows, [depth[0]] * len(rows), [r["measured"] for r in rows])
    caption = parts(
        "Stress in each level of cells, on their lower face, n = {} replicates. What is missing "
        "to the overburden is carried by friction (1 − E of each cell's load). The band holds the "
        "scatter from place to place in a level and from packing to packing.",
        data.number("profile", "", "replicates", results.count),
    )
    return Figure("profile", "Vertical stress against depth", caption, [panel])


def overburden(results: Results, low, high) -> np.ndarray:
    """Weight of the ground between two heights over its area, kPa.

    With regions, their densities are averaged over each level.
    """
    density = results.experiment.material.bulk_density
    if not results.experiment.regions:
        return density * GRAVITY * (high - low) * KPA
    lattice = results.lattice
    cells = results.block_model["bulk_density"].values.astype(np.float64)
    levels = np.where(cells > 0, cells, np.nan)
    weight = np.nanmean(levels, axis=(1, 2)) * GRAVITY * lattice.cell_size * KPA
    heights = lattice.cell_size * np.arange(lattice.nz + 1.0)
    heights[-1] -= lattice.cell_size * (1 - lattice.top_fraction)
    below = np.append(0.0, np.cumsum(weight))
    return np.interp(high, heights, below) - np.interp(low, heights, below)


def measured_points(panel: Panel, results: Results, readings, x, values, low=None, high=None):
    """Measured values on a panel, open where the calibration used them, with ± 1 sd bars."""
    for used in (True, False):
        at = [i for i, r in enumerate(readings) if r["used_in_calibration"] == used]
        if not at:
            continue
        sd = [readings[i]["measured_sd"] for i in at]
        value = np.array([values[i] for i in at], dtype=np.float64)
        panel.points(
            f"{results.label} data, {'' if used else 'not '}used in calibration (± 1 sd)",
            [x[i] for i in at],
            value,
            value - sd if low is None else np.array([low[i] for i in at]),
            value + sd if high is None else np.array([high[i] for i in at]),
            filled=not used,
        )


def filling_figure(results: Results, data: Data) -> Figure:
    """Base stress while the model is filled (the experiment of Fig. 7)."""
    statistics, height = results.statistics, results.clock
    mean, low, high = (
        statistics[f"base_vertical_stress_{part}"].values for part in ("mean", "p05", "p95")
    )
    panel = Panel(
        data,
        "filling",
        "",
        "fill height (m)",
        "mean vertical stress on the base (kPa)",
        f"Base stress while filling: {mean[0]:.3g} kPa at {height[0]:.3g} m, {mean[-1]:.3g} kPa "
        f"at {height[-1]:.3g} m.",
        (3.6, 2.7),
    )
    panel.curve(
        "overburden ρ g h",
        np.append(0, height),
        np.append(0, overburden(results, 0.0, height)),
        color=MUTED,
        dash="dotted",
    )
    declared = f"base_vertical_stress{AS_DECLARED}_mean"
    if declared in statistics:
        panel.curve(
            "model, as declared", height, statistics[declared].values, color=GREEN, dash="dashed"
        )
    model = "model, calibrated" if results.is_calibrated else "model, as declared"
    panel.curve(model, height, mean, low, high, band="5–95 % of replicates")
    readings = results.readings("vertical_stress")
    full = results.experiment.geometry.height
    x = [full if r["fill_height"] is None else r["fill_height"] for r in readings]
    measured_points(panel, results, readings, x, [r["measured"] for r in readings])
    panel.axes.set_ylim(0, 1.35 * max([mean.max(), *(r["measured"] for r in readings)]))
    panel.axes.set_xlim(0, None)
    caption = parts(
        "Simulated readings of the whole base at {} fill levels, n = {} replicates. Stress levels "
        "off as the walls take a growing share of the weight (Janssen). Points stand only where "
        "the {} data have a value. The weight on the base does not depend on the packing, so the "
        "band over replicates has no visible width.",
        data.number("filling", "", "fill levels", len(height)),
        data.number("filling", "", "replicates", results.count),
        results.label,
    )
    return Figure("filling", "Stress on the base during filling", caption, [panel])


def convergence_figure(results: Results, data: Data) -> Figure:
    """Running mean over replicates with its standard error."""
    last = len(results.clock) - 1
    replicates = results.replicates
    n = np.arange(1, results.count + 1)
    panels = []
    for title, words, name in (
        ("Mean over the base", "mean stress (kPa)", "base_vertical_stress"),
        ("Sd from place to place on the base", "sd of stress (kPa)", "base_vertical_stress_std"),
    ):
        values = replicates[name].values[:, last]
        mean = np.cumsum(values) / n
        square = np.array([values[:k].var(ddof=1) if k > 1 else np.nan for k in n])
        error = np.sqrt(square / n)
        panel = Panel(
            data,
            "convergence",
            title,
            "number of replicates n",
            words,
            f"{title}: running mean {mean[-1]:.4g} kPa after {results.count} replicates.",
            (3.3, 2.0),
        )
        panel.curve("running mean", n, mean, mean - error, mean + error, band="± 1 standard error")
        if results.count == 1:
            panel.points("the only replicate", n, mean, color=BLUE)
        swing = max(np.ptp(values), 0.02 * abs(mean[-1]), 1e-9)
        panel.axes.set_ylim(mean[-1] - 0.6 * swing, mean[-1] + 0.6 * swing)
        panels.append(panel)
    caption = parts(
        "Does another replicate change the answer? Running mean over replicates {}, "
        "with its standard error.{}",
        "at the end of the draw" if results.experiment.is_draw else "with the model full",
        ""
        if results.experiment.is_draw
        else " The mean over the base is the same in every packing, because weight is conserved "
        "and only E sets how much of it arrives: its curve is flat.",
    )
    return Figure("convergence", "Convergence over replicates", caption, panels)


def spreading_figure(results: Results, data: Data) -> Figure:
    """Spreading weights β against s for this experiment's N(mean, sd) (Fig. 2)."""
    p, rule = results.parameters, results.experiment.stress.rule
    reach = max(3 * p.s_std, 2.0)
    s = np.linspace(min(p.s_mean - reach, -2.0), max(p.s_mean + reach, 6.0), 161)
    edge, corner = spreading_weights(s, rule, np.float64)
    total = 1 + 4 * edge + 4 * corner
    panel = Panel(
        data,
        "spreading",
        "",
        "spreading exponent s (–)",
        "share β of the load to one receiver (–)",
        f"Spreading weights against s; s has mean {p.s_mean:.3g} and sd {p.s_std:.3g} here.",
        (3.6, 2.5),
    )
    low, high = p.s_mean - 1.645 * p.s_std, p.s_mean + 1.645 * p.s_std
    if p.s_std > 0:
        panel.span("90 % of this experiment's cells", low, high)
    panel.reference("mean of s", x=p.s_mean, color=INK)
    panel.curve("straight below, d = 1", s, 1 / total, color=BLUE)
    panel.curve("beside, d = √2 (each of four)", s, edge / total, color=ORANGE, dash="dashed")
    panel.curve("corner, d = √3 (each of four)", s, corner / total, color=GREEN, dash="dashdot")
    panel.axes.set_ylim(0, 1.02)
    caption = parts(
        "A cell hands its load to the nine cells below it; the exponent s decides how much goes "
        "straight down. Each cell draws its own s from N({}, {}²); a negative s spreads outwards. "
        "Shares over all nine receivers, rule {}. Where every curve is flat, more scatter in s "
        "changes nothing.",
        data.number("spreading", "", "mean of s", p.s_mean),
        data.number("spreading", "", "sd of s", p.s_std),
        rule,
    )
    return Figure("spreading", "How a cell spreads its load", caption, [panel])


def lattice_figure(results: Results, data: Data) -> Figure:
    """P_V / P_T against the number of cells in the column, exact and as printed (Fig. 3B)."""
    E, geometry = results.parameters.E, results.experiment.geometry
    cells = round(geometry.height / geometry.cell_size, 9)
    n = np.unique(np.round(np.geomspace(1, 4 * cells, 60)).astype(int))
    exact = closed_form_stress(1.0, 1.0, 1.0, E, n) / n
    here = float(closed_form_stress(1.0, 1.0, 1.0, E, cells) / cells)
    panel = Panel(
        data,
        "lattice",
        "",
        "number of cells in the column n",
        "share of the weight at the base P_V / P_T (–)",
        f"Share of the column's weight that reaches the base: {here:.3g} at n = {cells:g} cells.",
        (3.6, 2.5),
    )
    panel.curve("sum of eqs 1 and 2", n, exact)
    panel.curve("eq 5 as printed (once more × E)", n, E * exact, color=ORANGE, dash="dashed")
    panel.points("this model", [cells], [here], color=INK)
    panel.axes.set_xscale("log")
    panel.axes.xaxis.set_major_formatter("{x:g}")
    panel.axes.xaxis.minorticks_off()
    panel.axes.set_ylim(0, 1.05)
    caption = parts(
        "Every cell passes on the share E = {} of its load, so E belongs to a cell size: the more "
        "cells in a column, the less of its weight P_T reaches the base. Eq. 5 of the paper has "
        "one factor E more than its eqs 1 and 2 add up to. The model has n = {} cells and {} of "
        "its weight on the base, as a uniform column with this E alone.",
        data.number("lattice", "", "E", E),
        data.number("lattice", "", "n", cells),
        data.number("lattice", "", "P_V / P_T", here, 3),
    )
    return Figure("lattice", "What the lattice does to E", caption, [panel])
