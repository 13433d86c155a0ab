"""What the loop found, as the JSON documents and netCDF files of a study."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
import xarray as xr

from pipeline.calibrate.calibration import at_end
from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.effects import effects
from pipeline.effects.local_rule import in_words
from pipeline.loop.certificate import certificate
from pipeline.loop.covariance import COMPONENTS, Noise
from pipeline.loop.data import Data
from pipeline.loop.fit import Fit, posterior_covariance
from pipeline.loop.model import Model, Point, Term, limits
from pipeline.loop.problem import Problem
from pipeline.loop.rounds import Outcome, Round

Z90 = NormalDist().inv_cdf(0.95)
SHOWN = 12  # hypotheses that a round's list of evidence holds, at most


def point_document(point: Point) -> dict[str, Any]:
    """A point as JSON-able data."""
    return {
        "coordinates": list(point.coordinates),
        "terms": [
            {
                "effect": t.effect,
                "parameter": t.parameter,
                "scope": t.scope,
                "key": t.key,
                "cases": list(t.cases),
                "options": [list(option) for option in t.options],
                "amplitude": a,
            }
            for t, a in zip(point.terms, point.amplitudes, strict=True)
        ],
    }


def point_from(document: Mapping[str, Any]) -> Point:
    """Back from `point_document`."""
    terms = [
        Term(
            t["effect"],
            t["parameter"],
            t["scope"],
            t["key"],
            tuple(t["cases"]),
            tuple((name, choice) for name, choice in t["options"]),
        )
        for t in document["terms"]
    ]
    amplitudes = tuple(t["amplitude"] for t in document["terms"])
    return Point(tuple(document["coordinates"]), tuple(terms), amplitudes)


def noise_from(last: xr.Dataset) -> Noise:
    """The noise of a round from its file, `round_dataset`; without what it draws from."""
    parts = tuple(last[f"covariance_{name}"].values for name in COMPONENTS)
    declared = Noise(parts, (1.0,) * len(parts), np.eye(len(parts[0])), ())
    return declared.scaled(json.loads(last.attrs["noise_factors"]))


def standard_deviations(model: Model, data: Data, one: Round) -> np.ndarray:
    """Sd (unknown) of a round's coordinates and amplitudes, given its covariance and priors."""
    return np.sqrt(np.diag(posterior_covariance(model, data, one.fit, one.noise)))


def parameters_document(model: Model, found: Fit, sd: np.ndarray) -> dict[str, Any]:
    """Calibrated values with 90 % intervals, by label."""
    document = {}
    for coordinate, u, s in zip(model.coordinates, found.point.coordinates, sd, strict=False):
        ends = np.clip([u - Z90 * s, u + Z90 * s], coordinate.low, coordinate.high)
        document[coordinate.label] = {
            "name": coordinate.name,
            "key": coordinate.key,
            "value": coordinate.scale.backward(u),
            "interval_90": sorted(coordinate.scale.backward(end) for end in ends),
            "start": coordinate.scale.backward(coordinate.start),
            "unit": coordinate.scale.unit,
        }
    return document


def effects_document(model: Model, outcome: Outcome, sd: np.ndarray) -> list[dict[str, Any]]:
    """Added effects in order, one entry for each key, with values of the final fit."""
    point = outcome.fit.point
    count = len(point.coordinates)
    document = []
    for evidence, probabilities in zip(outcome.added, outcome.sure, strict=True):
        found_in = (
            one.attribution is not None
            and any(evidence.refit is other.refit for other in one.attribution.evidence)
            for one in outcome.rounds
        )
        number = list(found_in).index(True)
        keys: dict[str | None, dict] = {}
        for term in evidence.hypothesis.terms:
            place = point.terms.index(term)
            value, spread = point.amplitudes[place], sd[count + place]
            entry = keys.setdefault(
                term.key,
                {
                    "name": term.effect,
                    "kind": evidence.hypothesis.kind,
                    "scope": term.scope,
                    "scope_key": term.key,
                    "parameters": {},
                    "options": dict(term.options),
                    "probability": probabilities[term.key],
                    "round": number + 1,
                },
            )
            entry["parameters"][term.parameter] = {
                "value": value,
                "interval_90": [
                    float(end)
                    for end in np.clip([value - Z90 * spread, value + Z90 * spread], *limits(term))
                ],
                "at_bound": at_bound(term, value),
                "unit": term.described.unit,
            }
        document += keys.values()
    return document


def at_bound(term: Term, amplitude: float) -> bool:
    """Whether an amplitude lies at an end of its range, other than neutral, where a fit is none."""
    low, high = limits(term)
    nearest = min((low, high), key=lambda end: abs(amplitude - end))
    return nearest != term.described.neutral and at_end(amplitude, low, high)


def rules_document(outcome: Outcome) -> list[dict[str, Any]]:
    """Local rules that were added or came near it."""
    entries: dict[tuple, dict] = {}
    for one in outcome.rounds:
        if one.attribution is None:
            continue
        pairs = zip(one.attribution.evidence, one.attribution.probabilities, strict=True)
        for evidence, probability in pairs:
            if evidence.hypothesis.kind != "rule" or evidence.refit is None:
                continue
            term = evidence.hypothesis.terms[0]
            options = dict(term.options)
            amplitude = evidence.refit.point.amplitudes[-1]
            entries[tuple(options.values())] = {
                **options,
                "words": in_words(options["channel"], options["feature"], amplitude),
                "amplitude": amplitude,
                "at_bound": at_bound(term, amplitude),
                "probability": float(probability),
                "added": evidence in outcome.added,
            }
    return sorted(entries.values(), key=lambda e: -e["probability"])


def gate_document(outcome: Outcome) -> list[dict[str, Any]]:
    """The lack-of-fit test of each round."""
    return [
        {
            "round": number,
            "statistic": one.gate.statistic,
            "p_value": one.gate.p_value,
            "alpha": one.gate.alpha,
            "rejected": one.gate.rejected,
            "largest": one.gate.labels[int(np.argmax(one.gate.scores))] if one.gate.labels else "",
            "threshold": _finite(one.gate.threshold),
            "sum_of_squares": one.gate.omnibus,
            "sum_of_squares_p_value": one.gate.omnibus_p_value,
            "degrees_of_freedom_beyond": one.freedom,
            "noise_factors": dict(zip(COMPONENTS, map(float, one.noise.factors), strict=True)),
        }
        for number, one in enumerate(outcome.rounds, start=1)
    ]


def candidates_document(one: Round, untried: Mapping[str, str]) -> list[dict[str, Any]]:
    """One entry for each name of the catalogue and hypothesis of it, best first.

    `untried` are the names that no hypothesis stands for, with the reason.
    """
    probabilities = {}
    if one.attribution is not None:
        pairs = zip(one.attribution.evidence, one.attribution.probabilities, strict=True)
        probabilities = {e.hypothesis.label: float(p) for e, p in pairs}
    entries = []
    for entry in certificate(one.seen, one.gate, one.hypotheses):
        h = entry.hypothesis
        if h.kind == "rule":
            continue
        entries.append(
            {
                "name": h.name,
                "label": h.label,
                "kind": h.kind,
                "scope": h.terms[0].scope,
                "scope_key": h.key,
                "probability": probabilities.get(h.label, 0.0) if one.attribution else None,
                "score": entry.score,
                "surviving_fraction": entry.surviving_fraction,
                "minimal_detectable": entry.minimal_detectable,
                "unit": h.terms[0].described.unit,
                "nearest_mimic": entry.nearest_mimic,
                "mimic_distance": entry.mimic_distance,
                "alike": list(entry.alike),
                "testable": entry.testable,
                "why": entry.why,
            }
        )
    entries.sort(key=lambda e: (-(e["probability"] or 0.0), -e["score"]))
    return entries + [_untried_entry(name, why) for name, why in untried.items()]


def _untried_entry(name: str, why: str) -> dict[str, Any]:
    effect = effects()[name]
    return {
        "name": name,
        "label": name,
        "kind": effect.kind,
        "scope": effect.scope,
        "scope_key": None,
        "probability": None,
        "score": 0.0,
        "surviving_fraction": 0.0,
        "minimal_detectable": None,
        "unit": effect.parameters[0].unit,
        "nearest_mimic": None,
        "mimic_distance": None,
        "alike": [],
        "testable": False,
        "why": why,
    }


def evidence_document(one: Round) -> dict[str, Any] | None:
    """Posterior of a round by name, and the best hypotheses."""
    if one.attribution is None:
        return None
    pairs = list(zip(one.attribution.evidence, one.attribution.probabilities, strict=True))
    return {
        "by_name": one.attribution.by_name,
        "none": one.attribution.none,
        "set_90": one.attribution.smallest_set,
        "best": [
            {
                "label": e.hypothesis.label,
                "log_evidence": e.log_evidence,
                "probability": float(p),
                "refitted": e.refit is not None,
            }
            for e, p in pairs[:SHOWN]
        ],
    }


def residual_dataset(
    problem: Problem, measured: Sequence[MeasuredRow], before: Fit, noise: Noise
) -> xr.Dataset:
    """Content of `residual.nc`: calibration readings against the calibrated baseline.

    Residuals are measured − simulated in the reading's unit, and as logarithms; standardized ones
    are over the sd of a reading about the model, packing and instrument together; whitened ones
    are without what readings share.
    """
    sd = np.sqrt(np.diag(noise.covariance))
    model, use = problem.model, problem.data.use
    rows = [measured[i] for i in use]
    is_log = model.is_log[use]
    expected = before.expected[use]
    simulated = np.where(is_log, np.exp(np.where(is_log, expected, 0.0)), expected)
    standard = before.residual / sd
    value = np.array([row.value for row in rows])
    scale = np.where(is_log, value, 1.0)

    def text(values: Sequence[str]) -> tuple[str, np.ndarray]:
        return "reading", np.array([v.encode() for v in values], dtype="S")

    experiments = [model.cases[model.case_of[i]].experiment for i in use]
    names = [one.name for one in experiments]
    return xr.Dataset(
        {
            "measured": ("reading", value),
            "measured_uncertainty": ("reading", sd * scale),
            "simulated": ("reading", simulated),
            "residual": ("reading", value - simulated),
            "log_residual": ("reading", np.where(is_log, before.residual, np.nan)),
            "standardized_residual": ("reading", standard),
            "whitened_residual": ("reading", noise.whitened(before.residual)),
            "experiment": text(names),
            "load_cell": text([row.load_cell or "" for row in rows]),
            "quantity": text([row.quantity for row in rows]),
            "unit": text([QUANTITIES[row.quantity] for row in rows]),
            "material": text([one.material.name for one in experiments]),
            "wall_friction_angle": (
                "reading",
                np.array([e.walls.friction_angle if e.walls else math.nan for e in experiments]),
            ),
            "fill_height": ("reading", _fill_heights(model, use, rows)),
            "mass_drawn": ("reading", np.array([row.mass_drawn or 0.0 for row in rows])),
        },
        coords={"reading": ("reading", np.asarray(use, dtype=np.int32))},
    )


def _fill_heights(model: Model, use: np.ndarray, rows: Sequence[MeasuredRow]) -> np.ndarray:
    full = [model.cases[model.case_of[i]].experiment.geometry.height for i in use]
    return np.array([r.fill_height or height for r, height in zip(rows, full, strict=True)])


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def round_dataset(problem: Problem, one: Round) -> xr.Dataset:
    """Arrays of a round, so that its numbers can be followed.

    Rows of vectors that are whitened have the readings first, then the priors of the unknowns.
    """
    model, data = problem.model, problem.data
    terms = [t.label.encode() for t in one.seen.terms]
    parts = zip(COMPONENTS, one.noise.parts, strict=True)
    attrs = {
        "point": json.dumps(point_document(one.fit.point)),
        "reference": json.dumps(point_document(one.fit.reference)),
        "noise_factors": json.dumps([float(f) for f in one.noise.factors]),
        "coordinates": json.dumps([c.label for c in model.coordinates]),
        "terms": json.dumps(
            [{"effect": t.effect, "parameter": t.parameter, "key": t.key} for t in one.seen.terms]
        ),
    }
    content = {
        "residual": ("reading", one.fit.residual),
        "expected": ("reading", one.fit.expected[data.use]),
        "parameter_sensitivity": (("reading", "unknown"), one.fit.slopes[data.use]),
        "term_sensitivity": (("reading", "term"), one.seen.slopes[data.use]),
        "whitened_residual": ("whitened", one.seen.z),
        "whitened_sensitivity": (("whitened", "term"), one.seen.columns),
        "term_name": ("term", np.array(terms, dtype="S")),
        "score": ("direction", one.gate.scores),
        "direction_name": (
            "direction",
            np.array([label.encode() for label in one.gate.labels], dtype="S"),
        ),
    }
    content |= {f"covariance_{n}": (("reading", "other_reading"), p) for n, p in parts}
    return xr.Dataset(content, coords={"reading": np.asarray(data.use, np.int32)}, attrs=attrs)
