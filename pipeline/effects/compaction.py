"""The bed is denser below."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Packing, Parameter, State, Values
from pipeline.lattice.cells import STAGNANT


def compact_fill(state: State, values: Values) -> State:
    """A filling at rest: its own overburden at each fill level."""
    if state.experiment.is_draw:
        return state
    weight = _compacted(state.weight, state.code == STAGNANT, values["index"])
    return replace(state, weight=weight)


def compact_cells(cells: Packing, values: Values) -> Packing:
    """A bed to be drawn: the overburden before draw; cells keep their density as they move."""
    if not cells.experiment.is_draw:
        return cells
    weight = cells.weight.reshape(cells.code.shape)
    weight = _compacted(weight, cells.code == STAGNANT, values["index"])
    return replace(cells, weight=weight.ravel())


def _compacted(weight: np.ndarray, ground: np.ndarray, index: float) -> np.ndarray:
    """Weights (z, y, x) times (overburden at the middle of the level)^index, the sum kept."""
    level = np.where(ground, weight, 0.0).sum(axis=(1, 2), dtype=np.float64)
    mean = level / np.maximum(ground.sum(axis=(1, 2)), 1)
    overburden = np.cumsum(mean[::-1])[::-1] - 0.5 * mean
    factor = np.where(mean > 0.0, overburden, 1.0) ** index
    factor *= level.sum() / (level * factor).sum()
    return weight * factor[:, None, None]


EFFECT = Effect(
    description="Bulk density rises with the weight of the bed above; the declared mass of the bed "
    "is kept, at every fill level. The overburden is that of the bed at rest, without arching.",
    equation="ρ(z) ∝ σ_g(z)^index, σ_g = ∫ρ g dz above z, ∫ρ dV as declared",
    source="Couto et al. 2013; Kvapil 2008",
    scope="material",
    parameters=(Parameter("index", "1", 0.0, 0.0, 0.5, 0.03, 1, "slope of ln ρ in ln overburden"),),
    moves="raises readings at the base where E < 1: more of the weight is near it",
    example={"index": 0.1},
    packing=compact_cells,
    state=compact_fill,
)
