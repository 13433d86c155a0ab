"""What the kernels are measured against; nothing else uses it.

`triad` and `random_reads` are what the machine's memory gives; `published_sweep` is what others do.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def triad(a, b, c, scalar):
    """The STREAM triad a = b + scalar c on one thread; arrays (n) of one dtype (McCalpin 1995)."""
    for i in range(len(a)):
        a[i] = b[i] + scalar * c[i]


@njit(nogil=True, cache=True)
def random_reads(values, count, seed):
    """Read `count` random places of `values` (n, zeros), each place known only after the last read.

    A climbing void reads so too: where it looks next hangs on what it found. Returns the last
    state of the generator (64-bit linear congruence, Knuth's MMIX), where the next call goes on.
    """
    size = np.uint64(len(values))
    state = np.uint64(seed)
    for _ in range(count):
        place = ((state >> np.uint64(32)) * size) >> np.uint64(32)
        state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
        state += np.uint64(values[place])
    return state


def published_sweep(
    weight: np.ndarray, granular: np.ndarray, straight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Our minimal restatement of the 2-D stress sweep of a published void-migration model.

    Eqs 36 and 37 of Claudin, Bouchaud, Cates & Wittmer (1998), Phys. Rev. E 57, 4441, as the
    void-migration model (github.com/benjym/void-migration, `stress.py`, isotropic mode) uses them,
    cell by cell in Python as there. With σ and τ of the three cells above (left, straight, right),
    f = `straight` and a cell's own weight w,

        σ = w + f σ_s + (1 − f)/2 (σ_l + σ_r) + (τ_l − τ_r)/2
        τ = (τ_l + τ_r)/2 + (1 − f)/2 (σ_l − σ_r).

    One cell stands at a place (there: many, of several sizes). A void carries nothing, and what
    points at it is lost. Two things differ from the published code, so that weight is kept where
    there are no voids: the top level carries its weight, and beyond a wall stands the mirror image
    of the cell beside it (there: the neighbor on the other side, which keeps the weight of uniform
    levels only). Neither matters for speed.

    Parameters
    ----------
    weight : (z, x) float, own weight of each cell, N; level 0 is the base
    granular : (z, x) bool, False in voids
    straight : f in [0, 1]; the published model takes sin φ of the repose angle

    Returns
    -------
    stress, shear : (z, x) float64, the vertical force σ and the shear force τ of each cell, N
    """
    nz, nx = weight.shape
    stress, shear = np.zeros((nz, nx)), np.zeros((nz, nx))
    for x in range(nx):
        if granular[nz - 1, x]:
            stress[nz - 1, x] = weight[nz - 1, x]
    for k in range(nz - 2, -1, -1):
        for x in range(nx):
            if not granular[k, x]:
                continue
            above = stress[k + 1, x]
            left, left_shear = above, -shear[k + 1, x]
            right, right_shear = left, left_shear
            if x > 0:
                left, left_shear = stress[k + 1, x - 1], shear[k + 1, x - 1]
            if x < nx - 1:
                right, right_shear = stress[k + 1, x + 1], shear[k + 1, x + 1]
            aside = 0.5 * (1.0 - straight)
            stress[k, x] = weight[k, x] + straight * above + aside * (left + right)
            stress[k, x] += 0.5 * (left_shear - right_shear)
            shear[k, x] = 0.5 * (left_shear + right_shear) + aside * (left - right)
    return stress, shear


def published_sweep_by_levels(
    weight: np.ndarray, granular: np.ndarray, straight: float
) -> tuple[np.ndarray, np.ndarray]:
    """`published_sweep` a level at a time in NumPy: what it could do in plain Python."""
    stress, shear = np.zeros(weight.shape), np.zeros(weight.shape)
    stress[-1] = np.where(granular[-1], weight[-1], 0.0)
    aside = 0.5 * (1.0 - straight)
    for k in range(len(weight) - 2, -1, -1):
        above, above_shear = stress[k + 1], shear[k + 1]
        around = np.concatenate([above[:1], above, above[-1:]])
        around_shear = np.concatenate([-above_shear[:1], above_shear, -above_shear[-1:]])
        left, right = around[:-2], around[2:]
        left_shear, right_shear = around_shear[:-2], around_shear[2:]
        vertical = weight[k] + straight * above + aside * (left + right)
        vertical += 0.5 * (left_shear - right_shear)
        lateral = 0.5 * (left_shear + right_shear) + aside * (left - right)
        stress[k] = np.where(granular[k], vertical, 0.0)
        shear[k] = np.where(granular[k], lateral, 0.0)
    return stress, shear
