"""Hypothesis strategies: states of the lattice as the stress sweep takes them."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.lattice.cells import AIR, MOVEMENT, OUTSIDE, STAGNANT, VOID
from pipeline.lattice.spreading import RULES, spreading_weights
from pipeline.lattice.stress import AT_HOME, BY_CELL, UNCOUPLED, Moved, Ranked, stress_sweep

SPREADS = {  # scenario: (mean, std) of s
    "even": (0.0, 0.0),
    "usual": (4.0, 3.0),
    "negative": (-3.0, 4.0),
    "wide": (50.0, 49.0),
    "extreme": (0.0, 400.0),
}


@dataclass(frozen=True)
class State:
    """Arguments of one stress sweep; arrays (z, y, x), z index 0 at the base."""

    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray
    code: np.ndarray
    relaxation: float
    top_fraction: float

    def arguments(self) -> tuple:
        """In the order of `stress_sweep`."""
        return tuple(vars(self).values())

    def with_arrays(self, change) -> "State":
        """The same with `change` applied to each array."""
        arrays = {k: change(v) for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Swept:
    """What a sweep returns."""

    load: np.ndarray
    base_load: np.ndarray
    total_weight: float
    shed: float


def sweep(
    state: State,
    dtype: type = np.float64,
    moved: Moved = AT_HOME,
    ranked: Ranked = BY_CELL,
) -> Swept:
    """Run the kernel on a state, the cells stored in `dtype`."""
    stored = state.with_arrays(
        lambda a: np.ascontiguousarray(a if a.dtype == np.int8 else a.astype(dtype))
    )
    load = np.zeros(state.code.shape, dtype)
    base_load = np.zeros(state.code.shape[1:])
    total, shed = stress_sweep(*stored.arguments(), load, base_load, UNCOUPLED, moved, ranked)
    return Swept(load, base_load, total, shed)


@st.composite
def lattice_states(draw, relaxations=st.just(1.0), codes=(VOID, STAGNANT, MOVEMENT, OUTSIDE, AIR)):
    """Any state: all cell codes anywhere, E from cell to cell, s of any sign and size."""
    shape = draw(hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6))
    # a single code twice as often as the others, so that loads come through
    code = draw(hnp.arrays(np.int8, shape, elements=st.sampled_from([*codes, STAGNANT, STAGNANT])))
    code[-1, 0, 0] = STAGNANT  # some weight to carry
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    granular = (code == STAGNANT) | (code == MOVEMENT)
    shed = rng.uniform(0.0, 1.0, shape) * draw(st.sampled_from([0.0, 0.02, 1.0]))
    density = rng.uniform(500.0, 4000.0, shape)
    mean, std = SPREADS[draw(st.sampled_from(sorted(SPREADS)))]
    rule = draw(st.sampled_from(RULES))
    edge, corner = spreading_weights(rng.normal(mean, std, shape), rule, np.float64)
    return State(
        weight=np.where(granular, 9.81 * 1e-3 * density, 0.0),
        shed_fraction=np.where(granular, shed, 0.0),
        edge=edge,
        corner=corner,
        code=code,
        relaxation=draw(relaxations),
        top_fraction=draw(st.sampled_from([1.0, 0.25]) | st.floats(1e-3, 1.0)),
    )


def uniform_state(shape, transmission, s, top_fraction=1.0, weight=1.0) -> State:
    """Stagnant ground of one weight and E everywhere; `s` (z, y, x)."""
    edge, corner = spreading_weights(np.broadcast_to(s, shape), dtype=np.float64)
    return State(
        weight=np.full(shape, weight),
        shed_fraction=np.full(shape, 1.0 - transmission),
        edge=edge,
        corner=corner,
        code=np.full(shape, STAGNANT),
        relaxation=1.0,
        top_fraction=top_fraction,
    )
