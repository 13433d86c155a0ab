"""One replicate of an experiment.

`simulate` is a pure function of the setup, the parameters and the random streams.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.lattice.grid import levels_of
from pipeline.lattice.stress import UNCOUPLED, Moved
from pipeline.parameters import Parameters
from pipeline.simulate.flow import Flow, FlowRecord, Snapshot
from pipeline.simulate.ground import Ground, for_sweep, pack
from pipeline.simulate.readings import Readings
from pipeline.simulate.setup import Setup
from pipeline.simulate.sweeps import Inspector, Recorder

# called at each reading with (time index, cell codes, cell ids, carried load in N)
Observer = Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]


def simulate(
    setup: Setup,
    parameters: Parameters,
    packing: np.random.Generator,
    flow: np.random.Generator | FlowRecord | None = None,
    observe: Observer | None = None,
    inspect: Inspector | None = None,
) -> Readings:
    """Run one replicate and read its base.

    Parameters
    ----------
    packing : stream that draws s for each cell, and anew where a cell has moved
    flow : stream of the void diffusion, or what `record_flow` kept of it; a draw experiment
        needs one
    observe : called at each reading with the state of the lattice, to reduce fields in place
    inspect : called at each reading with its sweep, whose arrays the next one may reuse

    Raises
    ------
    WeightBalanceError
        If a sweep does not return the weight that was put in.
    """
    if setup.masses:
        return _simulate_draw(setup, parameters, packing, flow, observe, inspect)
    return _simulate_filling(setup, parameters, packing, observe, inspect)


def _simulate_filling(setup, parameters, packing, observe, inspect):
    lattice = setup.lattice
    out = Recorder(setup, observe is not None, inspect)
    ground = Ground(setup, parameters, packing, out)
    if observe is not None:
        identity = np.arange(setup.code.size, dtype=np.int32).reshape(lattice.shape)
    for t, height in enumerate(setup.true_levels):
        levels, fraction = levels_of(height, lattice.cell_size)
        if levels == lattice.nz:  # the top level's density is scaled in the block model already
            fraction = min(fraction / lattice.top_fraction, 1.0)
        code = setup.code[:levels]
        if out.needs_state:
            state = ground.at_rest(code, fraction)
            load = out.sweep(t, *for_sweep(state, ground.dtype), 1.0, state)
        else:
            cells, ranked = ground.upto(levels)
            load = out.sweep(t, cells, code, parameters.R, UNCOUPLED, fraction, ranked=ranked)
        if observe is not None:
            observe(t, code, identity[:levels], load)
    return out.finish()


def _simulate_draw(setup, parameters, packing, flow, observe, inspect):
    out = Recorder(setup, observe is not None, inspect)
    ground = Ground(setup, parameters, packing, out)
    if not isinstance(flow, FlowRecord):
        flow = Flow(setup, parameters, ground.cells.weight, flow)
    readings = out.readings
    readings.movement_zone_height = np.zeros(setup.times)
    readings.movement_zone_width = np.zeros(setup.times)
    readings.replicate_mass_drawn = np.zeros(setup.times)
    for t, now in enumerate(flow):
        ground.redraw(now.moved, now.cell_id, setup.masses[t])
        zone_shed = parameters.shed_in_zone(now.heights).astype(ground.dtype).astype(np.float64)
        if out.needs_state:
            state = ground.in_draw(now, zone_shed)
            load = out.sweep(t, *for_sweep(state, ground.dtype), 1.0, state)
        else:
            places = {"moved": Moved(now.cell_id, now.zone, zone_shed)}
            cells, places["ranked"] = ground.upto(len(now.code))
            load = out.sweep(t, cells, now.code, parameters.R, UNCOUPLED, 1.0, **places)
        readings.movement_zone_height[t] = now.heights.max()
        readings.movement_zone_width[t] = now.widths.max()
        readings.replicate_mass_drawn[t] = now.mass
        if observe is not None:
            observe(t, now.code, now.cell_id, load)
    for name, value in flow.totals.items():
        setattr(readings, name, value)
    return out.finish()


def record_flow(
    setup: Setup,
    parameters: Parameters,
    packing: np.random.Generator,
    flow: np.random.Generator,
) -> FlowRecord:
    """The flow of one replicate of a draw experiment; `simulate` takes it in place of the stream.

    It hangs on the flow parameters and on the cells' masses alone: not on E, s, R or E_min, nor
    on effects that change no mass.
    """
    cell_weight = pack(setup, parameters, packing).weight
    flow = Flow(setup, parameters, cell_weight, flow)
    copied = tuple(
        Snapshot(*(part.copy() if isinstance(part, np.ndarray) else part for part in now))
        for now in flow
    )
    return FlowRecord(copied, flow.totals)
