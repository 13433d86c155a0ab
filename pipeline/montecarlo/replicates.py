"""Monte Carlo replicates in parts: computed by a crew of workers, reduced inside the task."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.experiment import StopAt
from pipeline.files.netcdf import AS_DECLARED, WITHOUT_ZONE
from pipeline.montecarlo.checkpoints import Checkpoints, Shelf
from pipeline.montecarlo.fields import FieldSums
from pipeline.montecarlo.parts import DIMS, Collected, Part, stack
from pipeline.montecarlo.progress import Progress
from pipeline.montecarlo.streams import FLOW, PACKING, replicate_streams
from pipeline.montecarlo.workers import Crew, Execution, crew, pieces
from pipeline.parameters import Parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import Setup, load_cells

log = logging.getLogger(__name__)

VARIED = (  # kept of a variant
    "vertical_stress",
    "base_vertical_stress",
    "base_vertical_stress_std",
    "movement_zone_height",
    "movement_zone_width",
)
# a guess at what a replicate takes, s; it decides nothing but how replicates are shared out
SECONDS_A_REPLICATE, SECONDS_A_CELL = 2.5e-4, 2e-8
LARGE = 1_000_000  # cells from which Python's share of a replicate is too small to hold up threads


@dataclass(frozen=True)
class Run:
    """Replicates to do: everything that decides them but their number.

    `purposes` are the stream purposes of packing and flow; `fields` asks for field sums.
    """

    setup: Setup
    parameters: Parameters
    purposes: tuple[int, int] = (PACKING, FLOW)
    fields: bool = True

    def of(self, replicate: int) -> tuple[Setup, Parameters]:
        """Setup and parameters of a replicate: here the same for all."""
        return self.setup, self.parameters

    @property
    def decided_by(self) -> Any:
        """What decides the parameters of every replicate, as JSON-able data."""
        return self.parameters.to_document()

    def seconds(self, count: int) -> float:
        """A guess at what `count` replicates take on one core, s."""
        cells = self.setup.code.size * self.setup.times
        return count * (SECONDS_A_REPLICATE + SECONDS_A_CELL * cells)


def run_replicates(
    setup: Setup,
    parameters: Parameters,
    count: int,
    execution: Execution = Execution(),
    purposes: tuple[int, int] = (PACKING, FLOW),
    fields: bool = True,
) -> tuple[xr.Dataset, FieldSums | None]:
    """Readings of `count` replicates and, if asked, the sums of their fields.

    `purposes` are the stream purposes of packing and flow.
    """
    run = Run(setup, parameters, purposes, fields)
    collected = Collected()
    with _crew_for(run, count, execution) as workers:
        _collect(run, count, collected, workers, execution.chunk)
    whole = collected.whole()
    return replicates_dataset(setup, whole.readings), whole.sums


def run_experiment(
    setup: Setup,
    used: Parameters,
    declared: Parameters,
    execution: Execution = Execution(),
    checkpoints: Checkpoints | None = None,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Content of `replicates.nc` and `fields.nc` of an experiment.

    Runs the experiment's replicates with the parameters `used`; on the same streams once more
    with those `declared`, where calibration changed them, and in a draw experiment with a
    movement zone that carries stress like stagnant ground (R = 1, E_min = E). What
    `checkpoints` hold of them is not computed again.
    """
    experiment = setup.experiment
    variants = {}
    if declared != used:
        variants[AS_DECLARED] = declared
    if setup.masses:
        variants[WITHOUT_ZONE] = replace(used, R=1.0, E_min=None)
    run = Run(setup, used)
    with _crew_for(run, experiment.replicates, execution) as workers:
        chunk = execution.chunk
        main = _run_on(
            run, experiment.replicates, experiment.stop_at, workers, chunk, "", checkpoints
        )
        others = {
            suffix: _run_on(
                Run(setup, parameters, fields=False),
                main.last,
                None,
                workers,
                chunk,
                suffix,
                checkpoints,
            ).readings
            for suffix, parameters in variants.items()
        }
    if checkpoints is not None:
        checkpoints.keep_only_whole()
    return replicates_dataset(setup, main.readings, others), main.sums.finalise()


def run_each(
    runs: Mapping[str, Run],
    count: int,
    execution: Execution = Execution(),
    checkpoints: Checkpoints | None = None,
) -> dict[str, dict[str, np.ndarray]]:
    """Readings, as in `Part`, of the first `count` replicates of several runs, by the same names.

    What `checkpoints` hold of them is not computed again.
    """
    found = {}
    for name, run in runs.items():
        with _crew_for(run, count, execution) as workers:
            part = _run_on(run, count, None, workers, execution.chunk, f" {name}", checkpoints)
        found[name] = part.readings
    if checkpoints is not None:
        checkpoints.keep_only_whole()
    return found


def _run_on(run, most, stop_at, workers, chunk, suffix, checkpoints) -> Part:
    """Replicates of one set of parameters: `most`, or fewer where `stop_at` says so."""
    name = f"{run.setup.experiment.name}{suffix}"
    shelf = None
    if checkpoints is not None:
        shelf = checkpoints.shelf(run.setup, run.decided_by, run.purposes, run.fields)
    progress = Progress(name, most)
    collected = _found(shelf, most)
    progress.found(collected.count)
    for goal in _goals(most, stop_at):
        _collect(run, goal, collected, workers, chunk, shelf, progress)
        if goal == most or _is_precise(name, collected.first_stresses(goal), stop_at):
            break
    if collected.count > goal:  # more were found than are wanted, and sums cannot be taken apart
        collected = _found(shelf, goal)
        _collect(run, goal, collected, workers, chunk, shelf, progress)
    progress.end()
    whole = collected.whole()
    if shelf:
        shelf.whole = whole
    return whole


def _found(shelf: Shelf | None, count: int) -> Collected:
    collected = Collected()
    for part in shelf.parts(count) if shelf else ():
        collected.add(part)
    return collected


def _goals(most: int, stop_at: StopAt | None) -> Iterator[int]:
    """Counts of replicates after which the precision is looked at; the last is `most`.

    They double from `at_least`, whoever computes: so the count does not hang on the workers.
    """
    goal = most if stop_at is None else stop_at.at_least
    while goal < most:
        yield goal
        goal *= 2
    yield most


def _is_precise(name: str, stress: np.ndarray, stop_at: StopAt) -> bool:
    """Whether every load cell's mean is known well enough, at every reading.

    `stress` is (replicate, time, load_cell), kPa.
    """
    largest = float((stress.std(axis=0, ddof=1) / math.sqrt(len(stress))).max())
    reached = largest <= stop_at.standard_error
    log.info(
        "%s: the largest standard error of %d replicates is %.4g kPa, %s %.4g kPa: %s",
        name,
        len(stress),
        largest,
        "within" if reached else "above",
        stop_at.standard_error,
        "enough" if reached else "going on",
    )
    return reached


def _crew_for(run: Run, count: int, execution: Execution):
    is_long = run.seconds(count) > 1.0
    small = run.setup.code.size < LARGE
    return crew(execution, run.setup.experiment.name, processes=is_long and small)


def _collect(
    run: Run,
    count: int,
    collected: Collected,
    workers: Crew,
    chunk: int | None = None,
    shelf: Shelf | None = None,
    progress: Progress | None = None,
) -> None:
    """Compute what is missing of the first `count` replicates."""
    gaps = collected.gaps(count)
    if chunk is None:
        missing = sum(last - first for first, last in gaps)
        chunk = math.ceil(missing / pieces(run.seconds(missing), workers.workers)) or 1
    others = replace(run, setup=None)  # a cluster gets a setup once for all that is run on it
    jobs = [
        (others, start, min(start + chunk, last))
        for first, last in gaps
        for start in range(first, last, chunk)
    ]
    for _, part in workers.each(_run_part_of, jobs, run.setup):
        if part.sums is not None:
            part.sums.setup = run.setup
        if shelf:
            shelf.keep(part)
        collected.add(part)
        if progress:
            progress.computed(part.last - part.first)


def _run_part_of(setup: Setup, run: Run, first: int, last: int) -> Part:
    return run_part(replace(run, setup=setup), first, last)


def run_part(run: Run, first: int, last: int) -> Part:
    """Replicates `first` … `last` − 1; the sums go without the setup, which the caller has."""
    start = time.perf_counter()
    sums = FieldSums.empty(run.setup) if run.fields else None
    replicates = []
    for replicate in range(first, last):
        streams = replicate_streams(run.setup.experiment, replicate, run.purposes)
        observe = None
        if sums is not None:
            observe = sums.observe if replicate else sums.observe_first
        replicates.append(simulate(*run.of(replicate), *streams, observe))
    if sums is not None:
        sums.count, sums.setup = last - first, None
    return Part(first, last, stack(replicates), sums, time.perf_counter() - start)


def replicates_dataset(
    setup: Setup,
    readings: Mapping[str, np.ndarray],
    variants: Mapping[str, Mapping[str, np.ndarray]] = {},
) -> xr.Dataset:
    """Readings, as in `Part`, with `mass_drawn` or `fill_height` (time) and the load cells.

    `variants` are the same replicates with other parameters, by the suffix that the names of
    their stress readings get.
    """
    experiment = setup.experiment
    data = dict(_on_dims(readings))
    for suffix, others in variants.items():
        data |= {f"{name}{suffix}": value for name, value in _on_dims(others) if name in VARIED}
    if setup.masses:
        data["mass_drawn"] = ("time", np.array(setup.masses))
        data["drawpoint_name"] = ("drawpoint", _names(experiment.drawpoints))
    else:
        data["fill_height"] = ("time", np.array(setup.fill_levels))
    coords = {
        "time": ("time", np.arange(setup.times, dtype=np.float64)),
        "replicate": ("replicate", np.arange(len(readings["vertical_stress"]), dtype=np.int32)),
    }
    if experiment.keep_fields:
        coords |= {axis: (axis, setup.lattice.centers(axis)) for axis in "zyx"}
    cells = load_cells(experiment)
    coords["load_cell_name"] = ("load_cell", _names(cells))
    for key in ("x", "y", "width", "length"):
        values = np.array([getattr(cell, key) for cell in cells])
        (coords if key in "xy" else data)[f"load_cell_{key}"] = ("load_cell", values)
    return xr.Dataset(data, coords=coords)


def _on_dims(readings: Mapping[str, np.ndarray]) -> Iterator[tuple[str, tuple]]:
    for name, dims in DIMS.items():
        if name in readings:
            yield name, (("replicate", *dims), readings[name])


def _names(items: Sequence) -> np.ndarray:
    return np.array([item.name for item in items], dtype="S")
