"""The page of one study: what the closed loop found, what it added, and the errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import xarray as xr
from markupsafe import Markup

from pipeline.config.study import Study
from pipeline.effects import effects
from pipeline.files.atomic import read_json, write_text
from pipeline.loop.attribution import SURE
from pipeline.report.figures import panel_style
from pipeline.report.page import Badge, Data, Link, Table, decimals_of, parts, render
from pipeline.report.study_figures import (
    fold_figure,
    held_out_figure,
    posterior_figures,
    residual_figures,
)

VERDICTS = {
    "no_effect_detectable": Badge("no effect detectable", "good"),
    "effect": Badge("effect found", "good"),
    "ambiguous": Badge("ambiguous", "warn"),
    "unknown_effect": Badge("unknown effect", "warn"),
    "unexplained": Badge("unexplained", "bad"),
}
FINDINGS = {  # by the kind of an effect: before its name, and after it
    "physics": ("The model lacks", ""),
    "input": ("An input is not as declared:", ""),
    "sensor": ("A sensor is at fault:", ", which corrects the data and never the ground"),
    "rule": ("The model lacks what no effect of the catalogue stands for:", ""),
}
VARIANTS = {
    "before": "before: the calibrated baseline",
    "after": "after: with what was added",
    "recalibrated_only": "recalibrated only, nothing added",
    "gaussian_process": "Gaussian process on the residual",
}
MEASURES = {
    "n": "values",
    "rms_kpa": "rms (kPa)",
    "mean_absolute_kpa": "mean absolute (kPa)",
    "rms_log": "rms of logarithms",
}
FEW = 3  # look-alikes that stand unfolded


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
    for entries in _added(found):
        one, row = entries[0], f"round {entries[0]['round']}"
        before, after = FINDINGS[one["kind"]]
        sentences.append(
            parts(
                "{} <strong>{}</strong>{}. Without it the test gives {}; among all that could be "
                "missing its probability is {} (from {} on one name is added).",
                before,
                _title(entries, found),
                after,
                _evidence(found["gate"][one["round"] - 1], data),
                data.number("verdict", row, "probability", one["probability"], 3),
                data.number("verdict", "", "probability from which one name is added", SURE, 1),
            )
        )
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


def _added(found: Mapping[str, Any]) -> Iterator[list[Mapping[str, Any]]]:
    """Entries of each added effect, one for each key, in the order added."""
    for _, entries in groupby(found["effects_added"], key=lambda entry: entry["round"]):
        yield list(entries)


def _title(entries: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> str:
    """Name of an added effect with what it belongs to; a rule in words."""
    one = entries[0]
    for rule in found["local_rules"] if one["kind"] == "rule" else ():
        if all(rule[name] == choice for name, choice in one["options"].items()):
            return rule["words"]
    keys = ", ".join(entry["scope_key"] for entry in entries if entry["scope_key"])
    return f"{one['name']} ({keys})" if keys else one["name"]


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
    if not found["error"]["held_out"]["before"]["n"]:
        sentences.insert(0, Markup("No held-out value could be predicted: nothing tests it."))
    return sentences


# ---------------------------------------------------------------------------------------------
# certificate and gate


def label_of(entry: Mapping[str, Any]) -> str:
    """What tells a candidate from the others."""
    key = entry["scope_key"]
    label = entry.get("label") or entry["name"] + (f" [{key}]" if key is not None else "")
    return label if key is not None else f"{label} of {_scope(entry['scope'], key)}"


def listed(labels: Iterable[str]) -> str:
    """Labels of hypotheses, those of one name (and channel) together."""
    groups: dict[str, list[str]] = {}
    for label in labels:
        name, bracket, key = label.partition(" [")
        if name.startswith("local_rule "):
            name, bracket, key = label.rpartition(" ")
        groups.setdefault(name, [])
        if bracket:
            groups[name].append(key.removesuffix("]"))
    return "; ".join(f"{n} [{', '.join(keys)}]" if keys else n for n, keys in groups.items())


def certificate_tables(found: Mapping[str, Any], data: Data) -> list[Table]:
    """Every candidate: what would show of it, or why nothing would."""
    columns = [
        "Candidate",
        "Kind",
        "Surviving fraction",
        "Minimal detectable: amplitude",
        "Minimal detectable: unit",
        "Nearest mimic: name",
        "Nearest mimic: distance (sd)",
        "Look-alikes",
    ]
    testable = Table(
        "testable",
        "Candidates that these readings can test. Surviving fraction: part of the candidate's "
        "signal that calibration cannot explain. Minimal detectable: the amplitude that the test "
        "finds nine times in ten. Distance: how far an amplitude of usual size lies from what the "
        "nearest mimic can do. Look-alikes: what these readings see as the same.",
        columns,
        data,
    )
    untestable = Table(
        "untestable",
        "Candidates that these readings cannot test, and why. They are neither found nor excluded.",
        ["Candidate", "Why", *columns[1:]],
        data,
    )
    for entry in found["candidates"]:
        if entry["testable"]:
            testable.rows.append(_certificate_row(testable, [entry]))
    for entries in _alike(e for e in found["candidates"] if not e["testable"]):
        name, *cells = _certificate_row(untestable, entries)
        untestable.rows.append([name, entries[0]["why"], *cells])
    return [table.without_empty_columns() for table in (testable, untestable) if table.rows]


def _alike(entries: Iterable[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Entries in groups that differ in nothing but what they belong to."""
    groups: dict[str, list] = {}
    own = {"scope", "scope_key", "label", "probability", "score"}
    for entry in entries:
        key = repr([(name, value) for name, value in entry.items() if name not in own])
        groups.setdefault(key, []).append(entry)
    return list(groups.values())


def _certificate_row(table: Table, entries: Sequence[Mapping[str, Any]]) -> list[Any]:
    one = entries[0]
    name = listed(dict.fromkeys(map(label_of, entries)))
    detectable = one["minimal_detectable"]
    return [
        name,
        one["kind"],
        table.number(name, "surviving fraction", one["surviving_fraction"], 3),
        table.number(name, "minimal detectable amplitude", detectable, unit=one["unit"]),
        "" if detectable is None else _unit(one["unit"]),
        one["nearest_mimic"] or "",
        table.number(name, "distance to the nearest mimic", one["mimic_distance"], 2, "sd"),
        _look_alikes(table, name, one["alike"]),
    ]


def _look_alikes(table: Table, name: str, labels: Sequence[str]) -> str | Markup:
    if len(labels) <= FEW:
        return listed(labels)
    return parts(
        "<details><summary>{} others</summary>{}</details>",
        table.number(name, "look-alikes", len(labels)),
        listed(labels),
    )


def _scope(scope: str, key: str | None) -> str:
    if key is not None:
        return key
    return "the study" if scope == "study" else f"each {scope.replace('_', ' ')}"


def _unit(unit: str) -> str:
    return "–" if unit == "1" else unit


def gate_table(found: Mapping[str, Any], data: Data) -> Table:
    """The lack-of-fit test, round by round."""
    table = Table(
        "gate",
        "One test of all that could be missing in each round: the largest standardized score of "
        "all candidates and local rules against what chance gives, and the sum of squares of the "
        "whitened residual. α halves from round to round. Variance factors: what each part of the "
        "noise was multiplied with, estimated where enough degrees of freedom lie beyond all "
        "candidates.",
        [
            "Round",
            "Largest score: of",
            "Largest score: value",
            "Largest score: threshold",
            "Sum of squares: value",
            "Sum of squares: p",
            "Both: p",
            "Both: α",
            "Outcome",
            "Degrees of freedom beyond",
            "Variance factors: packing",
            "Variance factors: shared",
            "Variance factors: independent",
        ],
        data,
    )
    for gate in found["gate"]:
        row = f"round {gate['round']}"

        def cell(column, value, decimals=None, row=row):
            return table.number(row, column, value, decimals)

        factors = gate["noise_factors"]
        table.rows.append(
            [
                cell("round", gate["round"]),
                gate["largest"],
                cell("largest score", gate["statistic"], 2),
                cell("threshold", gate["threshold"], 2),
                cell("sum of squares", gate["sum_of_squares"], decimals_of(gate["sum_of_squares"])),
                cell("p of the sum of squares", gate["sum_of_squares_p_value"]),
                cell("p", gate["p_value"]),
                cell("alpha", gate["alpha"]),
                Badge("something is missing", "warn")
                if gate["rejected"]
                else Badge("nothing detectable", "good"),
                cell("degrees of freedom beyond", gate["degrees_of_freedom_beyond"]),
                *(cell(name, factors[name], 2) for name in ("scatter", "shared", "independent")),
            ]
        )
    return table


def noise_sentences(noise: Mapping[str, Any], data: Data) -> list[Markup]:
    """The noise that the test took, and how much hangs on it."""
    sentences = [
        parts(
            "Noise floor: a right model would be off by {} in the logarithm of a reading (rms). {}",
            data.number("noise", "", "noise floor, rms of logarithms", noise["floor_rms_log"]),
            "The parts of the noise were estimated from the data."
            if noise["estimated_from_the_data"]
            else "Too few degrees of freedom remain to estimate it: it is as declared.",
        )
    ]
    if other := noise.get("with_noise_1_5_times_declared"):
        sentences.append(
            parts(
                "With {} times the declared noise the largest score would be {} against a "
                "threshold of {}: the model would {} be rejected.",
                data.number("noise", "", "times the declared noise", 1.5, 1),
                data.number("noise", "larger noise", "largest score", other["statistic"], 2),
                data.number("noise", "larger noise", "threshold", other["threshold"], 2),
                "still" if other["rejected"] else "not",
            )
        )
    return sentences


# ---------------------------------------------------------------------------------------------
# attribution


def outcome_table(found: Mapping[str, Any], data: Data) -> Table:
    """What became of each name, none left out."""
    rounds = len(found["gate"])
    asked = [n for n, evidence in enumerate(found["evidence"], start=1) if evidence]
    last = f"Largest score: round {rounds}"
    table = Table(
        "outcomes",
        "Every name that was considered: the largest score of its hypotheses (local rules: in "
        "the table of the test), its probability, and what became of it. Sensor faults and "
        "mis-declared inputs compete with physics, each group with one prior mass.",
        [
            "Name",
            "Kind",
            "Hypotheses",
            "Largest score: round 1",
            *([last] if rounds > 1 else []),
            *(f"Probability: round {n}" for n in asked),
            "Outcome",
        ],
        data,
    )
    lists = [found["candidates"], *([found["candidates_left"]] if rounds > 1 else [])]
    probabilities = [found["evidence"][n - 1]["by_name"] for n in asked]
    names = [name for by_name in probabilities for name in by_name]
    names += [entry["name"] for entry in found["candidates"]]
    for name in dict.fromkeys(names):
        own = [[e for e in entries if e["name"] == name] for entries in lists]
        scores = [max((e["score"] for e in entries), default=None) for entries in own]
        kind = own[0][0]["kind"] if own[0] else effects()[name].kind
        values = [(len(own[0]) or None, 0), *((score, 2) for score in scores)]
        values += [(by_name.get(name), 3) for by_name in probabilities]
        cells = zip(table.columns[2:-1], values, strict=True)
        table.rows.append(
            [
                name,
                kind,
                *(table.number(name, column, *value) for column, value in cells),
                _outcome(name, own[0], found),
            ]
        )
    return table.without_empty_columns()


def _outcome(name: str, entries: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> Badge:
    for entry in found["effects_added"]:
        if entry["name"] == name:
            return Badge(f"added in round {entry['round']}", "good")
    if name in found["candidate_set"]:
        return Badge("still open", "warn")
    if entries and not any(entry["testable"] for entry in entries):
        return Badge("not testable here")
    return Badge("lost" if any(found["evidence"]) else "no sign of it")


def hypothesis_tables(found: Mapping[str, Any], data: Data) -> list[Table]:
    """The best hypotheses of each round that asked."""
    tables = []
    for number, evidence in enumerate(found["evidence"], start=1):
        if evidence is None:
            continue
        table = Table(
            f"hypotheses_{number}",
            f"Round {number}: the best hypotheses, with their evidence against the model as it "
            "was. Those worth it were refitted; the others have the closed form of a linear model.",
            ["Hypothesis", "Log evidence", "Probability", "Evidence from"],
            data,
        )
        for one in evidence["best"]:
            numbers = (("log evidence", one["log_evidence"], 2),
                       ("probability", one["probability"], 3))  # fmt: skip
            table.rows.append(
                [
                    one["label"],
                    *(table.number(one["label"], *number) for number in numbers),
                    "refit" if one["refitted"] else "closed form",
                ]
            )
        tables.append(table)
    return tables


def rule_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """Local rules that were added or came near it, in words; None without any."""
    if not found["local_rules"]:
        return None
    table = Table(
        "rules",
        "Local rules that were added or came near it. Amplitude: change of the logarithm of the "
        "quantity where the rule acts in full.",
        ["Rule", "Amplitude", "Probability", "Outcome"],
        data,
    )
    for rule in found["local_rules"]:
        table.rows.append(
            [
                rule["words"],
                table.number(rule["words"], "amplitude", rule["amplitude"]),
                table.number(rule["words"], "probability", rule["probability"], 3),
                Badge("added", "good") if rule["added"] else "lost",
            ]
        )
    return table


# ---------------------------------------------------------------------------------------------
# what was added


def added_effects(found: Mapping[str, Any], data: Data) -> list[dict[str, Any]]:
    """Each added effect: what it is, and its parameters with intervals."""
    added = []
    for entries in _added(found):
        one = entries[0]
        effect = effects()[one["name"]]
        words = {parameter.name: parameter.words for parameter in effect.parameters}
        table = Table(
            f"added_{one['round']}",
            f"Parameters of {one['name']}, from the joint fit of all of the study's parameters.",
            [
                "Parameter",
                "Of",
                "Value",
                "90 % interval: from",
                "90 % interval: to",
                "Unit",
                "What",
            ],
            data,
        )
        for entry in entries:
            key = _scope(entry["scope"], entry["scope_key"])
            for name, parameter in entry["parameters"].items():
                values = (parameter["value"], *(parameter["interval_90"] or (None, None)))
                columns = zip(table.columns[2:5], values, strict=True)
                row, unit = f"{name} of {key}", parameter["unit"]
                cells = (table.number(row, c, value, unit=unit) for c, value in columns)
                table.rows.append([name, key, *cells, _unit(unit), words.get(name, "")])
        added.append(
            {
                "name": one["name"],
                "title": _title(entries, found),
                "scope": _scope(one["scope"], None),
                "options": ", ".join(f"{key}: {choice}" for key, choice in one["options"].items()),
                "round": data.number("added", one["name"], "round", one["round"]),
                "probability": data.number(
                    "added", one["name"], "probability", one["probability"], 3
                ),
                "effect": effect,
                "table": table,
            }
        )
    return added


def sharing_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """The added effects once more with one shared value; None where they have no more."""
    if not found["sharing"]:
        return None
    freedom, error = found["degrees_of_freedom"], found["error"]
    measures = {key: MEASURES[key] for key in ("rms_kpa", "rms_log")}
    table = Table(
        "sharing",
        "What is gained by an effect's own value for each part of the study, against one value "
        "for the whole: unknowns (calibrated parameters and amplitudes) and errors.",
        [
            "Model",
            "Shared value",
            "Values fitted",
            "Unknowns",
            *(f"{part}: {words}" for part in ("Fit", "Held out") for words in measures.values()),
        ],
        data,
    )
    rows = [
        (
            "as added",
            {},
            freedom["readings"],
            freedom["calibrated"] + freedom["amplitudes"],
            error["calibration"]["after"],
            error["held_out"]["after"],
        )
    ]
    rows += [
        (
            f"{one['name']}: one value for {_scope(one['scope'], None)}",
            one["parameters"],
            one["readings"],
            one["unknowns"],
            one["calibration"],
            one["held_out"] or {},
        )
        for one in found["sharing"]
    ]
    for name, shared, readings, unknowns, *errors in rows:
        values: list[Any] = []
        for parameter, entry in shared.items():
            number = table.number(name, parameter, entry["value"], unit=entry["unit"])
            values += [f"{parameter} =", number, "" if entry["unit"] == "1" else entry["unit"]]
        numbers = [(readings, 0), (unknowns, 0)]
        numbers += [(one.get(key), None) for one in errors for key in measures]
        cells = zip(table.columns[2:], numbers, strict=True)
        table.rows.append([name, values, *(table.number(name, c, *number) for c, number in cells)])
    return table.without_empty_columns()


# ---------------------------------------------------------------------------------------------
# errors


def error_table(found: Mapping[str, Any], data: Data) -> Table:
    """Errors on the data of the fit and on what was held out, by model."""
    heads = {"calibration": "Fit", "held_out": "Held out"}
    table = Table(
        "errors",
        "Errors of the model's values. Fit: the data that the study calibrates on. Held out: "
        "predictions of data that had no part in the fit that makes them. The last two rows are "
        "what can be had without knowing what is missing.",
        ["Model", *(f"{head}: {words}" for head in heads.values() for words in MEASURES.values())],
        data,
    )
    error = found["error"]
    for variant, words in VARIANTS.items():
        numbers = []
        for part in heads:
            one = error[part][variant] if variant in error[part] else error[variant][part]
            numbers += [(one[key], 0 if key == "n" else None) for key in MEASURES]
        table.add_numbers(words, numbers)
    return table.without_empty_columns()


def ratio_sentence(error: Mapping[str, Any], data: Data) -> Markup | None:
    """Held-out error after over before with its interval; None without it."""
    if error["ratio"] is None:
        return None
    ratio = data.number("errors", "held out", "after over before", error["ratio"], 3)
    if error["ratio_interval_90"] is None:
        return parts("Held-out error (rms of logarithms) after over before: {}.", ratio)
    low, high = error["ratio_interval_90"]
    return parts(
        "Held-out error (rms of logarithms) after over before: {}, 90 % interval {} to {} (load "
        "cells drawn anew, or experiments where each has one value).",
        ratio,
        data.number("errors", "held out", "after over before, from", low, 3),
        data.number("errors", "held out", "after over before, to", high, 3),
    )


def fold_table(found: Mapping[str, Any], data: Data) -> Table:
    """What each loop that did not see a part of the data chose, and its errors on that part."""
    keys = ("rms_kpa", "rms_log")
    table = Table(
        "folds",
        "Each part that was held out, what the loop without it chose, and the errors there. Not "
        "predictable: experiments with a parameter that no other data tell of; they have no part "
        "in the held-out error.",
        [
            "Held out",
            "Verdict without it",
            "Added without it",
            "Values",
            *(f"{MEASURES[key]}: {when}" for key in keys for when in ("before", "after")),
            "Not predictable",
        ],
        data,
    )
    for fold in found["folds"]:
        error = fold["error"] or {"before": {}, "after": {}}
        numbers = [(error["before"].get("n"), 0)]
        numbers += [(error[when].get(key), None) for key in keys for when in ("before", "after")]
        cells = zip(table.columns[3:-1], numbers, strict=True)
        verdict_badge = VERDICTS[fold["verdict"]] if fold["verdict"] else ""
        table.rows.append(
            [
                fold["name"],
                verdict_badge,
                listed(fold["added"]) or (verdict_badge and "nothing"),
                *(table.number(fold["name"], column, *number) for column, number in cells),
                [Badge(name, "warn") for name in fold["not_predictable"]],
            ]
        )
    return table.without_empty_columns()


def parameter_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """Calibrated parameters before and after; None where nothing is calibrated."""
    before, after = found["parameters"]["before"], found["parameters"]["after"]
    if not before:
        return None
    freedom = found["degrees_of_freedom"]
    table = Table(
        "parameters",
        parts(
            "Calibrated parameters without and with what was added: {} values, {} calibrated "
            "parameters, {} amplitudes. A model that lacks an effect puts its error into its "
            "parameters.",
            data.number("parameters", "", "values", freedom["readings"]),
            data.number("parameters", "", "calibrated parameters", freedom["calibrated"]),
            data.number("parameters", "", "amplitudes", freedom["amplitudes"]),
        ),
        [
            "Parameter",
            "As declared",
            *(
                f"{when}: {name}"
                for when in ("Before", "After")
                for name in ("value", "90 % from", "90 % to")
            ),
            "Unit",
            "Remarks",
        ],
        data,
    )
    for name, one in before.items():
        values = [one["start"]]
        for entry in (one, after.get(name)):
            entry = entry or {"value": None, "interval_90": None}
            values += [entry["value"], *(entry["interval_90"] or (None, None))]
        cells = zip(table.columns[1:-2], values, strict=True)
        untested = name in found["untestable_parameters"]
        table.rows.append(
            [
                name,
                *(table.number(name, column, value, unit=one["unit"]) for column, value in cells),
                _unit(one["unit"]),
                Badge("no reading depends on it", "warn") if untested else "",
            ]
        )
    return table.without_empty_columns()


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


def mimic_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """What looks like the effects that were added or are still open; None without any."""
    names = {entry["name"] for entry in found["effects_added"]} | {*found["candidate_set"]}
    entries = [e for e in found["candidates"] if e["name"] in names and e["nearest_mimic"]]
    if not entries:
        return None
    table = Table(
        "mimics",
        "What these readings can hardly tell from what was added or is open: a distance below "
        "about two standard deviations is no evidence for one against the other.",
        ["Candidate", "Nearest mimic", "Distance (sd)", "Look-alikes"],
        data,
    )
    for entry in entries:
        name = label_of(entry)
        table.rows.append(
            [
                name,
                entry["nearest_mimic"],
                table.number(name, "distance", entry["mimic_distance"], 2, "sd"),
                _look_alikes(table, name, entry["alike"]),
            ]
        )
    return table.without_empty_columns()


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


def improved_table(improved: Mapping[str, Any], data: Data) -> Table | None:
    """Errors of each experiment's own run, as declared and as improved; None without runs."""
    if not improved:
        return None
    keys = {"bias": "bias", "mean_absolute_error": "mean absolute", "rmse": "rmse"}
    table = Table(
        "improved",
        "Vertical stress from the workflow's own runs of each experiment over all its values, "
        "those of the fit among them (kPa; bias: model less value). Before: the study's "
        "calibrated baseline. After: the improved file as it is.",
        [
            "Improved file",
            "Values",
            *(f"{when}: {name}" for when in ("Before", "After") for name in keys.values()),
        ],
        data,
    )
    for name, one in improved.items():
        numbers = [(one["after"]["n"], 0)]
        numbers += [(one[when][key], None) for when in ("before", "after") for key in keys]
        table.add_numbers(name, numbers)
        table.rows[-1][0] = Link(f"{name}.yaml", one["file"])
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
