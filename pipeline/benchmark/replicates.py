"""What whole replicates take: memory, time against cells, and time by many workers."""

from __future__ import annotations

import gc
import math
import multiprocessing
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import psutil

from pipeline.benchmark.figures import Action, Figure, Target, figures_beside, measure
from pipeline.benchmark.lattices import cube, replicate_on, triad_over
from pipeline.montecarlo.parts import Collected
from pipeline.montecarlo.replicates import Run, run_part
from pipeline.montecarlo.workers import Crew, Execution, crew
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

HUGE = 99_000_000  # cells from which the targets of the largest lattices hold
MANY = 10_000  # replicates that targets are for
TASKS = 8


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
    replicate_on(make_setup(cube(8, drawn))).run(None)  # what kernels take once
    cells = side**3
    gc.collect()
    before = psutil.Process().memory_info().rss
    with _Peak() as arrays:
        held = [np.full(cells, value, np.float32) for value in (0.0, 1.0, 2.0)]
    del held
    with _Peak() as making:
        setup = make_setup(cube(side, drawn))
    gc.collect()
    with _Peak() as replicate:
        replicate_on(setup).run(None)
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
        setup = make_setup(cube(side))
        actions = {"triad": triad_over(side**3), "replicate": replicate_on(setup)}
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


def replicates_figures(side: int, count: int, repeats: int) -> Iterator[Figure]:
    """The same tasks, fields and all, in this process, by two threads or processes, and on Dask.

    Dask's workers are processes of one thread on this machine; they run, and have what tasks
    share, before the time is taken. What Dask costs is what one of its workers takes longer than
    this process does. Two processes that each run half of the replicates and hand nothing back
    show what the two cores can do.
    """
    setup = make_setup(cube(side))
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

    def apart(_):
        fork = multiprocessing.get_context("fork")
        halves = pairwise((0, count // 2, count))
        started = [fork.Process(target=run_part, args=(run, *half)) for half in halves]
        for process in started:
            process.start()
        for process in started:
            process.join()
        return count

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
                "by two processes that hand nothing back": Action(apart),
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
    yield from figures_beside(local, "replicates in this process", goals, **about)
    yield from figures_beside({name: rates[name] for name in dask}, dask[0], goals, **about)


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
