"""A load on top of the bed."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT


def load(state: State, values: Values) -> State:
    """q c² on the topmost granular cell of every column; rock above keeps it off."""
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    first = np.argmax((granular | (state.code == OUTSIDE))[::-1], axis=0)
    top = state.code.shape[0] - 1 - first
    y, x = np.nonzero(np.take_along_axis(granular, top[None], axis=0)[0])
    weight = state.weight.copy()
    weight[top[y, x], y, x] += 1e3 * values["stress"] * state.lattice.cell_area
    return replace(state, weight=weight)


EFFECT = Effect(
    description="A stress on the surface of the bed, carried down with its weight. It follows the "
    "surface as that subsides, and no density factor touches it.",
    equation="P_top ← P_top + q c²",
    source="Vanel et al. 2000, Phys. Rev. Lett. 84: a silo's response to an overload",
    scope="experiment",
    parameters=(Parameter("stress", "kPa", 0.0, 0.0, 1e4, 1.0, 1, "stress q on the surface"),),
    moves="raises every reading, by q times what the column transmits",
    example={"stress": 2.0},
    order=10,
    state=load,
)
