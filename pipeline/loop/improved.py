"""The improved model as experiments, so that the next run of the workflow has the effect in it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import reduce
from itertools import pairwise
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pipeline.config.experiment import Experiment
from pipeline.config.load import resolved
from pipeline.config.study import Study
from pipeline.effects import Active, effects
from pipeline.loop.model import Model, Point
from pipeline.parameters import Parameters


def improved_document(
    study: Study,
    experiment: Experiment,
    parameters: Parameters,
    active: tuple[Active, ...],
    at: Path,
) -> dict[str, Any]:
    """An experiment's file with the study's parameters and effects written out.

    `at` is the file that it is for: paths in it are relative to that. Nothing of it is calibrated
    again.
    """
    document = _without_nothing(resolved(experiment))
    document["title"] = f"{experiment.title or experiment.name}, as study {study.name} improves it"
    document["calibrate"] = []
    document["stress"] = _stress(experiment, parameters)
    if parameters.exponent is not None and experiment.is_draw:
        document["flow"] = {"exponent": parameters.exponent, "bulking": parameters.bulking}
    document["effects"] = _effects(active)
    measured = study.data_path or experiment.measured_path
    if measured is not None:
        document["measured"] = _relative(measured, at)
    if study.data is not None:
        document["data_label"] = study.data.label
    for (*parents, key), file in experiment.files.items():
        reduce(getitem, parents, document)[key] = _relative(file, at)
    return document


def improved_text(document: Mapping[str, Any], study: Study) -> str:
    """The document as YAML, with a line that says where it comes from."""
    head = f"# Written by the closed loop of study {study.name}; its parameters and effects.\n"
    return head + yaml.safe_dump(dict(document), sort_keys=False, allow_unicode=True)


def improved_documents(study: Study, model: Model, point: Point, folder: Path) -> dict[str, str]:
    """Text of every experiment's improved file, by name."""
    texts = {}
    for case, subject in enumerate(model.cases):
        experiment = subject.experiment
        at = folder / f"{experiment.name}.yaml"
        document = improved_document(study, experiment, *model.at(point, case), at)
        texts[experiment.name] = improved_text(document, study)
    return texts


def _stress(experiment: Experiment, parameters: Parameters) -> dict[str, Any]:
    stress = {
        "E": parameters.E,
        "s": {"mean": parameters.s_mean, "std": parameters.s_std},
        "rule": experiment.stress.rule,
    }
    if experiment.is_draw:
        stress["R"] = parameters.R
    if parameters.E_min is not None:
        law = parameters.E_min.model_dump(mode="json")
        factor = math.exp(parameters.E_min_shift)

        def shifted(value: float) -> float:
            return min(max(1.0 - factor * (1.0 - value), 0.0), parameters.E)

        value = law["value"]
        if isinstance(value, list):
            heights = _with_crossings(
                law["height"], [1.0 - factor * (1.0 - v) for v in value], parameters.E
            )
            law["height"] = heights
            law["value"] = [float(shifted(v)) for v in np.interp(heights, *_knots(parameters))]
        else:
            law["value"] = shifted(value)
            if law["value"] in (0.0, parameters.E) and law["exponent"] and value < 1.0:
                left = factor * (1.0 - value) / (1.0 - law["value"])  # what the bounds cut off
                law["at_height"] *= left ** (1.0 / law["exponent"])
        stress["E_min"] = law
    return stress


def _knots(parameters: Parameters) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return parameters.E_min.height, parameters.E_min.value


def _with_crossings(heights: list[float], values: list[float], E: float) -> list[float]:
    """Heights of a table, and those between them at which its values meet 0 or E."""
    knots = list(heights)
    for (low, a), (high, b) in pairwise(zip(heights, values, strict=True)):
        for bound in (0.0, E):
            if (a - bound) * (b - bound) < 0.0:
                knots.append(low + (high - low) * (bound - a) / (b - a))
    return sorted(knots)


def _effects(active: tuple[Active, ...]) -> dict[str, Any]:
    block: dict[str, Any] = {}
    for one in active:
        if one.is_neutral:
            continue
        values = dict(one.values)
        if effects()[one.name].scope == "load_cell":
            block.setdefault(one.name, {})[one.load_cell] = values
        else:
            block[one.name] = values
    return block


def _relative(path: Path, at: Path) -> str:
    return Path(os.path.relpath(path.resolve(), at.parent.resolve())).as_posix()


def _without_nothing(value: Any) -> Any:
    """The same without keys that hold nothing."""
    if isinstance(value, dict):
        return {k: _without_nothing(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [_without_nothing(v) for v in value]
    return value
