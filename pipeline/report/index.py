"""The index page: what was run, at a glance, and what the experiments say together."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from pipeline.compare.comparison import SIDES
from pipeline.config.experiment import Experiment
from pipeline.files.atomic import read_json, write_json, write_text
from pipeline.report.figures import BLUE, GREEN, MARKERS, ORANGE, Panel, panel_style
from pipeline.report.page import (
    Badge,
    Data,
    Figure,
    Link,
    Number,
    Table,
    decimals_of,
    parts,
    render,
)
from pipeline.report.results import THRESHOLD_SD, THRESHOLD_SHARE, Agreement, agreement
from pipeline.report.study import VERDICTS
from pipeline.validate.validation import CALIBRATED, DECLARED, REPRODUCED

NAMES_WIDTH = 2.2  # of the experiments' names beside a figure, inches
AGREES, DISAGREES = Badge("agrees", "good"), Badge("disagrees", "bad")
FITTED, NO_DATA = Badge("fitted", "note"), Badge("no data", "note")
OUTCOMES = (AGREES, FITTED, DISAGREES, NO_DATA)
RUNS = {CALIBRATED: "calibrated", DECLARED: "as declared"}


@dataclass(frozen=True)
class Entry:
    """One experiment on the index page; `link` is its report, relative to the page."""

    experiment: Experiment
    calibration: dict[str, Any]
    validation: dict[str, Any]
    link: str

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.experiment.name

    @property
    def label(self) -> str:
        """What its data are; empty without any."""
        return self.experiment.data_label if self.validation["readings"] else ""

    @property
    def published(self) -> dict[str, Any]:
        """What was published beside it, empty if nothing."""
        return self.validation["published"] or {}

    @property
    def is_calibrated(self) -> bool:
        """Whether any parameter was fitted."""
        return any(entry["calibrated"] for entry in self.calibration["parameters"].values())

    def agreement(self, run: str) -> Agreement | None:
        """Agreement of a run with the readings; None for a calibration that was not made."""
        if run == CALIBRATED and not self.is_calibrated:
            return None
        return agreement(self.validation, run)

    @property
    def is_fitted(self) -> bool:
        """Whether every value was used in the calibration."""
        return all(reading["used_in_calibration"] for reading in self.validation["readings"])

    def full_base(self) -> dict[str, Any] | None:
        """The reading of mean vertical stress on the whole base with the model full."""
        height = self.experiment.geometry.height
        for reading in self.validation["readings"]:
            whole = reading["load_cell"] is None and reading["fill_height"] in (None, height)
            if reading["quantity"] == "vertical_stress" and whole:
                return reading
        return None


def write_index(
    experiments: Iterable[Experiment],
    calibrations: Iterable[str | Path],
    validations: Iterable[str | Path],
    reports: Iterable[str | Path],
    flow_law: str | Path,
    page: str | Path,
    numbers: str | Path,
    studies: Mapping[str, str | Path] | None = None,
    comparisons: Iterable[str | Path] = (),
    blind_scores: str | Path | None = None,
) -> None:
    """Write the index page and `index.json`, which holds every number on it.

    The first four are in the same order: experiments, their `calibration.json`,
    `validation.json` and `report.html`. `flow_law` is the figure of the flow kernel's own check,
    with its numbers beside it; the page shows it. `studies` are their `closed_loop.json` by name,
    each beside its `report.html`; `comparisons` are `comparison.json`, likewise, and
    `blind_scores` is the `scores.json` of a blind benchmark, where one was run.
    """
    folder = Path(page).parent
    entries = [
        Entry(
            experiment,
            read_json(calibration),
            read_json(validation),
            _link(report, folder),
        )
        for experiment, calibration, validation, report in zip(
            experiments, calibrations, validations, reports, strict=True
        )
    ]
    closed = [
        read_json(path) | {"link": _link(Path(path).with_name("report.html"), folder)}
        for path in (studies or {}).values()
    ]
    compared = [
        read_json(path) | {"link": _link(Path(path).with_name("report.html"), folder)}
        for path in comparisons
    ]
    blind = None
    if blind_scores is not None:
        link = _link(Path(blind_scores).with_name("report.html"), folder)
        blind = blind_summary(read_json(blind_scores) | {"link": link})
    data = Data()
    with panel_style():
        html = index_page(
            entries, closed, compared, blind, data, Path(numbers).name, _link(flow_law, folder)
        )
    write_json(
        numbers,
        {
            "schema_version": "1.0",
            "experiments": [summary(entry) for entry in entries],
            "studies": [study_summary(found) for found in closed],
            "comparisons": [comparison_summary(found) for found in compared],
            "blind_benchmark": blind,
            "data": data.to_records(),
        },
    )
    write_text(page, html)


def summary(entry: Entry) -> dict[str, Any]:
    """What the page says of an experiment, for scripts."""
    runs = {run: entry.agreement(run) for run in RUNS}
    return {
        "experiment": entry.name,
        "title": entry.experiment.title,
        "kind": "draw" if entry.experiment.is_draw else "static",
        "data_label": entry.label or None,
        "report": entry.link,
        "agreement": {
            run: found
            and {
                "values": found.count,
                "within": found.within,
                "largest_error_in_sd": found.worst,
                "agrees": found.agrees,
            }
            for run, found in runs.items()
        },
        "published_mean_reproduced": entry.published.get("mean_reproduced"),
    }


def study_summary(found: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says of a study, for scripts."""
    return {
        "study": found["study"],
        "title": found["title"],
        "data_labels": found["data_labels"],
        "report": found["link"],
        "verdict": found["verdict"],
        "effects_added": _names_added(found),
        "held_out": found["error"]["held_out"],
    }


def comparison_summary(found: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says of a comparison, for scripts."""
    return {
        "comparison": found["comparison"],
        "title": found["title"],
        "experiments": [one["experiment"] for one in found["experiments"]],
        "report": found["link"],
        "threshold_mpa": found["threshold_mpa"],
    }


def _names_added(found: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys(entry["name"] for entry in found["effects_added"]))


def _link(path: str | Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def blind_summary(scores: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says of the blind benchmark, for scripts."""
    bars = [bar["met"] for bar in scores["bars"] if bar["met"] is not None]
    return {
        "report": scores["link"],
        "commit": scores["commit"],
        "date": scores["date"],
        "worlds": scores["worlds"],
        "bars": len(bars),
        "bars_met": sum(bars),
        "is_scored": scores["seed_is_the_commits"],
    }


def blind_sentence(blind: Mapping[str, Any], data: Data) -> Markup:
    """What was run, with a link to its page."""

    def count(name: str) -> Number:
        return data.number("blind benchmark", "", name, blind[name], 0)

    return parts(
        "The loop on data with undeclared effects in them: {}, {} worlds, {} of {} bars met "
        "(commit {}, {}{}).",
        Link("the blind benchmark", blind["report"]),
        count("worlds"),
        count("bars_met"),
        count("bars"),
        blind["commit"][:7],
        blind["date"],
        "" if blind["is_scored"] else "; tuning worlds, which score nothing",
    )


def index_page(
    entries: Sequence[Entry],
    studies: Sequence[Mapping[str, Any]],
    comparisons: Sequence[Mapping[str, Any]],
    blind: Mapping[str, Any] | None,
    data: Data,
    numbers: str,
    flow_law: str,
) -> str:
    """HTML of the index.

    `studies` and `comparisons` are their closed_loop.json and comparison.json with a `link` to
    their page; `blind` is what `blind_summary` makes of a benchmark.
    `numbers` and `flow_law` are links from it to these files.
    """
    static = [entry for entry in entries if not entry.experiment.is_draw]
    draw = [entry for entry in entries if entry.experiment.is_draw]
    own_E = [e for e in entries if not e.experiment.is_draw or "E" in e.experiment.calibrate]
    figures = [
        transmission_figure(own_E, data),
        published_figure(entries, data),
        error_figure(entries, data),
    ]
    return render(
        "index.html.j2",
        overview=overview(entries, data),
        glances=glances(entries, studies, data),
        threshold=parts(
            "A model agrees with its data if at least {} % of the values lie within {} standard "
            "deviations (sd) of the data. Fitted: it agrees, but every value was used in the "
            "calibration, so none tests it.",
            data.number("threshold", "", "least share of values", 100 * THRESHOLD_SHARE, 0, "%"),
            data.number("threshold", "", "threshold", THRESHOLD_SD, 0, "sd"),
        ),
        static=static_table(static, data) if static else None,
        draw=draw_table(draw, data) if draw else None,
        studies=study_table(studies, data) if studies else None,
        comparisons=comparison_table(comparisons, data) if comparisons else None,
        blind=blind_sentence(blind, data) if blind else None,
        transmission=transmission_table(own_E, data) if own_E else None,
        figures=[figure for figure in figures if figure],
        numbers=numbers,
        flow_law=flow_law,
    )


def overview(entries: Sequence[Entry], data: Data):
    """The page's first sentence."""
    measured = [entry for entry in entries if entry.label]
    sentence = [
        parts(
            "{} experiments, {} of them with data.",
            data.number("overview", "", "experiments", len(entries)),
            data.number("overview", "", "experiments with data", len(measured)),
        )
    ]
    for run, words in RUNS.items():
        found = [a for a in (entry.agreement(run) for entry in measured) if a]
        if found:
            sentence.append(
                parts(
                    "With {} the model agrees with the data of {} of {} experiments.",
                    "calibrated parameters" if run == CALIBRATED else "parameters as declared",
                    data.number("overview", words, "agree", sum(a.agrees for a in found)),
                    data.number("overview", words, "compared", len(found)),
                )
            )
    compared = [e.published["mean_reproduced"] for e in entries if "mean_reproduced" in e.published]
    if compared:
        sentence.append(
            parts(
                "The published inputs reproduce {} of {} published simulated means to {} %.",
                data.number("overview", "published", "reproduced", sum(compared)),
                data.number("overview", "published", "compared", len(compared)),
                data.number("overview", "published", "within", 100 * REPRODUCED, 0, "%"),
            )
        )
    return sentence


@dataclass(frozen=True)
class Glance:
    """Pages of one kind that ended alike: how many, and links to them."""

    what: str
    outcome: Badge | str
    count: Number
    links: list[Link]


def glances(
    entries: Sequence[Entry], studies: Sequence[Mapping[str, Any]], data: Data
) -> list[Glance]:
    """Experiments by whether they agree with their data, studies by their verdict."""
    groups: dict[tuple[str, Badge], list[Link]] = {}
    for outcome in OUTCOMES:
        groups["experiments", outcome] = []
    for entry in entries:
        groups["experiments", outcome_of(entry)].append(Link(entry.name, entry.link))
    for found in studies:
        outcome = VERDICTS[found["verdict"]]
        groups.setdefault(("studies", outcome), []).append(Link(found["study"], found["link"]))
    return [
        Glance(what, outcome, data.number("glance", what, outcome.text, len(links), 0), links)
        for (what, outcome), links in groups.items()
        if links
    ]


def outcome_of(entry: Entry) -> Badge:
    """One of `OUTCOMES`: of the calibrated run, or as declared where none was calibrated."""
    if not entry.label:
        return NO_DATA
    run = CALIBRATED if entry.is_calibrated else DECLARED
    return _verdict(entry.agreement(run), entry.is_fitted and run == CALIBRATED)


def static_table(entries: Sequence[Entry], data: Data) -> Table:
    """Static experiments: stress on the whole base with the model full."""
    stress = "Mean stress on the full base (kPa)"
    table = Table(
        "static",
        "Static experiments. Stress on the whole base with the model full; the verdict counts "
        "every value of the experiment.",
        [
            "Experiment",
            "Data",
            "Values",
            *(f"{stress}: {name}" for name in ("data", *RUNS.values(), "published sim.")),
            *_run_columns("Largest error (sd)"),
            *_run_columns("Verdict"),
            "Published mean reproduced",
        ],
        data,
    )
    for entry in entries:
        reading = entry.full_base() or {}
        shown = [reading.get("measured")]
        shown += [reading.get(run, {}).get("mean") for run in RUNS]
        if DECLARED not in reading:
            shown[1], shown[2] = None, shown[1]
        published = entry.published.get("vertical_stress_mean")
        places = decimals_of(next((v for v in (*shown, published) if v is not None), 0.0))
        _add_row(table, entry, [*shown, published], places)
        reproduced = entry.published.get("mean_reproduced")
        words = {True: Badge("yes", "good"), False: Badge("no", "bad")}
        table.rows[-1].append(words.get(reproduced, ""))
    return table.without_empty_columns()


def draw_table(entries: Sequence[Entry], data: Data) -> Table:
    """Draw experiments: mean absolute error of vertical stress."""
    error = "Mean absolute error of vertical stress (kPa)"
    table = Table(
        "draw",
        "Draw experiments. Mean absolute error over all readings of vertical stress; the verdict "
        "counts every value of the experiment. Published errors are quoted: their readings are "
        "not public.",
        [
            "Experiment",
            "Data",
            "Values",
            *(f"{error}: {name}" for name in (*RUNS.values(), "published")),
            *_run_columns("Largest error (sd)"),
            *_run_columns("Verdict"),
            "Published signs that hold",
        ],
        data,
    )
    for entry in entries:
        overall = entry.validation["overall"]
        errors = [
            overall.get(run, {}).get("vertical_stress", {}).get("mean_absolute_error")
            for run in RUNS
        ]
        if DECLARED not in overall:
            errors.reverse()
        _add_row(table, entry, [*errors, entry.published.get("mean_absolute_error")], 2)
        facts = entry.published.get("facts") or []
        held = table.number(entry.name, "signs that hold", sum(fact["holds"] for fact in facts))
        of = table.number(entry.name, "published signs", len(facts))
        table.rows[-1].append([held, "of", of] if facts else "")
    return table.without_empty_columns()


def study_table(studies: Sequence[Mapping[str, Any]], data: Data) -> Table:
    """Studies: what was found and added, and the held-out error before and after."""
    kpa, logs = "Held-out error, rms (kPa)", "Held-out error, rms of logarithms"
    table = Table(
        "studies",
        "Studies close the loop: they find what the model lacks, add it, and compare the error "
        "before and after on data that had no part in the fit.",
        [
            "Study",
            "Title",
            "Data",
            "Verdict",
            "Added",
            f"{kpa}: before",
            f"{kpa}: after",
            f"{logs}: before",
            f"{logs}: after",
            "Values",
        ],
        data,
    )
    for found in studies:
        before, after = (found["error"]["held_out"][when] for when in ("before", "after"))
        numbers = [(one[key], None) for key in ("rms_kpa", "rms_log") for one in (before, after)]
        numbers.append((after["n"], 0))
        cells = zip(table.columns[5:], numbers, strict=True)
        table.rows.append(
            [
                Link(found["study"], found["link"]),
                found["title"],
                ", ".join(found["data_labels"]),
                VERDICTS[found["verdict"]],
                ", ".join(_names_added(found)) or "nothing",
                *(table.number(found["study"], column, *number) for column, number in cells),
            ]
        )
    return table.without_empty_columns()


def comparison_table(comparisons: Sequence[Mapping[str, Any]], data: Data) -> Table:
    """Comparisons of two experiments: the threshold, and the base's peak and time above it."""
    table = Table(
        "comparisons",
        "Two draw experiments beside each other, simulated: mean stress on the whole base, its "
        "peak among the readings and the share of time (as mass drawn) above a threshold.",
        [
            "Comparison",
            "Title",
            "Experiments",
            "Threshold (MPa)",
            *(f"{head}: {side}" for head in ("Peak (MPa)", "Above (%)") for side in SIDES),
        ],
        data,
    )
    for found in comparisons:
        name, base = found["comparison"], found["base"]
        numbers = [(found["threshold_mpa"], None)]
        numbers += [(base[side]["peak_mpa"], None) for side in SIDES]
        numbers += [(100 * base[side]["share_above"], 1) for side in SIDES]
        cells = zip(table.columns[3:], numbers, strict=True)
        table.rows.append(
            [
                Link(name, found["link"]),
                found["title"],
                " and ".join(one["experiment"] for one in found["experiments"]),
                *(table.number(name, column, *number) for column, number in cells),
            ]
        )
    return table


def _run_columns(head: str) -> list[str]:
    return [f"{head}: {words}" for words in RUNS.values()]


def _add_row(table: Table, entry: Entry, values: Sequence[float | None], places: int) -> None:
    """Add an experiment: link, data, number of values, `values`, largest errors, verdicts."""
    found = [entry.agreement(run) for run in RUNS]
    numbers = [(len(entry.validation["readings"]), 0)]
    numbers += [(value, places) for value in values]
    numbers += [(a and a.worst, 2) for a in found]
    cells = zip(table.columns[2:], numbers, strict=False)
    verdicts = [
        _verdict(a, entry.is_fitted and run == CALIBRATED)
        for run, a in zip(RUNS, found, strict=True)
    ]
    table.rows.append(
        [
            Link(entry.name, entry.link),
            entry.label or "none",
            *(table.number(entry.name, column, *number) for column, number in cells),
            *verdicts,
        ]
    )


def _verdict(found: Agreement | None, is_fitted: bool) -> Badge | str:
    if found is None:
        return ""
    if not found.agrees:
        return DISAGREES
    return FITTED if is_fitted else AGREES


def transmission_table(entries: Sequence[Entry], data: Data) -> Table:
    """E as declared and as calibrated, with what it means for the column."""
    table = Table(
        "transmission",
        "The share E of its load that a cell at rest passes on belongs to its cell size; "
        "ℓ = c / (1 − E) is the length over which load is shed, and K the stress ratio that "
        "Janssen's law asks for with this ℓ.",
        [
            "Experiment",
            "Cell size c (m)",
            "R_h·H (m²)",
            "Wall friction angle (°)",
            "E: as declared",
            "E: calibrated",
            "E, 90 % interval: from",
            "E, 90 % interval: to",
            "ℓ (m)",
            "K",
        ],
        data,
    )
    for entry in entries:
        E, derived = entry.calibration["parameters"]["E"], entry.calibration["derived"]
        walls = entry.experiment.walls
        numbers = (
            entry.experiment.geometry.cell_size,
            _size(entry),
            walls and walls.friction_angle,
            E["start"],
            E["value"] if E["calibrated"] else None,
            *(E["interval_90"] or (None, None)),
            derived["attenuation_length"]["value"],
            derived.get("janssen_K", {}).get("value"),
        )
        table.add_numbers(entry.name, [(number, None) for number in numbers])
        table.rows[-1][0] = Link(entry.name, entry.link)
    return table.without_empty_columns()


def _size(entry: Entry) -> float:
    """R_h·H, m²: hydraulic radius of the base times the height of the model."""
    radius = entry.calibration["derived"]["hydraulic_radius"]["value"]
    return radius * entry.experiment.geometry.height


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
                np.array([_size(entries[j]) for j in at]),
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
    panel = Panel(
        data,
        "published",
        "",
        "ours / published (–)",
        "",
        f"Ratio of our simulated mean to the published one; {worst[1]} is off by {worst[0]:.0%}.",
        (2.5, 0.3 + 0.27 * len(names)),
        left=NAMES_WIDTH,
    )
    panel.rows(names)
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
    panel = Panel(
        data,
        "errors",
        "",
        "model less value (sd of the value)",
        "",
        "Errors of each experiment in standard deviations of its data.",
        (2.5, 0.3 + 0.27 * len(names)),
        left=NAMES_WIDTH,
    )
    panel.rows(names)
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
