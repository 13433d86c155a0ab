"""The page of one study: what the closed loop found, what it added, and the errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr
from markupsafe import Markup

from pipeline.config.study import Study
from pipeline.files.atomic import read_json, write_text
from pipeline.loop import SURE
from pipeline.report.figures import panel_style
from pipeline.report.page import Data, Link, Table, parts, render
from pipeline.report.study_errors import (
    added_effects,
    error_table,
    fold_table,
    improved_table,
    parameter_table,
    ratio_sentence,
    sharing_table,
)
from pipeline.report.study_evidence import (
    certificate_tables,
    gate_table,
    hypothesis_tables,
    mimic_table,
    noise_sentences,
    outcome_table,
    rule_table,
)
from pipeline.report.study_figures import (
    fold_figure,
    held_out_figure,
    posterior_figures,
    residual_figures,
)
from pipeline.report.study_words import (
    AT_BOUND,
    VERDICTS,
    each_added,
    predicts_worse,
    title_of,
)

FINDINGS = {  # by the kind of an effect: before its name, and after it
    "physics": ("The model lacks", ""),
    "input": ("An input is not as declared:", ""),
    "sensor": ("A sensor is at fault:", ", which corrects the data and never the ground"),
    "rule": ("The model lacks what no effect of the catalogue stands for:", ""),
}


def write_study_report(
    study: Study, paths: Mapping[str, str | Path], page: str | Path, data: str | Path
) -> None:
    """Write a study's page and the data that it shows.

    Parameters
    ----------
    paths : files of results by name, all beside the page: residual (netCDF), attribution,
        closed_loop, predictions and, where the improved model was run, improved (JSON)
    page, data : the HTML page and the CSV with the columns of `page.COLUMNS`
    """
    numbers = Data()
    names = [Path(path).name for path in (data, *paths.values())]
    improved = read_json(paths["improved"])["experiments"] if "improved" in paths else {}
    with (
        xr.open_dataset(paths["residual"], engine="netcdf4", decode_times=False) as residual,
        panel_style(),
    ):
        html = study_page(
            study,
            read_json(paths["closed_loop"]),
            read_json(paths["predictions"])["rows"],
            improved,
            residual,
            numbers,
            names,
        )
    write_text(data, numbers.to_csv())
    write_text(page, html)


def study_page(
    study: Study,
    found: Mapping[str, Any],
    predictions: Sequence[Mapping[str, Any]],
    improved: Mapping[str, Any],
    residual: xr.Dataset,
    data: Data,
    file_names: Iterable[str],
) -> str:
    """HTML of the page; `found` is closed_loop.json, `file_names` are linked at its bottom, the
    first has its data.
    """
    label, names = " and ".join(found["data_labels"]), list(file_names)
    return render(
        "study.html.j2",
        study=study,
        labels=found["data_labels"],
        badge=VERDICTS[found["verdict"]],
        verdict=[*verdict(found, data), *error_sentences(found, data)],
        experiments=[Link(n, f"../../experiments/{n}/report.html") for n in study.experiments],
        residual_figures=residual_figures(residual, label, data),
        certificate=certificate_tables(found, data),
        gate=gate_table(found, data),
        noise=noise_sentences(found["noise_floor"], data),
        posteriors=posterior_figures(found, data),
        outcomes=outcome_table(found, data),
        hypotheses=hypothesis_tables(found, data),
        rules=rule_table(found, data),
        added=added_effects(found, data),
        sharing=sharing_table(found, data),
        errors=error_table(found, data),
        ratio=ratio_sentence(found["error"]["held_out"], data),
        held_out_is=found["held_out_is"],
        folds=fold_table(found, data),
        held_out=[
            figure
            for figure in (
                held_out_figure(predictions, label, data),
                fold_figure(found["folds"], data),
            )
            if figure
        ],
        parameters=parameter_table(found, data),
        still_open=open_sentence(found, data),
        mimics=mimic_table(found, data),
        next_measurement=next_table(found, data),
        improved=improved_table(improved, data),
        provenance=provenance_table(found, data),
        files=names,
        numbers=names[0],
        versions=", ".join(f"{name} {version}" for name, version in found["versions"].items()),
    )


# ---------------------------------------------------------------------------------------------
# the head


def verdict(found: Mapping[str, Any], data: Data) -> list[Markup]:
    """The answer in plain words, with the numbers that give it."""
    first, last = found["gate"][0], found["gate"][-1]
    if found["verdict"] == "no_effect_detectable":
        return [
            parts(
                "These readings show <strong>nothing that the model lacks</strong>: {}. What they "
                "could have shown, and what not, stands in the certificate.",
                _evidence(first, data),
            )
        ]
    if found["verdict"] == "unexplained":
        return [
            parts(
                "<strong>Something is missing</strong>: {}. No candidate and no local rule "
                "explains it.",
                _evidence(last, data),
            )
        ]
    sentences = []
    for entries in each_added(found):
        one, row = entries[0], f"round {entries[0]['round']}"
        before, after = FINDINGS[one["kind"]]
        sentences.append(
            parts(
                "{} <strong>{}</strong>{}. Without it the test gives {}; among all that could be "
                "missing its probability is {} (from {} on one name is added).",
                before,
                title_of(entries, found),
                after,
                _evidence(found["gate"][one["round"] - 1], data),
                data.number("verdict", row, "probability", one["probability"], 3),
                data.number("verdict", "", "probability from which one name is added", SURE, 1),
            )
        )
        if any(p["at_bound"] for entry in entries for p in entry["parameters"].values()):
            sentences[-1] += f" Its amplitude lies {AT_BOUND}."
    if not last["rejected"]:
        sentences.append(parts("With it nothing more is detectable: {}.", _evidence(last, data)))
        return sentences
    sentences.append(
        parts(
            "<strong>Something is {}missing</strong>: {}.{}",
            "still " if sentences else "",
            _evidence(last, data),
            _candidates(found["candidate_set"]),
        )
    )
    if found["effects_added"] and last["round"] > found["settings"]["max_effects"]:
        sentences[-1] += " The study allows no more effects."
    return sentences


def _evidence(gate: Mapping[str, Any], data: Data) -> Markup:
    row = f"round {gate['round']}"
    return parts(
        "p = {} {} α = {}",
        data.number("verdict", row, "p", gate["p_value"]),
        "≤" if gate["rejected"] else ">",
        data.number("verdict", row, "alpha", gate["alpha"]),
    )


def _candidates(names: Sequence[str]) -> str:
    if len(names) > 1:
        return f" The readings cannot tell which of these it is: {', '.join(names)}."
    return f" It is most likely {names[0]}." if names else ""


def error_sentences(found: Mapping[str, Any], data: Data) -> list[Markup]:
    """Error before and after in a line each, held-out data first."""
    sentences = []
    for part, words in (
        ("held_out", "on what was held out"),
        ("calibration", "on the data of the fit"),
    ):
        error = found["error"][part]
        before, after = error["before"], error["after"]
        if not before["n"]:
            continue
        key, unit = ("rms_kpa", " kPa") if before["rms_kpa"] is not None else ("rms_log", "")
        sentences.append(
            parts(
                "Error (rms{}) {}: <strong>{}{} before, {}{} after</strong>, over {} values{}.",
                "" if unit else " of logarithms",
                words,
                data.number("verdict", part, "error before", before[key], unit=unit.strip()),
                unit,
                data.number("verdict", part, "error after", after[key], unit=unit.strip()),
                unit,
                data.number("verdict", part, "values", after["n"]),
                f" ({found['held_out_is']})" if part == "held_out" else "",
            )
        )
        if part == "held_out" and predicts_worse(found):
            ratio = data.number("verdict", part, "error ratio", error["ratio"], 2)
            sentences.append(
                parts(
                    "<strong>What was added predicts them worse</strong> than the model without "
                    "it: {} times the error (rms of logarithms). Do not predict with it.",
                    ratio,
                )
            )
    if not found["error"]["held_out"]["before"]["n"]:
        sentences.insert(0, Markup("No held-out value could be predicted: nothing tests it."))
    return sentences


# ---------------------------------------------------------------------------------------------
# what is open, and what to do next


def open_sentence(found: Mapping[str, Any], data: Data) -> Markup | str:
    """Which names could not be told apart."""
    names = found["candidate_set"]
    if not names:
        return "No question is open: there is no set of names left to tell apart."
    return parts(
        "The smallest set of names that holds {} % of the probability: <strong>{}</strong>.",
        data.number("open", "", "share of the probability", 100 * SURE, 0, "%"),
        ", ".join(names),
    )


def next_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """Additions ranked by what they are worth; None where none helps."""
    if not found["next_measurement"]:
        return None
    if len(found["candidate_set"]) > 1 or found["verdict"] == "ambiguous":
        gain = (
            "chance that the right one of the names still open is then sure, amplitudes as the "
            "readings so far leave them"
        )
    else:
        gain = (
            "rise of the chance of finding an effect of the catalogue, amplitudes averaged over "
            "what is usual"
        )
    table = Table(
        "next_measurement",
        f"What to measure next, best first. Expected gain: {gain}.",
        ["Rank", "What", "Where", "Expected gain"],
        data,
    )
    for rank, one in enumerate(found["next_measurement"], start=1):
        row = f"{one['what']}, {one['where']}"
        table.rows.append(
            [
                table.number(row, "rank", rank),
                one["what"],
                one["where"],
                table.number(row, "expected gain", one["expected_gain"], 3),
            ]
        )
    return table


def provenance_table(found: Mapping[str, Any], data: Data) -> Table:
    """Seeds, versions, replicates and the study's settings."""
    table = Table("provenance", "What the study ran with.", ["Setting", "Value"], data)
    rows = [
        *_flat("replicates", found["replicate_count"]),
        *_flat("version", found["versions"]),
        *_flat("seed", found["seeds"]),
        *_flat("", found["settings"]),
    ]
    for name, value in rows:
        if isinstance(value, int | float):
            decimals = 0 if isinstance(value, int) else None
            value = [table.number(name, "value", value, decimals)]
        table.rows.append([name, value])
    return table


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """(name, text or number) of everything in a document."""
    if isinstance(value, Mapping) and value:
        for key, part in value.items():
            yield from _flat(f"{name}: {key}" if name else key, part)
    elif isinstance(value, list) and any(isinstance(part, Mapping) for part in value):
        for number, part in enumerate(value, start=1):
            yield from _flat(f"{name} {number}", part)
    elif isinstance(value, list):
        yield name, ", ".join(map(str, value)) or "none"
    elif isinstance(value, bool):
        yield name, "yes" if value else "no"
    else:
        yield name, value if isinstance(value, int | float) else value or "none"
