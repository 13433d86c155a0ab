"""Figures and tables of a draw, in the manner of Figs 11-18 of Gómez & Castro 2022."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.files.netcdf import AS_DECLARED, WITHOUT_ZONE
from pipeline.report.figures import GREEN, INK, MUTED, ORANGE, SHARE_COLORS, Panel, section_size
from pipeline.report.page import Data, Figure, Table, decimals_of, parts
from pipeline.report.plan_figures import MOST_MAPS, areas_of, evenly, plan
from pipeline.report.results import Results
from pipeline.report.stress_figures import measured_points
from pipeline.simulate.setup import visits

RATIO = "σᵥ / σᵥ₀ (–)"
SECTIONS = 4  # readings shown as sections, the first and the last among them
BAND = "5–95 % of replicates"
VARIANTS = {  # suffix of the variables of another run: its words, color and dash
    AS_DECLARED: ("model, as declared", GREEN, "dashed"),
    WITHOUT_ZONE: ("model without R and E_min", ORANGE, "dashdot"),
}


def draw_figures(results: Results, data: Data) -> list[Figure]:
    """Sections, growth of the movement zone, E_min and the extraction zone."""
    return [
        *([base_map_figure(results, data)] if results.has_many_load_cells else []),
        stress_section_figure(results, data),
        zone_section_figure(results, data),
        movement_zone_figure(results, data),
        e_min_figure(results, data),
        extraction_figure(results, data),
    ]


def draw_tables(results: Results, data: Data) -> list[Table]:
    """Stress on each load cell by reading and its extremes, what each drawpoint gave."""
    by_period = [base_stress_table(results, data)] if results.base_stress else []
    return [*by_period, load_cell_table(results, data), drawpoint_table(results, data)]


def stress_ratio(results: Results, suffix: str = "") -> np.ndarray:
    """Vertical stress over that before draw, (replicate, time, load_cell)."""
    stress = results.replicates[f"vertical_stress{suffix}"].values
    with np.errstate(invalid="ignore", divide="ignore"):
        return stress / stress[:, :1]


def measured_ratio(results: Results, load_cell: str):
    """Readings after the first with σᵥ/σᵥ₀, low and high (± 1 sd): measured at a load cell.

    A ratio is taken as given; a stress is divided by the reading before draw, and both readings'
    independent errors enter. Without a reading before draw stresses are left out.
    """
    points = [
        (r, r["measured"], r["measured_sd"])
        for r in results.readings("vertical_stress_ratio", load_cell)
    ]
    stress = results.readings("vertical_stress", load_cell)
    before = next((r for r in stress if not r["mass_drawn"]), None)
    if before is not None:
        for r in stress:
            ratio = r["measured"] / before["measured"]
            error = np.hypot(r["measured_std"], ratio * before["measured_std"])
            points.append((r, ratio, 0.0 if r is before else error / before["measured"]))
    return (
        [r for r, _, _ in points],
        np.array([ratio for _, ratio, _ in points]),
        np.array([error for _, _, error in points]),
    )


def load_cell_figure(results: Results, data: Data, times: Sequence[int]) -> Figure:
    """σᵥ/σᵥ₀ of each load cell against mass drawn, on the same axes (Figs 16 and 18).

    A cursor has a frame at each reading of `times`.
    """
    ratio, mass = stress_ratio(results), results.drawn
    low, high = np.quantile(ratio, [0.05, 0.95], axis=0)
    mean = ratio.mean(axis=0)
    others = {
        suffix: stress_ratio(results, suffix).mean(axis=0)
        for suffix in VARIANTS
        if f"vertical_stress{suffix}" in results.replicates
    }
    measured = {cell.name: measured_ratio(results, cell.name) for cell in results.load_cells}
    tops = [high, *others.values(), *(v + e for _, v, e in measured.values())]
    top = max(np.nanmax(values) for values in tops if np.isfinite(values).any())
    panels = []
    for i in results.shown_load_cells:
        cell = results.load_cells[i]
        known = mean[np.isfinite(mean[:, i]), i]
        extremes = f"from {known.min():.2f} to {known.max():.2f}" if len(known) else "no ground"
        panel = Panel(
            data,
            "load_cells",
            f"Load cell {cell.name}",
            mass_words(results),
            RATIO,
            f"Load cell {cell.name}: simulated stress over that before draw, {extremes}.",
            (2.05, 1.6),
        )
        panel.reference("unchanged", y=1.0, dash="dotted")
        for suffix, (words, color, dash) in VARIANTS.items():
            if suffix in others:
                panel.curve(words, mass, others[suffix][:, i], color=color, dash=dash)
        panel.curve("model, mean", mass, mean[:, i], low[:, i], high[:, i], band=BAND)
        readings, values, errors = measured[cell.name]
        panel_x = [results.mass_unit[0] * (r["mass_drawn"] or 0.0) for r in readings]
        measured_points(panel, results, readings, panel_x, values, values - errors, values + errors)
        panel.cursor(mass[list(times)])
        panel.notes = [_ratio_words(mean[t, i], low[t, i], high[t, i]) for t in times]
        panel.axes.set(ylim=(0, 1.08 * top), xlim=(-0.02 * mass[-1], 1.02 * mass[-1]))
        panels.append(panel)
    caption = parts(
        "Vertical stress on each load cell over that before draw; all panels have the same axes. "
        "n = {} replicates. {}{}",
        data.number("load_cells", "", "replicates", results.count),
        f"Points, {results.label} data: stress over the reading before draw, bars are ± 1 sd of "
        "the readings' independent error."
        if any(len(v) for _, v, _ in measured.values())
        else "No load cell was measured.",
        results.words_of_shown,
    )
    return Figure("load_cells", "Stress on the load cells during draw", caption, panels)


def _ratio_words(mean: float, low: float, high: float) -> str:
    if not np.isfinite(mean):
        return "no ground"
    return f"σᵥ/σᵥ₀ {mean:.2f}, 5–95 %: {low:.2f} to {high:.2f}"


def base_map_figure(results: Results, data: Data) -> Figure:
    """Mean stress on each load cell in plan, reading by reading, from `base_stress.csv`."""
    experiment, rows = results.experiment, results.base_stress
    high = max(float(row["mean_mpa"]) for row in rows if row["mean_mpa"])
    extent = (experiment.geometry.width, experiment.geometry.length)
    panels = []
    for t in evenly(len(results.clock), MOST_MAPS):
        values = [float(row["mean_mpa"] or "nan") for row in rows if int(row["period"]) == t]
        panels.append(
            plan(
                data,
                "base_map",
                mass_drawn_words(results, t) if t else "Before draw",
                extent,
                areas_of(results.load_cells),
                np.array(values),
                "mean stress (MPa)",
                (0.0, high),
                areas_of(experiment.drawpoints),
                "mean stress",
            )
        )
    caption = parts(
        "Simulated mean stress on each load cell at the base, n = {} replicates; all maps have "
        "the same scale. Squares are drawpoints{}.",
        data.number("base_map", "", "replicates", results.count),
        assumed_words(results),
    )
    return Figure("base_map", "Base stress in plan, period by period", caption, panels)


def base_stress_table(results: Results, data: Data) -> Table:
    """Stress on each load cell at each reading, from `base_stress.csv`."""
    factor, unit = results.mass_unit
    statistics = {"mean": "mean", "p10": "P10", "p50": "P50", "p90": "P90"}
    table = Table(
        "base_stress",
        parts(
            "Base stress of each load cell and period: simulated mean and percentiles over {} "
            "replicates at the end of the period. The same is in base_stress.csv.",
            data.number("base_stress", "", "replicates", results.count),
        ),
        [
            "Load cell, period",
            f"Drawn ({unit})",
            *(f"Stress (kPa): {words}" for words in statistics.values()),
            *(f"Stress (MPa): {words}" for words in statistics.values()),
        ],
        data,
    )
    for row in results.base_stress:
        numbers = [(factor * float(row["mass_drawn_kg"]), None)]
        for scale, decimals in (("kpa", 1), ("mpa", 4)):
            values = (row[f"{name}_{scale}"] for name in statistics)
            numbers += [(float(value) if value else None, decimals) for value in values]
        period = f"period {row['period']}" if row["period"] != "0" else "before draw"
        table.add_numbers(f"{row['name']}, {period}", numbers)
    return table


def mass_words(results: Results) -> str:
    """Name of an axis of the mass drawn."""
    return f"mass drawn ({results.mass_unit[1]})"


def mass_drawn_words(results: Results, t: int) -> str:
    """What is drawn at a reading."""
    return f"{results.drawn[t]:.4g} {results.mass_unit[1]} drawn"


def assumed_words(results: Results) -> str:
    """In brackets, which of drawpoints and load cells are assumed; empty where none is."""
    assumed = [key for key in ("drawpoints", "load_cells") if key in results.experiment.assumed]
    if not assumed:
        return ""
    return f" (assumed, not from the source: {' and '.join(assumed).replace('_', ' ')})"


def load_cell_table(results: Results, data: Data) -> Table:
    """Largest and smallest σᵥ/σᵥ₀ of each load cell."""
    mean, mass, unit = stress_ratio(results).mean(axis=0), results.drawn, results.mass_unit[1]
    table = Table(
        "load_cell_extremes",
        parts(
            "Largest and smallest σᵥ/σᵥ₀ of each load cell: of the mean over {} replicates, and "
            "of the data where there are any.",
            data.number("load_cell_extremes", "", "replicates", results.count),
        ),
        [
            "Load cell",
            "Stress before draw (kPa)",
            "Model: largest",
            f"Model: at mass ({unit})",
            "Model: smallest",
            f"Model: at mass ({unit}) ",
            f"Data, {results.label}: largest",
            f"Data, {results.label}: smallest",
        ],
        data,
    )
    before = results.statistics["vertical_stress_mean"].values[0]
    for i, cell in enumerate(results.load_cells):
        _, values, _ = measured_ratio(results, cell.name)
        ranked = np.argsort(mean[:, i])[: np.isfinite(mean[:, i]).sum()]  # NaN: no ground above it
        ends = [(mean[t, i], mass[t]) for t in ranked[[-1, 0]]] if len(ranked) else []
        (most, at_most), (least, at_least) = ends or [(None, None)] * 2
        numbers = (
            (before[i], decimals_of(before[i])),
            (most, 2),
            (at_most, 2),
            (least, 2),
            (at_least, 2),
            (values.max() if len(values) > 1 else None, 2),
            (values.min() if len(values) > 1 else None, 2),
        )
        table.add_numbers(cell.name, numbers)
    return table.without_empty_columns()


def shown_readings(results: Results) -> list[int]:
    """Indices of the readings that are shown as sections, evenly over the mass drawn."""
    mass = results.clock
    wanted = np.linspace(0, mass[-1], SECTIONS)
    return sorted({int(np.argmin(np.abs(mass - m))) for m in wanted})


def stress_section_figure(results: Results, data: Data) -> Figure:
    """Mean vertical stress at a few masses drawn (Figs 12, 15 and 17): x-z sections and, where
    the load cells have no map of their own, plans of the base.
    """
    times, name = shown_readings(results), "vertical_stress_mean"
    x, y, z = (results.fields[axis].values for axis in "xyz")
    sections = [results.section(name, t) for t in times]
    high = float(max(np.nanmax(section) for section in sections))
    scale = "mean stress (kPa)", 0.0, high
    panels = []
    for t, section in zip(times, sections, strict=True):
        peak = f"stress up to {np.nanmax(section):.3g} kPa"
        panel = _section_panel(results, data, "stress_sections", t, peak)
        panel.image(x, z, section, *scale, stored=results.section_in_file(name, t))
        zone = results.section("movement_zone_probability", t)
        panel.outline("edge of the movement zone (in half of the replicates)", x, z, zone, 0.5)
        mark_base(panel, results)
        panels.append(panel)
    for t in times if not results.has_many_load_cells else ():
        base = results.base(name, t)
        mass = mass_drawn_words(results, t)
        panel = Panel(
            data,
            "stress_sections",
            f"Base, {mass}",
            "x (m)",
            "y (m)",
            f"Plan of the base at {mass}: {stress_range(base)}.",
            section_size(x[-1] + x[0], y[-1] + y[0], (2.3, 2.0)),
            bar=True,
        )
        panel.image(x, y, base, *scale, stored=results.base_in_file(name, t))
        panels.append(panel)
    caption = _section_caption(results, data, "stress_sections", "Mean vertical stress")
    if not results.has_many_load_cells:
        caption += " Below them the lowest level of cells in plan."
    return Figure("stress_sections", "Vertical stress during draw", caption, panels)


def stress_range(values: np.ndarray) -> str:
    """Lowest and highest stress (kPa) of a field in words."""
    if not np.isfinite(values).any():
        return "no material"
    return f"stress from {np.nanmin(values):.3g} to {np.nanmax(values):.3g} kPa"


def zone_section_figure(results: Results, data: Data) -> Figure:
    """x-z sections of the probability that a place belongs to a movement zone."""
    panels = []
    for t in shown_readings(results)[1:]:
        zone = results.section("movement_zone_probability", t)
        x, z = results.fields["x"].values, results.fields["z"].values
        reach = z[np.nanmax(zone, axis=1) >= 0.5]
        words = f"movement zone up to {reach.max():.2f} m" if len(reach) else "no movement zone"
        panel = _section_panel(results, data, "zone_sections", t, words)
        panel.image(
            x, z, zone, "probability (–)", 0.0, 1.0, SHARE_COLORS,
            results.section_in_file("movement_zone_probability", t),
        )  # fmt: skip
        mark_base(panel, results)
        panels.append(panel)
    caption = _section_caption(
        results, data, "zone_sections", "Share of replicates in which the place moves or has moved"
    )
    return Figure("zone_sections", "Movement zone during draw", caption, panels)


def _section_panel(results: Results, data: Data, figure: str, t: int, words: str) -> Panel:
    x, z = results.fields["x"].values, results.fields["z"].values
    mass = mass_drawn_words(results, t)
    return Panel(
        data,
        figure,
        mass,
        "x (m)",
        "height z (m)",
        f"Section at {mass}: {words}.",
        section_size(x[-1] + x[0], z[-1] + z[0]),
        bar=True,
    )


def mark_base(panel: Panel, results: Results) -> None:
    """Drawpoints and load cells under the base of a section."""
    panel.base_marks("drawpoint", results.experiment.drawpoints, INK, 0)
    if results.experiment.load_cells:
        panel.base_marks("load cell", results.load_cells, ORANGE, 1)


def _section_caption(results: Results, data: Data, figure: str, words: str):
    y = float(results.fields["y"].values[results.section_row])
    return parts(
        "{}, x–z section at y = {} m, n = {} replicates. Bars under the base mark drawpoints and "
        "load cells{}.",
        words,
        data.number(figure, "", "y", y, unit="m"),
        data.number(figure, "", "replicates", results.count),
        assumed_words(results),
    )


def movement_zone_figure(results: Results, data: Data) -> Figure:
    """Height and width of the movement zone against mass drawn (Fig. 11)."""
    mass, panels = results.drawn, []
    for part in ("height", "width"):
        name = f"movement_zone_{part}"
        mean, low, high = (
            results.statistics[f"{name}_{statistic}"].values for statistic in ("mean", "p05", "p95")
        )
        panel = Panel(
            data,
            "movement_zone",
            part.capitalize(),
            mass_words(results),
            f"{part} of the movement zone (m)",
            f"The movement zone's {part} reaches {mean[-1]:.3g} m at {mass[-1]:.4g} "
            f"{results.mass_unit[1]}.",
            (3.3, 2.2),
        )
        limit = getattr(results.experiment.geometry, part)
        panel.reference(f"{part} of the model", y=limit, dash="dotted")
        panel.curve("model, mean", mass, mean, low, high, band=BAND)
        readings = results.readings(name)
        x = [results.mass_unit[0] * (r["mass_drawn"] or 0.0) for r in readings]
        measured_points(panel, results, readings, x, [r["measured"] for r in readings])
        panel.axes.set(ylim=(0, 1.08 * limit), xlim=(-0.02 * mass[-1], 1.02 * mass[-1]))
        panels.append(panel)
    given = any(results.readings(f"movement_zone_{part}") for part in ("height", "width"))
    caption = parts(
        "Height of the tallest and width along x of the widest connected movement zone, at its "
        "widest level; zones that meet count as one. n = {} replicates. {}",
        data.number("movement_zone", "", "replicates", results.count),
        "" if given else "It was not measured here.",
    )
    return Figure("movement_zone", "Growth of the movement zone", caption, panels)


def e_min_figure(results: Results, data: Data) -> Figure:
    """E_min against the height of the movement zone, as used (Fig. 13)."""
    p, top = results.parameters, results.experiment.geometry.height
    height = np.linspace(0, top, 101)
    value = 1 - p.shed_in_zone(height)
    panel = Panel(
        data,
        "E_min",
        "",
        "height of the movement zone (m)",
        "share of load passed on (–)",
        f"E_min from {value[0]:.4g} at the base to {value[-1]:.4g} at {top:g} m; E = {p.E:.4g}.",
        (3.6, 2.3),
    )
    panel.reference("E, ground at rest", y=p.E, color=GREEN)
    panel.curve("E_min, movement zone", height, value)
    reached = float(results.statistics["movement_zone_height_mean"].values[-1])
    panel.reference("height reached (mean)", x=reached, color=MUTED, dash="dotted")
    fitted = results.calibration["parameters"].get("E_min", {}).get("calibrated", False)
    caption = parts(
        "E_min is the share of its load that a cell of a movement zone passes on, set by the "
        "height of that zone; ground at rest passes on E = {}. {}. The zones reach {} m, mean "
        "over n = {} replicates.",
        data.number("E_min", "", "E", p.E),
        "Its level was calibrated here" if fitted else "It was not calibrated here",
        data.number("E_min", "", "height reached", reached, 2, "m"),
        data.number("E_min", "", "replicates", results.count),
    )
    return Figure("E_min", "Load passed on by flowing ground", caption, [panel])


def extraction_figure(results: Results, data: Data) -> Figure:
    """Where the drawn cells lay before draw, as a share of replicates, x-z section."""
    nz, ny, nx = results.lattice.shape
    drawn = results.replicates["drawn_cell"].values.astype(np.float64)
    count = np.zeros(nz * ny * nx)
    for cells in drawn:
        count[cells[cells >= 0].astype(np.int64)] += 1
    ground = np.isfinite(results.section("movement_zone_probability", 0))
    share = count.reshape(nz, ny, nx)[:, results.section_row] / len(drawn)
    share = np.where(ground, share, np.nan)
    x, z = results.fields["x"].values, results.fields["z"].values
    reach = z[np.nanmax(share, axis=1) >= 0.5]
    panel = Panel(
        data,
        "extraction_zone",
        "",
        "x (m)",
        "height z (m)",
        f"Extraction zone up to {reach.max() if len(reach) else 0:.2f} m (half of replicates).",
        section_size(x[-1] + x[0], z[-1] + z[0]),
        bar=True,
    )
    panel.image(x, z, share, "probability of being drawn (–)", 0.0, 1.0, SHARE_COLORS)
    mark_base(panel, results)
    caption = parts(
        "Extraction zone: the share of n = {} replicates in which the ground that lay here before "
        "draw has come out of a drawpoint, x–z section at y = {} m.",
        data.number("extraction_zone", "", "replicates", len(drawn)),
        data.number(
            "extraction_zone",
            "",
            "y",
            float(results.fields["y"].values[results.section_row]),
            unit="m",
        ),
    )
    return Figure("extraction_zone", "Where the drawn ground came from", caption, [panel])


def drawpoint_table(results: Results, data: Data) -> Table:
    """Scheduled and drawn mass of each drawpoint, its shortfall, and hang-ups."""
    experiment, statistics = results.experiment, results.statistics
    hang_ups = float(results.replicates["hang_ups"].mean())
    factor, unit = results.mass_unit
    table = Table(
        "drawpoints",
        parts(
            "What each drawpoint gave: mean over {} replicates. A shortfall is scheduled mass that "
            "a drawpoint run empty could not give. On average {} voids hung up below other voids.",
            data.number("drawpoints", "", "replicates", results.count),
            data.number("drawpoints", "", "hang-ups", hang_ups),
        ),
        [
            "Drawpoint",
            f"Scheduled ({unit})",
            f"Drawn ({unit})",
            f"sd between replicates ({unit})",
            "Share of schedule",
            f"Shortfall ({unit})",
        ],
        data,
    )
    scheduled = np.zeros(len(experiment.drawpoints))
    done = 0.0
    for point, end in visits(experiment):
        scheduled[point] += end - done
        done = end
    which = results.replicates["drawn_drawpoint"].values.astype(np.float64)
    total = np.where(which >= 0, results.replicates["drawn_mass"].values, 0.0)
    each = np.diff(total, axis=1, prepend=0.0)
    drawn = np.array([np.where(which == i, each, 0.0).sum(axis=1) for i in range(len(scheduled))])
    shortfall = statistics["drawpoint_shortfall_mean"].values
    scheduled, drawn, shortfall = factor * scheduled, factor * drawn, factor * shortfall
    for i, point in enumerate(experiment.drawpoints):
        spread = drawn[i].std(ddof=1) if results.count > 1 else None
        decimals = decimals_of(scheduled[i] or 1.0)
        numbers = (
            (scheduled[i], decimals),
            (drawn[i].mean(), decimals),
            (spread, decimals),
            (drawn[i].mean() / scheduled[i] if scheduled[i] else None, 3),
            (shortfall[i], decimals),
        )
        table.add_numbers(point.name, numbers)
    return table
