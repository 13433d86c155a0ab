"""Load leans to one side."""

import math
from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, STAGNANT

OFFSETS = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)], dtype=float)
RING = np.abs(OFFSETS).sum(axis=1).astype(int)  # 0 straight below, 1 edges, 2 corners


def lean(state: State, values: Values) -> State:
    """κ that shifts the packing's mean weights by the tangent of the angle for each level."""
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    straight = state.coupling.straight
    down = straight[granular] if straight.size else 1.0
    edge, corner = (a[granular].astype(np.float64) for a in (state.edge, state.corner))
    total = down + 4.0 * (edge + corner)
    beta = np.array([np.mean(weight / total) for weight in (down, edge, corner)])
    shift = [math.tan(math.radians(values[name])) for name in ("angle_x", "angle_y")]
    x, y = _kappa(beta[RING], np.array(shift))
    return replace(state, coupling=state.coupling._replace(lean_x=x, lean_y=y))


def _kappa(beta: np.ndarray, shift: np.ndarray) -> tuple[float, float]:
    """κ (x, y) with Σ o β exp(κ·o) / Σ β exp(κ·o) = shift: Newton on a convex function."""

    def weights(kappa):
        exponent = np.log(np.maximum(beta, 1e-300)) + OFFSETS @ kappa
        largest = exponent.max()
        weight = np.exp(exponent - largest)
        return weight / weight.sum(), largest + math.log(weight.sum()) - kappa @ shift

    kappa = np.zeros(2)
    for _ in range(200):
        share, value = weights(kappa)
        mean = share @ OFFSETS
        if np.abs(mean - shift).max() < 1e-13:
            break
        spread = (OFFSETS * share[:, None]).T @ OFFSETS - np.outer(mean, mean)
        step = np.linalg.solve(spread + 1e-12 * np.eye(2), shift - mean)
        step *= min(1.0, 5.0 / np.abs(step).max())
        while weights(kappa + step)[1] > value + 1e-14 * abs(value) and np.abs(step).max() > 1e-15:
            step *= 0.5
        kappa = kappa + step
        if np.abs(step).max() < 1e-14:
            break
    return float(kappa[0]), float(kappa[1])


EFFECT = Effect(
    description="Weights lean to one side, as after inclined deposition. The lean is one for the "
    "packing and shifts its mean β by the tangent of the angle for each level; cells whose β "
    "differ shift by more or less.",
    equation="β ← β exp(κ_x x + κ_y y), normalised; Σ (x, y) β̄ = (tan angle_x, tan angle_y) cells",
    source="Hemmingsson et al. 1997: stress dip under an inclined deposit",
    scope="experiment",
    parameters=(
        Parameter("angle_x", "°", 0.0, -40.0, 40.0, 3.0, 0, "lean of load paths along x"),
        Parameter("angle_y", "°", 0.0, -40.0, 40.0, 3.0, 0, "lean of load paths along y"),
    ),
    moves="raises readings at the side that it leans to",
    example={"angle_x": 6.0},
    order=10,
    state=lean,
)
