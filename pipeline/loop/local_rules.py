"""Derivatives of the readings by every local rule, for the price of one adjoint sweep each."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from pipeline.effects import State
from pipeline.effects._features import FEATURES
from pipeline.effects.local_rule import CHANNELS, WEIGHT_PART
from pipeline.lattice.adjoint import Influence
from pipeline.loop.hypotheses import Hypothesis
from pipeline.loop.model import Model, Point
from pipeline.montecarlo.streams import LOOP_PACKING
from pipeline.montecarlo.workers import run_tasks
from pipeline.sensitivity.footprints import row_gradients
from pipeline.simulate.sweeps import Sweep

REPLICATES = 4


def rule_slopes(model: Model, point: Point, rules: Sequence[Hypothesis]) -> np.ndarray:
    """Derivatives (row, rule) of the model's rows by the rules' amplitudes, at amplitude 0."""
    wanted = [dict(rule.terms[0].options) for rule in rules]
    channels, features = list(CHANNELS), list(FEATURES)
    columns = [
        channels.index(w["channel"]) * len(features) + features.index(w["feature"]) for w in wanted
    ]
    jobs = [(c, k) for c in model.active for k in range(min(REPLICATES, model.common(c)))]
    parts = run_tasks([partial(_gradients, model, point, *job) for job in jobs], model.execution)
    whole = np.full((len(model.rows), len(channels) * len(features)), np.nan)
    for case in model.active:
        each = np.array([p for p, job in zip(parts, jobs, strict=True) if job[0] == case])
        whole[model.slices[case]] = model.log_slopes(point, case, each)
    return whole[:, columns]


def _gradients(model: Model, point: Point, case: int, replicate: int) -> np.ndarray:
    """Derivatives (row, channel · feature) of the raw rows of one replicate."""
    setup, parameters, flow_at = model.setup_at(point, case)
    packing = model.stream(LOOP_PACKING, case, replicate)
    flow = model.flow(case, flow_at, replicate) if setup.masses else None
    at_rest: dict[int, np.ndarray] = {}

    def project(sweep: Sweep, state: State, found: Influence) -> np.ndarray:
        levels = len(sweep.code)
        features = at_rest.get(levels)
        if features is None or setup.masses:
            features = at_rest[levels] = np.array(
                [np.broadcast_to(f(state), sweep.code.shape).ravel() for f in FEATURES.values()]
            )
        by_shed = found.shed * sweep.shed_fraction
        if found.own_shed.size:
            by_shed = by_shed + found.own_shed * sweep.coupling.own_shed
        by_weight = WEIGHT_PART * found.weight * sweep.weight
        fields = [by_shed, by_weight, found.relaxation] if setup.masses else [by_shed, by_weight]
        parts = [field.reshape(len(field), -1) @ features.T for field in fields]
        if not setup.masses:
            parts.append(np.zeros_like(parts[0]))
        return np.hstack(parts)

    rows = model.cases[case].rows
    return row_gradients(
        setup, parameters, rows, project, packing, flow, of_relaxation=bool(setup.masses)
    )
