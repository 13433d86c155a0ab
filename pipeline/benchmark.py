"""`python -m pipeline.benchmark`: the kernels' speed and memory, each beside a yardstick.

A figure is a ratio taken in one run: what is measured and its yardstick run in turn, and the
median of the paired ratios is what counts. Nothing here fails for being slow: a target is met or
missed, and both are said. `docs/speed.md` tells how to read it.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import multiprocessing
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import psutil

from pipeline.config.experiment import Experiment
from pipeline.lattice import flow_reference
from pipeline.lattice.block_model import build_block_model
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
from pipeline.lattice.spreading import draw_ranks, rank_normals, spreading_weights
from pipeline.lattice.stress import AT_HOME, BY_CELL, UNCOUPLED, Ranked, stress_sweep
from pipeline.lattice.stress_reference import stress_sweep_reference
from pipeline.montecarlo.parts import Collected
from pipeline.montecarlo.replicates import Run, run_part
from pipeline.montecarlo.workers import Crew, Execution, crew
from pipeline.parameters import declared_parameters
from pipeline.simulate import Setup, make_setup, simulate
from pipeline.yardsticks import (
    published_sweep,
    published_sweep_by_levels,
    random_reads,
    triad,
)

LEAST_SECONDS = 0.005  # a timing goes over as many calls as take so long
CELL_SIZE, BULK_DENSITY = 1.0, 1600.0  # m, kg m-3
EXPONENT, BULKING = 3.0, 0.15
APART, OPENING = 15, 4  # drawpoints, cells: their distance and side
CELLS_A_VISIT = 40
READS = 100_000
MINE = 27_000_000  # cells from which the targets of a mine's lattice hold
HUGE = 99_000_000  # and those of the largest
TESTED, MANY = 37, 10_000  # side of a lattice of 50 000 cells; replicates that targets are for
TASKS = 8


class Sizes(NamedTuple):
    """Sides of the cubic lattices, in cells, how often each figure is taken, and of how many
    replicates those of processes and Dask are."""

    static: tuple[int, ...]
    flow: tuple[int, ...]
    reference: int
    plane: int
    memory: int
    scaling: tuple[int, ...]
    repeats: int
    replicates: int = 400


QUICK = Sizes((37, 100), (64, 100), 12, 60, 144, (46, 67, 100, 144), 5)
FULL = Sizes((37, 100, 300), (64, 300), 12, 60, 215, (46, 67, 100, 144, 215, 300, 464), 7, 10_000)


class Target(NamedTuple):
    """A bound on the median of a figure's "value" or "ratio"; the least, or the most."""

    of: str
    bound: float
    is_most: bool = False

    def is_met(self, median: float) -> bool:
        """Whether a median keeps within the bound."""
        return median <= self.bound if self.is_most else median >= self.bound


@dataclass(frozen=True)
class Figure:
    """Something measured beside a yardstick, both (repeat); units are SI, rates per second."""

    name: str
    unit: str
    values: np.ndarray
    yardstick: str
    yardstick_values: np.ndarray
    shapes: tuple[tuple[int, ...], ...]
    dtype: str
    remark: str = ""
    targets: tuple[Target, ...] = ()
    quoted: bool = False  # the yardstick was not measured here
    yardstick_unit: str | None = None  # None: as the figure's

    @property
    def ratios(self) -> np.ndarray:
        """Value over yardstick, repeat by repeat."""
        return self.values / self.yardstick_values

    def document(self) -> dict[str, Any]:
        """As JSON-able data."""
        parts = {"value": _spread(self.values), "ratio": _spread(self.ratios)}
        return {
            "name": self.name,
            "unit": self.unit,
            "value": parts["value"],
            "yardstick": {
                "name": self.yardstick,
                "quoted": self.quoted,
                "unit": self.unit if self.yardstick_unit is None else self.yardstick_unit,
                **_spread(self.yardstick_values),
            },
            "ratio": parts["ratio"],
            "sizes": {
                "shapes": [list(shape) for shape in self.shapes],
                "cells": [math.prod(shape) for shape in self.shapes],
                "remark": self.remark,
            },
            "dtype": self.dtype,
            "repeats": len(self.values),
            "targets": [
                {
                    "of": target.of,
                    "bound": target.bound,
                    "is": "most" if target.is_most else "least",
                    "met": target.is_met(parts[target.of]["median"]),
                }
                for target in self.targets
            ],
        }


def _spread(values: np.ndarray) -> dict[str, float]:
    return {name: float(getattr(np, name)(values)) for name in ("min", "median", "max")}


# ---------------------------------------------------------------------------------------------
# timing


class Action(NamedTuple):
    """`run(prepared)` returns how much it did; `prepare()` is not timed."""

    run: Callable[[Any], float]
    prepare: Callable[[], Any] = lambda: None


def measure(actions: Mapping[str, Action], repeats: int) -> dict[str, np.ndarray]:
    """Rates (repeat) of actions that take turns, in what they did a second.

    In a repeat each is called as often as it takes to fill `LEAST_SECONDS`; finding out how often
    warms it up.
    """
    calls = {}
    for name, action in actions.items():
        _rate(action, 1)
        calls[name] = 1
        while _rate(action, calls[name])[1] < LEAST_SECONDS:
            calls[name] *= 2
    rounds = [
        [_rate(action, calls[name])[0] for name, action in actions.items()] for _ in range(repeats)
    ]
    return dict(zip(actions, np.array(rounds).T, strict=True))


def _rate(action: Action, calls: int) -> tuple[float, float]:
    done = seconds = 0.0
    for _ in range(calls):
        prepared = action.prepare()
        start = time.perf_counter()
        done += action.run(prepared)
        seconds += time.perf_counter() - start
    return done / seconds, seconds


def _figures(
    rates: Mapping[str, np.ndarray], yardstick: str, targets: Mapping = {}, **about
) -> Iterator[Figure]:
    """A figure for each of some rates but their yardstick's."""
    for name, values in rates.items():
        if name != yardstick:
            about["targets"] = targets.get(name, ())
            yield Figure(
                name, values=values, yardstick=yardstick, yardstick_values=rates[yardstick], **about
            )


def _triad(cells: int) -> Action:
    a, b, c = (np.full(cells, value, np.float32) for value in (0.0, 1.0, 2.0))

    def run(_):
        triad(a, b, c, np.float32(3.0))
        return cells

    return Action(run)


# ---------------------------------------------------------------------------------------------
# lattices


def cube(side: int, drawn: bool = False) -> Experiment:
    """A cube of `side` cells of 1 m, at rest or drawn as a mine is.

    Drawn: up to ten by ten drawpoints of 4 × 4 cells, 15 cells apart in the middle of the base,
    each drawn in turn, 40 cells a visit; one round.
    """
    extent = side * CELL_SIZE
    content = {
        "title": "A cube",
        "geometry": {name: extent for name in ("width", "length", "height")},
        "material": {"name": "rock", "bulk_density": BULK_DENSITY, "particle_density": 2700},
        "stress": {"E": 0.99, "s": {"mean": 4, "std": 3}},
        "replicates": 1,
        "seed": 1,
    }
    content["geometry"]["cell_size"] = CELL_SIZE
    if drawn:
        abreast = max(2, min(10, side // APART))
        apart = min(APART, side // abreast)
        opening = min(OPENING, apart)
        first = (side - (abreast - 1) * apart - opening) // 2 + opening / 2
        places = [CELL_SIZE * (first + i * apart) for i in range(abreast)]
        size = {"width": opening * CELL_SIZE, "length": opening * CELL_SIZE}
        points = [
            {"name": f"D{j}_{i}", "x": x, "y": y, **size}
            for j, y in enumerate(places)
            for i, x in enumerate(places)
        ]
        visit = min(CELLS_A_VISIT, side) * BULK_DENSITY * CELL_SIZE**3
        names = [point["name"] for point in points]
        content["stress"] |= {
            "R": 0.3,
            "E_min": {"type": "power", "at_height": extent, "value": 0.9},
        }
        content["flow"] = {"exponent": EXPONENT, "bulking": BULKING}
        content["drawpoints"] = points
        content["draw"] = [{"drawpoints": names, "mass": visit * len(names), "increment": visit}]
        content["readings"] = {"every": visit * len(names)}
    return Experiment.model_validate(content).at(Path("cube.yaml"))


def _setup(experiment: Experiment) -> Setup:
    return make_setup(experiment, build_block_model(experiment))


def _replicate(setup: Setup) -> Action:
    parameters = declared_parameters(setup.experiment)
    packing, flow = np.random.default_rng(1), np.random.default_rng(2)

    def run(_):
        simulate(setup, parameters, packing, flow)
        return setup.code.size

    return Action(run)


# ---------------------------------------------------------------------------------------------
# figures


def static_figures(side: int, repeats: int) -> Iterator[Figure]:
    """The stress sweep, its parts and a whole static replicate, against the triad."""
    setup = _setup(cube(side))
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
        "STREAM triad": _triad(cells),
        "ranks of s": Action(ranks),
        "sweep, weights by rank": _sweep(weight, Ranked(rank, np.column_stack([edge, corner]))),
        "sweep, weights by cell": _sweep(weight, (edge[rank], corner[rank])),
        "static replicate": _replicate(setup),
    }
    goals = {"static replicate": (Target("value", 500e6), Target("ratio", 1 / 6))}
    yield from _figures(
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
    yield from _figures(measure(actions, repeats), next(iter(actions)), **about)

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
    yield from _figures(measure(actions, repeats), next(iter(actions)), **about)


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
        yield from _figures(measure(actions, repeats), name, **about)


def flow_figures(side: int, repeats: int) -> Iterator[Figure]:
    """The flow kernel on a mine's lattice, against random reads of as many int32.

    In moving ground, all of which has been loosened before, each void climbs to the surface; in
    new ground zones grow from the drawpoints, draw by draw. Draw goes on from repeat to repeat.
    """
    setup = _setup(cube(side, drawn=True))
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
    yield from _figures(
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
    setup = _setup(experiment)
    replicate = _replicate(setup)

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


# ---------------------------------------------------------------------------------------------
# memory, and time against cells


class Memory(NamedTuple):
    """Bytes a cell beyond what the process held before: most at a time, as resident memory."""

    yardstick: float
    making: float
    replicate: float


def resident_memory(side: int, drawn: bool) -> Memory:
    """What a cube takes of this process, which has to be a fresh one.

    Most while its setup is made and during a replicate, the setup included; and, as yardstick,
    three float32 arrays of as many cells. Resident memory is looked at every millisecond.
    """
    _replicate(_setup(cube(8, drawn))).run(None)  # what kernels take once
    cells = side**3
    gc.collect()
    before = psutil.Process().memory_info().rss
    with _Peak() as arrays:
        held = [np.full(cells, value, np.float32) for value in (0.0, 1.0, 2.0)]
    del held
    with _Peak() as making:
        setup = _setup(cube(side, drawn))
    gc.collect()
    with _Peak() as replicate:
        _replicate(setup).run(None)
    return Memory(*((peak.bytes - before) / cells for peak in (arrays, making, replicate)))


class _Peak:
    """The most resident memory, in bytes, while it is open."""

    def __enter__(self) -> _Peak:
        self.bytes = 0
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._look()
        self._closed.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._closed.wait(0.001):
            self._look()

    def _look(self) -> None:
        self.bytes = max(self.bytes, psutil.Process().memory_info().rss)


def memory_figures(side: int, repeats: int) -> tuple[list[Figure], Memory]:
    """Memory of a static and of a draw replicate; and that of the static one."""
    spawn = multiprocessing.get_context("spawn")
    found = []
    for _ in range(repeats):
        pair = []
        for drawn in (False, True):
            with ProcessPoolExecutor(1, spawn) as fresh:
                pair.append(fresh.submit(resident_memory, side, drawn).result())
        found.append(pair)
    static, draw = (np.array(part) for part in zip(*found, strict=True))
    about = {
        "unit": "bytes/cell",
        "yardstick": "three arrays, measured alike",
        "shapes": ((side, side, side),),
        "dtype": "float32",
    }
    figures = [
        Figure(
            "memory of a static replicate",
            values=static[:, 2],
            yardstick_values=static[:, 0],
            targets=(Target("value", 16.0, is_most=True),),
            **about,
        ),
        Figure(
            "memory that a draw replicate adds",
            values=draw[:, 2] - static[:, 2],
            yardstick_values=draw[:, 0],
            targets=(Target("value", 12.0, is_most=True),),
            **about,
        ),
    ]
    return figures, Memory(*np.median(static, axis=0))


def scaling_figures(
    sides: tuple[int, ...], repeats: int, memory: Memory, skipped: list[str]
) -> Iterator[Figure]:
    """Power of the wall time of static replicates against cells, beside the triad's.

    Sizes whose need would not fit into four fifths of the free memory are left out, with a line
    in `skipped`.
    """
    shapes, ours, yardsticks = [], [], []
    for side in sides:
        need = side**3 * (max(memory.making, memory.replicate) + memory.yardstick)
        free = psutil.virtual_memory().available
        if need > 0.8 * free:
            skipped.append(
                f"static replicate of {side**3} cells: needs some {need / 1e9:.1f} GB, "
                f"{free / 1e9:.1f} GB are free"
            )
            continue
        setup = _setup(cube(side))
        actions = {"triad": _triad(side**3), "replicate": _replicate(setup)}
        rates = measure(actions, repeats)
        shapes.append(setup.code.shape)
        ours.append(side**3 / rates["replicate"])
        yardsticks.append(side**3 / rates["triad"])
        del setup, actions

    cells = [math.prod(shape) for shape in shapes]

    def powers(seconds):
        return np.polyfit(np.log(cells), np.log(seconds), 1)[0]

    target = (Target("value", 1.05, is_most=True),) if cells[-1] >= HUGE else ()
    yield Figure(
        "power of wall time against cells, static replicate",
        "",
        powers(ours),
        "STREAM triad's power",
        powers(yardsticks),
        tuple(shapes),
        "float32",
        targets=target,
    )
    for shape, seconds, yardstick in zip(shapes, ours, yardsticks, strict=True):
        yield Figure(
            "wall time of a static replicate",
            "s",
            seconds,
            "STREAM triad",
            yardstick,
            (shape,),
            "float32",
        )


# ---------------------------------------------------------------------------------------------
# replicates in processes and on Dask


def replicates_figures(side: int, count: int, repeats: int) -> Iterator[Figure]:
    """The same tasks, fields and all, in this process, by two threads or processes, and on Dask.

    Dask's workers are processes of one thread on this machine; they run, and have what tasks
    share, before the time is taken. What Dask costs is what one of its workers takes longer than
    this process does.
    """
    setup = _setup(cube(side))
    run = Run(setup, declared_parameters(setup.experiment))
    bounds = np.linspace(0, count, TASKS + 1).astype(int).tolist()

    def tasks(workers: Crew) -> Action:
        def act(_):
            collected = Collected()
            for _, part in workers.each(run_part, list(pairwise(bounds)), run):
                if part.sums is not None:
                    part.sums.setup = setup
                collected.add(part)
            return collected.count

        return Action(act)

    here, threads = crew(Execution(1)), crew(Execution(2))
    processes = crew(Execution(2), processes=True)
    with here as one, threads as two_threads, processes as two, ExitStack() as stack:
        one_of_dask, two_of_dask = (stack.enter_context(_dask_crew(n)) for n in (1, 2))
        about = {
            "unit": "replicates/s",
            "shapes": (setup.code.shape,),
            "dtype": "float32",
            "remark": f"{count} replicates in {TASKS} tasks",
        }
        is_large = count >= MANY
        rates = measure(
            {
                "replicates in this process": tasks(one),
                "by two threads": tasks(two_threads),
                "by two processes": tasks(two),
                "on Dask, one worker process": tasks(one_of_dask),
                "on Dask, two worker processes": tasks(two_of_dask),
            },
            repeats,
        )
    dask = ("on Dask, one worker process", "on Dask, two worker processes")
    goals = {
        "by two processes": (Target("ratio", 1.85),),
        dask[0]: (Target("ratio", 1 / 1.05),),
        dask[1]: (Target("ratio", 1.85),),
    }
    goals = goals if is_large else {}
    local = {name: values for name, values in rates.items() if name != dask[1]}
    yield from _figures(local, "replicates in this process", goals, **about)
    yield from _figures({name: rates[name] for name in dask}, dask[0], goals, **about)


@contextmanager
def _dask_crew(workers: int) -> Iterator[Crew]:
    from distributed import LocalCluster

    with (
        LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
        ) as cluster,
        crew(Execution(scheduler=cluster.scheduler_address)) as ready,
    ):
        yield ready


# ---------------------------------------------------------------------------------------------
# all of it


def run_benchmark(sizes: Sizes) -> dict[str, Any]:
    """Machine, figures and what was left out, as JSON-able data."""
    start = time.perf_counter()
    machine = describe_machine()
    repeats, skipped = sizes.repeats, []
    figures: list[Figure] = []
    for side in sizes.static:
        figures += static_figures(side, repeats)
    figures += reference_figures(sizes.reference, min(repeats, 3))
    figures += published_figures(sizes.plane, repeats)
    for side in sizes.flow:
        figures += flow_figures(side, repeats)
    figures += laboratory_figures(repeats)
    figures += replicates_figures(TESTED, sizes.replicates, min(repeats, 3))
    memory, of_static = memory_figures(sizes.memory, min(repeats, 2))
    figures += memory
    figures += scaling_figures(sizes.scaling, min(repeats, 3), of_static, skipped)
    return {
        "machine": machine,
        "lattices": sizes._asdict(),
        "figures": [figure.document() for figure in figures],
        "skipped": skipped,
        "seconds": time.perf_counter() - start,
    }


def describe_machine() -> dict[str, Any]:
    """What the figures hang on; what the machine does not tell is None or left out."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    caches = {}
    for cache in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        level, kind, size = (
            (cache / part).read_text().strip() for part in ("level", "type", "size")
        )
        caches[f"L{level} {kind.lower()}"] = size
    return {
        "processor": models[0] if models else platform.processor() or None,
        "cores": os.cpu_count(),
        "caches": caches,
        "memory_bytes": psutil.virtual_memory().total,
        "load_average": list(psutil.getloadavg()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }


def as_table(document: Mapping[str, Any]) -> str:
    """The document for people: a line on the machine, a table, what was left out."""
    machine = document["machine"]
    caches = ", ".join(f"{name} {size}" for name, size in machine["caches"].items())
    head = (
        f"{machine['processor']}, {machine['cores']} cores ({caches or 'caches unknown'}); "
        f"{machine['memory_bytes'] / 1e9:.0f} GB; "
        f"load at the start {machine['load_average'][0]:.2f}; "
        f"Python {machine['python']}, NumPy {machine['numpy']}, numba {machine['numba']}"
    )
    rows, groups = [("", "median", "min–max", "ratio", "min–max", "target")], []
    for figure in document["figures"]:
        value, ratio, yardstick = figure["value"], figure["ratio"], figure["yardstick"]
        scale, unit = _scaled(figure["unit"])
        scale_beside, unit_beside = _scaled(yardstick["unit"])
        quoted = "quoted" if yardstick["quoted"] else _range(yardstick, scale_beside)
        median = f"{scale_beside * yardstick['median']:.4g} {unit_beside}".rstrip()
        groups.append(
            f"{_words(figure['sizes'])}, {figure['dtype']}, {figure['repeats']} repeats; "
            f"yardstick: {yardstick['name']}, {median} ({quoted})"
        )
        targets = figure["targets"]
        rows.append(
            (
                "  " + figure["name"],
                f"{scale * value['median']:.4g} {unit}",
                _range(value, scale),
                f"{ratio['median']:.3g}",
                _range(ratio),
                "; ".join(_judged(target, scale, unit) for target in targets),
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    title, *text = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    table = [title]
    for group, before, row in zip(groups, [None, *groups], text, strict=False):
        table += [row] if group == before else [group, row]
    left_out = [f"left out: {reason}" for reason in document["skipped"]]
    return "\n".join([head, "", *table, "", *left_out, f"took {document['seconds']:.0f} s"])


def _words(sizes: Mapping[str, Any]) -> str:
    words = ", ".join(f"{cells:.3g}" for cells in sizes["cells"])
    if len(sizes["shapes"]) == 1:
        words = " × ".join(map(str, sizes["shapes"][0])) + f" = {sizes['cells'][0]}"
    return f"{words} cells" + (f", {sizes['remark']}" if sizes["remark"] else "")


def _scaled(unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a rate."""
    if unit in ("cells/s", "void steps/s", "reads/s"):
        return 1e-6, f"M {unit}"
    return 1.0, unit


def _range(spread: Mapping[str, float], scale: float = 1.0) -> str:
    return f"{scale * spread['min']:.3g}–{scale * spread['max']:.3g}"


def _judged(target: Mapping[str, Any], scale: float, unit: str) -> str:
    bound = f"{target['bound']:.3g} of the yardstick"
    if target["of"] == "value":
        bound = f"{scale * target['bound']:.3g} {unit}".rstrip()
    return f"at {target['is']} {bound}: {'met' if target['met'] else 'missed'}"


def main(arguments: list[str]) -> int:
    """The command line; always 0, since a missed target is a result."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.benchmark", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print data instead of a table")
    parser.add_argument("--quick", action="store_true", help="small lattices, under a minute")
    asked = parser.parse_args(arguments)
    document = run_benchmark(QUICK if asked.quick else FULL)
    print(json.dumps(document, indent=2) if asked.json else as_table(document))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
