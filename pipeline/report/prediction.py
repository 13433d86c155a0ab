"""The page of a prediction: its bands, what makes them wide, and what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup

from pipeline.config.experiment import Experiment
from pipeline.files.atomic import write_text
from pipeline.files.results import clock_of
from pipeline.report.figures import BLUE, GREEN, INK, ORANGE, PURPLE, Panel, panel_style
from pipeline.report.page import Badge, Data, Figure, Table, decimals_of, parts, render
from pipeline.report.plan_figures import evenly, mass_unit
from pipeline.report.results import quantity_words

STRESS = "vertical stress (kPa)"
BASE = "whole base"
MOST_PANELS, MOST_ROWS = 7, 60
WORDS = {
    "packing": "packing",
    "calibration": "packing and calibration",
    "effect": "packing, calibration and effects",
}
COLORS = {"packing": BLUE, "calibration": ORANGE, "effect": GREEN, "interaction": PURPLE}
UNIT = {"m": "fill height (m)"}


class Content:
    """`prediction.nc` and `prediction.json` with what the page asks of them."""

    def __init__(self, experiment: Experiment, dataset: xr.Dataset, document: Mapping[str, Any]):
        self.experiment, self.dataset, self.document = experiment, dataset, document
        self.names = [name.decode() for name in dataset["load_cell_name"].values]
        self.sources = [name.decode() for name in dataset["source_name"].values]
        self.levels = [name.decode() for name in dataset["level_name"].values]
        self.percentiles = [int(p) for p in dataset["percentile"].values]
        kind, clock = clock_of(dataset)
        factor, unit = mass_unit(experiment.mass_scheduled) if kind == "mass_drawn" else (1.0, "m")
        self.factor, self.clock = factor, factor * clock
        self.clock_name = UNIT.get(unit, f"mass drawn ({unit})")

    @property
    def has_effects(self) -> bool:
        """Whether amplitudes of effects were drawn."""
        return "sampled_amplitude" in self.dataset

    @property
    def shown_levels(self) -> list[str]:
        """Levels at which something is drawn that was not drawn before."""
        kinds = {one["kind"] for one in self.document["unknowns"]}
        drawn = {"packing": True, "calibration": "parameter" in kinds, "effect": "effect" in kinds}
        return [level for level in self.levels if drawn[level]]

    @property
    def places(self) -> list[str]:
        """Load cells, and the base where it is not the only one of them."""
        return self.names if self.names == ["base"] else [*self.names, BASE]

    @property
    def shown_places(self) -> list[str]:
        """Those that get a panel each: all, or a few where they are many."""
        cells = [self.names[i] for i in evenly(len(self.names), MOST_PANELS)]
        return [place for place in self.places if place in (*cells, BASE)]

    def of(self, what: str, place: str) -> np.ndarray:
        """A variable of stress at a place, (..., time)."""
        if place == BASE:
            return self.dataset[f"base_vertical_stress_{what}"].values
        return self.dataset[f"vertical_stress_{what}"].values[..., self.names.index(place)]

    def percentile(self, level: str, percent: int, place: str) -> np.ndarray:
        """A percentile at a level, (time)."""
        at = self.levels.index(level), self.percentiles.index(percent)
        return self.of("percentile", place)[at]

    def measured(self, place: str) -> list[Mapping[str, Any]]:
        """Measured stresses at a place."""
        cell = None if place in (BASE, "base") else place
        return [
            one
            for one in self.document["readings"]
            if one["quantity"] == "vertical_stress" and one["load_cell"] == cell
        ]

    def clock_at(self, reading: Mapping[str, Any]) -> float:
        """Where a measured row stands on the clock."""
        if self.experiment.is_draw:
            return self.factor * (reading["mass_drawn"] or 0.0)
        height = reading["fill_height"]
        return self.experiment.geometry.height if height is None else height


def write_prediction_report(
    experiment: Experiment,
    dataset: xr.Dataset,
    document: Mapping[str, Any],
    report: str | Path,
    data_file: str | Path,
) -> None:
    """Write the page of a prediction, from its netCDF and JSON, and the data that it shows."""
    data, content = Data(), Content(experiment, dataset, document)
    keys = ("source", "git_revision", "config_sha256", "root_seed", "references")
    with panel_style():
        page = render(
            "prediction.html.j2",
            numbers=Path(data_file).name,
            experiment=experiment,
            known_from=document["known_from"],
            label=document["data_label"] if document["readings"] else "",
            remarks=document["remarks"],
            verdict=verdict(content, data),
            bands=band_figure(content, data),
            shares=share_figure(content, data),
            share_table=share_table(content, data),
            unknown_table=unknown_table(content, data),
            reading_table=reading_table(content, data),
            method=method(content, data),
            files=["prediction.nc", "prediction.json", Path(data_file).name],
            provenance={key: dataset.attrs.get(key, "unknown") for key in keys},
        )
    write_text(data_file, data.to_csv())
    write_text(report, page)


def verdict(content: Content, data: Data) -> list[Markup]:
    """The answer in a few sentences: what the bands are made of, and what was measured."""
    share = content.document["variance_share"]
    sentences = []
    if share["packing"] is None:
        sentences.append(Markup("Nothing that is drawn moves a load cell: there is no band."))
    else:
        named = [s for s in content.sources if s != "effect" or content.has_effects]
        numbers = [
            parts(
                "<strong>{} %</strong> {}",
                data.number("verdict", "", f"share of {source}", 100 * share[source], 0, "%"),
                source,
            )
            for source in named
        ]
        sentences.append(
            parts(
                "Of the variance of the load cells' predicted stress, over all of them and all "
                "readings: {}.",
                Markup(", ").join(numbers),
            )
        )
    readings = content.document["readings"]
    for words, group in (
        ("data", readings),
        ("data that no fit has seen", [r for r in readings if not r["used_in_calibration"]]),
    ):
        if group and (words == "data" or len(group) < len(readings)):
            sentences.append(
                parts(
                    "{} of {} values of the {} {} lie within their 90 % band.",
                    data.number("verdict", words, "within", sum(r["within_90"] for r in group)),
                    data.number("verdict", words, "values", len(group)),
                    content.document["data_label"],
                    words,
                )
            )
    if readings and all(r["used_in_calibration"] for r in readings):
        sentences.append(Markup("All of them were used in the fit: they do not test it."))
    return sentences


def band_figure(content: Content, data: Data) -> Figure:
    """Nested 90 % bands of each place over the readings, with what was measured there."""
    if len(content.clock) == 1:
        panels = [_bars_of_one_reading(content, data)]
    else:
        panels = [_bands_of(content, data, place) for place in content.shown_places]
    left_out = len(content.places) - len(content.shown_places)
    caption = parts(
        "Bands hold 90 % of n = {} samples (5th to 95th percentile); each draws what the one "
        "before it draws, and one thing more. {} are medians.{}{}",
        data.number("bands", "", "samples", content.document["samples"]),
        "Lines" if len(content.clock) > 1 else "Squares",
        parts(
            " Points are the {} data, with one sd; one that is a mean over several packings "
            "scatters less than the band.",
            content.document["data_label"],
        )
        if content.document["readings"]
        else "",
        f" {left_out} more load cells are in the files." if left_out else "",
    )
    return Figure("bands", "Vertical stress with its bands", caption, panels)


def _bands_of(content: Content, data: Data, place: str) -> Panel:
    whole = content.levels[-1]
    low, high = (content.percentile(whole, p, place) for p in (5, 95))
    words = f"{place}: 90 % band of the whole from {low[-1]:.3g} to {high[-1]:.3g} kPa at the end."
    title = place if place == BASE else f"Load cell {place}"
    panel = Panel(data, "bands", title, content.clock_name, STRESS, words)
    for level in reversed(content.shown_levels):
        ends = (content.percentile(level, p, place) for p in (5, 95))
        middle = content.percentile(level, 50, place)
        label = f"median of {WORDS[level]}"
        band = f"90 % band: {WORDS[level]}"
        panel.curve(label, content.clock, middle, *ends, COLORS[level], "solid", band)
    _add_measured(panel, content, place, [content.clock_at(r) for r in content.measured(place)])
    return panel


def _bars_of_one_reading(content: Content, data: Data) -> Panel:
    places = content.shown_places
    width = max(3.4, 0.75 * len(places))
    words = "90 % band of each load cell: " + "; ".join(
        f"{place} {content.percentile(content.levels[-1], 5, place)[0]:.3g} to "
        f"{content.percentile(content.levels[-1], 95, place)[0]:.3g} kPa"
        for place in places
    )
    panel = Panel(data, "bands", "", "load cell", STRESS, words, (width, 2.3))
    levels = content.shown_levels
    for i, level in enumerate(levels):
        x = np.arange(len(places)) + 0.16 * (i - (len(levels) - 1) / 2)
        low, middle, high = (
            np.array([content.percentile(level, p, place)[0] for place in places])
            for p in (5, 50, 95)
        )
        label = f"median and 90 % band: {WORDS[level]}"
        panel.points(label, x, middle, low, high, COLORS[level], "s")
    for i, place in enumerate(places):
        _add_measured(panel, content, place, [i + 0.32] * len(content.measured(place)))
    panel.axes.set_xticks(range(len(places)), places)
    panel.axes.set_xlim(-0.6, len(places) - 0.4)
    return panel


def _add_measured(panel: Panel, content: Content, place: str, at: list[float]) -> None:
    readings = content.measured(place)
    for used, marker in ((True, "D"), (False, "o")):
        kept = [i for i, one in enumerate(readings) if one["used_in_calibration"] == used]
        if kept:
            value = np.array([readings[i]["measured"] for i in kept])
            sd = np.array([readings[i]["measured_sd"] for i in kept])
            label = f"{content.document['data_label']}{', used in the fit' if used else ''}"
            where = [at[i] for i in kept]
            panel.points(label, where, value, value - sd, value + sd, INK, marker, not used)


def share_figure(content: Content, data: Data) -> Figure:
    """Shares of the variance of each place, stacked, at the first and the last reading."""
    panels = []
    for time in sorted({0, len(content.clock) - 1}):
        title = (
            f"{content.clock_name.partition(' (')[0]} {content.clock[time]:.4g} {_unit(content)}"
        )
        shares = {p: 100.0 * content.of("variance_share", p)[:, time] for p in content.shown_places}
        shares = {place: share for place, share in shares.items() if np.isfinite(share[0])}
        if not shares:
            continue
        words = "; ".join(
            f"{place}: "
            + ", ".join(
                f"{source} {value:.0f} %"
                for source, value in zip(content.sources, share, strict=True)
            )
            for place, share in shares.items()
        )
        alt = f"Shares of the variance, {title}: {words}."
        panel = Panel.of_rows(data, "shares", title, "share of the variance (%)", alt, shares)
        start = np.zeros(len(shares))
        for i, source in enumerate(content.sources):
            length = np.array([share[i] for share in shares.values()])
            if source == "effect" and not content.has_effects:
                continue
            length = np.maximum(length, 0.0)
            panel.bars(source, length, list(shares), COLORS[source], start)
            start = start + length
        panel.reference("variance of the whole", x=100.0)
        panels.append(panel)
    caption = (
        "Packing: s and the paths of the flow at the best values, which no measurement settles. "
        "Calibration: the posterior of the parameters. Effect: what is not known of added effects "
        "once the parameters are. Interaction: packings scatter otherwise with other parameters; "
        "where it is less, the others add up to more than 100 %, as shares below 0 are no bars."
    )
    return Figure("shares", "Shares of the variance", caption, panels)


def _unit(content: Content) -> str:
    return content.clock_name.rpartition("(")[2].rstrip(")")


def share_table(content: Content, data: Data) -> Table:
    """Percentiles, sd and shares of every load cell at its readings."""
    columns = ["Place", content.clock_name[0].upper() + content.clock_name[1:]]
    columns += [f"Stress (kPa): {name}" for name in ("P5", "P10", "P50", "P90", "P95", "sd")]
    sources = [s for s in content.sources if s != "effect" or content.has_effects]
    columns += [f"{s.capitalize()} (%): {name}" for s in sources for name in ("share", "se")]
    times = range(len(content.clock))
    if len(content.clock) * len(content.places) > MOST_ROWS:
        times = sorted({0, len(content.clock) - 1})
    table = Table(
        "shares",
        parts(
            "Stress that is predicted, and what its variance comes from: shares with their Monte "
            "Carlo standard error (se), of n = {} samples.{}",
            data.number("shares", "", "samples", content.document["samples"]),
            "" if len(times) == len(content.clock) else " All readings are in prediction.nc.",
        ),
        columns,
        data,
    )
    for place in content.places:
        for time in times:
            numbers = [(content.clock[time], None), *_numbers(content, place, time, sources)]
            row = f"{place} at {content.clock[time]:.6g}"
            cells = zip(columns[1:], numbers, strict=True)
            table.rows.append([place, *(table.number(row, c, *number) for c, number in cells)])
    return table


def _numbers(content: Content, place: str, time: int, sources) -> Iterator[tuple]:
    whole = content.levels[-1]
    spread = float(np.sqrt(content.of("variance", place)[time]))
    places = decimals_of(content.percentile(whole, 50, place)[time])
    for percent in content.percentiles:
        yield content.percentile(whole, percent, place)[time], places
    yield spread, places
    for source in sources:
        i = content.sources.index(source)
        for what in ("variance_share", "variance_share_se"):
            yield 100.0 * content.of(what, place)[i, time], 1


def unknown_table(content: Content, data: Data) -> Table | None:
    """What was drawn: best value and samples of each unknown; None without any."""
    unknowns = content.document["unknowns"]
    if not unknowns:
        return None
    table = Table(
        "unknowns",
        parts(
            "What is drawn besides the packing, from: {}. Best: as fitted; the rest is over n = "
            "{} samples.",
            content.document["known_from"],
            data.number("unknowns", "", "samples", content.document["samples"]),
        ),
        ["Unknown", "Kind", "Best", *(f"Samples: {n}" for n in ("mean", "sd", "P5", "P95")),
         "Unit", "Remarks"],
        data,
    )  # fmt: skip
    for one in unknowns:
        values = (one[key] for key in ("best", "mean", "std", "p05", "p95"))
        cells = zip(table.columns[2:7], values, strict=True)
        table.rows.append(
            [
                one["label"],
                one["kind"],
                *(table.number(one["label"], c, value, None, one["unit"]) for c, value in cells),
                "–" if one["unit"] == "1" else one["unit"],
                _unknown_badge(one),
            ]
        )
    return table.without_empty_columns()


def _unknown_badge(one: Mapping[str, Any]) -> Badge | str:
    if one["at_bound"]:
        return Badge("at the end of its range: not a fit", "bad")
    return "" if one["identified"] else Badge("next to nothing is known of it", "bad")


def reading_table(content: Content, data: Data) -> Table | None:
    """Every measured value beside the band of such a reading; None without any."""
    readings = content.document["readings"]
    if not readings:
        return None
    label = content.document["data_label"]
    table = Table(
        "readings",
        parts(
            "The {} data beside the 90 % band of such a reading: with the reading's own errors, "
            "and with the packing's scatter as far as its sd does not hold it already.",
            label,
        ),
        ["Quantity", "Load cell", "Fill height (m)", "Mass drawn (kg)", f"Data, {label}: value",
         f"Data, {label}: sd", "Band: P5", "Band: P50", "Band: P95", "Within", "Used in the fit"],
        data,
    )  # fmt: skip
    for i, one in enumerate(readings, start=1):
        row = f"{i}: {one['quantity']} {one['load_cell'] or BASE}"
        places = decimals_of(one["measured"])
        numbers = [(one["fill_height"], None), (one["mass_drawn"], None)]
        keys = ("measured", "measured_sd", "p05", "p50", "p95")
        numbers += [(one[key], places) for key in keys]
        cells = zip(table.columns[2:9], numbers, strict=True)
        table.rows.append(
            [
                quantity_words(one["quantity"]),
                one["load_cell"] or (BASE if content.experiment.load_cells else ""),
                *(table.number(row, column, *number) for column, number in cells),
                Badge("yes", "good") if one["within_90"] else Badge("no", "bad"),
                Badge("yes", "warn") if one["used_in_calibration"] else "no",
            ]
        )
    return table.without_empty_columns()


def method(content: Content, data: Data) -> Markup:
    """How bands and shares come about, and where from."""
    return parts(
        "Each of the {} samples is simulated on a packing (and flow) of its own: with the best "
        "values, with parameters drawn, and with effects drawn too ({} replicates in all). Two "
        "samples have the same draw and two packings. What such pairs have in common is due to "
        "what was drawn; what they differ in, to the packing (law of total variance: parameters "
        "before effects, effects given the parameters; Mara & Tarantola 2012, Reliab. Eng. Syst. "
        "Saf. 107, 115–121). Standard errors of shares: jackknife over pairs (Efron & Stein 1981, "
        "Ann. Stat. 9, 586–596). Unknowns are normal (the sd of s and the flow parameters in their "
        "logarithms), cut off at their bounds. What no fit knows of is in no band: an effect that "
        "is missing, an input declared wrong.",
        data.number("method", "", "samples", content.document["samples"]),
        data.number("method", "", "replicates", content.document["simulated_replicates"]),
    )
