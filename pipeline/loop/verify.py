"""The improved model run like any experiment, beside the baseline that it improves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.config.load import load_experiment
from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.config.study import Study
from pipeline.effects import Active, declared_effects
from pipeline.loop.documents import point_from
from pipeline.loop.problem import Problem
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.workers import Execution
from pipeline.observe import only_measured, simulated_rows
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.setup import make_setup


def improved_runs(
    problem: Problem,
    found: Mapping[str, Any],
    folder: Path,
    measured: Mapping[str, Sequence[MeasuredRow]],
    execution: Execution = Execution(),
) -> dict[str, Any]:
    """Content of `improved.json`: both models against each experiment's measured rows.

    `folder` holds the improved experiments; they run as their files say, on the replicates that a
    plain run has. `found` is the content of `attribution.json`, with the baseline.
    """
    baseline = point_from(found["baseline"]["point"])
    document = {}
    for case, subject in enumerate(problem.model.cases):
        name = subject.experiment.name
        path = folder / f"{name}.yaml"
        improved = load_experiment(path)
        rows = measured[name]
        old = subject.experiment, *problem.model.at(baseline, case)
        new = improved, declared_parameters(improved), declared_effects(improved)
        document[name] = {
            "file": f"{folder.name}/{path.name}",
            "data_label": improved.data_label,
            "before": _compared(*old, rows, execution),
            "after": _compared(*new, rows, execution),
        }
    return {"study": problem.study.name, "schema_version": "1.0", "experiments": document}


def rows_by_experiment(
    study: Study, problem: Problem, measured: Sequence[MeasuredRow]
) -> dict[str, list[MeasuredRow]]:
    """Measured rows of each of the study's experiments."""
    slices = problem.model.slices
    return {n: list(measured[s]) for n, s in zip(study.experiments, slices, strict=True)}


def _compared(
    experiment: Experiment,
    parameters: Parameters,
    active: tuple[Active, ...],
    rows: Sequence[MeasuredRow],
    execution: Execution,
) -> dict[str, Any]:
    """`bias`, `mean_absolute_error` and `rmse` in kPa over stresses, and every reading."""
    setup = make_setup(experiment, rows=rows, effects=active)
    setup = only_measured(setup, rows)
    count = experiment.replicates
    dataset, _ = run_replicates(setup, parameters, count, execution, fields=False)
    values = simulated_rows(experiment, dataset, rows)
    mean = values.mean(axis=0)
    spread = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(len(rows), np.nan)
    in_kpa = np.array([QUANTITIES[row.quantity] == "kPa" for row in rows])
    off = (mean - np.array([row.value for row in rows]))[in_kpa]
    return {
        "bias": float(off.mean()) if off.size else None,
        "mean_absolute_error": float(np.abs(off).mean()) if off.size else None,
        "rmse": float(np.sqrt(np.mean(off**2))) if off.size else None,
        "n": int(off.size),
        "replicates": count,
        "readings": [
            {"measured": row.value, "simulated": float(m), "simulated_std": float(s)}
            for row, m, s in zip(rows, mean, spread, strict=True)
        ],
    }
