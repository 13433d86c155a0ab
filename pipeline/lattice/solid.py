"""The stress sweep through stagnant ground, several cells at a time.

Where two levels in a row are stagnant ground from side to side, each place gives and takes: no
code has to be looked at. What is left is arithmetic in short loops over rows, which the compiler
turns into vector instructions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lattice.cells import STAGNANT


class SolidRows(NamedTuple):
    """What `through_solid` works in; it fits into the fastest cache.

    `down`, `sides` and `corners`, float64 (3, nx + 2), are three rows of what `stress._sweep`
    keeps of a level under these names, row y at y % 3. `abreast`, float64 (nx), counts the
    receivers on either side along x. `pairs` (nx) has both spreading weights of a cell as one
    number of twice the size.
    """

    down: np.ndarray
    sides: np.ndarray
    corners: np.ndarray
    abreast: np.ndarray
    pairs: np.ndarray


@njit(nogil=True, cache=True)
def solid_rows(nx, ranked):
    """`SolidRows` for rows of so many cells."""
    abreast = np.full(nx, 2.0)
    abreast[0] -= 1.0
    abreast[-1] -= 1.0
    row = (3, nx + 2)
    pairs = np.empty(nx, ranked.weights.dtype)
    return SolidRows(np.zeros(row), np.zeros(row), np.zeros(row), abreast, pairs)


@njit(nogil=True, cache=True)
def is_solid(code, k):
    """Whether level k is stagnant ground from side to side."""
    _, ny, nx = code.shape
    for y in range(ny):
        other = np.int8(0)
        for x in range(nx):
            other |= code[k, y, x] ^ STAGNANT
        if other != 0:
            return False
    return True


@njit(nogil=True, cache=True, fastmath={"reassoc"})
def _add(total, part):
    """Their sum, in no set order where there are many parts: several are summed at a time."""
    return total + part


@njit(nogil=True, cache=True, error_model="numpy")
def through_solid(k, weight, shed_fraction, edge, corner, ranked, carried, rows):
    """Carry the loads `carried` (y, x) of level k + 1 down to level k, both stagnant ground.

    `weight` (y, x) is of level k, `shed_fraction` of the one above. What the general sweep does:
    the result is the same bit for bit, but for the order in which weights, and what is lost, are
    summed up; it returns these two sums. A row gives before the one beside it takes, so that three
    rows of givers are enough and the loads can be overwritten.
    """
    ny, nx = weight.shape
    down, sides, corners, abreast, pairs = rows
    flat = pairs.view(weight.dtype)
    total_weight = lost = 0.0
    sides[2], corners[2] = 0.0, 0.0  # beyond the first row
    for row in range(ny + 1):
        to = row % 3
        if row == ny:
            sides[to], corners[to] = 0.0, 0.0
        else:
            if ranked.rank.shape[0] > 0:
                for x in range(nx):
                    pairs[x] = ranked.weights[ranked.rank[k + 1, row, x]]
            else:
                for x in range(nx):
                    flat[2 * x] = edge[k + 1, row, x]
                    flat[2 * x + 1] = corner[k + 1, row, x]
            along = np.float64((row > 0) + (row < ny - 1))
            for x in range(nx):
                part = carried[row, x] * np.float64(shed_fraction[row, x])
                lost = _add(lost, part)
                w_edge, w_corner = np.float64(flat[2 * x]), np.float64(flat[2 * x + 1])
                beside, diagonal = along + abreast[x], along * abreast[x]
                unit = (carried[row, x] - part) / (1.0 + w_edge * beside + w_corner * diagonal)
                down[to, x + 1] = unit
                sides[to, x + 1] = unit * w_edge
                corners[to, x + 1] = unit * w_corner
        if row > 0:
            y = row - 1
            of, last = y % 3, (y + 2) % 3
            for x in range(nx):
                own = np.float64(weight[y, x])
                total_weight = _add(total_weight, own)
                level = down[of, x + 1] + (sides[of, x] + sides[of, x + 2])
                before = sides[last, x + 1] + (corners[last, x] + corners[last, x + 2])
                after = sides[to, x + 1] + (corners[to, x] + corners[to, x + 2])
                carried[y, x] = own + (level + (before + after))
    return total_weight, lost
