"""One replicate of an experiment: the interface that everything above the lattice leans on.

`simulate` is a pure function of the setup, the parameters and the random streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment, LoadCell
from pipeline.config.measured import MeasuredRow, fill_levels, reading_masses
from pipeline.effects import (
    Active,
    Packing,
    Reading,
    State,
    apply,
    as_filled,
    declared_effects,
    ordered,
)
from pipeline.lattice.block_model import build_block_model, cell_codes, lattice_of
from pipeline.lattice.cells import OUTSIDE, STAGNANT
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    climb_chances,
    draw_to,
    draw_visits,
    new_flow_state,
    zone_geometry,
)
from pipeline.lattice.grid import GRAVITY, Lattice, levels_of
from pipeline.lattice.spreading import (
    count_below,
    draw_ranks,
    rank_normals,
    redraw_ranks,
    spreading_weights,
)
from pipeline.lattice.stress import (
    AT_HOME,
    BY_CELL,
    UNCOUPLED,
    Coupling,
    Moved,
    Ranked,
    place_cells,
    place_zones,
    read_base,
    stress_sweep,
)
from pipeline.parameters import Parameters

KPA = 1e-3
BALANCE_TOLERANCE = 1e-6
BLOCK = 2**16  # cells that are made at a time: they stay in cache

# called at each reading with (time index, cell codes, cell ids, carried load in N)
Observer = Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]


class Sweep(NamedTuple):
    """One sweep: what it took, see `stress.stress_sweep`, and the loads that it returned, N."""

    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray
    code: np.ndarray
    relaxation: float
    top_fraction: float
    coupling: Coupling
    load: np.ndarray
    base_load: np.ndarray


# called at each reading with (time index, its sweep, the lattice as effects left it)
Inspector = Callable[[int, Sweep, State], None]


class Snapshot(NamedTuple):
    """What the flow has made of the lattice at a reading; arrays as in `flow.FlowState`.

    `moved` marks the places whose cell has moved since the reading before; `heights` and `widths`
    (label) are the movement zones', m; `mass` was drawn so far, kg.
    """

    code: np.ndarray
    cell_id: np.ndarray
    zone: np.ndarray
    zone_root: np.ndarray
    moved: np.ndarray
    heights: np.ndarray
    widths: np.ndarray
    mass: float


@dataclass(frozen=True)
class FlowRecord:
    """The flow of one replicate, kept to be simulated again under other stresses.

    `totals` are the fields of `Readings` that the flow alone decides.
    """

    snapshots: tuple[Snapshot, ...]
    totals: Mapping[str, Any]

    def __iter__(self) -> Iterator[Snapshot]:
        return iter(self.snapshots)

    @property
    def nbytes(self) -> int:
        """Bytes that its arrays take."""
        return sum(getattr(part, "nbytes", 0) for snapshot in self.snapshots for part in snapshot)


@dataclass(frozen=True)
class Setup:
    """What stays the same from replicate to replicate.

    Attributes
    ----------
    code : (z, y, x) int8, cell codes before draw
    cell_weight : (z * y * x) float, own weight of each cell by its identity, N
    base : (y, x) bool, columns with ground
    footprints : (load_cell, y, x) float64, share of each base cell in a load cell's reading
    fill_levels : m, one for each time of a static experiment; empty in a draw experiment
    masses : kg drawn at each time of a draw experiment; empty in a static one
    openings : for each drawpoint, the (z, y, x) indices (cell, 3) of its base cells
    visits : (visit) index of the drawpoint and scheduled mass in kg at the visit's end
    to_the_end : whether draw goes on after the last reading, to the schedule's end
    true_levels : m, the heights that `fill_levels` are in truth, where effects say so
    effects : in the order in which they act
    """

    experiment: Experiment
    lattice: Lattice
    code: np.ndarray
    cell_weight: np.ndarray
    base: np.ndarray
    footprints: np.ndarray
    fill_levels: tuple[float, ...]
    masses: tuple[float, ...]
    openings: tuple[np.ndarray, ...]
    visits: tuple[np.ndarray, np.ndarray]
    to_the_end: bool = True
    true_levels: tuple[float, ...] = ()
    effects: tuple[Active, ...] = ()

    def acts_on(self, stage: str) -> bool:
        """Whether an effect that is not neutral acts at a stage."""
        return any(getattr(e.effect, stage) and not e.is_neutral for e in self.effects)

    @property
    def times(self) -> int:
        """Number of readings in one replicate."""
        return len(self.masses) or len(self.fill_levels)


@dataclass
class Readings:
    """What one replicate returns; dims (time, load_cell), (time) or (drawpoint).

    Stresses and their spatial standard deviation over the base (population, over ground
    columns) in kPa, lengths in m, masses in kg; `weight_balance_error` is relative to the weight
    put in; `negative_s_share` is the share of cells with s < 0. In a draw experiment
    `drawn_cell`, `drawn_drawpoint` and `drawn_mass` are the extraction record: which initial
    cell came out of which drawpoint at which drawn mass. `replicate_vertical_stress`
    (time, z, y, x) in kPa is kept where the experiment asks for it.
    """

    vertical_stress: np.ndarray
    base_vertical_stress: np.ndarray
    base_vertical_stress_std: np.ndarray
    weight_balance_error: np.ndarray
    negative_s_share: float
    movement_zone_height: np.ndarray | None = None
    movement_zone_width: np.ndarray | None = None
    replicate_mass_drawn: np.ndarray | None = None
    drawpoint_shortfall: np.ndarray | None = None
    hang_ups: int = 0
    drawn_cell: np.ndarray | None = None
    drawn_drawpoint: np.ndarray | None = None
    drawn_mass: np.ndarray | None = None
    replicate_vertical_stress: np.ndarray | None = None


class WeightBalanceError(RuntimeError):
    """Weight put in differs from weight carried and shed by more than `BALANCE_TOLERANCE`."""


def make_setup(
    experiment: Experiment,
    block_model: xr.Dataset,
    rows: tuple[MeasuredRow, ...] = (),
    dtype: type = np.float32,
    effects: tuple[Active, ...] | None = None,
) -> Setup:
    """Arrays of an experiment for its replicates.

    `rows` are its measured rows, whose fill heights and masses join the declared readings;
    `dtype` is the storage type of the cells' weights; `effects` replace those that the experiment
    declares.
    """
    active = declared_effects(experiment) if effects is None else ordered(effects)
    levels = () if experiment.is_draw else fill_levels(experiment, rows)
    true_levels = tuple(float(apply(active, "geometry", level)) for level in levels)
    filled = as_filled(experiment, active)
    lattice = lattice_of(filled)
    if filled is not experiment:
        block_model = build_block_model(filled)
    code = cell_codes(block_model)
    weight = block_model["bulk_density"].values.astype(np.float64).ravel()
    weight *= GRAVITY
    weight *= lattice.cell_volume
    base = (code != OUTSIDE).any(axis=0)
    if experiment.load_cells:
        footprints = np.array([_footprint(lattice, base, cell) for cell in experiment.load_cells])
    else:
        footprints = (base / base.sum())[None]
    drawpoints, ends = zip(*visits(experiment), strict=True) if experiment.is_draw else ((), ())
    return Setup(
        experiment=experiment,
        lattice=lattice,
        code=code,
        cell_weight=weight.astype(dtype),
        base=base,
        footprints=footprints,
        fill_levels=levels,
        masses=reading_masses(experiment, rows) if experiment.is_draw else (),
        openings=tuple(_openings(experiment, lattice, code)) if experiment.is_draw else (),
        visits=(np.array(drawpoints, dtype=np.int64), np.array(ends, dtype=np.float64)),
        true_levels=true_levels,
        effects=active,
    )


def load_cells(experiment: Experiment) -> tuple[LoadCell, ...]:
    """The declared load cells; without any, one called "base" under the whole base."""
    g = experiment.geometry
    whole = {"name": "base", "x": g.width / 2, "y": g.length / 2}
    size = {"width": g.width, "length": g.length}
    return experiment.load_cells or (LoadCell(**whole, **size),)


def _footprint(lattice: Lattice, base: np.ndarray, cell: LoadCell) -> np.ndarray:
    """Share (y, x) of each base cell with ground in a load cell's reading; adds up to 1."""
    area = lattice.covered_area(cell.x, cell.y, cell.width, cell.length) * base
    return area / area.sum()


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
    out = _Recorder(setup, observe is not None, inspect)
    ground = _Ground(setup, parameters, packing, out)
    if observe is not None:
        identity = np.arange(setup.code.size, dtype=np.int32).reshape(lattice.shape)
    for t, height in enumerate(setup.true_levels):
        levels, fraction = levels_of(height, lattice.cell_size)
        if levels == lattice.nz:  # the top level's density is scaled in the block model already
            fraction = min(fraction / lattice.top_fraction, 1.0)
        code = setup.code[:levels]
        if out.needs_state:
            state = ground.at_rest(code, fraction)
            load = out.sweep(t, *_taken(state, ground.dtype), 1.0, state)
        else:
            cells, ranked = ground.upto(levels)
            load = out.sweep(t, cells, code, parameters.R, UNCOUPLED, fraction, ranked=ranked)
        if observe is not None:
            observe(t, code, identity[:levels], load)
    return out.finish()


def _simulate_draw(setup, parameters, packing, flow, observe, inspect):
    out = _Recorder(setup, observe is not None, inspect)
    ground = _Ground(setup, parameters, packing, out)
    if not isinstance(flow, FlowRecord):
        flow = _Flow(setup, parameters, ground.cells.weight, flow)
    readings = out.readings
    readings.movement_zone_height = np.zeros(setup.times)
    readings.movement_zone_width = np.zeros(setup.times)
    readings.replicate_mass_drawn = np.zeros(setup.times)
    for t, now in enumerate(flow):
        ground.redraw(now.moved, now.cell_id, setup.masses[t])
        zone_shed = parameters.shed_in_zone(now.heights).astype(ground.dtype).astype(np.float64)
        if out.needs_state:
            state = ground.in_draw(now, zone_shed)
            load = out.sweep(t, *_taken(state, ground.dtype), 1.0, state)
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
    cell_weight = _packing(setup, parameters, packing).weight
    flow = _Flow(setup, parameters, cell_weight, flow)
    copied = tuple(
        Snapshot(*(part.copy() if isinstance(part, np.ndarray) else part for part in now))
        for now in flow
    )
    return FlowRecord(copied, flow.totals)


class _Flow:
    """Follows the draw schedule; iterating it gives a `Snapshot` of views at each reading.

    A drawpoint with no granular cell left leaves the rest of its visit undrawn: what is missing
    adds to `drawpoint_shortfall` (drawpoint) in kg, and the schedule goes on.
    """

    def __init__(self, setup, parameters, cell_weight, flow):
        self._setup, self._parameters = setup, parameters
        self._cell_weight, self._stream = cell_weight, flow
        self._state = new_flow_state(setup.code, setup.openings)
        self._shortfall = np.zeros(len(setup.experiment.drawpoints))

    def __iter__(self) -> Iterator[Snapshot]:
        setup, state, weight = self._setup, self._state, self._cell_weight
        arguments = climb_chances(self._parameters.exponent), self._parameters.bulking, self._stream
        drawpoints, ends = setup.visits
        done, missing = 0, 0.0
        for target in setup.masses:
            here = int(np.searchsorted(ends, target))  # the visit during which it is read
            visited = drawpoints[done:here], ends[done:here]
            missing = draw_visits(state, weight, *visited, missing, self._shortfall, *arguments)
            if here < len(ends):
                draw_to(state, weight, int(drawpoints[here]), target - missing, *arguments)
            done = here
            yield self._snapshot()
            state.moved[:] = False
        if setup.to_the_end:
            visited = drawpoints[done:], ends[done:]
            draw_visits(state, weight, *visited, missing, self._shortfall, *arguments)

    def _snapshot(self) -> Snapshot:
        state = self._state
        drawn = state.counters[DRAWN_CELLS]
        return Snapshot(
            state.code,
            state.cell_id,
            state.zone,
            state.zone_root,
            state.moved,
            *zone_geometry(state, self._setup.lattice.cell_size),
            float(state.drawn_mass[drawn - 1]) if drawn else 0.0,
        )

    @property
    def totals(self) -> dict[str, Any]:
        state = self._state
        drawn = state.counters[DRAWN_CELLS]
        return {
            "drawpoint_shortfall": self._shortfall,
            "hang_ups": int(state.counters[HANG_UPS]),
            "drawn_cell": state.drawn_cell[:drawn].copy(),
            "drawn_drawpoint": state.drawn_drawpoint[:drawn].copy(),
            "drawn_mass": state.drawn_mass[:drawn].copy(),
        }


def visits(experiment: Experiment) -> Iterator[tuple[int, float]]:
    """The draw schedule as (index of the drawpoint, scheduled mass in kg at the visit's end).

    The drawpoints of a line are drawn in turn, `increment` kg at a time, until the line's mass.
    """
    index = {point.name: i for i, point in enumerate(experiment.drawpoints)}
    done = 0.0
    for line in experiment.draw:
        start, turn = done, 0
        while done < start + line.mass * (1 - 1e-12):
            done = min(start + (turn + 1) * line.increment, start + line.mass)
            yield index[line.drawpoints[turn % len(line.drawpoints)]], done
            turn += 1


def _openings(experiment: Experiment, lattice: Lattice, code: np.ndarray) -> Iterator[np.ndarray]:
    """Lowest ground cells whose larger part lies in each drawpoint; at least the nearest one."""
    lowest = np.argmax(code != OUTSIDE, axis=0)
    ground = (code != OUTSIDE).any(axis=0)
    taken = np.zeros(ground.shape, dtype=bool)
    for point in experiment.drawpoints:
        area = lattice.covered_area(point.x, point.y, point.width, point.length)
        area = np.where(ground & ~taken, area, 0.0)
        inside = area > 0.5 * lattice.cell_area
        if not inside.any():
            inside = (area == area.max()) & (area > 0.0)
        taken |= inside
        j, i = np.nonzero(inside)
        yield np.column_stack([lowest[j, i], j, i])


class _Cells(NamedTuple):
    """What a sweep takes of each cell, (z, y, x); see `stress.stress_sweep`.

    `edge` and `corner` are (0, 0, 0) where ranks stand for them.
    """

    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray


class _Ground:
    """One replicate's packing, as effects leave it, and its spreading weights.

    The ranks of s stand for them, unless an effect makes them differ between cells of one rank.
    """

    def __init__(
        self, setup: Setup, parameters: Parameters, packing: np.random.Generator, out: _Recorder
    ):
        self._setup, self._parameters, self._rng = setup, parameters, packing
        self.dtype = setup.cell_weight.dtype
        self.cells = _packing(setup, parameters, packing)
        shape = setup.code.shape
        self._s = parameters.s_mean + parameters.s_std * rank_normals()
        weights = np.column_stack(spreading_weights(self._s, self._rule, self.dtype))
        self._ranked = Ranked(draw_ranks(packing, shape), weights)
        shed = self.cells.shed_fraction
        shed = np.reshape(shed, shape if np.ndim(shed) else (1, 1, 1))
        none = np.zeros((0, 0, 0), self.dtype)
        self._cells = _Cells(self.cells.weight.reshape(shape), shed, none, none)
        self._by_cell = np.ndim(self.cells.s_shift) > 0 or self.cells.persistence > 0.0
        if self._by_cell:
            granular, negative = self._weigh_cells()
        else:
            limit = np.searchsorted(self._s, 0.0)
            granular, negative = count_below(limit, self._ranked.rank.ravel(), setup.code.ravel())
        out.readings.negative_s_share = negative / granular
        self._increments = np.concatenate([[0.0], setup.visits[1]])
        self._drawn = 0.0  # increments so far, and when the cell at each place came
        self._came = np.zeros(shape) if out.needs_state else None

    def _weigh_cells(self):
        """Spreading weights cell by cell; the number of cells, and of those with s < 0."""
        edge, corner = np.empty((2, *self._setup.code.shape), self.dtype)
        self._cells = self._cells._replace(edge=edge, corner=corner)
        granular = negative = 0
        for levels, places in _blocks(edge.shape):
            s = self._of_cells(self._ranked.rank[levels], places)
            edge[levels], corner[levels] = spreading_weights(s, self._rule, self.dtype)
            here = self._setup.code[levels] == STAGNANT
            granular += np.count_nonzero(here)
            negative += np.count_nonzero(here & (s < 0))
        return granular, negative

    @property
    def _rule(self) -> str:
        return self._setup.experiment.stress.rule

    def _of_cells(self, ranks, cells):
        """s of cells of these ranks, whose identities are given as an index."""
        s, shift = self._s[ranks], self.cells.s_shift
        return s if np.ndim(shift) == 0 else s + shift[cells].reshape(s.shape)

    def upto(self, levels: int) -> tuple[_Cells, Ranked]:
        """What a sweep takes of the lowest levels, cells at home."""
        cells = _Cells(*(part[:levels] for part in self._cells))
        if self._by_cell:
            return cells, BY_CELL
        return cells, self._ranked._replace(rank=self._ranked.rank[:levels])

    def _spreading(self, levels):
        """Edge and corner weights (z, y, x) of the lowest levels."""
        if self._by_cell:
            return self._cells.edge[:levels], self._cells.corner[:levels]
        rank, weights = self._ranked
        return weights[:, 0][rank[:levels]], weights[:, 1][rank[:levels]]

    def redraw(self, moved: np.ndarray, cell_id: np.ndarray, mass: float) -> None:
        """New s where `moved` is set, after `mass` kg."""
        self._drawn = np.interp(mass, self._increments, np.arange(len(self._increments)))
        redraw_ranks(self._rng, self._ranked.rank, moved)
        if self._by_cell or self._came is not None:
            for _, block in _blocks(moved.shape):
                places = np.flatnonzero(moved.ravel()[block])
                if len(places):
                    self._renew(places + block.start, cell_id)

    def _renew(self, places, cell_id):
        if self._by_cell:
            edge, corner = self._cells.edge.ravel(), self._cells.corner.ravel()
            cells = np.maximum(cell_id.ravel()[places], 0)
            s = self._of_cells(self._ranked.rank.ravel()[places], cells)
            weights = spreading_weights(s, self._rule, self.dtype)
            if self.cells.persistence > 0.0:
                old = edge[places], corner[places]
                weights = _mixed(old, weights, self.cells.persistence)
            edge[places], corner[places] = weights
        if self._came is not None:
            self._came.flat[places] = self._drawn

    def at_rest(self, code: np.ndarray, top_fraction: float) -> State:
        """The lattice of a filling, through the state effects."""
        nowhere = np.full(code.shape, -1, dtype=np.int16)
        weight = self._cells.weight[: len(code)].copy()
        weight[-1] *= top_fraction
        shed = np.broadcast_to(self._cells.shed_fraction[: len(code)], code.shape).copy()
        cells = _Cells(weight, shed, *self._spreading(len(code)))
        return self._through_effects(code, nowhere, nowhere, np.zeros(0), shed, cells)

    def in_draw(self, now: Snapshot, zone_shed: np.ndarray) -> State:
        """The lattice during draw, through the state effects; `zone_shed` (label): 1 − E_min."""
        moved = Moved(now.cell_id, now.zone, zone_shed)
        weight, shed, _, _ = self._cells
        spreading = self._spreading(len(now.code))
        cells = _Cells(*place_cells(now.code, moved, weight, shed), *spreading)
        root, own = place_zones(moved, now.zone_root, shed)
        return self._through_effects(now.code, now.zone, root, now.heights, own, cells)

    def _through_effects(self, code, zone, zone_root, heights, own_shed, cells):
        state = State(
            experiment=self._setup.experiment,
            lattice=self._setup.lattice,
            code=code,
            zone=zone,
            zone_root=zone_root,
            zone_height=heights,
            own_shed=own_shed,
            steps_at_rest=self._drawn - self._came[: code.shape[0]],
            relaxation=self._parameters.R,
            coupling=UNCOUPLED,
            **cells._asdict(),
        )
        return apply(self._setup.effects, "state", state)


def _blocks(shape: tuple[int, int, int]) -> Iterator[tuple[slice, slice]]:
    """Levels and flat places of blocks of whole levels that fit into cache, from the base up."""
    nz, ny, nx = shape
    levels = max(1, BLOCK // (ny * nx))
    for k in range(0, nz, levels):
        end = min(k + levels, nz)
        yield slice(k, end), slice(k * ny * nx, end * ny * nx)


def _packing(setup: Setup, parameters: Parameters, packing: np.random.Generator) -> Packing:
    """The cells of a replicate, as effects leave them."""
    dtype = setup.cell_weight.dtype
    cells = Packing(
        experiment=setup.experiment,
        lattice=setup.lattice,
        code=setup.code,
        weight=setup.cell_weight,
        shed_fraction=dtype.type(1.0 - parameters.E),
        s_shift=0.0,
        persistence=0.0,
        random=packing,
    )
    if not setup.acts_on("packing"):
        return cells
    cells = apply(setup.effects, "packing", replace(cells, random=packing.spawn(1)[0]))
    return replace(
        cells,
        weight=cells.weight.astype(dtype, copy=False),
        shed_fraction=np.asarray(cells.shed_fraction, dtype),
    )


def _taken(state: State, dtype: type) -> tuple[_Cells, np.ndarray, float, Coupling]:
    """What a sweep takes of a state."""
    parts = (getattr(state, name).astype(dtype, copy=False) for name in _Cells._fields)
    cells = _Cells(*map(np.ascontiguousarray, parts))
    return cells, state.code, state.relaxation, state.coupling


def _mixed(old, new, persistence):
    """Edge and corner weights whose β are a mix of the old and the new β."""
    shares = []
    for edge, corner in (old, new):
        edge, corner = np.float64(edge), np.float64(corner)
        total = 1.0 + 4.0 * edge + 4.0 * corner
        shares.append(np.array([1.0 / total, edge / total, corner / total]))
    down, edge, corner = persistence * shares[0] + (1.0 - persistence) * shares[1]
    return edge / down, corner / down


@dataclass
class _Recorder:
    """Runs the sweeps of a replicate and keeps what the base reads."""

    setup: Setup
    keeps_load: bool
    inspect: Inspector | None
    readings: Readings = field(init=False)

    def __post_init__(self):
        times = self.setup.times
        self.readings = Readings(
            vertical_stress=np.zeros((times, len(self.setup.footprints))),
            base_vertical_stress=np.zeros(times),
            base_vertical_stress_std=np.zeros(times),
            weight_balance_error=np.zeros(times),
            negative_s_share=np.nan,
        )
        if self.setup.experiment.keep_fields:
            shape = (times, *self.setup.lattice.shape)
            self.readings.replicate_vertical_stress = np.full(shape, np.nan, dtype=np.float32)

    @property
    def needs_state(self) -> bool:
        """Whether someone wants the lattice as a `State`."""
        return self.inspect is not None or self.setup.acts_on("state")

    def finish(self) -> Readings:
        """The readings, as the sensors give them."""
        readings = self.readings
        readings.vertical_stress = sensed(self.setup, readings.vertical_stress)
        return readings

    def sweep(
        self,
        t,
        cells,
        code,
        relaxation,
        coupling,
        top_fraction,
        state=None,
        moved=AT_HOME,
        ranked=BY_CELL,
    ):
        """One sweep, read at time `t`; returns the carried load (z, y, x) in N where kept."""
        setup, readings = self.setup, self.readings
        fields = readings.replicate_vertical_stress
        keep = self.keeps_load or self.inspect is not None or fields is not None
        shape = code.shape if keep else (0, 0, 0)
        load = np.zeros(shape, dtype=setup.cell_weight.dtype)
        base_load = np.zeros(code.shape[1:])
        weight, shed = stress_sweep(
            *cells, code, relaxation, top_fraction, load, base_load, coupling, moved, ranked
        )
        error = abs(weight - base_load.sum() - shed) / weight
        if not error <= BALANCE_TOLERANCE:
            raise WeightBalanceError(
                f"{setup.experiment.name}: weight balance is off by {error:.3g} of the weight at "
                f"reading {t}; at most {BALANCE_TOLERANCE:g} is allowed"
            )
        kpa = KPA / setup.lattice.cell_area
        mean, std = read_base(
            base_load, setup.base, setup.footprints, kpa, readings.vertical_stress[t]
        )
        readings.base_vertical_stress[t] = mean
        readings.base_vertical_stress_std[t] = std
        readings.weight_balance_error[t] = error
        if fields is not None:
            fields[t, : len(load)] = load / setup.lattice.cell_area * KPA
        if self.inspect is not None:
            self.inspect(
                t, Sweep(*cells, code, relaxation, top_fraction, coupling, load, base_load), state
            )
        return load


def sensed(setup: Setup, stress: np.ndarray) -> np.ndarray:
    """What the load cells read of stresses (time, load_cell) in kPa, through the sensor effects."""
    names = [cell.name for cell in load_cells(setup.experiment)]
    for one in setup.effects:
        if one.effect.readings is not None and not one.is_neutral:
            masses = np.array(setup.masses or np.zeros(setup.times))
            reading = Reading(stress, names.index(one.load_cell), masses)
            stress = one.effect.readings(reading, one.values)
    return stress
