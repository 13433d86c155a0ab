"""One replicate's packing: its cells and how they hand their load down, as effects leave them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pipeline.effects import Packing, State, apply
from pipeline.lattice.cells import STAGNANT
from pipeline.lattice.ranks import count_below, draw_ranks, rank_normals, redraw_ranks
from pipeline.lattice.spreading import spreading_weights
from pipeline.lattice.stress import (
    BY_CELL,
    UNCOUPLED,
    Coupling,
    Moved,
    Ranked,
    place_cells,
    place_zones,
)
from pipeline.parameters import Parameters
from pipeline.simulate.flow import Snapshot
from pipeline.simulate.setup import Setup
from pipeline.simulate.sweeps import Recorder

BLOCK = 2**16  # cells that are made at a time: they stay in cache


class Cells(NamedTuple):
    """What a sweep takes of each cell, (z, y, x); see `stress.stress_sweep`.

    `edge` and `corner` are (0, 0, 0) where ranks stand for them.
    """

    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray


class Ground:
    """One replicate's packing, as effects leave it, and its spreading weights.

    The ranks of s stand for them, unless an effect makes them differ between cells of one rank.
    """

    def __init__(
        self, setup: Setup, parameters: Parameters, packing: np.random.Generator, out: Recorder
    ):
        self._setup, self._parameters, self._rng = setup, parameters, packing
        self.dtype = setup.cell_weight.dtype
        self.cells = pack(setup, parameters, packing)
        shape = setup.code.shape
        self._s, weights = _by_rank(parameters.s_mean, parameters.s_std, self._rule, self.dtype)
        self._ranked = Ranked(draw_ranks(packing, shape), weights)
        shed = self.cells.shed_fraction
        shed = np.reshape(shed, shape if np.ndim(shed) else (1, 1, 1))
        none = np.zeros((0, 0, 0), self.dtype)
        self._cells = Cells(self.cells.weight.reshape(shape), shed, none, none)
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

    def upto(self, levels: int) -> tuple[Cells, Ranked]:
        """What a sweep takes of the lowest levels, cells at home."""
        cells = Cells(*(part[:levels] for part in self._cells))
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
        cells = Cells(weight, shed, *self._spreading(len(code)))
        return self._through_effects(code, nowhere, nowhere, np.zeros(0), shed, cells)

    def in_draw(self, now: Snapshot, zone_shed: np.ndarray) -> State:
        """The lattice during draw, through the state effects; `zone_shed` (label): 1 − E_min."""
        moved = Moved(now.cell_id, now.zone, zone_shed)
        weight, shed, _, _ = self._cells
        spreading = self._spreading(len(now.code))
        cells = Cells(*place_cells(now.code, moved, weight, shed), *spreading)
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


@lru_cache(maxsize=16)
def _by_rank(mean: float, std: float, rule: str, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """s (rank) and its edge and corner weights (rank, 2): the same for many replicates."""
    s = mean + std * rank_normals()
    return s, np.column_stack(spreading_weights(s, rule, dtype))


def _blocks(shape: tuple[int, int, int]) -> Iterator[tuple[slice, slice]]:
    """Levels and flat places of blocks of whole levels that fit into cache, from the base up."""
    nz, ny, nx = shape
    levels = max(1, BLOCK // (ny * nx))
    for k in range(0, nz, levels):
        end = min(k + levels, nz)
        yield slice(k, end), slice(k * ny * nx, end * ny * nx)


def pack(setup: Setup, parameters: Parameters, packing: np.random.Generator) -> Packing:
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


def for_sweep(state: State, dtype: type) -> tuple[Cells, np.ndarray, float, Coupling]:
    """What a sweep takes of a state."""
    parts = (getattr(state, name).astype(dtype, copy=False) for name in Cells._fields)
    cells = Cells(*map(np.ascontiguousarray, parts))
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
