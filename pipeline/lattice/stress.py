"""Vertical stress on the lattice: one top-down sweep (eqs 1-4 of Gómez & Castro 2022).

Arrays are (z, y, x) with z index 0 at the base; loads are forces in newtons. The kernel knows the
nine receivers of a cell only through three spreading weights: 1 straight down, `edge` for the four
receivers at distance √2 and `corner` for the four at √3. `stress_reference.py` holds the same
sweep written for the eye.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT
from pipeline.lattice.flags import in_place
from pipeline.lattice.solid import is_solid, solid_rows, through_solid

LEAST_RECEPTIVITY = 1e-100  # R = 0 still lets a cell without stagnant receivers hand its load on


class Coupling(NamedTuple):
    """What a sweep does beyond eqs 1-4; each part is off as it stands here.

    Fields that are arrays are (z, y, x), or (0, 0, 0) where off.

    - ``relaxation``: R of each receiver in the movement zone, instead of one R. Where R differs
      from receiver to receiver, it matters without a stagnant one among them too.
    - ``straight``: factor on the weight of each cell's receiver straight below.
    - ``lean_x``, ``lean_y``: κ; the weight of a receiver at offset (x, y) is multiplied by
      exp(κ_x x + κ_y y).
    - ``zone_root`` int16: label of the connected movement zone at a place, −1 outside; with
      ``own_shed``, 1 − E of the cell in stagnant ground, and ``transfer`` (0-1): that part of the
      load that a zone sheds beyond its E goes to the stagnant cells beside it one level below.
    - ``cohesion``: N; a movement-zone cell hands up to it to each stagnant cell beside it.
    - ``slope``: of log(1 − E) in log(load / ``reference``), load and reference in N.
    """

    relaxation: np.ndarray = np.zeros((0, 0, 0), np.float32)
    straight: np.ndarray = np.zeros((0, 0, 0), np.float32)
    lean_x: float = 0.0
    lean_y: float = 0.0
    zone_root: np.ndarray = np.zeros((0, 0, 0), np.int16)
    own_shed: np.ndarray = np.zeros((0, 0, 0), np.float32)
    transfer: float = 0.0
    cohesion: float = 0.0
    slope: float = 0.0
    reference: float = 1.0


UNCOUPLED = Coupling()


class Moved(NamedTuple):
    """Where draw has brought the cells, and what those in movement zones shed.

    - ``cell_id`` int32, ``zone`` int16: (z, y, x) as in `flow.FlowState`, or (0, 0, 0) where no
      cell has moved.
    - ``zone_shed`` float64 (drawpoint): 1 − E_min for each zone label.
    """

    cell_id: np.ndarray = np.zeros((0, 0, 0), np.int32)
    zone: np.ndarray = np.zeros((0, 0, 0), np.int16)
    zone_shed: np.ndarray = np.zeros(0)


AT_HOME = Moved()


class Ranked(NamedTuple):
    """Spreading weights by the rank of a cell's s (see `spreading`) instead of cell by cell.

    - ``rank`` uint16: (z, y, x), or (0, 0, 0) where the weights are given by cell.
    - ``weights``: (rank, 2) float, edge and corner weight of the s of each rank.
    """

    rank: np.ndarray = np.zeros((0, 0, 0), np.uint16)
    weights: np.ndarray = np.zeros((0, 2), np.float32)


BY_CELL = Ranked()
PAIRS = {"float32": np.float64, "float64": np.complex128}  # of the same bytes as two such numbers


def stress_sweep(
    weight: np.ndarray,
    shed_fraction: np.ndarray,
    edge: np.ndarray,
    corner: np.ndarray,
    code: np.ndarray,
    relaxation: float,
    top_fraction: float,
    load: np.ndarray,
    base_load: np.ndarray,
    coupling: Coupling = UNCOUPLED,
    moved: Moved = AT_HOME,
    ranked: Ranked = BY_CELL,
) -> tuple[float, float]:
    """Carry all weights down the lattice.

    All loads are in double precision, whatever the storage type of the cells. Levels of stagnant
    ground above another such are computed several cells at a time.

    Parameters
    ----------
    weight : (z, y, x) float
        Own weight γV of each granular cell, N; 0 in void cells and outside the ground.
    shed_fraction : (z, y, x) float, or (1, 1, 1) where all cells are alike
        1 − E of each cell: the share of its load that friction takes (eq 1).
    edge, corner : (z, y, x) float
        Spreading weights of the giving cell, from `spreading_weights`; not looked at with
        `ranked`, which then stands for them.
    code : (z, y, x) int8
        Cell codes of `pipeline.lattice.cells`.
    relaxation : float
        R: factor on the weights of movement-zone receivers, normalised again (§2.2). It has no
        effect where a cell has no stagnant receiver.
    top_fraction : float
        Part of the top level that is filled; scales the weights of that level.
    load : (z, y, x) float, or (0, 0, 0) to keep none
        Receives P of eq 2, N; a load on its way down through void cells is not in it.
    base_load : (y, x) float64
        Receives the load that each base place (or the rock below a column) takes, N.
    coupling : what effects add to the sweep
    moved : where the cells are
        If they have moved, `weight` and `shed_fraction` are by the place where a cell began.
    ranked : spreading weights by rank, in the floating type of `weight`

    Returns
    -------
    total_weight, shed : float
        Weight put in and load shed, N. Nothing vanishes: total_weight = base_load.sum() + shed.
    """
    return _sweep(
        weight,
        shed_fraction,
        edge,
        corner,
        code,
        float(relaxation),
        float(top_fraction),
        load,
        base_load,
        coupling,
        moved,
        _paired(ranked, weight.dtype),
    )


def _paired(ranked: Ranked, dtype: np.dtype) -> Ranked:
    """With both weights of a rank as one number, which takes one look: (rank)."""
    weights = np.ascontiguousarray(ranked.weights, dtype)
    return ranked._replace(weights=weights.view(PAIRS[dtype.name])[:, 0])


@njit(nogil=True, cache=True, error_model="numpy")
def _sweep(
    weight,
    shed_fraction,
    edge,
    corner,
    code,
    relaxation,
    top_fraction,
    load,
    base_load,
    coupling,
    moved,
    ranked,
):
    nz, ny, nx = code.shape
    keep = load.shape[0] > 0
    lower, upper = math.exp(-coupling.lean_y), math.exp(coupling.lean_y)
    left, right = math.exp(-coupling.lean_x), math.exp(coupling.lean_x)
    leaning = coupling.lean_x != 0.0 or coupling.lean_y != 0.0
    shares_excess = coupling.transfer > 0.0
    excess = np.zeros(coupling.zone_root.max() + 1 if shares_excess else 0)
    straight_share = coupling.straight.shape[0] > 0
    plain = not leaning and not straight_share and coupling.slope == 0.0
    by_rank = ranked.rank.shape[0] > 0
    flat = ranked.weights.view(weight.dtype)
    have_moved = moved.cell_id.shape[0] > 0
    dtype = weight.dtype
    level_weight = np.empty((ny if have_moved else 0, nx), dtype)
    level_shed = np.full((ny, nx), shed_fraction[0, 0, 0])
    spare = np.empty((ny if have_moved else 0, nx), level_shed.dtype)
    carried = np.zeros((ny, nx))
    straight = np.zeros((ny, nx))  # handed straight down because no receiver is granular
    down = np.zeros((ny + 2, nx + 2))  # transmitted load per unit of spreading weight, that
    sides = np.zeros((ny + 2, nx + 2))  # times the edge weight,
    corners = np.zeros((ny + 2, nx + 2))  # and times the corner weight
    receptivity = np.zeros((ny + 2, nx + 2))
    _receptivity(code, nz - 1, relaxation, coupling.relaxation, receptivity)
    rows = solid_rows(nx, ranked)
    total_weight = 0.0
    shed = 0.0
    base_load[:, :] = 0.0
    solid, through, falling = is_solid(code, nz - 1), False, False
    for k in range(nz - 1, -1, -1):
        shed_above = level_shed
        if have_moved:
            level_shed, spare = spare, level_shed
            _place_level(code, moved, k, weight, shed_fraction, level_weight, level_shed)
        else:
            level_weight = weight[k]
            if shed_fraction.size > 1:
                level_shed = shed_fraction[k]
        if through:
            put_in, lost = through_solid(
                k, level_weight, shed_above, edge, corner, ranked, carried, rows
            )
            total_weight += put_in
            shed += lost
        else:
            scale = top_fraction if k == nz - 1 else 1.0
            for y in range(ny):
                for x in range(nx):
                    own = scale * np.float64(level_weight[y, x])
                    total_weight += own
                    if leaning:  # apart: a third to four fifths faster without its factors
                        level = down[y + 1, x + 1] + (
                            right * sides[y + 1, x] + left * sides[y + 1, x + 2]
                        )
                        before = sides[y, x + 1] + (
                            right * corners[y, x] + left * corners[y, x + 2]
                        )
                        after = sides[y + 2, x + 1] + (
                            right * corners[y + 2, x] + left * corners[y + 2, x + 2]
                        )
                        received = level + (upper * before + lower * after)
                    else:
                        level = down[y + 1, x + 1] + (sides[y + 1, x] + sides[y + 1, x + 2])
                        before = sides[y, x + 1] + (corners[y, x] + corners[y, x + 2])
                        after = sides[y + 2, x + 1] + (corners[y + 2, x] + corners[y + 2, x + 2])
                        received = level + (before + after)
                    carried[y, x] = own + receptivity[y + 1, x + 1] * received + straight[y, x]
            if shares_excess:
                shed -= _share_excess(code[k], coupling.zone_root[k], excess, carried)
            if coupling.cohesion > 0.0:
                carried += _hand_aside(code[k], carried, coupling.cohesion)
        if keep:
            for y in range(ny):
                for x in range(nx):
                    granular = through or receptivity[y + 1, x + 1] > 0.0
                    load[k, y, x] = carried[y, x] if granular else 0.0
        if k == 0:
            break
        solid_above, solid = solid, is_solid(code, k - 1)
        through = plain and solid_above and solid and not falling
        if through:
            continue
        _receptivity(code, k - 1, relaxation, coupling.relaxation, receptivity)
        falling = False
        for y in range(ny):
            for x in range(nx):
                cell = code[k, y, x]
                if cell in (STAGNANT, MOVEMENT):
                    fraction = np.float64(level_shed[y, x])
                    by_stress = 1.0
                    if coupling.slope != 0.0 and carried[y, x] > 0.0:
                        by_stress = (carried[y, x] / coupling.reference) ** coupling.slope
                        fraction = min(fraction * by_stress, 1.0)
                    lost = carried[y, x] * fraction
                    given = carried[y, x] - lost
                    shed += lost
                    if shares_excess and cell == MOVEMENT:
                        beyond = fraction - by_stress * coupling.own_shed[k, y, x]
                        excess[coupling.zone_root[k, y, x]] += (
                            coupling.transfer * max(beyond, 0.0) * carried[y, x]
                        )
                    if leaning:
                        beside, diagonal = leaning_sums(
                            receptivity, y, x, lower, upper, left, right
                        )
                    else:
                        beside = (
                            receptivity[y, x + 1]
                            + receptivity[y + 1, x]
                            + receptivity[y + 1, x + 2]
                            + receptivity[y + 2, x + 1]
                        )
                        diagonal = (
                            receptivity[y, x]
                            + receptivity[y, x + 2]
                            + receptivity[y + 2, x]
                            + receptivity[y + 2, x + 2]
                        )
                    w_down = np.float64(coupling.straight[k, y, x]) if straight_share else 1.0
                    if by_rank:
                        rank = ranked.rank[k, y, x]
                        w_edge = np.float64(flat[2 * rank])
                        w_corner = np.float64(flat[2 * rank + 1])
                    else:
                        w_edge = np.float64(edge[k, y, x])
                        w_corner = np.float64(corner[k, y, x])
                    total = w_down * receptivity[y + 1, x + 1] + w_edge * beside
                    total += w_corner * diagonal
                    if total > 0.0:
                        unit = given / total
                        down[y + 1, x + 1] = unit * w_down
                        sides[y + 1, x + 1] = unit * w_edge
                        corners[y + 1, x + 1] = unit * w_corner
                        straight[y, x] = 0.0
                        continue
                    straight[y, x] = given
                else:
                    straight[y, x] = carried[y, x]
                down[y + 1, x + 1] = 0.0
                sides[y + 1, x + 1] = 0.0
                corners[y + 1, x + 1] = 0.0
                if straight[y, x] > 0.0 and code[k - 1, y, x] == OUTSIDE:
                    base_load[y, x] += straight[y, x]
                    straight[y, x] = 0.0
                falling |= straight[y, x] != 0.0
    base_load += carried
    return total_weight, shed


@in_place
def leaning_sums(field, y, x, lower, upper, left, right):
    """Sums over the edge and the corner receivers of a place in a padded field, with the lean."""
    beside = (
        lower * field[y, x + 1]
        + left * field[y + 1, x]
        + right * field[y + 1, x + 2]
        + upper * field[y + 2, x + 1]
    )
    diagonal = (
        lower * left * field[y, x]
        + lower * right * field[y, x + 2]
        + upper * left * field[y + 2, x]
        + upper * right * field[y + 2, x + 2]
    )
    return beside, diagonal


@njit(nogil=True, cache=True)
def _receptivity(code, k, relaxation, field, receptivity):
    """Weight factor of each receiver of level k: 0 if not granular, R in the movement zone."""
    _, ny, nx = code.shape
    by_place = field.shape[0] > 0
    for y in range(ny):
        for x in range(nx):
            cell = code[k, y, x]
            factor = 1.0 if cell == STAGNANT else 0.0
            if cell == MOVEMENT:
                r = np.float64(field[k, y, x]) if by_place else relaxation
                factor = max(r, LEAST_RECEPTIVITY)
            receptivity[y + 1, x + 1] = factor


@njit(nogil=True, cache=True)
def _share_excess(code, zone_root, excess, carried):
    """Hand each zone's excess in equal shares to the stagnant cells that touch it in this level.

    `excess` (zone label) in N is emptied; what finds no stagnant cell stays shed. Returns the load
    handed on, N.
    """
    if excess.sum() == 0.0:
        return 0.0
    ny, nx = code.shape
    touching = np.zeros(len(excess))
    found = np.empty(9, np.int64)
    for turn in range(2):  # count the cells that touch each zone, then hand out
        for y in range(ny):
            for x in range(nx):
                if code[y, x] != STAGNANT:
                    continue
                for i in range(_zones_around(zone_root, y, x, found)):
                    root = found[i]
                    if turn == 0:
                        touching[root] += 1.0
                    else:
                        carried[y, x] += excess[root] / touching[root]
    handed = 0.0
    for root in range(len(excess)):
        if touching[root] > 0.0:
            handed += excess[root]
        excess[root] = 0.0
    return handed


@njit(nogil=True, cache=True)
def _zones_around(zone_root, y, x, found):
    """Zones of the eight cells around (y, x) in its level, each once, into `found`; how many."""
    ny, nx = zone_root.shape
    count = 0
    for yy in range(max(y - 1, 0), min(y + 2, ny)):
        for xx in range(max(x - 1, 0), min(x + 2, nx)):
            root = zone_root[yy, xx]
            known = root < 0
            for i in range(count):
                known |= found[i] == root
            if not known:
                found[count] = root
                count += 1
    return count


@njit(nogil=True, cache=True)
def _hand_aside(code, carried, cohesion):
    """Change of the loads (y, x) of a level by what movement-zone cells hand to their sides.

    Each hands min(P / n, cohesion) to each of the n stagnant cells that share a face with it.
    """
    ny, nx = code.shape
    change = np.zeros((ny, nx))
    for y in range(ny):
        for x in range(nx):
            if code[y, x] != MOVEMENT:
                continue
            faces = 0
            for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                if 0 <= y + dy < ny and 0 <= x + dx < nx:
                    faces += code[y + dy, x + dx] == STAGNANT
            if faces == 0:
                continue
            handed = min(carried[y, x] / faces, cohesion)
            change[y, x] -= faces * handed
            for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                inside = 0 <= y + dy < ny and 0 <= x + dx < nx
                if inside and code[y + dy, x + dx] == STAGNANT:
                    change[y + dy, x + dx] += handed
    return change


@njit(nogil=True, cache=True)
def read_base(base_load, on_ground, footprints, scale, readings):
    """Stresses that a base reads: `scale` (stress per newton) times its loads.

    `base_load` (y, x) in N; `on_ground` (y, x) bool, columns with ground; `footprints`
    (load_cell, y, x), shares of base cells in each reading. Fills `readings` (load_cell). Returns
    the mean over the ground columns and their standard deviation (population).
    """
    ny, nx = base_load.shape
    readings[:] = 0.0
    total, count = 0.0, 0
    for y in range(ny):
        for x in range(nx):
            stress = scale * base_load[y, x]
            for cell in range(len(readings)):
                readings[cell] += footprints[cell, y, x] * stress
            if on_ground[y, x]:
                total += stress
                count += 1
    mean = total / count
    square = 0.0
    for y in range(ny):
        for x in range(nx):
            if on_ground[y, x]:
                square += (scale * base_load[y, x] - mean) ** 2
    return mean, math.sqrt(square / count)


@njit(nogil=True, cache=True)
def place_cells(code, moved, cell_weight, cell_shed):
    """Weights and shed fractions (z, y, x) of the cells where they now are.

    `code` (z, y, x) and `moved` are the lattice's; `cell_weight` (N) and `cell_shed` (1 − E) are
    (z, y, x) by the place where a cell began, the latter (1, 1, 1) where all are alike.
    """
    weight, shed = np.empty(code.shape, cell_weight.dtype), np.empty(code.shape, cell_shed.dtype)
    for k in range(len(code)):
        _place_level(code, moved, k, cell_weight, cell_shed, weight[k], shed[k])
    return weight, shed


@njit(nogil=True, cache=True)
def _place_level(code, moved, k, cell_weight, cell_shed, weight, shed):
    """`place_cells` of level k, into `weight` and `shed` (y, x)."""
    _, ny, nx = code.shape
    for y in range(ny):
        for x in range(nx):
            place = code[k, y, x]
            weight[y, x], shed[y, x] = 0.0, 0.0
            if place in (STAGNANT, MOVEMENT):
                cell = moved.cell_id[k, y, x]
                weight[y, x] = cell_weight.flat[cell]
                if place == MOVEMENT:
                    shed[y, x] = moved.zone_shed[moved.zone[k, y, x]]
                else:
                    shed[y, x] = cell_shed.flat[min(cell, cell_shed.size - 1)]


@njit(nogil=True, cache=True)
def place_zones(moved, zone_root, cell_shed):
    """(z, y, x): label of the connected zone, −1 outside, and 1 − E of the cell that is there now.

    `moved` and `cell_shed` as in `place_cells`; `zone_root` (drawpoint) as in `flow.FlowState`.
    Where there is no cell, 1 − E is that of the first.
    """
    shape, sheds = moved.zone.shape, cell_shed.reshape(-1)
    root, own = np.empty(shape, np.int16), np.empty(shape, cell_shed.dtype)
    labels, ids = moved.zone.reshape(-1), moved.cell_id.reshape(-1)
    for place in range(labels.size):
        label = labels[place]
        root.flat[place] = zone_root[label] if label >= 0 else np.int16(-1)
        own.flat[place] = sheds[min(max(ids[place], 0), len(sheds) - 1)]
    return root, own
