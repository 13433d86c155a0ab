"""How the spreading exponent s of a cell is drawn: as a rank.

s ~ N(mean, std²) is drawn as one of `RANKS` equally likely ranks, 12 random bits a cell: rank r
stands for s = mean + std · `rank_normals()[r]`. So a cell's weights are one look into a table, and
what is kept of a packing is 2 bytes a cell. The bits of a place are those of SplitMix64 (Steele,
Lea & Flood 2014, OOPSLA) at this place: word key + (place // 4 + 1) γ, four places a word. They
hang on nothing but the key and the place.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from scipy.special import ndtri

from pipeline.lattice.cells import STAGNANT

RANKS = 4096


@cache
def rank_normals() -> np.ndarray:
    """What each rank stands for in a standard normal distribution: (RANKS,) float64, ascending.

    The mean of the normal distribution within the rank's share of it, (φ(a) − φ(b)) · RANKS, all
    of them scaled to a variance of 1. Mean 0 and symmetry are exact; the fourth moment is 2.997
    (3), the outermost ranks stand for ±3.74, and no probability is off by more than 1 / RANKS.
    """
    ends = ndtri(np.arange(1, RANKS) / RANKS)
    density = np.concatenate([[0.0], np.exp(-0.5 * ends**2) / math.sqrt(2.0 * math.pi), [0.0]])
    means = -np.diff(density) * RANKS
    means = 0.5 * (means - means[::-1])
    return means / math.sqrt(np.mean(means**2))


def draw_ranks(stream: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Ranks (uint16, below `RANKS`) of the s of new cells, from one 64-bit key of the stream."""
    ranks = np.empty(shape, np.uint16)
    _fill(_key(stream), ranks.reshape(-1))
    return ranks


def redraw_ranks(stream: np.random.Generator, ranks: np.ndarray, moved: np.ndarray) -> None:
    """New ranks where `moved` (bool) is set, in place, from one more key of the stream."""
    _refill(_key(stream), ranks.reshape(-1), moved.reshape(-1))


@njit(nogil=True, cache=True)
def count_below(limit, ranks, code):
    """How many places (flat) are stagnant ground, and how many of those have a rank below."""
    stagnant, below = 0, 0
    for place in range(len(ranks)):
        here = code[place] == STAGNANT
        stagnant += here
        below += here & (ranks[place] < limit)
    return stagnant, below


def _key(stream: np.random.Generator) -> np.uint64:
    return stream.integers(2**64, dtype=np.uint64)


@njit(nogil=True, cache=True)
def _word(key, number):
    """Word `number` of SplitMix64 from `key`."""
    z = key + np.uint64(number + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(nogil=True, cache=True)
def _rank(word, place):
    """The rank of a place: the upper 12 of its 16 bits of the word."""
    return np.uint16((word >> np.uint64(16 * (place % 4) + 4)) & np.uint64(RANKS - 1))


@njit(nogil=True, cache=True)
def _fill(key, ranks):
    words = len(ranks) // 4
    for number in range(words):
        word = _word(key, number)
        for lane in range(4):
            ranks[4 * number + lane] = _rank(word, lane)
    for place in range(4 * words, len(ranks)):
        ranks[place] = _rank(_word(key, words), place)


@njit(nogil=True, cache=True)
def _refill(key, ranks, moved):
    for place in range(len(ranks)):
        if moved[place]:
            ranks[place] = _rank(_word(key, place // 4), place)
