"""What stays the same from replicate to replicate of an experiment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment, LoadCell
from pipeline.config.measured import MeasuredRow, fill_levels, reading_masses
from pipeline.effects import Active, apply, as_filled, declared_effects, ordered
from pipeline.lattice.block_model import build_block_model, cell_codes, lattice_of
from pipeline.lattice.cells import OUTSIDE
from pipeline.lattice.grid import GRAVITY, Lattice


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


def make_setup(
    experiment: Experiment,
    block_model: xr.Dataset | None = None,
    rows: tuple[MeasuredRow, ...] = (),
    dtype: type = np.float32,
    effects: tuple[Active, ...] | None = None,
) -> Setup:
    """Arrays of an experiment for its replicates.

    `block_model` is made here if it is not given. `rows` are its measured rows, whose fill heights
    and masses join the declared readings; `dtype` is the storage type of the cells' weights;
    `effects` replace those that the experiment declares.
    """
    active = declared_effects(experiment) if effects is None else ordered(effects)
    levels = () if experiment.is_draw else fill_levels(experiment, rows)
    true_levels = tuple(float(apply(active, "geometry", level)) for level in levels)
    filled = as_filled(experiment, active)
    lattice = lattice_of(filled)
    if block_model is None or filled is not experiment:
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
