"""Load leans to one side."""

import math
from dataclasses import replace

import numpy as np
from numba import njit

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, STAGNANT

OFFSETS = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)], dtype=float)
RING = np.abs(OFFSETS).sum(axis=1).astype(int)  # 0 straight below, 1 edges, 2 corners


def lean(state: State, values: Values) -> State:
    """κ that shifts the packing's mean weights by the tangent of the angle for each level."""
    beta = np.array(_mean_shares(state.code, state.coupling.straight, state.edge, state.corner))
    shift = [math.tan(math.radians(values[name])) for name in ("angle_x", "angle_y")]
    x, y = map(float, _kappa(beta[RING], np.array(shift)))
    return replace(state, coupling=state.coupling._replace(lean_x=x, lean_y=y))


@njit(nogil=True, cache=True)
def _mean_shares(code, straight, edge, corner):
    """Mean over granular cells of the shares of one receiver of each ring, as if all took part."""
    nz, ny, nx = code.shape
    count, below, beside, across = 0, 0.0, 0.0, 0.0
    for k in range(nz):
        for y in range(ny):
            for x in range(nx):
                if code[k, y, x] == STAGNANT or code[k, y, x] == MOVEMENT:
                    down = np.float64(straight[k, y, x]) if straight.size else 1.0
                    side, diagonal = np.float64(edge[k, y, x]), np.float64(corner[k, y, x])
                    total = down + 4.0 * (side + diagonal)
                    below += down / total
                    beside += side / total
                    across += diagonal / total
                    count += 1
    return below / count, beside / count, across / count


@njit(nogil=True, cache=True, error_model="numpy")
def _kappa(beta, shift):
    """κ (x, y) with Σ o β exp(κ·o) / Σ β exp(κ·o) = shift: Newton on a convex function."""
    kappa, share = np.zeros(2), np.empty(9)
    mean, spread = np.empty(2), np.empty((2, 2))
    for _ in range(200):
        value = _shares(beta, kappa, shift, share)
        mean[:] = 0.0
        spread[:] = 0.0
        for n in range(9):
            for a in range(2):
                mean[a] += share[n] * OFFSETS[n, a]
                for b in range(2):
                    spread[a, b] += share[n] * OFFSETS[n, a] * OFFSETS[n, b]
        left = shift - mean
        if np.abs(left).max() < 1e-13:
            break
        for a in range(2):
            for b in range(2):
                spread[a, b] -= mean[a] * mean[b]
            spread[a, a] += 1e-12
        determinant = spread[0, 0] * spread[1, 1] - spread[0, 1] * spread[1, 0]
        step = np.array(
            [
                (spread[1, 1] * left[0] - spread[0, 1] * left[1]) / determinant,
                (spread[0, 0] * left[1] - spread[1, 0] * left[0]) / determinant,
            ]
        )
        step *= min(1.0, 5.0 / np.abs(step).max())
        allowed = value + 1e-14 * abs(value)
        while _shares(beta, kappa + step, shift, share) > allowed and np.abs(step).max() > 1e-15:
            step *= 0.5
        kappa += step
        if np.abs(step).max() < 1e-14:
            break
    return kappa[0], kappa[1]


@njit(nogil=True, cache=True, error_model="numpy")
def _shares(beta, kappa, shift, share):
    """Shares of the nine at κ, into `share`, and the convex function whose minimum is wanted."""
    for n in range(9):
        share[n] = (
            math.log(max(beta[n], 1e-300)) + OFFSETS[n, 0] * kappa[0] + OFFSETS[n, 1] * kappa[1]
        )
    largest = share.max()
    share[:] = np.exp(share - largest)
    total = share.sum()
    share /= total
    return largest + math.log(total) - kappa[0] * shift[0] - kappa[1] * shift[1]


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
