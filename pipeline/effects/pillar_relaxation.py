"""Narrow pillars draw more load than wide ones."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, STAGNANT


def relax(state: State, values: Values) -> State:
    """R of each movement-zone receiver by the pillars at the edges of its zone."""
    moving = state.code == MOVEMENT
    if not moving.any():
        return state
    narrowness = np.maximum(_narrowness(state, axis=1), _narrowness(state, axis=2))
    divisor = 1.0 + values["width"] * narrowness / state.lattice.cell_size
    field = np.where(moving, state.relaxation / divisor, state.relaxation).astype(np.float32)
    return replace(state, coupling=state.coupling._replace(relaxation=field))


def _narrowness(state: State, axis: int) -> np.ndarray:
    """One over the width in cells of the pillars beside each place (z, y, x), along an axis.

    Linear between the two edges of a movement zone; 0 at an edge that is no pillar: wide ground
    or a wall. Stagnant cells inside the zone of one drawpoint are no edge.
    """
    stagnant = np.moveaxis(state.code == STAGNANT, axis, -1)
    zone = np.moveaxis(state.zone, axis, -1)
    before, after = nearest(~stagnant)
    left, right = value_at(zone, before, -1), value_at(zone, after, -1)
    between = stagnant & (left >= 0) & (right >= 0)
    pillar = between & (left != right)
    narrowness = np.where(pillar, 1.0 / np.maximum(after - before - 1, 1), 0.0)
    before, after = nearest((zone < 0) & (~between | pillar))
    part = (np.arange(zone.shape[-1]) - before) / np.maximum(after - before, 1)
    left, right = value_at(narrowness, before, 0.0), value_at(narrowness, after, 0.0)
    return np.moveaxis((1.0 - part) * left + part * right, -1, axis)


def nearest(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index along the last axis of the nearest place found at or before, and at or after, each.

    −1 and the length of the axis where there is none.
    """
    count = found.shape[-1]
    before = np.maximum.accumulate(np.where(found, np.arange(count), -1), axis=-1)
    after = np.where(found, np.arange(count), count)[..., ::-1]
    return before, np.minimum.accumulate(after, axis=-1)[..., ::-1]


def value_at(values: np.ndarray, index: np.ndarray, off: float) -> np.ndarray:
    """Values at an index along the last axis; `off` where it is off the lattice."""
    count = values.shape[-1]
    taken = np.take_along_axis(values, np.clip(index, 0, count - 1), axis=-1)
    return np.where((index >= 0) & (index < count), taken, off)


EFFECT = Effect(
    description="R falls at a narrow pillar, stagnant ground between the movement zones of two "
    "drawpoints, and rises with its width W to the R of wide ground. W is counted along x and "
    "along y in each level; across a movement zone 1/W runs from one edge to the other, and is 0 "
    "at an edge without a pillar.",
    equation="R(W) = R / (1 + width / W)",
    source="Castro et al. 2020: stress depends on the size of draw and non-draw areas; "
    "Gómez & Castro 2022, §5: R calibrated where no pillar concentrated stress",
    scope="study",
    parameters=(
        Parameter("width", "m", 0.0, 0.0, 100.0, 0.1, 1, "pillar width at which R is halved"),
    ),
    moves="raises readings under pillars between movement zones",
    example={"width": 0.3},
    state=relax,
)
