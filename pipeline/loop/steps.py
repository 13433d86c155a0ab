"""The loop's steps as the workflow runs them, each from files to files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from pipeline import __version__
from pipeline.config.load import resolved
from pipeline.config.measured import MeasuredRow
from pipeline.config.study import Shared
from pipeline.effects import effects
from pipeline.loop.covariance import LEAST_FREEDOM, Noise, noise
from pipeline.loop.data import Data
from pipeline.loop.documents import (
    candidates_document,
    effects_document,
    evidence_document,
    gate_document,
    parameters_document,
    point_document,
    point_from,
    residual_dataset,
    round_dataset,
    rules_document,
    standard_deviations,
)
from pipeline.loop.fit import Fit, calibrated, fit
from pipeline.loop.gaussian_process import correction
from pipeline.loop.hypotheses import untried
from pipeline.loop.model import Model, Point, Term
from pipeline.loop.next_measurement import next_measurements, recommended
from pipeline.loop.problem import Fold, Problem, predictable, subset
from pipeline.loop.rounds import Outcome, close
from pipeline.loop.scores import VARIANTS, errors, predicted, ratio_interval
from pipeline.montecarlo.streams import LOOP_BOOTSTRAP, random_stream
from pipeline.montecarlo.workers import run_tasks

SCHEMA_VERSION = "1.0"


# ---------------------------------------------------------------------------------------------
# residual


def residual(problem: Problem, measured: Sequence[MeasuredRow]) -> tuple[xr.Dataset, xr.Dataset]:
    """Calibrate the baseline: `residual.nc`, and what the next step takes up from here.

    `measured` are the rows of the calibration readings' files.
    """
    model = problem.model.only(problem.data.use)
    found, here = calibrated(model, problem.data, model.start)
    content = residual_dataset(problem, measured, found, here)
    values = {
        f"values_{case}": (
            (f"replicate_{case}", f"value_{case}"),
            model.kept(found.reference, case),
        )
        for case in model.active
    }
    start = xr.Dataset(
        {**values, "slopes": (("row", "unknown"), found.slopes)},
        attrs={
            "point": json.dumps(point_document(found.point)),
            "reference": json.dumps(point_document(found.reference)),
        },
    )
    return content, start


def resumed(problem: Problem, start: xr.Dataset) -> tuple[Fit, Noise]:
    """The calibrated baseline of `residual`, without simulating it again."""
    model = problem.model.only(problem.data.use)
    point, reference = (point_from(json.loads(start.attrs[n])) for n in ("point", "reference"))
    for case in model.active:
        model.recall(reference, case, start[f"values_{case}"].values)
    here = noise(model, reference, problem.data)
    return fit(model, problem.data, here, point, reference, start["slopes"].values), here


# ---------------------------------------------------------------------------------------------
# attribute


def attribution(problem: Problem, start: xr.Dataset) -> tuple[dict[str, Any], list[xr.Dataset]]:
    """The loop on all calibration readings: `attribution.json`, and the arrays of each round."""
    study, model, data = problem.study, problem.model, problem.data
    outcome = close(study, model, data, resumed(problem, start))
    first, last = outcome.rounds[0], outcome.rounds[-1]
    left_out = untried(study, model, data.use)
    before, after = (standard_deviations(model, data, one) for one in (first, last))
    additions = next_measurements(model.only(data.use), data, last)
    document = {
        "study": study.name,
        "schema_version": SCHEMA_VERSION,
        "verdict": outcome.verdict,
        "effects_added": effects_document(model, outcome, after),
        "candidate_set": last.attribution.smallest_set if last.attribution else [],
        "dropped": list(outcome.dropped),
        "gate": gate_document(outcome),
        "candidates": candidates_document(first, left_out),
        "candidates_left": candidates_document(last, left_out),
        "evidence": [evidence_document(one) for one in outcome.rounds],
        "local_rules": rules_document(outcome),
        "parameters": {
            "before": parameters_document(model, first.fit, before),
            "after": parameters_document(model, last.fit, after),
        },
        "untestable_parameters": _untestable(model, data, first.fit),
        "next_measurement": recommended(additions),
        "possible_measurements": additions,
        "noise": _noise(outcome),
        "degrees_of_freedom": {
            "readings": len(data.use),
            "calibrated": len(model.coordinates),
            "amplitudes": len(last.fit.point.terms),
        },
        "baseline": {
            "point": point_document(first.fit.point),
            "expected": first.fit.expected[data.use],
        },
        "final": {
            "point": point_document(last.fit.point),
            "expected": last.fit.expected[data.use],
        },
        "replicates_simulated": model.simulated,
    }
    return document, [round_dataset(problem, one) for one in outcome.rounds]


def _untestable(model: Model, data: Data, found: Fit) -> list[str]:
    """Parameters that no reading depends on: they stay at their start."""
    slopes = found.slopes[data.use, : len(model.coordinates)]
    return [
        c.label
        for c, column in zip(model.coordinates, slopes.T, strict=True)
        if np.abs(column).max(initial=0.0) < 1e-9
    ]


def _noise(outcome: Outcome) -> dict[str, Any]:
    """What noise the test took, and what 1.5 times the declared noise would have changed."""
    first = outcome.rounds[0]
    sd = float(np.sqrt(np.mean(np.diag(first.noise.covariance))))
    estimated = first.freedom >= LEAST_FREEDOM
    document = {"floor_rms_log": sd, "estimated_from_the_data": estimated}
    if not estimated:
        score = first.gate.statistic / 1.5
        document["with_noise_1_5_times_declared"] = {
            "statistic": score,
            "threshold": first.gate.threshold,
            "rejected": bool(score > first.gate.threshold),
        }
    return document


# ---------------------------------------------------------------------------------------------
# close the loop


def closed(
    problem: Problem,
    measured: Sequence[MeasuredRow],
    start: xr.Dataset,
    found: Mapping[str, Any],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """`closed_loop.json` and `predictions.json`, from what `attribution` found.

    `measured` are all rows, held-out ones among them: they are read for the scores alone.
    """
    study, model = problem.study, problem.model
    points = {
        "before": point_from(found["baseline"]["point"]),
        "after": point_from(found["final"]["point"]),
    }
    calibration = _own_errors(problem, measured, start, found)
    if problem.leaves_one_out:
        alone = replace(problem, model=model.alone())
        tasks = [partial(_fold, alone, fold, start, points) for fold in problem.folds]
        folds = run_tasks(tasks, model.execution, processes=True)
    else:
        folds = [_fold(problem, fold, start, points) for fold in problem.folds]
    rows = [i for fold in folds for i in fold["rows"]]
    pooled = {
        name: np.concatenate([np.asarray(fold["expected"][name]) for fold in folds])
        for name in VARIANTS
    }
    random = random_stream(0, study.name, LOOP_BOOTSTRAP, 0)
    held_out = {name: errors(model, measured, rows, pooled[name]) for name in VARIANTS}
    ratio, interval = ratio_interval(
        model, measured, rows, pooled["before"], pooled["after"], random
    )
    document = {
        "study": study.name,
        "title": study.title,
        "schema_version": SCHEMA_VERSION,
        "verdict": found["verdict"],
        "effects_added": found["effects_added"],
        "dropped": found["dropped"],
        "candidate_set": found["candidate_set"],
        "gate": found["gate"],
        "candidates": found["candidates"],
        "local_rules": found["local_rules"],
        "error": {
            "calibration": {
                "before": calibration["before"],
                "after": calibration["after"],
            },
            "held_out": {
                "before": held_out["before"],
                "after": held_out["after"],
                "ratio": ratio,
                "ratio_interval_90": interval,
            },
            "recalibrated_only": {
                "calibration": calibration["recalibrated_only"],
                "held_out": held_out["recalibrated_only"],
            },
            "gaussian_process": {
                "calibration": calibration["gaussian_process"],
                "held_out": held_out["gaussian_process"],
            },
        },
        "parameters": found["parameters"],
        "next_measurement": found["next_measurement"],
        "possible_measurements": found["possible_measurements"],
        "noise_floor": found["noise"],
        "held_out_is": _kind(problem),
        "folds": [
            {key: fold[key] for key in ("name", "verdict", "added", "not_predictable")}
            | {"error": _fold_error(model, measured, fold)}
            for fold in folds
        ],
        "sharing": _sharing(problem, measured, points["after"], folds),
        "degrees_of_freedom": found["degrees_of_freedom"],
        "untestable_parameters": found["untestable_parameters"],
        "candidates_left": found["candidates_left"],
        "evidence": found["evidence"],
        "replicate_count": {"simulated": model.simulated + found["replicates_simulated"]},
        "seeds": {case.experiment.name: case.experiment.seed for case in model.cases},
        "versions": {"pipeline": __version__},
        "data_labels": sorted(
            {study.data.label if study.data else c.experiment.data_label for c in model.cases}
        ),
        "settings": resolved(study),
    }
    predictions = {
        "study": study.name,
        "unit": "as measured: kPa for stresses",
        "rows": [
            _place(model, i)
            | {"measured": measured[i].value}
            | {name: _plain(model, i, pooled[name][k]) for name in VARIANTS}
            for k, i in enumerate(rows)
        ],
    }
    return document, predictions


def _own_errors(problem: Problem, measured, start: xr.Dataset, found) -> dict[str, dict]:
    """Errors on the fitted readings, by variant."""
    model, data = problem.model.only(problem.data.use), problem.data
    baseline, here = resumed(problem, start)
    expected = {
        "before": np.array(found["baseline"]["expected"]),
        "after": np.array(found["final"]["expected"]),
        "recalibrated_only": _recalibrated(problem, data, baseline, data.use)[data.use],
    }
    gp = correction(model, data, here, baseline.residual, data.use)
    expected["gaussian_process"] = expected["before"] + gp
    return {name: errors(model, measured, data.use, rows) for name, rows in expected.items()}


def _fold(problem: Problem, fold: Fold, start: xr.Dataset, points) -> dict[str, Any]:
    """Predictions of a fold's held-out rows by a loop that never saw them."""
    study, model = problem.study, problem.model
    rows = predictable(problem, fold)
    left_out = sorted({int(model.case_of[i]) for i in fold.held_out if i not in rows})
    if problem.leaves_one_out:
        data = subset(problem, fold.fitted)
        outcome = close(study, model, data)
        first, last = outcome.rounds[0], outcome.rounds[-1]
        before, here, ends = first.fit, first.noise, (first.fit.point, last.fit.point)
        verdict, added = outcome.verdict, [e.hypothesis.label for e in outcome.added]
    else:
        data = problem.data
        before, here = resumed(problem, start)
        ends = points["before"], points["after"]
        verdict, added = "", []
    expected = {name: np.zeros(0) for name in VARIANTS}
    if rows:
        places = np.array(rows)
        old, new = (predicted(model, end, rows)[places] for end in ends)
        gp = correction(model, data, here, before.residual, places)
        expected = {
            "before": old,
            "after": new,
            "recalibrated_only": old
            if study.parameters
            else _recalibrated(problem, data, before, places)[places],
            "gaussian_process": old + gp,
        }
    return {
        "name": fold.name,
        "rows": rows,
        "expected": expected,
        "verdict": verdict,
        "added": added,
        "not_predictable": [model.cases[case].experiment.name for case in left_out],
        "data": data,
    }


def _recalibrated(problem: Problem, data: Data, before: Fit, rows) -> np.ndarray:
    """Expected rows when nothing is added and E may be what it likes in each material.

    Where the study calibrates parameters of its own, that is the baseline itself.
    """
    if problem.study.parameters:
        return before.expected
    model = problem.model
    free = Model(model.cases, (Shared(name="E", shared_by="material"),), model.execution)
    found, _ = calibrated(free.only(data.use), data, free.start)
    return predicted(free, found.point, rows)


def _sharing(
    problem: Problem, measured: Sequence[MeasuredRow], after: Point, folds: Sequence[dict]
) -> list[dict[str, Any]]:
    """Each added effect with several values once more with one value for the whole study."""
    model, data = problem.model, problem.data
    alternatives = []
    for name in dict.fromkeys(t.effect for t in after.terms):
        keys = [t for t in after.terms if t.effect == name]
        if len(keys) < 2 or effects()[name].scope == "load_cell" or keys[0].options:
            continue
        if len({t.key for t in keys}) < 2:
            continue
        starts, fitted = [_shared_point(after, name)], {}
        own = {fold["name"]: fold["data"] for fold in folds} if problem.leaves_one_out else {}
        for label, fold_data in ({"calibration": data} | own).items():
            view = model.only(fold_data.use)
            ends = [calibrated(view, fold_data, start)[0] for start in starts]
            fitted[label] = min(ends, key=lambda found: found.cost).point
            starts = [starts[0], fitted["calibration"]]  # the first may end in a minimum nearby
        expected = predicted(model, fitted["calibration"], data.use)
        entry = {
            "name": name,
            "scope": "study",
            "parameters": {
                t.parameter: {"value": a, "unit": t.described.unit}
                for t, a in zip(
                    fitted["calibration"].terms, fitted["calibration"].amplitudes, strict=True
                )
                if t.effect == name
            },
            "unknowns": len(model.coordinates) + len(fitted["calibration"].terms),
            "readings": len(data.use),
            "calibration": errors(model, measured, data.use, expected[data.use]),
            "held_out": None,
        }
        if problem.leaves_one_out:
            rows, parts = [], []
            for fold in folds:
                if fold["rows"]:
                    part = predicted(model, fitted[fold["name"]], fold["rows"])
                    rows += fold["rows"]
                    parts.append(part[list(fold["rows"])])
            entry["held_out"] = errors(model, measured, rows, np.concatenate(parts))
        elif folds and folds[0]["rows"]:
            rows = list(folds[0]["rows"])
            part = predicted(model, fitted["calibration"], rows)[rows]
            entry["held_out"] = errors(model, measured, rows, part)
        alternatives.append(entry)
    return alternatives


def _shared_point(point: Point, name: str) -> Point:
    """The same terms, those of one effect joined to one value for the study."""
    kept = [(t, a) for t, a in zip(point.terms, point.amplitudes, strict=True) if t.effect != name]
    own = [(t, a) for t, a in zip(point.terms, point.amplitudes, strict=True) if t.effect == name]
    for parameter in dict.fromkeys(t.parameter for t, _ in own):
        same = [(t, a) for t, a in own if t.parameter == parameter]
        cases = tuple(sorted({case for t, _ in same for case in t.cases}))
        joined = Term(name, parameter, "study", None, cases)
        kept.append((joined, float(np.mean([a for _, a in same]))))
    return Point(point.coordinates, tuple(t for t, _ in kept), tuple(float(a) for _, a in kept))


def _fold_error(model: Model, measured, fold) -> dict[str, Any] | None:
    if not fold["rows"]:
        return None
    return {
        name: errors(model, measured, fold["rows"], fold["expected"][name])
        for name in ("before", "after")
    }


def _kind(problem: Problem) -> str:
    """What the held-out readings are, in words."""
    match problem.folds[0].name:
        case "load cells":
            return "load cells never calibrated on"
        case "tail":
            return "the end of each draw: an extrapolation in mass drawn"
        case "experiments":
            return "whole experiments never calibrated on"
    return "each experiment in turn, by a loop without it"


def _place(model: Model, row: int) -> dict[str, Any]:
    place = model.rows[row]
    return {
        "experiment": model.cases[model.case_of[row]].experiment.name,
        "load_cell": place.load_cell,
        "fill_height": place.fill_height,
        "mass_drawn": place.mass_drawn,
        "quantity": place.quantity,
    }


def _plain(model: Model, row: int, value: float) -> float:
    return float(np.exp(value)) if model.is_log[row] else float(value)
