"""Words of a study's page: verdicts, candidates and what they belong to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from pipeline.report.page import Badge

WORSE = 1.01  # times the held-out error before, from which a model counts as worse
AT_BOUND = "at the end of its range: not a fit"
VERDICTS = {
    "no_effect_detectable": Badge("no effect detectable", "good"),
    "effect": Badge("effect found", "good"),
    "ambiguous": Badge("ambiguous", "warn"),
    "unknown_effect": Badge("unknown effect", "warn"),
    "unexplained": Badge("unexplained", "bad"),
}
MEASURES = {
    "n": "values",
    "rms_kpa": "rms (kPa)",
    "mean_absolute_kpa": "mean absolute (kPa)",
    "rms_log": "rms of logarithms",
}


def label_of(entry: Mapping[str, Any]) -> str:
    """What tells a candidate from the others."""
    key = entry["scope_key"]
    label = entry.get("label") or entry["name"] + (f" [{key}]" if key is not None else "")
    return label if key is not None else f"{label} of {scope_words(entry['scope'], key)}"


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


def each_added(found: Mapping[str, Any]) -> Iterator[list[Mapping[str, Any]]]:
    """Entries of each added effect, one for each key, in the order added."""
    for _, entries in groupby(found["effects_added"], key=lambda entry: entry["round"]):
        yield list(entries)


def title_of(entries: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> str:
    """Name of an added effect with what it belongs to; a rule in words."""
    one = entries[0]
    for rule in found["local_rules"] if one["kind"] == "rule" else ():
        if all(rule[name] == choice for name, choice in one["options"].items()):
            return rule["words"]
    keys = ", ".join(entry["scope_key"] for entry in entries if entry["scope_key"])
    return f"{one['name']} ({keys})" if keys else one["name"]


def scope_words(scope: str, key: str | None) -> str:
    """What has a value of its own: the key, or each thing of the scope."""
    if key is not None:
        return key
    return "the study" if scope == "study" else f"each {scope.replace('_', ' ')}"


def unit_words(unit: str) -> str:
    """A unit as a cell shows it."""
    return "–" if unit == "1" else unit


def names_added(found: Mapping[str, Any]) -> list[str]:
    """Names of the added effects, each once, in the order added."""
    return list(dict.fromkeys(entry["name"] for entry in found["effects_added"]))


def predicts_worse(found: Mapping[str, Any]) -> bool:
    """Whether the error (rms of logarithms) on what was held out is larger with what was added."""
    ratio = found["error"]["held_out"]["ratio"]
    return ratio is not None and ratio > WORSE
