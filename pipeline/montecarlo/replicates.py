"""Monte Carlo replicates in chunks on Dask, reduced inside the task."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import dask
import numpy as np
import xarray as xr

from pipeline.files.netcdf import AS_DECLARED, WITHOUT_ZONE
from pipeline.montecarlo.fields import FieldSums
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.parameters import Parameters
from pipeline.simulate import Readings, Setup, load_cells, simulate

log = logging.getLogger(__name__)

DIMS = {  # of a Readings attribute, after `replicate`
    "vertical_stress": ("time", "load_cell"),
    "base_vertical_stress": ("time",),
    "base_vertical_stress_std": ("time",),
    "weight_balance_error": ("time",),
    "negative_s_share": (),
    "movement_zone_height": ("time",),
    "movement_zone_width": ("time",),
    "replicate_mass_drawn": ("time",),
    "drawpoint_shortfall": ("drawpoint",),
    "hang_ups": (),
    "drawn_cell": ("extraction",),
    "drawn_drawpoint": ("extraction",),
    "drawn_mass": ("extraction",),
    "replicate_vertical_stress": ("time", "z", "y", "x"),
}
VARIED = (  # kept of a variant
    "vertical_stress",
    "base_vertical_stress",
    "base_vertical_stress_std",
    "movement_zone_height",
    "movement_zone_width",
)


@dataclass(frozen=True)
class Execution:
    """Where replicates run: `workers` threads, or the Dask cluster at `scheduler`.

    `chunk` is the number of replicates in a task (None: a few tasks for each worker). None of the
    three changes a bit of the results.
    """

    workers: int = 1
    scheduler: str = ""
    chunk: int | None = None


def run_replicates(
    setup: Setup,
    parameters: Parameters,
    count: int,
    execution: Execution = Execution(),
    purposes: tuple[int, int] = (PACKING, FLOW),
    fields: bool = True,
) -> tuple[list[Readings], FieldSums | None]:
    """Readings of `count` replicates in order and, if asked, the sums of their fields.

    `purposes` are the stream purposes of packing and flow.
    """
    chunk = execution.chunk or math.ceil(count / execution.workers / (4 if fields else 1))
    parts = [
        (setup, parameters, first, min(first + chunk, count), purposes, fields)
        for first in range(0, count, chunk)
    ]
    parts = run_tasks([partial(_run_chunk, *part) for part in parts], execution)
    sums = None
    if fields:
        sums = FieldSums.empty(setup)
        for _, part in parts:
            sums += part
    return [readings for chunk_readings, _ in parts for readings in chunk_readings], sums


def run_experiment(
    setup: Setup, used: Parameters, declared: Parameters, execution: Execution = Execution()
) -> tuple[xr.Dataset, xr.Dataset]:
    """Content of `replicates.nc` and `fields.nc` of an experiment.

    Runs the experiment's replicates with the parameters `used`; on the same streams once more
    with those `declared`, where calibration changed them, and in a draw experiment with a
    movement zone that carries stress like stagnant ground (R = 1, E_min = E).
    """
    name, count = setup.experiment.name, setup.experiment.replicates
    with progress(name, count):
        replicates, sums = run_replicates(setup, used, count, execution)
    variants = {}
    if declared != used:
        variants[AS_DECLARED] = declared
    if setup.masses:
        variants[WITHOUT_ZONE] = replace(used, R=1.0, E_min=None)
    others = {}
    for suffix, parameters in variants.items():
        with progress(f"{name}{suffix}", count):
            others[suffix], _ = run_replicates(setup, parameters, count, execution, fields=False)
    return replicates_dataset(setup, replicates, others), sums.finalise()


def replicates_dataset(
    setup: Setup,
    replicates: Sequence[Readings],
    variants: Mapping[str, Sequence[Readings]] | None = None,
) -> xr.Dataset:
    """Readings on (replicate, time, load_cell) with `mass_drawn` or `fill_height` (time).

    `variants` are the same replicates with other parameters, by the suffix that the names of
    their stress readings get. The extraction record is padded with -1.
    """
    experiment = setup.experiment
    data = dict(_stacked(replicates))
    for suffix, readings in (variants or {}).items():
        data |= {f"{name}{suffix}": value for name, value in _stacked(readings) if name in VARIED}
    if setup.masses:
        data["mass_drawn"] = ("time", np.array(setup.masses))
        data["drawpoint_name"] = ("drawpoint", _names(experiment.drawpoints))
    else:
        data["fill_height"] = ("time", np.array(setup.fill_levels))
    coords = {
        "time": ("time", np.arange(setup.times, dtype=np.float64)),
        "replicate": ("replicate", np.arange(len(replicates), dtype=np.int32)),
    }
    if experiment.keep_fields:
        coords |= {axis: (axis, setup.lattice.centers(axis)) for axis in "zyx"}
    cells = load_cells(experiment)
    coords["load_cell_name"] = ("load_cell", _names(cells))
    for key in ("x", "y", "width", "length"):
        values = np.array([getattr(cell, key) for cell in cells])
        (coords if key in "xy" else data)[f"load_cell_{key}"] = ("load_cell", values)
    return xr.Dataset(data, coords=coords)


def run_tasks(
    tasks: Sequence[Callable[[], Any]], execution: Execution, processes: bool = False
) -> list[Any]:
    """Results of tasks without arguments, in order: here with one worker, else through Dask.

    Without arguments, because Dask would look through every one of them for its own collections.
    `processes` is for tasks of many seconds that are more Python than kernel.
    """
    if execution.workers == 1 and not execution.scheduler:
        return [task() for task in tasks]
    delayed = [dask.delayed(task, pure=False)() for task in tasks]
    if processes and hasattr(os, "fork") and not execution.scheduler:
        workers = min(execution.workers, len(tasks))  # forked: others would run the job's script
        with dask.config.set({"multiprocessing.context": "fork"}):
            return list(dask.compute(*delayed, scheduler="processes", num_workers=workers))
    with dask_session(execution):
        return list(dask.compute(*delayed))


@contextmanager
def dask_session(execution: Execution) -> Iterator[None]:
    """The only place that configures Dask: a thread pool, or a client of a running cluster."""
    if not execution.scheduler:
        with dask.config.set(scheduler="threads", num_workers=execution.workers):
            yield
        return
    from distributed import Client

    with Client(execution.scheduler, set_as_default=True):
        yield


def _run_chunk(setup, parameters, first, last, purposes, fields):
    sums = FieldSums.empty(setup) if fields else None
    readings = []
    experiment = setup.experiment
    for replicate in range(first, last):
        packing, flow = (
            random_stream(experiment.seed, experiment.name, purpose, replicate)
            for purpose in purposes
        )
        observe = None
        if sums is not None:
            observe = sums.observe if replicate else sums.observe_first
        readings.append(simulate(setup, parameters, packing, flow, observe))
    if sums is not None:
        sums.count = last - first
    return readings, sums


@contextmanager
def progress(name: str, count: int) -> Iterator[None]:
    """Around `run_replicates`: a bar on a terminal, two lines in a log."""
    start = time.perf_counter()
    log.info("%s: %d replicates", name, count)
    bar = nullcontext()
    if sys.stderr.isatty():
        from dask.diagnostics import ProgressBar

        bar = ProgressBar(out=sys.stderr)
    with bar:
        yield
    log.info("%s: %d replicates took %.2f s", name, count, time.perf_counter() - start)


def _stacked(replicates: Sequence[Readings]) -> Iterator[tuple[str, tuple]]:
    for name, dims in DIMS.items():
        values = [getattr(readings, name) for readings in replicates]
        if any(value is None for value in values):
            continue
        if dims == ("extraction",):
            longest = max(len(value) for value in values)
            padded = np.full((len(values), longest), -1, dtype=values[0].dtype)
            for row, value in zip(padded, values, strict=True):
                row[: len(value)] = value
            yield name, (("replicate", *dims), padded)
        else:
            yield name, (("replicate", *dims), np.array(values))


def _names(items: Sequence) -> np.ndarray:
    return np.array([item.name for item in items], dtype="S")
