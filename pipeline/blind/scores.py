"""Scores of the loop over blind worlds: every table, and the bars that it is held to."""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from pipeline.blind.scored import (
    CHOICES,
    LOCAL_RULE,
    NULLS,
    PREDICTIONS,
    SINGLE,
    STRONG,
    Claim,
    Scored,
    held_out_errors,
    is_resolved,
)
from pipeline.effects import effects

DELTA_BINS = (0.0, 2.0, 3.5, 5.0, 8.0, math.inf)
PROBABILITY_BINS = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)
WORSE = 1.05


def score(worlds: Sequence[Scored]) -> dict[str, Any]:
    """Every table of the blind benchmark, as JSON-able data.

    Rates are documents {count, of, rate, low, high, lower_95, upper_95}: an exact two-sided 95 %
    interval, and the one-sided 95 % bounds. Rates of nothing are None. `broken` lists the
    quantities whose rate is beyond the bar by its one-sided bound, as a small edition can show.
    Attacks have a table of their own, and count in no other.
    """
    attacks = [world for world in worlds if world.is_attack]
    worlds = [world for world in worlds if not world.is_attack]
    nulls = {kind: [w for w in worlds if w.kind == kind] for kind in NULLS}
    single = [w for w in worlds if w.kind in SINGLE]
    soft = [w for w in worlds if w.kind not in NULLS[1:]]
    errors = [held_out_errors(world) for world in worlds]
    tables = {
        "worlds": len(worlds),
        "kinds": dict(Counter(w.kind for w in worlds)),
        "generators": dict(Counter(w.truth["generator"] for w in worlds)),
        "confusion": _confusion(worlds),
        "confusion_by_delta": {
            label: _confusion([w for w in worlds if w.delta is not None and low <= w.delta < high])
            for label, low, high in _bins(DELTA_BINS)
        },
        "false_alarms": {kind: _false_alarms(group) for kind, group in nulls.items()},
        "named_first_by_delta": {
            label: _named_first([w for w in single if low <= w.delta < high])
            for label, low, high in _bins(DELTA_BINS)
        },
        "reliability": _reliability(soft),
        "sets": _sets(single),
        "held_out": _held_out_tables(worlds, errors),
        "outside": _outside([w for w in worlds if w.kind == "outside"]),
        "two": _two([w for w in worlds if w.kind == "two"], lambda w: w.named),
        "peers": _peers(worlds),
        "attacks": _attacks(attacks),
        "remeasured": _remeasured(worlds),
        "missed": [_missed(w) for w in soft if w.is_missed],
        "seconds": _seconds(worlds),
        "each": [_each(world, error) for world, error in zip(worlds, errors, strict=True)],
    }
    bars = _bars(tables, single, soft)
    broken = [bar["quantity"] for bar in bars if bar["broken"]]
    return {"bars": bars, "broken": broken} | tables


def append_log(
    path: Path | str, scores: Mapping[str, Any], commit: str, seeds: Mapping[str, int], date: str
) -> None:
    """Append a scored run to the log, one JSON document for each line; nothing is overwritten."""
    entry = {"date": date, "commit": commit, "seeds": dict(seeds)}
    entry |= {key: scores[key] for key in ("worlds", "kinds", "generators", "bars")}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as log:
        log.write(json.dumps(entry, allow_nan=False) + "\n")


def rate(count: int, of: int) -> dict[str, Any]:
    """A rate with its exact (Clopper-Pearson) bounds."""
    if of == 0:
        bounds = dict.fromkeys(("rate", "low", "high", "lower_95", "upper_95"))
        return {"count": 0, "of": 0, **bounds}

    def low(tail: float) -> float:
        return 0.0 if count == 0 else float(beta.ppf(tail, count, of - count + 1))

    def high(tail: float) -> float:
        return 1.0 if count == of else float(beta.ppf(1.0 - tail, count + 1, of - count))

    bounds = {"low": low(0.025), "high": high(0.025), "lower_95": low(0.05), "upper_95": high(0.05)}
    return {"count": count, "of": of, "rate": count / of, **bounds}


# ---------------------------------------------------------------------------------------------
# tables


def _bins(edges: Sequence[float]) -> list[tuple[str, float, float]]:
    """(label, low, high) of each interval."""
    bins = []
    for low, high in pairwise(edges):
        label = f"{low:g}-{high:g}"
        if low == edges[0] == 0.0 and edges[-1] == math.inf:
            label = f"<{high:g}"
        bins.append((f">{low:g}" if high == math.inf else label, low, high))
    return bins


def _share(worlds: Iterable[Scored], holds: Callable[[Scored], bool]) -> dict[str, Any]:
    of = list(worlds)
    return rate(sum(map(holds, of)), len(of))


def _row_of(world: Scored) -> str:
    """What the truth is called in the confusion matrix."""
    return world.true[0][0] if world.kind in (*SINGLE, "outside") else world.kind


def _column_of(world: Scored) -> str:
    """What the loop said: an effect's name where it named one, else its verdict."""
    if not world.named:
        return world.result["verdict"]
    name, _ = world.named[0]
    wrong_place = name in {n for n, _ in world.true} and world.named[0] not in world.true
    return f"{name}, elsewhere" if wrong_place else name


def _confusion(worlds: Iterable[Scored]) -> dict[str, dict[str, int]]:
    table: dict[str, Counter] = defaultdict(Counter)
    for world in worlds:
        table[_row_of(world)][_column_of(world)] += 1
    return {row: dict(sorted(table[row].items())) for row in sorted(table)}


def _false_alarms(worlds: Sequence[Scored]) -> dict[str, Any]:
    return {
        "any_claim": _share(worlds, lambda w: w.claims),
        "named_effect": _share(worlds, lambda w: bool(w.named)),
        "gate_rejected": _share(worlds, lambda w: any(g["rejected"] for g in w.result["gate"])),
    }


def _named_first(worlds: Sequence[Scored]) -> dict[str, Any]:
    named = [w for w in worlds if w.named]
    return {
        "named": rate(len(named), len(worlds)),
        "right_of_named": _share(named, lambda w: w.first_is_right),
        "found_and_right": _share(worlds, lambda w: w.first_is_right),
    }


def _probable(worlds: Iterable[Scored]) -> list[tuple[float, bool]]:
    """Probability of each effect that the loop added, and whether it is there."""
    return [
        (one["probability"], (one["name"], one["scope_key"]) in world.true)
        for world in worlds
        for one in world.result["effects_added"]
        if one["name"] != LOCAL_RULE
    ]


def _reliability(worlds: Sequence[Scored]) -> list[dict[str, Any]]:
    pairs = _probable(worlds)
    table = []
    for label, low, high in _bins(PROBABILITY_BINS):
        inside = [(p, right) for p, right in pairs if low <= p < high or p == high == 1.0]
        mean = float(np.mean([p for p, _ in inside])) if inside else None
        right = rate(sum(right for _, right in inside), len(inside))
        table.append({"probability": label, "mean_probability": mean, "right": right})
    return table


def _sets(worlds: Sequence[Scored]) -> dict[str, Any]:
    """Of worlds with one effect where the loop leaves a set of names open, or names one."""
    answered = [w for w in worlds if w.candidate_names]
    sizes = [len(w.candidate_names) for w in answered]
    return {
        "coverage": _share(answered, lambda w: w.true[0][0] in w.candidate_names),
        "mean_size": float(np.mean(sizes)) if sizes else None,
    }


def _two(worlds: Iterable[Scored], claims: Callable[[Scored], Sequence[Claim]]) -> dict[str, Any]:
    def of(group):
        return {
            "exact_set": _share(group, lambda w: set(claims(w)) == set(w.true)),
            "one_right_none_wrong": _share(
                group, lambda w: 0 < len(claims(w)) < 2 and set(claims(w)) < set(w.true)
            ),
            "wrong_term": _share(group, lambda w: bool(set(claims(w)) - set(w.true))),
        }

    group = list(worlds)
    return {"all": of(group), "both_at_least_5": of([w for w in group if w.delta >= STRONG])}


def _outside(worlds: Sequence[Scored]) -> dict[str, Any]:
    def of(group):
        return {
            "not_named_as_catalogue": _share(group, lambda w: not w.named),
            "unknown_effect": _share(group, lambda w: w.result["verdict"] == "unknown_effect"),
            "right_rule": _share(group, lambda w: w.rule_is_right),
        }

    by_delta = {
        label: of([w for w in worlds if low <= w.delta < high])
        for label, low, high in _bins(DELTA_BINS)
    }
    return {
        "all": of(worlds),
        "at_least_5": of([w for w in worlds if w.delta >= STRONG]),
        "by_delta": by_delta,
    }


def _missed(world: Scored) -> dict[str, Any]:
    """What stood against the truth in a world with strong effects that the loop missed.

    `effects` has for each true one the probability that the loop gave it at first (None where the
    gate did not reject), its nearest mimic, and how many standard deviations apart the readings
    of the two are, for the true amplitude: below three no method can tell them apart for sure.
    """
    likely = {}
    for one in world.result["candidates"][::-1]:  # the most probable hypothesis of a claim stays
        likely[one["name"], one["scope_key"]] = one
    answers = []
    for one in world.truth["effects"]:
        found = likely.get((one["name"], one["scope_key"]), {})
        distance = found.get("mimic_distance")
        if distance is not None:
            distance *= _usual_amplitudes(one)
        answers.append(
            {
                "name": one["name"],
                "scope_key": one["scope_key"],
                "delta": one["delta"],
                "probability": found.get("probability"),
                "nearest_mimic": found.get("nearest_mimic"),
                "mimic_distance": distance,
            }
        )
    return {
        "world": world.truth["world"],
        "kind": world.kind,
        "generator": world.truth["generator"],
        "said": world.said,
        "effects": answers,
    }


def _usual_amplitudes(effect: Mapping[str, Any]) -> float:
    """How many usual amplitudes a true effect of the catalogue is away from neutral."""
    described = effects()[effect["name"]].parameters
    parts = [(effect["parameters"].get(p.name, p.neutral) - p.neutral) / p.scale for p in described]
    return math.hypot(*parts)


# ---------------------------------------------------------------------------------------------
# one more measurement


def _remeasured(worlds: Sequence[Scored]) -> dict[str, Any]:
    """Of the worlds left undecided: how many the recommended, and a random, measurement resolves.

    Worlds with one effect; no other is measured again.
    """
    undecided = [w for w in worlds if w.again is not None and w.kind in SINGLE]
    table: dict[str, Any] = {
        choice: _share(undecided, lambda w, c=choice: is_resolved(w, c)) for choice in CHOICES
    }
    table["each"] = [
        {"world": w.truth["world"]}
        | {
            choice: {
                "what": w.again[choice]["measurement"]["what"],
                "where": w.again[choice]["measurement"]["where"],
                "resolved": is_resolved(w, choice),
            }
            for choice in CHOICES
            if choice in w.again
        }
        for w in undecided
    ]
    return table


def _seconds(worlds: Iterable[Scored]) -> dict[str, float] | None:
    taken = [world.seconds for world in worlds if world.seconds is not None]
    if not taken:
        return None
    return {"median": float(np.median(taken)), "most": max(taken)}


# ---------------------------------------------------------------------------------------------
# held-out errors


def _ratios(errors: Iterable[Mapping], name: str = "after", measure: str = "rms_log") -> np.ndarray:
    return np.array([one[name][measure] / one["before"][measure] for one in errors if name in one])


def _held_out_tables(worlds: Sequence[Scored], errors: Sequence[Mapping]) -> dict[str, Any]:
    pairs = list(zip(worlds, errors, strict=True))

    def of(holds):
        group = [error for world, error in pairs if error and holds(world)]
        table = {"worlds": len(group)}
        for name in PREDICTIONS:
            for measure in ("rms_log", "rms_log_readings"):
                ratios = _ratios(group, name, measure)
                if ratios.size:
                    quartiles = np.quantile(ratios, [0.25, 0.5, 0.75])
                    table[f"{name}_{measure}"] = {
                        "median_ratio": float(quartiles[1]),
                        "quartiles": [float(quartiles[0]), float(quartiles[2])],
                        "made_worse": rate(int((ratios > WORSE).sum()), ratios.size),
                    }
        return table

    def strong(world):
        return world.delta is not None and world.delta >= STRONG

    return {
        "one_effect_at_least_5": of(lambda w: w.kind in SINGLE and strong(w)),
        "physics_at_least_5": of(lambda w: w.kind == "one" and strong(w)),
        "sensor_or_input_at_least_5": of(lambda w: w.kind == "sensor_or_input" and strong(w)),
        "two": of(lambda w: w.kind == "two"),
        "outside_at_least_5": of(lambda w: w.kind == "outside" and strong(w)),
        "nulls": of(lambda w: w.kind in NULLS),
        "effect_added": of(lambda w: bool(w.result["effects_added"])),
        "effect_added_at_least_5": of(lambda w: bool(w.result["effects_added"]) and strong(w)),
    }


def _peers(worlds: Sequence[Scored]) -> dict[str, Any]:
    """The same questions to the other methods that name effects."""
    single = [w for w in worlds if w.kind in SINGLE]
    names = sorted({name for world in worlds for name in world.peers})
    table = {}
    for name in names:
        asked = [w for w in worlds if name in w.peers]

        def first_right(world, name=name):
            return bool(world.peers[name]) and tuple(world.peers[name][0]) in world.true

        of_single = [w for w in single if name in w.peers]
        strong = [w for w in of_single if w.delta >= STRONG]
        plain = [w for w in asked if w.kind == "null_plain"]
        two = [w for w in asked if w.kind == "two"]
        table[name] = {
            "claims_on_plain_nulls": _share(plain, lambda w, n=name: bool(w.peers[n])),
            "right_of_named": _share([w for w in of_single if w.peers[name]], first_right),
            "found_and_right_at_least_5": _share(strong, first_right),
            "two": _two(two, lambda w, n=name: [tuple(claim) for claim in w.peers[n]]),
        }
    return table


def _attacks(worlds: Sequence[Scored]) -> dict[str, Any]:
    """By kind of attack: how many ended well, what the loop said, and held-out ratios."""
    table = {}
    for kind in dict.fromkeys(world.kind for world in worlds):
        group = [world for world in worlds if world.kind == kind]
        errors = [held_out_errors(world) for world in group]
        ratios = _ratios(errors)
        table[kind.removeprefix("attack_")] = {
            "ends_well": _share(group, lambda w: w.ends_well),
            "fooled": _share(group, lambda w: w.is_fooled),
            "gate_rejected": _share(group, lambda w: any(g["rejected"] for g in w.result["gate"])),
            "said": dict(Counter(w.said for w in group).most_common()),
            "held_out_ratio": float(np.median(ratios)) if ratios.size else None,
            "made_worse": rate(int((ratios > WORSE).sum()), ratios.size),
            "each": [
                _each(world, error)
                | {key: world.truth["attack"][key] for key in ("details", "joint_delta")}
                | {"ends_well": world.ends_well, "fooled": world.is_fooled}
                for world, error in zip(group, errors, strict=True)
            ],
        }
    return table


def _each(world: Scored, error: Mapping) -> dict[str, Any]:
    """The line of one world in the list of all."""
    return {
        "world": world.truth["world"],
        "kind": world.kind,
        "generator": world.truth["generator"],
        "true": [list(claim) for claim in world.true],
        "deltas": [one["delta"] for one in world.truth["effects"]],
        "verdict": world.result["verdict"],
        "named": [list(claim) for claim in world.named],
        "candidate_set": list(world.result["candidate_set"]),
        "held_out": dict(error),
    }


# ---------------------------------------------------------------------------------------------
# bars


def _bars(tables: Mapping[str, Any], single, soft) -> list[dict[str, Any]]:
    """Each quantity with its figure, bar and stretch, and whether they are met."""
    plain = tables["false_alarms"]["null_plain"]
    overall = _named_first(single)
    strong = _named_first([w for w in single if w.delta >= STRONG])
    probable = [right for p, right in _probable(soft) if p >= 0.9]
    held_out = tables["held_out"]
    ratio = held_out["one_effect_at_least_5"].get("after_rms_log", {}).get("median_ratio")
    worse = held_out["effect_added"].get("after_rms_log", {}).get("made_worse", rate(0, 0))
    outside = tables["outside"]["at_least_5"]
    two = tables["two"]["both_at_least_5"]["exact_set"]
    seconds = (tables["seconds"] or {}).get("median")
    return [
        _alarm("any false claim on plain null worlds", plain["any_claim"], 0.05, 0.05),
        _alarm("a named effect on null worlds", plain["named_effect"], 0.02, 0.01),
        _at_least(
            "right, of those where an effect is named first", overall["right_of_named"], 0.95, 0.98
        ),
        _at_least(
            "found and right, of worlds with delta of at least 5",
            strong["found_and_right"],
            0.95,
            0.98,
        ),
        _at_least(
            "right, of claims made with probability of at least 0.9",
            rate(sum(probable), len(probable)),
            0.97,
            0.99,
        ),
        _at_least("90 % set: coverage", tables["sets"]["coverage"], 0.92, 0.95),
        _at_most("90 % set: mean size", tables["sets"]["mean_size"], 1.5, 1.25),
        _at_most(
            "held-out RMS after over before, noise-free, delta of at least 5, median",
            ratio,
            0.35,
            0.25,
        ),
        _at_most("worlds made worse by the added effect", worse["rate"], 0.05, 0.02, worse),
        _at_least(
            "outside the catalogue, delta of at least 5: not named as a catalogue effect",
            outside["not_named_as_catalogue"],
            0.85,
            0.95,
        ),
        _at_least(
            "outside the catalogue, delta of at least 5: right rule",
            outside["right_rule"],
            0.70,
            0.85,
        ),
        _at_least("two effects, both with delta of at least 5: exact set", two, 0.70, 0.85),
        _at_least(
            "undecided worlds with one effect resolved by the recommended measurement",
            tables["remeasured"]["recommended"],
            0.50,
            0.60,
        ),
        _compared(
            "the same by a measurement chosen at random",
            tables["remeasured"]["random"],
        ),
        _at_most("one data set, one core, median processor seconds", seconds, 10.0, 3.0),
    ]


def _bar(quantity, figure, bar, stretch, met, of=None, broken=None):
    return {
        "quantity": quantity,
        "figure": figure,
        "rate": of,
        "bar": bar,
        "stretch": stretch,
        "met": None if figure is None else met(bar),
        "met_stretch": None if figure is None else met(stretch),
        "broken": None if figure is None or of is None else broken(),
    }


def _compared(quantity, of):
    """A figure beside another, without a bar of its own."""
    return _bar(quantity, of["rate"], None, None, lambda _: None, of, lambda: None)


def _alarm(quantity, of, bar, stretch):
    """Broken when the one-sided 95 % lower bound of the rate lies above the bar."""

    def met(limit):
        return of["lower_95"] <= limit

    return _bar(quantity, of["rate"], bar, stretch, met, of, lambda: not met(bar))


def _at_least(quantity, of, bar, stretch):
    def met(limit):
        return of["rate"] >= limit

    return _bar(quantity, of["rate"], bar, stretch, met, of, lambda: of["upper_95"] < bar)


def _at_most(quantity, figure, bar, stretch, of=None):
    def met(limit):
        return figure <= limit

    return _bar(quantity, figure, bar, stretch, met, of, lambda: of["lower_95"] > bar)
