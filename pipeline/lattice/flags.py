"""Yes or no at each place of the lattice, packed so that a climbing void finds it in cache.

Flags of a row of eight places along x share a word with those of the place on either side: bit b
of word g is the place x = 8 g - 1 + b. So the three places around any x lie in one word. Words
(y + 1, g, z), uint16, stand level by level: a line of cache holds 32 levels. There is a row on
either side and a level on top in which no flag is raised.
"""

import numpy as np
from numba import njit

PLACES = 8  # of its own in each word

in_place = njit(nogil=True, cache=True, _nrt=False)
"""For kernels that are called for each cell and make no array.

Elsewhere Numba counts references to each array that a call hands on, with an atomic instruction,
which would cost as much as a small kernel's work. Without its runtime it counts none.
"""


def new_flags(shape):
    """Flags for a lattice of this shape (nz, ny, nx), none raised."""
    nz, ny, nx = shape
    return np.zeros((ny + 2, -(-nx // PLACES), nz + 1), np.uint16)


@njit(nogil=True, cache=True, inline="always")
def has_flag(flags, k, j, i):
    """Whether the flag of a place is raised; unsigned indices spare the test for negative ones."""
    return flags[np.uint64(j + 1), np.uint64(i >> 3), np.uint64(k)] >> (i & 7) + 1 & 1


@njit(nogil=True, cache=True, inline="always")
def flags_around(flags, k, j, i):
    """Flags of the nine places of level ``k`` around (j, i), 0 to 511.

    A bit for each place, in the array order of (y, x); ``k`` may be the level above the highest.
    """
    level, row, group, first = np.uint64(k), np.uint64(j), np.uint64(i >> 3), i & 7
    return (
        (flags[row, group, level] >> first & 7)
        | (flags[row + np.uint64(1), group, level] >> first & 7) << 3
        | (flags[row + np.uint64(2), group, level] >> first & 7) << 6
    )


@in_place
def set_flag(flags, k, j, i, raised):
    """Raise or lower the flag of a place."""
    group, place = i >> 3, i & 7
    _set_bit(flags, k, j, group, place + 1, raised)
    if place == 0 and group > 0:
        _set_bit(flags, k, j, group - 1, PLACES + 1, raised)
    if place == PLACES - 1 and group + 1 < flags.shape[1]:
        _set_bit(flags, k, j, group + 1, 0, raised)


@njit(nogil=True, cache=True, inline="always")
def _set_bit(flags, k, j, group, bit, raised):
    if raised:
        flags[j + 1, group, k] |= np.uint16(1 << bit)
    else:
        flags[j + 1, group, k] &= ~np.uint16(1 << bit)
