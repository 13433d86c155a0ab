"""The kernels' speed, and a whole replicate's."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.benchmark.figures import Action, Figure, Target, figures_beside, measure
from pipeline.benchmark.lattices import (
    BULKING,
    CELLS_A_VISIT,
    EXPONENT,
    cube,
    replicate_on,
    triad_over,
)
from pipeline.benchmark.yardsticks import (
    published_sweep,
    published_sweep_by_levels,
    random_reads,
)
from pipeline.config.experiment import Experiment
from pipeline.lattice import flow_reference
from pipeline.lattice.cells import MOVEMENT, STAGNANT
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    LOOSENED_CELLS,
    VOID_STEPS,
    FlowState,
    climb_chances,
    draw_to,
    draw_visits,
    flow_index,
    new_flow_state,
)
from pipeline.lattice.grid import GRAVITY
from pipeline.lattice.ranks import draw_ranks, rank_normals
from pipeline.lattice.spreading import spreading_weights
from pipeline.lattice.stress import AT_HOME, BY_CELL, UNCOUPLED, Ranked, stress_sweep
from pipeline.lattice.stress_reference import stress_sweep_reference
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import Setup, make_setup

READS = 100_000
MINE = 27_000_000  # cells from which the targets of a mine's lattice hold


def static_figures(side: int, repeats: int) -> Iterator[Figure]:
    """The stress sweep, its parts and a whole static replicate, against the triad."""
    setup = make_setup(cube(side))
    shape, cells = setup.code.shape, setup.code.size
    parameters = declared_parameters(setup.experiment)
    rng = np.random.default_rng(1)

    def ranks(_):
        draw_ranks(rng, shape)
        return cells

    rank = draw_ranks(rng, shape)
    s = parameters.s_mean + parameters.s_std * rank_normals()
    edge, corner = spreading_weights(s)
    weight = setup.cell_weight.reshape(shape)
    actions = {
        "STREAM triad": triad_over(cells),
        "ranks of s": Action(ranks),
        "sweep, weights by rank": _sweep(weight, Ranked(rank, np.column_stack([edge, corner]))),
        "sweep, weights by cell": _sweep(weight, (edge[rank], corner[rank])),
        "static replicate": replicate_on(setup),
    }
    goals = {"static replicate": (Target("value", 500e6), Target("ratio", 1 / 6))}
    yield from figures_beside(
        measure(actions, repeats),
        "STREAM triad",
        goals if cells >= MINE else {},
        unit="cells/s",
        shapes=(shape,),
        dtype="float32",
    )


def _sweep(weight: np.ndarray, spreading: Ranked | tuple[np.ndarray, np.ndarray]) -> Action:
    shed = np.full((1, 1, 1), 0.01, weight.dtype)
    code = np.full(weight.shape, STAGNANT)
    nothing, base = np.zeros((0, 0, 0), weight.dtype), np.zeros(weight.shape[1:])
    by_cell, ranked = (nothing, nothing), BY_CELL
    if isinstance(spreading, Ranked):
        ranked = spreading
    else:
        by_cell = spreading

    def run(_):
        stress_sweep(
            weight, shed, *by_cell, code, 1.0, 1.0, nothing, base, UNCOUPLED, AT_HOME, ranked
        )
        return weight.size

    return Action(run)


def reference_figures(side: int, repeats: int) -> Iterator[Figure]:
    """Both kernels against their plain-Python references, on a small lattice."""
    shape = (side, side, side)
    code = np.full(shape, STAGNANT)
    rng = np.random.default_rng(1)
    weight = np.ones(shape, np.float32)
    edge, corner = spreading_weights(4 + 3 * rng.standard_normal(shape, dtype=np.float32))
    shed = np.full_like(weight, 0.01)

    def stress_by_reference(_):
        stress_sweep_reference(weight, shed, edge, corner, code, 1.0, 1.0)
        return weight.size

    actions = {
        "the sweep's plain-Python reference": Action(stress_by_reference),
        "sweep, small lattice": _sweep(weight, (edge, corner)),
    }
    about = {"shapes": (shape,), "unit": "cells/s", "dtype": "float32"}
    yield from figures_beside(measure(actions, repeats), next(iter(actions)), **about)

    middle = side // 2
    weight, cells = np.full(code.size, GRAVITY), min(20, side)  # cells of 1 kg
    chances = climb_chances(EXPONENT)

    def afresh():
        return new_flow_state(code, [[(0, middle, middle)]]), np.random.default_rng(1)

    def drawn_by(draw, law):
        def run(prepared):
            state, stream = prepared
            draw(state, weight, 0, float(cells), law, BULKING, stream)
            return state.counters[VOID_STEPS]

        return Action(run, afresh)

    actions = {
        "the flow's plain-Python reference": drawn_by(flow_reference.draw_to, EXPONENT),
        "flow, small lattice": drawn_by(draw_to, chances),
    }
    about |= {"unit": "void steps/s", "dtype": "int32", "remark": f"{cells} cells drawn"}
    yield from figures_beside(measure(actions, repeats), next(iter(actions)), **about)


def published_figures(side: int, repeats: int) -> Iterator[Figure]:
    """Our sweep of a slice one cell thick against a published 2-D sweep, restated."""
    weight, granular = np.ones((side, side)), np.ones((side, side), bool)
    straight = math.sin(math.radians(30.0))

    def restated(sweep):
        def run(_):
            sweep(weight, granular, straight)
            return weight.size

        return Action(run)

    s = np.full((side, 1, side), 4.0)
    edge, corner = spreading_weights(s, dtype=np.float64)
    for name, sweep in (
        ("published 2-D sweep, our restatement", published_sweep),
        ("the same by levels in NumPy", published_sweep_by_levels),
    ):
        actions = {name: restated(sweep), "sweep, 2-D": _sweep(weight[:, None], (edge, corner))}
        about = {"shapes": ((side, 1, side),), "unit": "cells/s", "dtype": "float64"}
        yield from figures_beside(measure(actions, repeats), name, **about)


def flow_figures(side: int, repeats: int) -> Iterator[Figure]:
    """The flow kernel on a mine's lattice, against random reads of as many int32.

    In moving ground, all of which has been loosened before, each void climbs to the surface; in
    new ground zones grow from the drawpoints, draw by draw. Draw goes on from repeat to repeat.
    """
    setup = make_setup(cube(side, drawn=True))
    weight, points = setup.cell_weight, len(setup.openings)
    mass = float(weight[0]) / GRAVITY
    chances, rng = climb_chances(EXPONENT), np.random.default_rng(1)

    def drawing(state, order, cells):
        def run(_):
            drawn, before = state.counters[[DRAWN_CELLS, VOID_STEPS]]
            start = state.drawn_mass[drawn - 1] if drawn else 0.0
            ends = start + cells * mass * np.arange(1, len(order) + 1)
            lacking = np.zeros(points)
            draw_visits(state, weight, order, ends, 0.0, lacking, chances, BULKING, rng)
            return state.counters[VOID_STEPS] - before

        return Action(run)

    values = np.full(setup.code.size, 0, np.int32)
    position = np.uint64(1)

    def reads(_):
        nonlocal position
        position = np.uint64(random_reads(values, READS, position))
        return READS

    new, moving = new_flow_state(setup.code, setup.openings), _all_loosened(setup)
    in_turn, cells = np.arange(points), min(CELLS_A_VISIT, side)
    elsewhere = np.cumsum(rng.integers(1, points, points * cells)) % points
    actions = {
        "random reads": Action(reads),
        "flow, a mine's schedule, moving ground": drawing(moving, in_turn, cells),
        "flow, a mine's schedule, new ground": drawing(new, in_turn, cells),
        "flow, each cell drawn elsewhere, moving ground": drawing(moving, elsewhere, 1),
    }
    goals = {name: (Target("value", 20e6),) for name in actions if "schedule" in name}
    yield from figures_beside(
        measure(actions, repeats),
        "random reads",
        goals if setup.code.size >= MINE else {},
        unit="void steps/s",
        yardstick_unit="reads/s",
        shapes=(setup.code.shape,),
        dtype="int32",
        remark=f"{points} drawpoints, {cells} cells a visit",
    )


def _all_loosened(setup: Setup) -> FlowState:
    """The flow's state when all ground belongs to one movement zone."""
    state = new_flow_state(setup.code, setup.openings)
    state.code[:] = MOVEMENT
    state.zone[:] = 0
    state.zone_root[:] = 0
    state.level_min_x[0], state.level_max_x[0] = 0, state.code.shape[2] - 1
    state.counters[LOOSENED_CELLS] = state.code.size
    return state._replace(index=flow_index(state.code, state.zone, state.zone_root))


def laboratory_figures(repeats: int) -> Iterator[Figure]:
    """0.4 kg drawn in the box of the discrete-element laboratory: ours beside its seconds."""
    drawn, laboratory_seconds = 0.4, 26.0
    slot = {"name": "D4", "x": 0.35, "y": 0.05, "width": 0.06, "length": 0.1}
    places = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    cells = [
        {"name": f"C{i}", "x": x, "y": 0.05, "width": 0.04, "length": 0.1}
        for i, x in enumerate(places, start=1)
    ]
    experiment = Experiment.model_validate(
        {
            "title": "The draw box of the discrete-element laboratory",
            "geometry": {"width": 0.7, "length": 0.1, "height": 0.816, "cell_size": 0.02},
            "material": {"name": "dem_rough", "bulk_density": 1417, "particle_density": 2650},
            "stress": {
                "E": 0.98,
                "s": {"mean": 4, "std": 3},
                "R": 0.5,
                "E_min": {"type": "table", "height": [0], "value": [0.93]},
            },
            "flow": {"exponent": EXPONENT, "bulking": BULKING},
            "drawpoints": [slot],
            "draw": [{"drawpoints": ["D4"], "mass": drawn, "increment": 0.05}],
            "readings": {"every": drawn},
            "load_cells": cells,
            "replicates": 1,
            "seed": 1,
        }
    ).at(Path("draw_box.yaml"))
    setup = make_setup(experiment)
    replicate = replicate_on(setup)

    def run(_):
        replicate.run(None)
        return drawn

    values = measure({"ours": Action(run)}, repeats)["ours"]
    yield Figure(
        "replicate that draws 0.4 kg",
        "kg/s",
        values,
        "discrete elements, 26 s of one core for 0.4 kg",
        np.full(len(values), drawn / laboratory_seconds),
        (setup.code.shape,),
        "float32",
        "two readings; there some 23000 spheres",
        quoted=True,
    )
