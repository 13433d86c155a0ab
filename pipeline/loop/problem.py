"""A study taken apart: what may be fitted, and what is held out, kept in different hands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.config.load import check_measured, is_held_out, load_experiment
from pipeline.config.measured import MeasuredRow, read_measured
from pipeline.config.study import HeldOutLoadCells, HeldOutTail, Study
from pipeline.loop.data import Data, observed
from pipeline.loop.model import Case, Model, declared_of
from pipeline.montecarlo.workers import Execution


@dataclass(frozen=True)
class Fold:
    """A split: rows to fit and rows to predict, as numbers among the model's rows."""

    name: str
    fitted: tuple[int, ...]
    held_out: tuple[int, ...]


@dataclass(frozen=True)
class Problem:
    """A study with its model, the values that all fits may see, and its splits.

    `data` are the readings that the verdict comes from. `folds` are what held-out errors come
    from: one where the study names what is held out, one for each experiment under leave-one-out.
    """

    study: Study
    model: Model
    data: Data
    folds: tuple[Fold, ...]

    @property
    def leaves_one_out(self) -> bool:
        """Whether every experiment is held out in turn."""
        return self.study.hold_out == "leave_one_out"


def load_problem(
    study: Study, files: Sequence[str | Path], workers: int = 1
) -> tuple[Problem, dict[str, Experiment]]:
    """The problem of a study, and its experiments from their files by name."""
    experiments = {Path(file).stem: load_experiment(Path(file)) for file in files}
    return make_problem(study, experiments, Execution(workers)), experiments


def measured_rows(study: Study, experiments: Mapping[str, Experiment]) -> list[MeasuredRow]:
    """Measured rows of all the study's experiments, in the model's order."""
    return [row for name in study.experiments for row in _rows(study, experiments[name])]


def make_problem(
    study: Study,
    experiments: Mapping[str, Experiment],
    execution: Execution = Execution(),
) -> Problem:
    """The study's model and splits.

    `experiments` holds those of the study and what their `stress: {from: NAME}` refer to. The
    model gets the rows without their values, and `Problem.data` only those that are not held out:
    what is held out stays in its file until `scores` opens it again.
    """
    rows = {name: _rows(study, experiments[name]) for name in study.experiments}
    cases = tuple(
        Case(
            experiments[name],
            tuple(replace(row, value=math.nan, std=math.nan, std_shared=math.nan) for row in own),
            declared_of(experiments, name),
        )
        for name, own in rows.items()
    )
    model = Model(cases, study.parameters, execution)
    folds = tuple(_folds(study, model))
    every = range(len(model.rows))
    fitted = every if study.hold_out == "leave_one_out" else folds[0].fitted
    measured = [row for own in rows.values() for row in own]
    return Problem(study, model, observed(model, measured, list(fitted)), folds)


def subset(problem: Problem, rows: Sequence[int]) -> Data:
    """The part of the problem's data that a fold may see."""
    kept = np.isin(problem.data.use, rows)
    data = problem.data
    return Data(
        use=data.use[kept],
        y=data.y[kept],
        independent=data.independent[kept],
        shared=data.shared[np.ix_(kept, kept)],
        scatter=data.scatter[kept],
    )


def predictable(problem: Problem, fold: Fold) -> tuple[int, ...]:
    """Held-out rows all of whose parameters have other data in the fold."""
    model = problem.model
    fitted = {int(model.case_of[i]) for i in fold.fitted}
    without = {
        case
        for coordinate in model.coordinates
        if not fitted & set(coordinate.cases)
        for case in coordinate.cases
    }
    return tuple(i for i in fold.held_out if int(model.case_of[i]) not in without)


def _rows(study: Study, experiment: Experiment) -> tuple[MeasuredRow, ...]:
    if study.data is not None:
        return read_measured(study.data_path, experiment)
    return check_measured(experiment)


def _folds(study: Study, model: Model) -> Iterator[Fold]:
    every = range(len(model.rows))
    names = [model.cases[case].experiment.name for case in model.case_of]

    def split(name: str, held_out: Callable[[int], bool]) -> Fold:
        out = tuple(i for i in every if held_out(i))
        return Fold(name, tuple(i for i in every if not held_out(i)), out)

    if study.hold_out == "leave_one_out":
        for name in study.experiments:
            yield split(name, lambda i, name=name: names[i] == name)
        return
    kinds = {HeldOutLoadCells: "load cells", HeldOutTail: "tail"}
    kind = kinds.get(type(study.hold_out), "experiments")
    yield split(kind, lambda i: is_held_out(study, names[i], model.rows[i]))
