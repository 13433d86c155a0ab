"""Gravity flow by void diffusion on a cubic lattice.

Arrays have shape (nz, ny, nx); level 0 is the base. Drawing a cell at a drawpoint leaves a void
that climbs: at each level it exchanges places with one granular cell of the nine above, chosen
with probability proportional to (1/d)^n, where d = 1, sqrt(2), sqrt(3) and n is the flow exponent.
A void that loosens a stagnant cell parks in its place with probability q (bulking).

`pipeline.lattice.flow_reference` does the same slowly and obviously, with the same random draws.

Source: void diffusion of Gomez & Castro (2022), IJRMMS 154, 105124, section 1.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lattice.cells import AIR, MOVEMENT, OUTSIDE, STAGNANT, VOID

DRAWN_CELLS, LOOSENED_CELLS, PARKED_VOIDS, HANG_UPS, VOID_STEPS = range(5)
"""Positions in ``FlowState.counters``."""


class FlowState(NamedTuple):
    """Everything that drawing changes; the kernels write into these arrays.

    Ground, on (z, y, x):

    - ``code`` int8: cell codes of `pipeline.lattice.cells`.
    - ``cell_id`` int32: flat index of the initial place of the cell that is here now; -1 where
      there is none. Properties of cells do not move: look them up with it.
    - ``moved`` bool: a granular cell came to this place since the caller last cleared the flag
      (a void may have taken the place since).

    Movement zones; a place is loosened once a void has been there:

    - ``zone`` int16 (z, y, x): the drawpoint whose void loosened this place; -1 if none has.
    - ``zone_root`` int16 (drawpoint): the lowest label of the connected zone that the label
      belongs to. Zones connect where loosened places touch by face, edge or corner.
    - ``level_min_x``, ``level_max_x`` int32 (drawpoint, z): x extent of each label; nx and -1
      where a label is absent.

    Drawpoints: the base cells of drawpoint d are the rows ``opening_offsets[d]`` to
    ``opening_offsets[d + 1]`` of ``opening_cells`` int32 (cell, 3), as (z, y, x) indices.

    The drawn sequence, in its first ``counters[DRAWN_CELLS]`` entries: ``drawn_cell`` int32 (the
    cell's identity), ``drawn_drawpoint`` int16, and ``drawn_mass`` float64, the cumulative mass
    in kg after the cell.

    ``counters`` int64 (5): cells drawn; cells loosened, which is also the number of loosened
    places; voids parked by bulking; voids parked by a hang-up; exchanges made by climbing voids.
    """

    code: np.ndarray
    cell_id: np.ndarray
    moved: np.ndarray
    zone: np.ndarray
    zone_root: np.ndarray
    level_min_x: np.ndarray
    level_max_x: np.ndarray
    opening_cells: np.ndarray
    opening_offsets: np.ndarray
    drawn_cell: np.ndarray
    drawn_drawpoint: np.ndarray
    drawn_mass: np.ndarray
    counters: np.ndarray


def new_flow_state(code, openings):
    """State of undisturbed ground.

    ``code`` (nz, ny, nx) holds ``STAGNANT``, ``OUTSIDE`` and ``AIR`` only; it is copied.
    ``openings`` has, for each drawpoint, an integer array (cells, 3) of the (z, y, x) indices of
    its base cells. Raises ValueError for any other code, and for an opening that is empty, off
    the lattice, or shared.
    """
    code = np.array(code, dtype=np.int8, order="C")
    if not np.isin(code, (STAGNANT, OUTSIDE, AIR)).all():
        raise ValueError("undisturbed ground holds only STAGNANT, OUTSIDE and AIR cells")
    openings = [np.asarray(cells, dtype=np.int32).reshape(-1, 3) for cells in openings]
    if not openings or min(map(len, openings)) == 0:
        raise ValueError("each drawpoint needs at least one base cell, and one drawpoint is needed")
    opening_cells = np.concatenate(openings)
    if (opening_cells < 0).any() or (opening_cells >= code.shape).any():
        raise ValueError(f"a drawpoint's base cell lies off the lattice of shape {code.shape}")
    if len(np.unique(opening_cells, axis=0)) < len(opening_cells):
        raise ValueError("a base cell belongs to one drawpoint, once")

    nz, _, nx = code.shape
    drawpoints = len(openings)
    granular = code == STAGNANT
    return FlowState(
        code=code,
        cell_id=np.where(granular, np.arange(code.size).reshape(code.shape), -1).astype(np.int32),
        moved=np.zeros(code.shape, dtype=np.bool_),
        zone=np.full(code.shape, -1, dtype=np.int16),
        zone_root=np.arange(drawpoints, dtype=np.int16),
        level_min_x=np.full((drawpoints, nz), nx, dtype=np.int32),
        level_max_x=np.full((drawpoints, nz), -1, dtype=np.int32),
        opening_cells=opening_cells,
        opening_offsets=np.cumsum([0, *map(len, openings)]),
        drawn_cell=np.full(granular.sum(), -1, dtype=np.int32),
        drawn_drawpoint=np.full(granular.sum(), -1, dtype=np.int16),
        drawn_mass=np.zeros(granular.sum()),
        counters=np.zeros(5, dtype=np.int64),
    )


def climb_chances(exponent):
    """Cumulative weights of the nine cells above a void, float64 (512, 9).

    Row b is for the case that bit m of b says whether cell m is granular. The nine are in array
    order: (-1, -1), (-1, 0), ... (1, 1) in (y, x). ``exponent`` is the flow exponent n.
    """
    weights = [
        (1 / math.sqrt(1 + abs(dy) + abs(dx))) ** exponent for dy in (-1, 0, 1) for dx in (-1, 0, 1)
    ]
    granular = np.arange(512)[:, None] >> np.arange(9) & 1
    return np.cumsum(granular * weights, axis=1)


@njit(nogil=True, cache=True)
def draw_to(state, cell_mass, drawpoint, target_mass, chances, bulking, rng):
    """Draw cells at ``drawpoint`` until the experiment's drawn mass is nearest to the target.

    ``cell_mass`` float64 (nz*ny*nx): kg of each cell, by its identity. ``target_mass`` kg counts
    from the start of the experiment, over all drawpoints. ``chances`` is `climb_chances` of the
    flow exponent, ``bulking`` the probability 0..1 that a void parks where it loosens a cell.
    ``rng`` is a ``numpy.random.Generator``, the only source of chance.

    One more cell is drawn while the drawn mass plus half the mean mass of the granular cells in
    the opening stays within the target. That is decided before any random number is taken, so
    a visit may be split into several without changing its outcome.

    Changes the arrays of ``state``. Returns the shortfall in kg: what is missing to the target
    when no granular cell is left in the opening, else 0. An empty opening stays empty.
    """
    opening = state.opening_cells
    first = state.opening_offsets[drawpoint]
    end = state.opening_offsets[drawpoint + 1]
    drawn = state.counters[DRAWN_CELLS]
    mass = state.drawn_mass[drawn - 1] if drawn > 0 else 0.0
    while True:
        count = 0
        opening_mass = 0.0
        for row in range(first, end):
            k, j, i = opening[row, 0], opening[row, 1], opening[row, 2]
            if _is_granular(state.code[k, j, i]):
                count += 1
                opening_mass += cell_mass[state.cell_id[k, j, i]]
        if count == 0:
            return max(target_mass - mass, 0.0)
        if mass + 0.5 * (opening_mass / count) > target_mass:
            return 0.0

        skip = int(rng.random() * count)
        row = first
        while True:
            k, j, i = opening[row, 0], opening[row, 1], opening[row, 2]
            row += 1
            if _is_granular(state.code[k, j, i]):
                if skip == 0:
                    break
                skip -= 1
        cell = state.cell_id[k, j, i]
        mass += cell_mass[cell]
        state.drawn_cell[drawn] = cell
        state.drawn_drawpoint[drawn] = drawpoint
        state.drawn_mass[drawn] = mass
        drawn += 1
        state.counters[DRAWN_CELLS] = drawn
        if state.code[k, j, i] == STAGNANT:
            _loosen(state, k, j, i, drawpoint)
        else:
            _unite(state.zone_root, state.zone[k, j, i], drawpoint)
        _climb(state, k, j, i, drawpoint, chances, bulking, rng)


@njit(nogil=True, cache=True)
def draw_visits(state, cell_mass, drawpoints, ends, missing, shortfall, chances, bulking, rng):
    """`draw_to` for visits in turn; returns the mass in kg that drawpoints lacked so far.

    ``drawpoints`` int64 and ``ends`` float64 (visit): where, and the scheduled mass at its end.
    ``missing`` kg were lacking before, which nobody makes up for; what a drawpoint lacks now adds
    to ``shortfall`` (drawpoint), kg.
    """
    for visit in range(len(drawpoints)):
        drawpoint = drawpoints[visit]
        target = ends[visit] - missing
        short = draw_to(state, cell_mass, drawpoint, target, chances, bulking, rng)
        shortfall[drawpoint] += short
        missing += short
    return missing


@njit(nogil=True, cache=True)
def zone_geometry(state, cell_size):
    """Height and width of the connected movement zone of each drawpoint, two float64 (drawpoint).

    In the unit of ``cell_size``. The height reaches from the base to the top of the highest
    loosened level; the width is the largest x extent of one level. 0 where nothing is loosened.
    """
    drawpoints, nz = state.level_min_x.shape
    height, width = np.zeros(drawpoints), np.zeros(drawpoints)
    for root in range(drawpoints):
        for k in range(nz):
            least, most = state.zone.shape[2], -1
            for label in range(drawpoints):
                if state.zone_root[label] == root:
                    least = min(least, state.level_min_x[label, k])
                    most = max(most, state.level_max_x[label, k])
            if most >= least:
                height[root] = (k + 1) * cell_size
                width[root] = max(width[root], (most - least + 1) * cell_size)
    return height[state.zone_root], width[state.zone_root]


@njit(nogil=True, cache=True)
def _climb(state, k, j, i, drawpoint, chances, bulking, rng):
    """Let the void that a drawn cell left at (k, j, i) climb until it parks or becomes air.

    The place of the void is written only where it stays. A place with a stagnant cell was never
    a void's, so that zones are looked at there only.
    """
    nz, ny, nx = state.code.shape
    code = state.code.reshape(-1)
    cell_id = state.cell_id.reshape(-1)
    moved = state.moved.reshape(-1)
    counters = state.counters
    place = (k * ny + j) * nx + i
    while True:
        above = place + ny * nx
        granular = _granular_at(code, above, j, i, ny, nx) if k + 1 < nz else 0
        if granular == 0:
            break

        threshold = rng.random() * chances[granular, 8]
        chosen = 0
        for m in range(8):
            chosen += threshold >= chances[granular, m]
        dy, dx = chosen // 3 - 1, chosen % 3 - 1
        above += dy * nx + dx
        was_stagnant = code[above] == STAGNANT
        code[place] = MOVEMENT
        cell_id[place] = cell_id[above]
        moved[place] = True
        place = above
        k += 1
        j += dy
        i += dx
        counters[VOID_STEPS] += 1
        if was_stagnant:
            _loosen(state, k, j, i, drawpoint)
            if bulking >= 1.0 or (bulking > 0.0 and rng.random() < bulking):
                counters[PARKED_VOIDS] += 1
                code[place] = VOID
                cell_id[place] = -1
                return

    cell_id[place] = -1
    if _reaches_surface(state.code, k, j, i):
        code[place] = AIR
    else:
        counters[HANG_UPS] += 1
        code[place] = VOID


@njit(nogil=True, cache=True)
def _is_granular(cell):
    return (cell == STAGNANT) | (cell == MOVEMENT)


@njit(nogil=True, cache=True, inline="always")
def _granular_at(code, center, j, i, ny, nx):
    """Which of the nine cells of a level around (j, i), flat index ``center``, are granular.

    One bit each, the row of `climb_chances`. Unsigned indices spare the test for negative ones.
    """
    bits = 0
    if 0 < j < ny - 1 and 0 < i < nx - 1:
        for m in range(9):
            near = np.uint64(center + (m // 3 - 1) * nx + m % 3 - 1)
            bits |= _is_granular(code[near]) << m
    else:
        for m in range(9):
            dy, dx = m // 3 - 1, m % 3 - 1
            if 0 <= j + dy < ny and 0 <= i + dx < nx:
                bits |= _is_granular(code[center + dy * nx + dx]) << m
    return bits


@njit(nogil=True, cache=True)
def _reaches_surface(code, k, j, i):
    """Whether a void with no granular cell above is open: to air, or with no void above it."""
    nz, ny, nx = code.shape
    no_void = True
    if k + 1 < nz:
        for jj in range(max(j - 1, 0), min(j + 2, ny)):
            for ii in range(max(i - 1, 0), min(i + 2, nx)):
                if code[k + 1, jj, ii] == AIR:
                    return True
                if code[k + 1, jj, ii] == VOID:
                    no_void = False
    return no_void


@njit(nogil=True, cache=True)
def _loosen(state, k, j, i, drawpoint):
    """Add a place to the zone of a drawpoint and unite that zone with those that it touches."""
    zone = state.zone
    nz, ny, nx = zone.shape
    state.counters[LOOSENED_CELLS] += 1
    zone[k, j, i] = drawpoint
    state.level_min_x[drawpoint, k] = min(state.level_min_x[drawpoint, k], i)
    state.level_max_x[drawpoint, k] = max(state.level_max_x[drawpoint, k], i)
    for kk in range(max(k - 1, 0), min(k + 2, nz)):
        for jj in range(max(j - 1, 0), min(j + 2, ny)):
            for ii in range(max(i - 1, 0), min(i + 2, nx)):
                if zone[kk, jj, ii] >= 0:
                    _unite(state.zone_root, zone[kk, jj, ii], drawpoint)


@njit(nogil=True, cache=True)
def _unite(zone_root, label, other):
    """Give the labels of two zones one root, the lower of their two; roots stay flat."""
    low = min(zone_root[label], zone_root[other])
    high = max(zone_root[label], zone_root[other])
    if low < high:
        for d in range(len(zone_root)):
            if zone_root[d] == high:
                zone_root[d] = low
