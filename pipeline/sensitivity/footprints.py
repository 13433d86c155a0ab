"""Where in the ground a load cell's reading comes from: influence of each cell on it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr
from numba import njit

from pipeline.config.measured import MeasuredRow
from pipeline.effects import State
from pipeline.lattice.adjoint import Influence, influence
from pipeline.lattice.stress import stress_sweep
from pipeline.montecarlo.streams import replicate_streams
from pipeline.montecarlo.workers import Execution, run_tasks
from pipeline.observe import SPREAD, STRESS, reading_index
from pipeline.parameters import Parameters
from pipeline.sensitivity import FOOTPRINT_REPLICATES
from pipeline.simulate.flow import FlowRecord
from pipeline.simulate.readings import KPA
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import Setup, load_cells
from pipeline.simulate.sweeps import Sweep

COST_REPEATS = 20
GROUP_CELLS = 2e7  # places times load cells whose influence is held at a time

# called with (sweep, its lattice, influence of the readings at a time); returns the derivatives
# (reading, channel)
Projection = Callable[[Sweep, State, Influence], np.ndarray]


def sweep_influence(readings: np.ndarray, sweep: Sweep, **options) -> Influence:
    """Derivatives of readings (reading, y, x) of a sweep, as from `adjoint.influence`."""
    return influence(
        readings,
        sweep.shed_fraction,
        sweep.edge,
        sweep.corner,
        sweep.code,
        sweep.relaxation,
        sweep.top_fraction,
        sweep.load,
        sweep.coupling,
        **options,
    )


def influence_fields(
    setup: Setup,
    parameters: Parameters,
    packing: np.random.Generator,
    flow: np.random.Generator | None = None,
    at: int = -1,
) -> xr.Dataset:
    """Influence of every cell on all load cells at one reading of one replicate.

    Parameters
    ----------
    setup : with the effects that act
    packing, flow : the replicate's streams, as `simulate` takes them
    at : index of the reading

    Returns
    -------
    Dataset on (load_cell, z, y, x), over the levels that the reading has:

    - `weight_influence`, kPa N-1: of the vertical stress with respect to the cell's weight;
    - `log_shed_influence`, kPa: with respect to the cell's log(1 − E);
    - `weight` (z, y, x), N, and `vertical_stress` (load_cell), kPa, which is Σ
      `weight_influence` · `weight` where no effect makes the sweep nonlinear. Sensors are left
      out: it is the ground's stress.

    Raises
    ------
    IndexError
        If the experiment has no such reading.
    """
    at = range(setup.times)[at]
    if setup.masses:
        setup = replace(setup, masses=setup.masses[: at + 1], to_the_end=False)
    lattice = setup.lattice
    weights = setup.footprints * (KPA / lattice.cell_area)
    data = {}

    def inspect(t: int, sweep: Sweep, state: State) -> None:
        if t != at:
            return
        found = sweep_influence(weights, sweep)
        weight = sweep.weight.astype(np.float64)
        fields, cells = ("load_cell", "z", "y", "x"), ("z", "y", "x")
        data["weight_influence"] = (fields, found.weight, {"units": "kPa N-1"})
        data["log_shed_influence"] = (fields, found.shed * sweep.shed_fraction, {"units": "kPa"})
        data["weight"] = (cells, weight, {"units": "N"})
        stress = np.tensordot(weights, sweep.base_load, axes=2)
        data["vertical_stress"] = ("load_cell", stress, {"units": "kPa"})

    simulate(setup, parameters, packing, flow, inspect=inspect)
    levels = data["weight"][1].shape[0]
    coords = {axis: (axis, lattice.centers(axis)) for axis in "zyx"}
    coords["z"] = ("z", lattice.centers("z")[:levels])
    coords["load_cell"] = [cell.name for cell in load_cells(setup.experiment)]
    return xr.Dataset(data, coords=coords)


def load_cell_footprint(
    setup: Setup, parameters: Parameters, execution: Execution = Execution()
) -> xr.DataArray:
    """Where each load cell's stress comes from before draw, or when full.

    Share of the stress that the weight at a place adds, summed over y and averaged over the first
    `FOOTPRINT_REPLICATES` replicates: (load_cell, z, x), adding up to 1 over (z, x) for each load
    cell where the sweep is linear in the weights. Groups of load cells are shared out by
    `execution`, which changes no bit.
    """
    experiment = setup.experiment
    count = min(FOOTPRINT_REPLICATES, experiment.replicates)
    at = 0 if setup.masses else setup.times - 1
    if setup.masses:
        setup = replace(setup, masses=setup.masses[:1], to_the_end=False)
    total = 0.0
    for replicate in range(count):
        streams = replicate_streams(experiment, replicate)
        found: list[np.ndarray] = []

        def inspect(t: int, sweep: Sweep, state: State, found=found) -> None:
            if t == at:
                found.append(_shares(setup, sweep, execution))

        simulate(setup, parameters, *streams, inspect=inspect)
        total = total + found[0]
    lattice = setup.lattice
    levels = total.shape[1]
    coords = {"z": lattice.centers("z")[:levels], "x": lattice.centers("x")}
    return xr.DataArray(
        (total / count).astype(np.float32), dims=("load_cell", "z", "x"), coords=coords
    )


def _shares(setup: Setup, sweep: Sweep, execution: Execution) -> np.ndarray:
    """Share of each load cell's stress in a sweep that places add: (load_cell, z, x), over y.

    Load cells are taken in groups, so that a mine's lattice and its pillars fit into memory.
    """
    footprints = setup.footprints * (KPA / setup.lattice.cell_area)
    group = max(1, int(GROUP_CELLS // sweep.weight.size))

    def shares(readings):
        stress = np.tensordot(readings, sweep.base_load, axes=2)
        found = sweep_influence(readings, sweep, of_shed=False).weight
        return _over_y(found, sweep.weight, stress)

    groups = [footprints[first : first + group] for first in range(0, len(footprints), group)]
    return np.concatenate(run_tasks([partial(shares, one) for one in groups], execution))


@njit(nogil=True, cache=True)
def _over_y(influence, weight, stress):
    """Σ over y of influence · weight / stress, (reading, z, x); 0 with no ground above."""
    count, nz, ny, nx = influence.shape
    total = np.zeros((count, nz, nx))
    for n in range(count):
        if stress[n] > 0.0:
            for z in range(nz):
                for y in range(ny):
                    for x in range(nx):
                        own = np.float64(weight[z, y, x])
                        total[n, z, x] += influence[n, z, y, x] * own / stress[n]
    return total


def row_gradients(
    setup: Setup,
    parameters: Parameters,
    rows: Sequence[MeasuredRow],
    project: Projection,
    packing: np.random.Generator,
    flow: np.random.Generator | FlowRecord | None = None,
    of_relaxation: bool = False,
) -> np.ndarray:
    """Derivatives of measured rows' counterparts in one replicate, (row, channel) float64.

    What the channels are is up to `project`: of the influence fields of the readings that a time
    has, it makes the derivatives (reading, channel) along directions of its choice, for example
    Σ over the cells of a region. Spatial standard deviations and ratios are linearised at this
    replicate's stresses; geometry has no derivative: 0. Sensors are left out.

    Parameters
    ----------
    setup : with the effects that act; its readings must hold those of `rows`
    flow : the replicate's stream, or what `record_flow` kept of it
    project : called with (sweep, its lattice, its influence) at each time
    of_relaxation : whether the influence has derivatives with respect to R
    """
    clock = "mass_drawn" if setup.masses else "fill_height"
    readings = xr.Dataset({clock: ("time", np.array(setup.masses or setup.fill_levels))})
    times = [reading_index(setup.experiment, readings, row) for row in rows]
    stresses = [i for i, row in enumerate(rows) if row.quantity in (*STRESS, *SPREAD)]
    read = {i: {times[i]} | ({0} if _is_ratio(rows[i]) else set()) for i in stresses}
    found: dict[tuple[int, int], tuple[float, np.ndarray]] = {}  # (time, row): value, slopes

    def inspect(t: int, sweep: Sweep, state: State) -> None:
        now = [i for i in stresses if t in read[i]]
        if not now:
            return
        weights = np.array([_base_weights(setup, rows[i], sweep.base_load) for i in now])
        values = np.tensordot(weights, sweep.base_load, axes=2)
        slopes = project(sweep, state, sweep_influence(weights, sweep, of_relaxation=of_relaxation))
        found.update(((t, i), entry) for i, *entry in zip(now, values, slopes, strict=True))

    simulate(setup, parameters, packing, flow, inspect=inspect)
    gradients: list[np.ndarray | float] = [0.0] * len(rows)
    for i in stresses:
        value, slopes = found[times[i], i]
        if _is_ratio(rows[i]):
            before, slopes_before = found[0, i]
            slopes = (slopes - value / before * slopes_before) / before
        gradients[i] = slopes
    channels = max((np.size(slopes) for slopes in gradients), default=0)
    return np.array([np.broadcast_to(slopes, channels) for slopes in gradients], dtype=np.float64)


def _is_ratio(row: MeasuredRow) -> bool:
    return row.quantity == "vertical_stress_ratio"


def _base_weights(setup: Setup, row: MeasuredRow, base_load: np.ndarray) -> np.ndarray:
    """Weights (y, x) of the base loads in a row, kPa N-1, linearised at these loads (N)."""
    per_load, base = KPA / setup.lattice.cell_area, setup.base
    if row.quantity in SPREAD:
        off = np.where(base, base_load - base_load[base].mean(), 0.0)
        size = math.sqrt(base.sum() * (off**2).sum())
        return off * (per_load / size if size > 0.0 else 0.0)
    if row.load_cell is None:
        return base * (per_load / base.sum())
    names = [cell.name for cell in load_cells(setup.experiment)]
    return setup.footprints[names.index(row.load_cell)] * per_load


def gradient_cost(
    setup: Setup, parameters: Parameters, packing: np.random.Generator, repeats: int = COST_REPEATS
) -> dict[str, float]:
    """Seconds of a forward sweep and of one reading's full gradient, the best of `repeats`.

    For a static experiment at its last reading: `forward` without keeping loads, `gradient` (the
    derivatives with respect to all weights and all log E, float32, from kept loads) and their
    `ratio`; `cells` is the size of the lattice.
    """
    sweeps: list[Sweep] = []
    simulate(setup, parameters, packing, inspect=lambda t, sweep, state: sweeps.append(sweep))
    last = sweeps[-1]
    weights = setup.footprints[:1] * (KPA / setup.lattice.cell_area)
    none = np.zeros((0, 0, 0), last.load.dtype)
    base_load = np.zeros_like(last.base_load)
    taken = last[: Sweep._fields.index("coupling")]
    forward = _best(lambda: stress_sweep(*taken, none, base_load, last.coupling), repeats)
    gradient = _best(lambda: sweep_influence(weights, last, dtype=np.float32), repeats)
    return {
        "cells": float(last.code.size),
        "forward": forward,
        "gradient": gradient,
        "ratio": gradient / forward,
    }


def _best(action: Callable[[], object], repeats: int) -> float:
    """Shortest of some runs, s, after one that may compile."""
    action()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)
