"""Narrow pillars draw more load than wide ones."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, STAGNANT

REACH = 2  # receivers of one cell lie at most so many places apart


def relax(state: State, values: Values) -> State:
    """R of each movement-zone receiver beside a pillar, by the pillar's width."""
    beside = np.minimum(_narrowest_beside(state, axis=1), _narrowest_beside(state, axis=2))
    width = values["width"] / (beside * state.lattice.cell_size)
    base = state.coupling.relaxation if state.coupling.relaxation.size else state.relaxation
    field = np.where(state.code == MOVEMENT, base / (1.0 + width), base).astype(np.float32)
    return replace(state, coupling=state.coupling._replace(relaxation=field))


def _narrowest_beside(state: State, axis: int) -> np.ndarray:
    """Cells (z, y, x) across the narrowest pillar within reach along an axis; inf without one."""
    stagnant = np.moveaxis(state.code == STAGNANT, axis, -1)
    zone = np.moveaxis(state.zone, axis, -1)
    count = stagnant.shape[-1]
    places = np.broadcast_to(np.arange(count), stagnant.shape)
    before = np.maximum.accumulate(np.where(stagnant, -1, places), axis=-1)
    after = np.where(stagnant, count, places)[..., ::-1]
    after = np.minimum.accumulate(after, axis=-1)[..., ::-1]
    ends = [
        np.take_along_axis(zone, np.clip(end, 0, count - 1), axis=-1) for end in (before, after)
    ]
    bounded = (before >= 0) & (after < count) & (ends[0] >= 0) & (ends[1] >= 0)
    pillar = stagnant & bounded & (ends[0] != ends[1])
    across = np.where(pillar, after - before - 1.0, np.inf)
    padded = np.pad(across, ((0, 0), (0, 0), (REACH, REACH)), constant_values=np.inf)
    near = (padded[..., shift : shift + count] for shift in range(2 * REACH + 1))
    return np.moveaxis(np.minimum.reduce(list(near)), -1, axis)


EFFECT = Effect(
    description="R falls where a pillar, stagnant ground between the movement zones of two "
    "drawpoints, is narrow, and rises with its width W to the R of wide stagnant ground. W is "
    "measured in cells along x and along y in each level, and acts on movement-zone receivers up "
    "to two places from the pillar.",
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
