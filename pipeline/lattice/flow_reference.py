"""The slow, obvious twin of `pipeline.lattice.flow`: same random draws, same results.

Plain loops over places as (z, y, x) tuples; what the kernel keeps up to date as it goes (connected
zones, extents, counts of loosened places) is here read off the whole lattice after each cell.
"""

import math
from itertools import accumulate, product

import numpy as np

from pipeline.lattice.cells import AIR, MOVEMENT, STAGNANT, VOID
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    LOOSENED_CELLS,
    PARKED_VOIDS,
    VOID_STEPS,
)
from pipeline.lattice.grid import GRAVITY


def draw_to(
    state,
    cell_weight,
    drawpoint,
    target_mass,
    exponent,
    bulking,
    rng,
    after_step=lambda state: None,
):
    """As `pipeline.lattice.flow.draw_to`, with the flow exponent itself instead of its table.

    ``after_step`` is called with the state whenever a void has exchanged places with a cell; the
    climbing void is then a ``VOID`` without identity. ``state.index`` is left as it is.
    """
    rows = slice(*state.opening_offsets[drawpoint : drawpoint + 2])
    opening = [tuple(place) for place in state.opening_cells[rows].tolist()]
    while True:
        drawn = state.counters[DRAWN_CELLS]
        mass = state.drawn_mass[drawn - 1] if drawn else 0.0
        available = [place for place in opening if state.code[place] in (STAGNANT, MOVEMENT)]
        if not available:
            return max(target_mass - mass, 0.0)
        opening_mass = 0.0
        for place in available:
            opening_mass += float(cell_weight[state.cell_id[place]]) / GRAVITY
        mean_mass = opening_mass / len(available)
        if mass + mean_mass / 2 > target_mass:
            return 0.0

        place = available[math.floor(rng.random() * len(available))]
        cell = state.cell_id[place]
        state.drawn_cell[drawn] = cell
        state.drawn_drawpoint[drawn] = drawpoint
        state.drawn_mass[drawn] = mass + float(cell_weight[cell]) / GRAVITY
        state.counters[DRAWN_CELLS] += 1
        state.code[place] = VOID
        state.cell_id[place] = -1
        if state.zone[place] < 0:
            state.zone[place] = drawpoint
        met = (drawpoint, state.zone[place])
        _climb(state, place, drawpoint, exponent, bulking, rng, after_step)
        _survey_zones(state, met)


def _climb(state, place, drawpoint, exponent, bulking, rng, after_step):
    while True:
        above = list(_around(place, (1,), state.code.shape))
        candidates = [
            (near, (1 / _distance(place, near)) ** exponent)
            for near in above
            if state.code[near] in (STAGNANT, MOVEMENT)
        ]
        if not candidates:
            codes = [state.code[near] for near in above]
            if AIR in codes or VOID not in codes:
                state.code[place] = AIR
            else:
                state.counters[HANG_UPS] += 1
            return

        cumulative = list(accumulate(weight for _, weight in candidates))
        threshold = rng.random() * cumulative[-1]
        chosen = next(
            near
            for (near, _), reached in zip(candidates, cumulative, strict=True)
            if reached > threshold
        )

        first_loosened = state.code[chosen] == STAGNANT
        state.code[place] = MOVEMENT
        state.cell_id[place] = state.cell_id[chosen]
        state.moved[place] = True
        state.code[chosen] = VOID
        state.cell_id[chosen] = -1
        if state.zone[chosen] < 0:
            state.zone[chosen] = drawpoint
        state.counters[VOID_STEPS] += 1
        after_step(state)
        place = chosen
        if first_loosened and (bulking == 1 or (bulking != 0 and rng.random() < bulking)):
            state.counters[PARKED_VOIDS] += 1
            return


def _around(place, levels, shape):
    """The nine places around one, inside the lattice, at each of some levels relative to it."""
    k, j, i = place
    for dk, dy, dx in product(levels, (-1, 0, 1), (-1, 0, 1)):
        if 0 <= k + dk < shape[0] and 0 <= j + dy < shape[1] and 0 <= i + dx < shape[2]:
            yield k + dk, j + dy, i + dx


def _distance(place, other):
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(place, other, strict=True)))


def _survey_zones(state, met):
    """Read roots, extents and the count of loosened places off the whole lattice.

    Zones stay connected once they are; ``met`` are two labels that a void has just connected.
    """
    loosened = np.argwhere(state.zone >= 0).tolist()
    contacts = {met, *enumerate(state.zone_root)}
    for k, j, i in loosened:
        label = state.zone[k, j, i]
        state.level_min_x[label, k] = min(state.level_min_x[label, k], i)
        state.level_max_x[label, k] = max(state.level_max_x[label, k], i)
        for near in _around((k, j, i), (-1, 0, 1), state.zone.shape):
            if state.zone[near] >= 0:
                contacts.add((label, state.zone[near]))
    for _ in range(len(state.zone_root)):
        for one, other in contacts:
            lowest = min(state.zone_root[one], state.zone_root[other])
            state.zone_root[one] = state.zone_root[other] = lowest
    state.counters[LOOSENED_CELLS] = len(loosened)
