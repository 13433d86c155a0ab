"""What a study added, and the errors and parameters before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from pipeline.effects import effects
from pipeline.report.page import Badge, Data, Link, Table, parts
from pipeline.report.study_words import (
    AT_BOUND,
    MEASURES,
    VERDICTS,
    each_added,
    listed,
    scope_words,
    title_of,
    unit_words,
)

VARIANTS = {
    "before": "before: the calibrated baseline",
    "after": "after: with what was added",
    "recalibrated_only": "recalibrated only, nothing added",
    "gaussian_process": "Gaussian process on the residual",
}


def added_effects(found: Mapping[str, Any], data: Data) -> list[dict[str, Any]]:
    """Each added effect: what it is, and its parameters with intervals."""
    added = []
    for entries in each_added(found):
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
            key = scope_words(entry["scope"], entry["scope_key"])
            for name, parameter in entry["parameters"].items():
                values = (parameter["value"], *(parameter["interval_90"] or (None, None)))
                columns = zip(table.columns[2:5], values, strict=True)
                row, unit = f"{name} of {key}", parameter["unit"]
                cells = (table.number(row, c, value, unit=unit) for c, value in columns)
                what = words.get(name, "") + (f"; {AT_BOUND}" if parameter["at_bound"] else "")
                table.rows.append([name, key, *cells, unit_words(unit), what])
        added.append(
            {
                "name": one["name"],
                "title": title_of(entries, found),
                "scope": scope_words(one["scope"], None),
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
            f"{one['name']}: one value for {scope_words(one['scope'], None)}",
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
                unit_words(one["unit"]),
                Badge("no reading depends on it", "warn") if untested else "",
            ]
        )
    return table.without_empty_columns()


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
