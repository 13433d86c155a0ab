"""The page of one experiment, and its data in long format."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from pipeline.config.experiment import Experiment
from pipeline.files.atomic import write_text
from pipeline.report.draw_figures import draw_figures, draw_tables
from pipeline.report.draw_player import draw_player
from pipeline.report.experiment_tables import (
    area_table,
    fact_table,
    overall_table,
    parameter_table,
    published_table,
    reading_table,
    schedule_table,
    setup_table,
)
from pipeline.report.figures import panel_style
from pipeline.report.page import Data, parts, render, resource
from pipeline.report.region_figures import grade_table, region_figures, region_table
from pipeline.report.results import THRESHOLD_SD, THRESHOLD_SHARE, Results, agreement, open_results
from pipeline.report.stress_figures import stress_figures
from pipeline.validate.validation import CALIBRATED, DECLARED


def write_report(
    experiment: Experiment,
    inputs: Mapping[str, str | Path],
    report: str | Path,
    data_file: str | Path,
) -> None:
    """Write an experiment's page and the data that it shows.

    Parameters
    ----------
    inputs : files of results by name: block_model, calibration, replicates, fields, statistics,
        base_stress, validation, and grade where it was made; all beside the page
    report, data_file : the HTML page and the CSV with the columns of `page.COLUMNS`
    """
    data = Data()
    with open_results(experiment, inputs) as results, panel_style():
        names = [Path(path).name for path in (data_file, *inputs.values())]
        page = report_page(results, data, names)
    write_text(data_file, data.to_csv())
    write_text(report, page)


def report_page(results: Results, data: Data, file_names: Iterable[str]) -> str:
    """HTML of the page; `file_names` are linked at its bottom, the first has its data."""
    experiment, names = results.experiment, list(file_names)
    is_draw = experiment.is_draw
    rest = stress_figures(results, data)
    player = draw_player(results, data) if is_draw else None
    draw = draw_figures(results, data) if is_draw else []
    tables = {
        "parameters": parameter_table(results, data),
        "readings": reading_table(results, data),
        "overall": overall_table(results, data),
        "published": published_table(results, data),
        "facts": fact_table(results, data),
        "setup": setup_table(results, data),
        "regions": region_table(results, data),
        "grade": grade_table(results, data),
        "areas": area_table(results, data),
        "schedule": schedule_table(results, data),
    }
    attributes = results.replicates.attrs
    return render(
        "experiment.html.j2",
        experiment=experiment,
        kind="draw" if is_draw else "static",
        label=results.label if experiment.measured else "",
        verdict=verdict(results, data),
        threshold=threshold(results, data),
        notes=[*results.lattice.notes],
        statements=results.validation["statements"],
        tables=tables,
        draw_tables=draw_tables(results, data) if is_draw else [],
        player=player,
        script=resource("player.js"),
        draw_figures=draw,
        rest_figures=rest,
        files=names,
        numbers=names[0],
        region_figures=region_figures(results, data),
        provenance={
            name: attributes.get(name, "unknown")
            for name in ("source", "git_revision", "config_sha256", "root_seed", "references")
        },
    )


def verdict(results: Results, data: Data) -> list[Markup]:
    """The answer in a few sentences: how many readings agree, with and without calibration."""
    validation = results.validation
    fitted = agreement(validation, CALIBRATED)
    if fitted is None:
        sentences = ["No data to compare with: a simulation, not validated on this experiment."]
        return sentences + _facts_that_hold(validation, data)
    readings = validation["readings"]
    used = sum(reading["used_in_calibration"] for reading in readings)
    runs = {"calibrated": fitted} if results.is_calibrated else {}
    runs["as declared"] = agreement(validation, DECLARED)
    published = results.experiment.published is not None
    sentences = []
    for run, found in runs.items():
        words = {
            "calibrated": "With the calibrated parameters",
            "as declared": f"With the {'published' if published else 'declared'} parameters",
        }[run]
        sentences.append(
            parts(
                "{} the model <strong>{}</strong> with the {} data: {} of {} {} within {} sd, "
                "the largest difference is {} sd.",
                words,
                "agrees" if found.agrees else "does not agree",
                results.label,
                data.number("verdict", run, "values within", found.within),
                data.number("verdict", run, "values", found.count),
                "value lies" if found.count == 1 else "values lie",
                data.number("verdict", "", "threshold", THRESHOLD_SD, 0, "sd"),
                data.number("verdict", run, "largest difference", found.worst, 2, "sd"),
            )
        )
    if used == len(readings):
        sentences.append(
            Markup(
                "Every value was used in the calibration: they show what the model can reach, "
                "and none of them tests it."
            )
        )
    elif used:
        sentences.append(
            parts(
                "{} of the values were used in the calibration; the others test it.",
                data.number("verdict", "", "used in calibration", used),
            )
        )
    comparison = validation["published"] or {}
    if "mean_reproduced" in comparison:
        sentences.append(
            parts(
                "The published simulated mean is <strong>{}</strong> with the published inputs.",
                "reproduced" if comparison["mean_reproduced"] else "not reproduced",
            )
        )
    return sentences + _facts_that_hold(validation, data)


def _facts_that_hold(validation: Mapping[str, Any], data: Data) -> list[Markup]:
    facts = (validation["published"] or {}).get("facts")
    if not facts:
        return []
    return [
        parts(
            "{} of {} published signs and orders of σᵥ/σᵥ₀ hold.",
            data.number("verdict", "published", "facts that hold", sum(f["holds"] for f in facts)),
            data.number("verdict", "published", "facts", len(facts)),
        )
    ]


def threshold(results: Results, data: Data) -> Markup | None:
    """What the verdict means by "agrees"; None where nothing was measured."""
    if not results.validation["readings"]:
        return None
    return parts(
        "Agrees: at least {} % of the values lie within {} sd. sd is the standard deviation of "
        "the value as given, with the packings' scatter where the value holds a single packing.",
        data.number("verdict", "", "least share of values", 100 * THRESHOLD_SHARE, 0, "%"),
        data.number("verdict", "", "threshold", THRESHOLD_SD, 0, "sd"),
    )
