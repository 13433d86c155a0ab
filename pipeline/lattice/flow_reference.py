"""The slow, obvious twin of `pipeline.lattice.flow`: same random draws, same results.

Plain loops over places as (z, y, x) tuples; what the kernel keeps up to date as it goes (connected
zones, extents, counts of loosened places) is here read off the whole lattice after each cell.
"""

import math
from itertools import product

import numpy as np

from pipeline.lattice.cells import AIR, MOVEMENT, STAGNANT, VOID
from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    LOOSENED_CELLS,
    PARKED_VOIDS,
    VOID_STEPS,
)


def draw_to(
    state,
    cell_mass,
    drawpoint,
    target_mass,
    exponent,
    bulking,
    rng,
    after_step=lambda state: None,
):
    """As `pipeline.lattice.flow.draw_to`, with the flow exponent itself instead of its table.

    ``after_step`` is called with the state whenever a void has exchanged places with a cell; the
    climbing void is then a ``VOID`` without identity.
    """
    rows = slice(*state.opening_offsets[drawpoint : drawpoint + 2])
    opening = [tuple(place) for place in state.opening_cells[rows]]
    while True:
        drawn = state.counters[DRAWN_CELLS]
        mass = state.drawn_mass[drawn - 1] if drawn else 0.0
        available = [place for place in opening if state.code[place] in (STAGNANT, MOVEMENT)]
        if not available:
            return max(target_mass - mass, 0.0)
        opening_mass = 0.0
        for place in available:
            opening_mass += cell_mass[state.cell_id[place]]
        mean_mass = opening_mass / len(available)
        if mass + mean_mass / 2 > target_mass:
            return 0.0

        place = available[math.floor(rng.random() * len(available))]
        cell = state.cell_id[place]
        state.drawn_cell[drawn] = cell
        state.drawn_drawpoint[drawn] = drawpoint
        state.drawn_mass[drawn] = mass + cell_mass[cell]
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
        above = [
            (place, math.sqrt(1 + abs(dy) + abs(dx)))
            for place, dy, dx in _nine_above(place, state.code.shape)
        ]
        candidates = [
            (near, (1 / distance) ** exponent)
            for near, distance in above
            if state.code[near] in (STAGNANT, MOVEMENT)
        ]
        if not candidates:
            codes = [state.code[near] for near, _ in above]
            if AIR in codes or VOID not in codes:
                state.code[place] = AIR
            else:
                state.counters[HANG_UPS] += 1
            return

        total = 0.0
        for _, weight in candidates:
            total += weight
        threshold = rng.random() * total
        cumulative = 0.0
        for chosen, weight in candidates:
            cumulative += weight
            if cumulative > threshold:
                break

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
        if first_loosened:
            parks = bulking == 1 if bulking in (0, 1) else rng.random() < bulking
            if parks:
                state.counters[PARKED_VOIDS] += 1
                return


def _nine_above(place, shape):
    """The places above, at most nine, in array order, each with its offset in y and x."""
    k, j, i = place
    for dy, dx in product((-1, 0, 1), repeat=2):
        above = (k + 1, j + dy, i + dx)
        if above[0] < shape[0] and 0 <= above[1] < shape[1] and 0 <= above[2] < shape[2]:
            yield above, dy, dx


def _survey_zones(state, met):
    """Read roots, extents and the count of loosened places off the whole lattice.

    Zones stay connected once they are; ``met`` are two labels that a void has just connected.
    """
    loosened = [tuple(place) for place in np.argwhere(state.zone >= 0)]
    contacts = {met, *enumerate(state.zone_root)}
    for place in loosened:
        label = state.zone[place]
        state.level_min_x[label, place[0]] = min(state.level_min_x[label, place[0]], place[2])
        state.level_max_x[label, place[0]] = max(state.level_max_x[label, place[0]], place[2])
        for step in product((-1, 0, 1), repeat=3):
            near = tuple(np.add(place, step))
            if min(near) >= 0 and np.less(near, state.zone.shape).all() and state.zone[near] >= 0:
                contacts.add((label, state.zone[near]))
    for _ in range(len(state.zone_root)):
        for one, other in contacts:
            lowest = min(state.zone_root[one], state.zone_root[other])
            state.zone_root[one] = state.zone_root[other] = lowest
    state.counters[LOOSENED_CELLS] = len(loosened)
