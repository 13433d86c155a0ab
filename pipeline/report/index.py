"""The index page: what was run, at a glance, and what the experiments say together."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from pipeline.config.experiment import Experiment
from pipeline.files.atomic import read_json, write_json, write_text
from pipeline.report.figures import panel_style
from pipeline.report.index_entries import NO_DATA, OUTCOMES, RUNS, Entry, verdict_of
from pipeline.report.index_figures import error_figure, published_figure, transmission_figure
from pipeline.report.index_tables import (
    comparison_table,
    draw_table,
    static_table,
    study_table,
    transmission_table,
)
from pipeline.report.page import Badge, Data, Link, Number, parts, render
from pipeline.report.results import THRESHOLD_SD, THRESHOLD_SHARE
from pipeline.report.study_words import VERDICTS, names_added
from pipeline.validate.validation import CALIBRATED, DECLARED, REPRODUCED


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
        "effects_added": names_added(found),
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

    words: str
    outcome: Badge | str
    count: Number
    links: list[Link]


def glances(
    entries: Sequence[Entry], studies: Sequence[Mapping[str, Any]], data: Data
) -> list[Glance]:
    """Experiments by whether they agree with their data, studies by their verdict."""
    plural = {"experiment": "experiments", "study": "studies"}
    groups: dict[tuple[str, Badge], list[Link]] = {}
    for outcome in OUTCOMES:
        groups["experiment", outcome] = []
    for entry in entries:
        groups["experiment", outcome_of(entry)].append(Link(entry.name, entry.link))
    for found in studies:
        outcome = VERDICTS[found["verdict"]]
        groups.setdefault(("study", outcome), []).append(Link(found["study"], found["link"]))
    return [
        Glance(
            what if len(links) == 1 else plural[what],
            outcome,
            data.number("glance", what, outcome.text, len(links), 0),
            links,
        )
        for (what, outcome), links in groups.items()
        if links
    ]


def outcome_of(entry: Entry) -> Badge:
    """One of `OUTCOMES`: of the calibrated run, or as declared where none was calibrated."""
    if not entry.label:
        return NO_DATA
    run = CALIBRATED if entry.is_calibrated else DECLARED
    return verdict_of(entry.agreement(run), entry.is_fitted and run == CALIBRATED)
