"""Gravity flow by void diffusion on a cubic lattice.

Arrays have shape (nz, ny, nx); level 0 is the base. Drawing a cell at a drawpoint leaves a void
that climbs: at each level it exchanges places with one granular cell of the nine above, chosen
with probability proportional to (1/d)^n, where d = 1, sqrt(2), sqrt(3) and n is the flow exponent.
A void that loosens a stagnant cell parks in its place with probability q (bulking).

A void finds its way up in flags that stay in cache (`pipeline.lattice.flags`); then the cells sink
along it. `pipeline.lattice.flow_reference` does the same slowly and obviously, with the same random
draws.

Source: void diffusion of Gomez & Castro (2022), IJRMMS 154, 105124, section 1.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lattice.cells import AIR, MOVEMENT, OUTSIDE, STAGNANT, VOID
from pipeline.lattice.flags import flags_around, has_flag, in_place, new_flags, set_flag
from pipeline.lattice.grid import GRAVITY

DRAWN_CELLS, LOOSENED_CELLS, PARKED_VOIDS, HANG_UPS, VOID_STEPS = range(5)
"""Positions in ``FlowState.counters``."""

NONE, SEVERAL = np.int16(-1), np.int16(-2)
"""Labels of a block without a loosened place, and of one with places of more zones than one."""
BLOCK = 8  # places a side


class FlowIndex(NamedTuple):
    """What the kernels look up in place of the lattice; it follows from `FlowState`'s ground.

    - ``granular``, ``loosened``: flags of the places with a granular cell, and of those in a
      movement zone, see `pipeline.lattice.flags`.
    - ``block_label`` int16 (z, y, x): for each block of the lattice, ``BLOCK`` places a side, a
      label of the one connected zone that all its loosened places belong to; ``NONE`` or
      ``SEVERAL``. A block of several stays so, even when they unite.
    """

    granular: np.ndarray
    loosened: np.ndarray
    block_label: np.ndarray


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

    ``index``: what `flow_index` makes of ``code``, ``zone`` and ``zone_root``, kept up to date.
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
    index: FlowIndex


def new_flow_state(code, openings):
    """State of undisturbed ground.

    ``code`` (nz, ny, nx) holds ``STAGNANT``, ``OUTSIDE`` and ``AIR`` only; it is copied.
    ``openings`` has, for each drawpoint, an integer array (cells, 3) of the (z, y, x) indices of
    its base cells. Raises ValueError for any other code, and for an opening that is empty, off
    the lattice, or shared.
    """
    code = np.array(code, dtype=np.int8, order="C")
    granular = code == STAGNANT
    if not (granular | (code == OUTSIDE) | (code == AIR)).all():
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
    cells = np.count_nonzero(granular)
    cell_id = np.arange(code.size, dtype=np.int32).reshape(code.shape)
    cell_id[~granular] = -1
    zone = np.full(code.shape, -1, dtype=np.int16)
    zone_root = np.arange(drawpoints, dtype=np.int16)
    return FlowState(
        code=code,
        cell_id=cell_id,
        moved=np.zeros(code.shape, dtype=np.bool_),
        zone=zone,
        zone_root=zone_root,
        level_min_x=np.full((drawpoints, nz), nx, dtype=np.int32),
        level_max_x=np.full((drawpoints, nz), -1, dtype=np.int32),
        opening_cells=opening_cells,
        opening_offsets=np.cumsum([0, *map(len, openings)]),
        drawn_cell=np.zeros(cells, dtype=np.int32),  # zeros take no memory before they are written
        drawn_drawpoint=np.zeros(cells, dtype=np.int16),
        drawn_mass=np.zeros(cells),
        counters=np.zeros(5, dtype=np.int64),
        index=flow_index(code, zone, zone_root),
    )


def flow_index(code, zone, zone_root):
    """`FlowIndex` of ground in any state; arguments as in `FlowState`."""
    blocks = [-(-n // BLOCK) for n in code.shape]
    index = FlowIndex(new_flags(code.shape), new_flags(code.shape), np.full(blocks, NONE))
    _fill_index(code, zone, zone_root, index)
    return index


@njit(nogil=True, cache=True)
def _fill_index(code, zone, zone_root, index):
    nz, ny, nx = code.shape
    for j in range(ny):
        for k in range(nz):
            for i in range(nx):
                if _is_granular(code[k, j, i]):
                    set_flag(index.granular, k, j, i, True)
                if zone[k, j, i] >= 0:
                    set_flag(index.loosened, k, j, i, True)
                    _label_block(index.block_label, zone_root, k, j, i, zone[k, j, i])


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
def draw_to(state, cell_weight, drawpoint, target_mass, chances, bulking, rng):
    """Draw cells at ``drawpoint`` until the experiment's drawn mass is nearest to the target.

    ``cell_weight`` float (nz*ny*nx): N of each cell, by its identity. ``target_mass`` kg counts
    from the start of the experiment, over all drawpoints. ``chances`` is `climb_chances` of the
    flow exponent, ``bulking`` the probability 0..1 that a void parks where it loosens a cell.
    ``rng`` is a ``numpy.random.Generator``, the only source of chance.

    One more cell is drawn while the drawn mass plus half the mean mass of the granular cells in
    the opening stays within the target. That is decided before any random number is taken, so
    a visit may be split into several without changing its outcome.

    Changes the arrays of ``state``. Returns the shortfall in kg: what is missing to the target
    when no granular cell is left in the opening, else 0. An empty opening stays empty.
    """
    room = state.opening_offsets[drawpoint + 1] - state.opening_offsets[drawpoint]
    available = np.empty(room, np.int64)
    way = np.empty((len(state.code), 2), np.int32)
    fresh = np.empty(len(state.code), np.bool_)
    return _draw(
        state, cell_weight, drawpoint, target_mass, chances, bulking, rng, available, way, fresh
    )


@njit(nogil=True, cache=True)
def draw_visits(state, cell_weight, drawpoints, ends, missing, shortfall, chances, bulking, rng):
    """`draw_to` for visits in turn; returns the mass in kg that drawpoints lacked so far.

    ``drawpoints`` int64 and ``ends`` float64 (visit): where, and the scheduled mass at its end.
    ``missing`` kg were lacking before, which nobody makes up for; what a drawpoint lacks now adds
    to ``shortfall`` (drawpoint), kg.
    """
    for visit in range(len(drawpoints)):
        drawpoint = drawpoints[visit]
        target = ends[visit] - missing
        short = draw_to(state, cell_weight, drawpoint, target, chances, bulking, rng)
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


@in_place
def _draw(state, cell_weight, drawpoint, target_mass, chances, bulking, rng, available, way, fresh):
    """`draw_to`; in the last three arrays it works: rows of the opening, and a void's way up."""
    code, cell_id, moved, counters = state.code, state.cell_id, state.moved, state.counters
    zone, zone_root = state.zone, state.zone_root
    min_x, max_x = state.level_min_x[drawpoint], state.level_max_x[drawpoint]
    granular, loosened, blocks = state.index
    opening = state.opening_cells
    first = state.opening_offsets[drawpoint]
    end = state.opening_offsets[drawpoint + 1]
    drawn = counters[DRAWN_CELLS]
    mass = state.drawn_mass[drawn - 1] if drawn > 0 else 0.0
    while True:
        count = 0
        opening_mass = 0.0
        for row in range(first, end):
            k, j, i = opening[row, 0], opening[row, 1], opening[row, 2]
            if _is_granular(code[k, j, i]):
                available[count] = row
                count += 1
                opening_mass += _mass(cell_weight[cell_id[k, j, i]])
        if count == 0:
            return max(target_mass - mass, 0.0)
        if mass + 0.5 * (opening_mass / count) > target_mass:
            return 0.0

        row = available[int(rng.random() * count)]
        k, j, i = opening[row, 0], opening[row, 1], opening[row, 2]
        cell = cell_id[k, j, i]
        mass += _mass(cell_weight[cell])
        state.drawn_cell[drawn] = cell
        state.drawn_drawpoint[drawn] = drawpoint
        state.drawn_mass[drawn] = mass
        drawn += 1
        counters[DRAWN_CELLS] = drawn

        way[0, 0], way[0, 1] = j, i
        fresh[0] = code[k, j, i] == STAGNANT
        if not fresh[0]:
            _unite(zone_root, zone[k, j, i], drawpoint)
        steps, parks = _climb(k, way, fresh, granular, loosened, chances, bulking, rng)
        counters[LOOSENED_CELLS] += _loosen(
            k, way, fresh, steps, drawpoint, code, zone, zone_root, min_x, max_x, loosened, blocks
        )
        _sink(k, way, steps, cell_id, moved)
        counters[VOID_STEPS] += steps
        k, j, i = k + steps, way[steps, 0], way[steps, 1]
        set_flag(granular, k, j, i, False)
        if parks:
            counters[PARKED_VOIDS] += 1
            code[k, j, i] = VOID
        elif _reaches_surface(code, k, j, i):
            code[k, j, i] = AIR
        else:
            counters[HANG_UPS] += 1
            code[k, j, i] = VOID


@in_place
def _climb(k, way, fresh, granular, loosened, chances, bulking, rng):
    """Find the way up of a void from level ``k``, until it parks or nothing is left above it.

    ``way`` int32 (step, 2) holds its place (j, i) on level k + step, the first of them given;
    ``fresh`` bool (step) whether it is the first void there. Returns the number of steps, and
    whether it parks where it loosened a cell. Nothing but the two arrays is written.
    """
    j, i = way[0, 0], way[0, 1]
    steps = 0
    parks = False
    while not parks:
        around = flags_around(granular, k + steps + 1, j, i)
        if around == 0:
            break
        threshold = rng.random() * chances[around, 8]
        chosen = 0
        for m in range(8):
            chosen += threshold >= chances[around, m]
        j += chosen // 3 - 1
        i += chosen % 3 - 1
        steps += 1
        way[steps, 0], way[steps, 1] = j, i
        fresh[steps] = not has_flag(loosened, k + steps, j, i)
        if fresh[steps]:
            parks = bulking >= 1.0 or (bulking > 0.0 and rng.random() < bulking)
    return steps, parks


@in_place
def _sink(k, way, steps, cell_id, moved):
    """Move the cells on a void's way from level ``k`` one place down; the last place is empty."""
    _, ny, nx = cell_id.shape
    cell_id, moved = cell_id.reshape(-1), moved.reshape(-1)
    place = (k * ny + way[0, 0]) * nx + way[0, 1]
    for m in range(steps):
        above = place + (ny + way[m + 1, 0] - way[m, 0]) * nx + way[m + 1, 1] - way[m, 1]
        cell_id[place] = cell_id[above]
        moved[place] = True
        place = above
    cell_id[place] = -1


@in_place
def _is_granular(cell):
    return (cell == STAGNANT) | (cell == MOVEMENT)


@in_place
def _mass(weight):
    """kg of a cell that weighs so many N."""
    return np.float64(weight) / GRAVITY


@in_place
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


@in_place
def _loosen(
    k, way, fresh, steps, drawpoint, code, zone, zone_root, min_x, max_x, loosened, block_label
):
    """Add the fresh places of a way to the zone of a drawpoint; returns how many there are.

    That zone is united with those that they touch.
    """
    nz, ny, nx = zone.shape
    count = 0
    for m in range(steps + 1):
        if not fresh[m]:
            continue
        count += 1
        kk, j, i = k + m, way[m, 0], way[m, 1]
        code[kk, j, i] = MOVEMENT
        zone[kk, j, i] = drawpoint
        set_flag(loosened, kk, j, i, True)
        min_x[kk] = min(min_x[kk], i)
        max_x[kk] = max(max_x[kk], i)
        if _other_zones_near(block_label, zone_root, kk, j, i, drawpoint, zone.shape):
            for z in range(max(kk - 1, 0), min(kk + 2, nz)):
                for y in range(max(j - 1, 0), min(j + 2, ny)):
                    for x in range(max(i - 1, 0), min(i + 2, nx)):
                        if zone[z, y, x] >= 0:
                            _unite(zone_root, zone[z, y, x], drawpoint)
        _label_block(block_label, zone_root, kk, j, i, drawpoint)
    return count


@in_place
def _other_zones_near(block_label, zone_root, k, j, i, drawpoint, shape):
    """Whether blocks that touch a place hold loosened places of other zones than a drawpoint's."""
    nz, ny, nx = shape
    found = False
    for z in (max(k - 1, 0) // BLOCK, min(k + 1, nz - 1) // BLOCK):
        for y in (max(j - 1, 0) // BLOCK, min(j + 1, ny - 1) // BLOCK):
            for x in (max(i - 1, 0) // BLOCK, min(i + 1, nx - 1) // BLOCK):
                label = block_label[z, y, x]
                other = zone_root[max(label, 0)] != zone_root[drawpoint]
                found |= (label == SEVERAL) | ((label != NONE) & other)
    return found


@in_place
def _label_block(block_label, zone_root, k, j, i, label):
    """Enter a loosened place with this label into its block."""
    z, y, x = k // BLOCK, j // BLOCK, i // BLOCK
    known = block_label[z, y, x]
    if known == NONE:
        block_label[z, y, x] = label
    elif known != SEVERAL and zone_root[known] != zone_root[label]:
        block_label[z, y, x] = SEVERAL


@in_place
def _unite(zone_root, label, other):
    """Give the labels of two zones one root, the lower of their two; roots stay flat."""
    low = min(zone_root[label], zone_root[other])
    high = max(zone_root[label], zone_root[other])
    if low < high:
        for d in range(len(zone_root)):
            if zone_root[d] == high:
                zone_root[d] = low
