"""Regions of an experiment, and grade and dilution of what its drawpoints gave."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.config.regions import Region
from pipeline.files.grade_table import quantities
from pipeline.report.figures import ORANGE, SPREAD_COLORS, Panel, section_size
from pipeline.report.page import Badge, Data, Figure, Table, decimals_of, parts
from pipeline.report.plan_figures import evenly
from pipeline.report.results import ASSUMED, Results, is_assumed

MOST_DRAWPOINTS = 7  # that get a panel each, beside all of them together
BAND = "P10–P90 of replicates"


def region_table(results: Results, data: Data) -> Table | None:
    """Regions as declared; None without any."""
    experiment = results.experiment
    if not experiment.regions:
        return None
    units = experiment.grade_units
    assumed = [ASSUMED] if is_assumed(experiment, "regions") else []
    table = Table(
        "regions",
        "Regions as declared; a cell belongs to the last one that holds its center. Ground in no "
        f"region has the experiment's material ({experiment.material.name}).",
        [
            "Number, region",
            "Where",
            "Bulk density (kg/m³)",
            "Smallest particle (m)",
            "Largest particle (m)",
            *(f"{name} ({unit})" for name, unit in units.items()),
            "Remarks",
        ],
        data,
    )
    for number, region in enumerate(experiment.regions, start=1):
        name, sizes = f"{number}: {region.name}", region.particle_size or (None, None)
        values = (region.bulk_density or experiment.material.bulk_density, *sizes)
        cells = zip(table.columns[2:5], values, strict=True)
        row = [name, where(region), *(table.number(name, *cell) for cell in cells)]
        for mineral, unit in units.items():
            grade = region.grade.get(mineral)
            if grade is not None and grade.column is not None:
                row.append(f"column {grade.column}")
            else:
                value = 0.0 if grade is None else grade.value
                row.append(table.number(name, f"{mineral} ({unit})", value))
        remarks = [Badge("waste", "warn")] if region.waste else []
        table.rows.append([*row, [*remarks, *assumed]])
    return table.without_empty_columns()


def where(region: Region) -> str:
    """Where a region is, in words."""
    if region.mask is not None:
        return f"{region.mask.variable or region.name} in {region.mask.path}"
    if region.column is not None:
        return f"{region.column.name} = {' or '.join(region.column.values)}"
    spans = {axis: getattr(region.box, axis) for axis in "xyz"}
    return ", ".join(f"{axis} {s[0]:g} to {s[1]:g} m" for axis, s in spans.items() if s)


def region_figures(results: Results, data: Data) -> list[Figure]:
    """Section through the regions, then grade and dilution of what was drawn."""
    if not results.experiment.regions:
        return []
    return [section_figure(results, data), *_curve_figures(results, data)]


def section_figure(results: Results, data: Data) -> Figure:
    """Which region each place belongs to before draw, and its grades; x-z sections."""
    experiment, row = results.experiment, results.section_row
    model = results.block_model.isel(y=row)
    x, z = model["x"].values, model["z"].values
    names = ["in no region", *(region.name for region in experiment.regions)]
    fields = {"Region": ("region", "number of the region")}
    for name, unit in experiment.grade_units.items():
        fields[name] = (f"grade_{name}", f"{name} ({unit})")
    panels = []
    for title, (variable, words) in fields.items():
        values = model[variable].values.astype(np.float64)
        values = np.where(model["region"].values >= 0, values, np.nan)
        there = [names[int(i)] for i in np.unique(model["region"].values) if i >= 0]
        alt = f"regions {', '.join(there)}"
        if title != "Region":
            alt = f"{words} from {np.nanmin(values):.3g} to {np.nanmax(values):.3g}"
        panel = Panel(
            data,
            "regions",
            title,
            "x (m)",
            "height z (m)",
            f"Section before draw: {alt}.",
            section_size(x[-1] + x[0], z[-1] + z[0]),
            bar=title != "Region",
        )
        if title == "Region":
            labels = [f"{number}: {name}" for number, name in enumerate(names)]
            panel.classes(x, z, values, words, labels)
        else:
            panel.image(x, z, values, words, 0.0, float(np.nanmax(values)) or 1.0, SPREAD_COLORS)
        panels.append(panel)
    caption = parts(
        "Regions before draw, and their grades; x–z section at y = {} m.",
        data.number("regions", "", "y", float(model["y"]), unit="m"),
    )
    return Figure("regions", "Regions and grades before draw", caption, panels)


def _curve_figures(results: Results, data: Data) -> Iterator[Figure]:
    curves = results.grade
    if curves is None:
        return
    factor, mass = results.mass_unit
    names = [name.decode() for name in curves["drawpoint_name"].values]
    shown = [len(names) - 1, *evenly(len(names) - 1, MOST_DRAWPOINTS)]
    for quantity, variable in _shown_quantities(results).items():
        words = _words(results, quantity)
        tops = curves[f"drawn_{variable}_p90"].values[shown]
        panels = []
        for place in shown:
            ends = factor * curves["mass_to"].values[place]
            middle = 0.5 * (factor * curves["mass_from"].values[place] + ends)
            mean, low, high = (
                curves[f"drawn_{variable}_{part}"].values[place] for part in ("mean", "p10", "p90")
            )
            until = curves[f"cumulative_{variable}_mean"].values[place]
            known = until[np.isfinite(until)]
            alt = f"{known[0]:.3g} at first, {known[-1]:.3g} over all" if len(known) else "nothing"
            panel = Panel(
                data,
                f"drawn_{quantity}",
                names[place].capitalize() if place == len(names) - 1 else names[place],
                f"mass drawn there ({mass})",
                words,
                f"{words} of what was drawn from {names[place]}: {alt}.",
                (2.05, 1.6),
            )
            panel.curve("in each bin, mean", middle, mean, low, high, band=BAND)
            panel.curve("from the start, mean", ends, until, color=ORANGE, dash="dashed")
            panel.axes.set(ylim=(0, 1.08 * np.nanmax(tops) or 1.0))
            panels.append(panel)
        title = "Dilution" if quantity == "dilution" else f"Grade of {quantity}"
        more = (
            f" Shown are {len(shown) - 1} of the {len(names) - 1} drawpoints; the table and "
            "grade.csv have all of them."
            if len(shown) < len(names)
            else ""
        )
        caption = parts(
            "{} of what was drawn, against the mass drawn from the drawpoint, in {} bins; all "
            "panels have the same vertical axis. Simulated, n = {} replicates.{}",
            "Share of waste by mass" if quantity == "dilution" else words,
            data.number(f"drawn_{quantity}", "", "bins", curves.sizes["mass_bin"]),
            data.number(f"drawn_{quantity}", "", "replicates", results.count),
            more,
        )
        yield Figure(f"drawn_{quantity}", f"{title} of what was drawn", caption, panels)


def grade_table(results: Results, data: Data) -> Table | None:
    """Grades and dilution of all that each drawpoint gave; None where nothing has any."""
    curves = results.grade
    if curves is None:
        return None
    factor, unit = results.mass_unit
    quantities = _shown_quantities(results)
    statistics = {"mean": "mean", "p10": "P10", "p50": "P50", "p90": "P90"}
    table = Table(
        "grade",
        parts(
            "Grade and dilution of all that was drawn: simulated mean and percentiles over {} "
            "replicates. Dilution is the share of waste by mass. By mass drawn, the same is in "
            "grade.csv.",
            data.number("grade", "", "replicates", results.count),
        ),
        [
            "Drawpoint",
            f"Drawn ({unit})",
            *(f"{_words(results, q)}: {s}" for q in quantities for s in statistics.values()),
        ],
        data,
    )
    total = curves["bin_mass_mean"].sum("mass_bin").values
    for place, name in enumerate(curves["drawpoint_name"].values):
        numbers = [(factor * total[place], decimals_of(factor * total.max()))]
        for variable in quantities.values():
            last = (curves[f"cumulative_{variable}_{s}"].values[place, -1] for s in statistics)
            numbers += [(value, 3) for value in last]
        table.add_numbers(name.decode(), numbers)
    return table


def _shown_quantities(results: Results) -> dict[str, str]:
    """Variables of the grades, and of dilution where a region is waste."""
    found = quantities(results.grade)
    if not any(region.waste for region in results.experiment.regions):
        found.pop("dilution")
    return found


def _words(results: Results, quantity: str) -> str:
    unit = results.experiment.grade_units.get(quantity)
    return "dilution (–)" if unit is None else f"{quantity} ({unit})"
