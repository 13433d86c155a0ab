"""One replicate of an experiment: the interface that everything above the lattice leans on.

`simulate` is a pure function of the setup, the parameters and the random streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment, LoadCell
from pipeline.config.measured import MeasuredRow, fill_levels, reading_masses
from pipeline.lattice.block_model import cell_codes, lattice_of
from pipeline.lattice.cells import OUTSIDE, STAGNANT
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    FlowState,
    climb_chances,
    draw_to,
    new_flow_state,
    zone_geometry,
)
from pipeline.lattice.grid import GRAVITY, Lattice, levels_of
from pipeline.lattice.stress import place_cells, spreading_weights, stress_sweep
from pipeline.parameters import Parameters

KPA = 1e-3
BALANCE_TOLERANCE = 1e-6

# called at each reading with (time index, cell codes, cell ids, carried load in N)
Observer = Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]


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
    openings : base cells (n, 3) of each drawpoint, as (z, y, x) indices
    to_the_end : whether draw goes on after the last reading, to the schedule's end
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
    to_the_end: bool = True

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
) -> Setup:
    """Arrays of an experiment for its replicates.

    `rows` are its measured rows, whose fill heights and masses join the declared readings;
    `dtype` is the storage type of the cells' weights.
    """
    lattice = lattice_of(experiment)
    code = cell_codes(block_model)
    density = block_model["bulk_density"].values.astype(np.float64)
    base = (code != OUTSIDE).any(axis=0)
    if experiment.load_cells:
        footprints = np.array([_footprint(lattice, base, cell) for cell in experiment.load_cells])
    else:
        footprints = (base / base.sum())[None]
    draw = experiment.is_draw
    return Setup(
        experiment=experiment,
        lattice=lattice,
        code=code,
        cell_weight=(density.ravel() * GRAVITY * lattice.cell_volume).astype(dtype),
        base=base,
        footprints=footprints,
        fill_levels=() if draw else fill_levels(experiment, rows),
        masses=reading_masses(experiment, rows) if draw else (),
        openings=tuple(_openings(experiment, lattice, code)) if draw else (),
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
    flow: np.random.Generator | None = None,
    observe: Observer | None = None,
) -> Readings:
    """Run one replicate and read its base.

    Parameters
    ----------
    packing : stream that draws s for each cell, and anew where a cell has moved
    flow : stream of the void diffusion; a draw experiment needs it
    observe : called at each reading with the state of the lattice, to reduce fields in place

    Raises
    ------
    WeightBalanceError
        If a sweep does not return the weight that was put in.
    """
    if setup.masses:
        return _simulate_draw(setup, parameters, packing, flow, observe)
    return _simulate_filling(setup, parameters, packing, observe)


def _simulate_filling(setup, parameters, packing, observe):
    lattice = setup.lattice
    spread = _Spreading(setup, parameters, packing)
    weight = setup.cell_weight.reshape(lattice.shape)
    shed = np.full(lattice.shape, 1.0 - parameters.E, dtype=weight.dtype)
    identity = np.arange(weight.size, dtype=np.int32).reshape(lattice.shape)
    out = _Recorder(setup, spread.negative_share)
    for t, height in enumerate(setup.fill_levels):
        levels, fraction = levels_of(height, lattice.cell_size)
        if levels == lattice.nz:  # the top level's density is scaled in the block model already
            fraction = min(fraction / lattice.top_fraction, 1.0)
        load = out.sweep(
            t,
            (weight[:levels], shed[:levels], spread.edge[:levels], spread.corner[:levels]),
            setup.code[:levels],
            parameters.R,
            fraction,
            observe is not None,
        )
        if observe is not None:
            observe(t, setup.code[:levels], identity[:levels], load)
    return out.readings


def _simulate_draw(setup, parameters, packing, flow, observe):
    lattice, dtype = setup.lattice, setup.cell_weight.dtype
    spread = _Spreading(setup, parameters, packing)
    state = new_flow_state(setup.code, setup.openings)
    shed_own = np.full(setup.cell_weight.shape, 1.0 - parameters.E, dtype=dtype)
    weight, shed = np.zeros(lattice.shape, dtype), np.zeros(lattice.shape, dtype)
    out = _Recorder(setup, spread.negative_share)
    readings = out.readings
    readings.movement_zone_height = np.zeros(setup.times)
    readings.movement_zone_width = np.zeros(setup.times)
    readings.replicate_mass_drawn = np.zeros(setup.times)
    readings.drawpoint_shortfall = np.zeros(len(setup.openings))
    for t in _draw(setup, parameters, state, flow, readings.drawpoint_shortfall):
        spread.redraw(state.moved)
        heights, widths = zone_geometry(state, lattice.cell_size)
        shed_zone = parameters.shed_in_zone(heights).astype(dtype)
        place_cells(
            state.code,
            state.cell_id,
            state.zone,
            setup.cell_weight,
            shed_own,
            shed_zone,
            weight,
            shed,
        )
        load = out.sweep(
            t,
            (weight, shed, spread.edge, spread.corner),
            state.code,
            parameters.R,
            1.0,
            observe is not None,
        )
        drawn = state.counters[DRAWN_CELLS]
        readings.movement_zone_height[t] = heights.max()
        readings.movement_zone_width[t] = widths.max()
        readings.replicate_mass_drawn[t] = state.drawn_mass[drawn - 1] if drawn else 0.0
        if observe is not None:
            observe(t, state.code, state.cell_id, load)
    drawn = state.counters[DRAWN_CELLS]
    readings.hang_ups = int(state.counters[HANG_UPS])
    readings.drawn_cell = state.drawn_cell[:drawn].copy()
    readings.drawn_drawpoint = state.drawn_drawpoint[:drawn].copy()
    readings.drawn_mass = state.drawn_mass[:drawn].copy()
    return readings


def _draw(
    setup: Setup,
    parameters: Parameters,
    state: FlowState,
    flow: np.random.Generator,
    shortfall: np.ndarray,
) -> Iterator[int]:
    """Follow the draw schedule; yields the index of each reading when its mass is drawn.

    A drawpoint with no granular cell left leaves the rest of its visit undrawn: what is missing
    is added to `shortfall` (drawpoint) in kg, and the schedule goes on.
    """
    cell_mass = setup.cell_weight.astype(np.float64) / GRAVITY
    chances = climb_chances(parameters.exponent)
    missing = 0.0
    t = 0
    while t < setup.times and setup.masses[t] <= 0.0:
        yield t
        t += 1
    for drawpoint, end in visits(setup.experiment):
        arguments = (chances, parameters.bulking, flow)
        while t < setup.times and setup.masses[t] <= end:
            draw_to(state, cell_mass, drawpoint, setup.masses[t] - missing, *arguments)
            yield t
            t += 1
        if t == setup.times and not setup.to_the_end:
            return
        short = draw_to(state, cell_mass, drawpoint, end - missing, *arguments)
        shortfall[drawpoint] += short
        missing += short
    while t < setup.times:
        yield t
        t += 1


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


class _Spreading:
    """The packing's s as spreading weights (z, y, x), redrawn where cells have moved."""

    def __init__(self, setup: Setup, parameters: Parameters, packing: np.random.Generator):
        self._mean, self._std = parameters.s_mean, parameters.s_std
        self._rule, self._rng = setup.experiment.stress.rule, packing
        self._dtype = setup.cell_weight.dtype
        s = self._draw(setup.code.shape)
        self.edge, self.corner = spreading_weights(s, self._rule, self._dtype)
        ground = setup.code == STAGNANT
        self.negative_share = np.count_nonzero(ground & (s < 0)) / np.count_nonzero(ground)

    def _draw(self, shape):
        return self._mean + self._std * self._rng.standard_normal(shape, dtype=np.float32)

    def redraw(self, moved: np.ndarray) -> None:
        """New s where `moved` is set, in array order; clears the flags."""
        places = np.flatnonzero(moved)
        edge, corner = spreading_weights(self._draw(len(places)), self._rule, self._dtype)
        self.edge.flat[places], self.corner.flat[places] = edge, corner
        moved[:] = False


@dataclass
class _Recorder:
    """Runs the sweeps of a replicate and keeps what the base reads."""

    setup: Setup
    negative_s_share: float
    readings: Readings = field(init=False)

    def __post_init__(self):
        times = self.setup.times
        self.readings = Readings(
            vertical_stress=np.zeros((times, len(self.setup.footprints))),
            base_vertical_stress=np.zeros(times),
            base_vertical_stress_std=np.zeros(times),
            weight_balance_error=np.zeros(times),
            negative_s_share=self.negative_s_share,
        )
        if self.setup.experiment.keep_fields:
            shape = (times, *self.setup.lattice.shape)
            self.readings.replicate_vertical_stress = np.full(shape, np.nan, dtype=np.float32)

    def sweep(self, t, cells, code, relaxation, top_fraction, keep):
        """One sweep, read at time `t`; returns the carried load (z, y, x) in N if `keep`."""
        setup, readings = self.setup, self.readings
        fields = readings.replicate_vertical_stress
        shape = code.shape if keep or fields is not None else (0, 0, 0)
        load = np.zeros(shape, dtype=setup.cell_weight.dtype)
        base_load = np.zeros(code.shape[1:])
        weight, shed = stress_sweep(*cells, code, relaxation, top_fraction, load, base_load)
        error = abs(weight - base_load.sum() - shed) / weight
        if not error <= BALANCE_TOLERANCE:
            raise WeightBalanceError(
                f"{setup.experiment.name}: weight balance is off by {error:.3g} of the weight at "
                f"reading {t}; at most {BALANCE_TOLERANCE:g} is allowed"
            )
        stress = base_load / setup.lattice.cell_area * KPA
        on_ground = stress[setup.base]
        readings.vertical_stress[t] = np.tensordot(setup.footprints, stress, axes=2)
        readings.base_vertical_stress[t] = on_ground.mean()
        readings.base_vertical_stress_std[t] = on_ground.std()
        readings.weight_balance_error[t] = error
        if fields is not None:
            fields[t, : len(load)] = load / setup.lattice.cell_area * KPA
        return load
