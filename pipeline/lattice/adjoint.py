"""What each cell contributes to a reading: the adjoint of the stress sweep, bottom-up.

A reading is a weighted sum of the base loads. The sweep of `stress.py` hands loads down; here the
reading's derivatives are handed up, from the base to the top, along the same weights. For a sweep
that is linear in the weights (no `slope`, no `cohesion`) the result is its exact transpose;
otherwise it is the linearisation at the loads of the forward sweep. Arrays are (z, y, x) with
z index 0 at the base, loads N, as in `stress.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT
from pipeline.lattice.stress import (
    LEAST_RECEPTIVITY,
    UNCOUPLED,
    Coupling,
    _receptivity,
    _zones_around,
    leaning_sums,
)

FULL = 1e-9  # of the cohesion: a load that is less has been handed aside as a whole


class Influence(NamedTuple):
    """Derivatives of readings, each (reading, z, y, x) in the reading's unit per that of:

    - ``weight``: the cell's weight, N. For a linear sweep, reading = Σ weight · cell weights.
    - ``shed``: 1 − E of the cell, if asked for; else (reading, 0, 0, 0). Times 1 − E it is the
      derivative with respect to log(1 − E); times −E, with respect to log E.
    - ``own_shed``: the coupling's `own_shed`, with `transfer` and where ``shed`` is asked for;
      else (reading, 0, 0, 0).
    - ``relaxation``: log R of the movement-zone cell as a receiver, if asked for; else
      (reading, 0, 0, 0).
    """

    weight: np.ndarray
    shed: np.ndarray
    own_shed: np.ndarray
    relaxation: np.ndarray


def influence(
    readings: np.ndarray,
    shed_fraction: np.ndarray,
    edge: np.ndarray,
    corner: np.ndarray,
    code: np.ndarray,
    relaxation: float,
    top_fraction: float,
    load: np.ndarray,
    coupling: Coupling = UNCOUPLED,
    of_relaxation: bool = False,
    of_shed: bool = True,
    dtype: type = np.float64,
) -> Influence:
    """Carry the derivatives of readings up the lattice.

    Parameters
    ----------
    readings : (reading, y, x) float
        Weight of each base load in each reading: reading = Σ readings · base_load. For a load
        cell its footprint over the cell area.
    shed_fraction, edge, corner, code, relaxation, top_fraction, coupling
        As the forward sweep took them, see `stress.stress_sweep`.
    load : (z, y, x) float
        Loads that the forward sweep kept, N.
    of_relaxation : whether derivatives with respect to R are returned too
    of_shed : whether those with respect to E are, which takes as much memory again
    dtype : floating type of the returned arrays

    Returns
    -------
    Influence
        At a kink (a load just at the cohesion's cap, a shed fraction just at 1) the derivative of
        one of its sides. E of the base level and of places that are void or outside the ground
        has no influence: 0.
    """
    readings = np.ascontiguousarray(readings, dtype=np.float64)
    whole, none = (len(readings), *code.shape), (len(readings), 0, 0, 0)
    result = Influence(
        weight=np.empty(whole, dtype),
        shed=np.zeros(whole if of_shed else none, dtype),
        own_shed=np.zeros(whole if of_shed and coupling.transfer > 0.0 else none, dtype),
        relaxation=np.zeros(whole if of_relaxation else none, dtype),
    )
    _influence(
        readings,
        shed_fraction,
        edge,
        corner,
        code,
        float(relaxation),
        float(top_fraction),
        load,
        coupling,
        result,
    )
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _influence(
    readings,
    shed_fraction,
    edge,
    corner,
    code,
    relaxation,
    top_fraction,
    load,
    coupling,
    result,
):
    nz, ny, nx = code.shape
    count = len(readings)
    lower, upper = math.exp(-coupling.lean_y), math.exp(coupling.lean_y)
    left, right = math.exp(-coupling.lean_x), math.exp(coupling.lean_x)
    shares_excess = coupling.transfer > 0.0
    by_relaxation, by_transmission = result.relaxation.shape[1] > 0, result.shed.shape[1] > 0
    receptivity = np.zeros((ny + 2, nx + 2))
    # derivatives of the readings by what reaches each place of the level below; that times the
    # place's receptivity; and by the excess of each zone
    of_load = np.empty((count, ny, nx))
    shared = np.zeros((count, ny + 2, nx + 2))
    of_excess = np.zeros((count, coupling.zone_root.max() + 1 if shares_excess else 0))
    # where a cell's load goes: shares by ring, or all of it to the place straight below or onto
    # rock; how what it gives answers to its load and its 1 − E, and likewise (with a third, its
    # own 1 − E) what it adds to the excess of its zone
    down, sides, corners = np.empty((ny, nx)), np.empty((ny, nx)), np.empty((ny, nx))
    through, onto_rock = np.empty((ny, nx)), np.empty((ny, nx))
    by_load, by_shed = np.empty((ny, nx)), np.empty((ny, nx))
    excess_by = np.empty((3, ny, nx))
    given = np.empty((ny, nx))
    of_given = np.empty((ny, nx))
    for k in range(nz):
        if k > 0:
            for y in range(ny):
                for x in range(nx):
                    through[y, x], onto_rock[y, x] = 1.0, 0.0
                    down[y, x], sides[y, x], corners[y, x] = 0.0, 0.0, 0.0
                    by_load[y, x], by_shed[y, x] = 1.0, 0.0
                    excess_by[:, y, x] = 0.0
                    given[y, x] = 0.0
                    cell = code[k, y, x]
                    if cell in (STAGNANT, MOVEMENT):
                        carried = np.float64(load[k, y, x])
                        fraction = np.float64(shed_fraction[k, y, x])
                        by_stress, bent = 1.0, coupling.slope != 0.0 and carried > 0.0
                        if bent:
                            by_stress = (carried / coupling.reference) ** coupling.slope
                        steeper = by_stress * (1.0 + coupling.slope) if bent else 1.0
                        if not bent or fraction * by_stress < 1.0:
                            by_load[y, x] = 1.0 - fraction * steeper
                            by_shed[y, x] = -carried * by_stress
                            given[y, x] = carried * (1.0 - fraction * by_stress)
                            if shares_excess and cell == MOVEMENT:
                                beyond = fraction - coupling.own_shed[k, y, x]
                                if beyond > 0.0:
                                    excess_by[0, y, x] = coupling.transfer * beyond * steeper
                                    excess_by[1, y, x] = coupling.transfer * carried * by_stress
                                    excess_by[2, y, x] = -excess_by[1, y, x]
                        else:
                            by_load[y, x] = 0.0
                            if shares_excess and cell == MOVEMENT:
                                own = np.float64(coupling.own_shed[k, y, x])
                                if own * by_stress < 1.0:
                                    excess_by[0, y, x] = coupling.transfer * (1.0 - own * steeper)
                                    excess_by[2, y, x] = -coupling.transfer * carried * by_stress
                        beside, diagonal = leaning_sums(
                            receptivity, y, x, lower, upper, left, right
                        )
                        w_down = 1.0
                        if coupling.straight.shape[0] > 0:
                            w_down = np.float64(coupling.straight[k, y, x])
                        w_edge = np.float64(edge[k, y, x])
                        w_corner = np.float64(corner[k, y, x])
                        total = w_down * receptivity[y + 1, x + 1] + w_edge * beside
                        total += w_corner * diagonal
                        if total > 0.0:
                            down[y, x] = w_down / total
                            sides[y, x] = w_edge / total
                            corners[y, x] = w_corner / total
                            through[y, x] = 0.0
                            continue
                    if code[k - 1, y, x] == OUTSIDE:
                        through[y, x], onto_rock[y, x] = 0.0, 1.0
        for n in range(count):
            below = shared[n]
            if k == 0:
                for y in range(ny):
                    for x in range(nx):
                        of_load[n, y, x] = readings[n, y, x]
            else:
                for y in range(ny):
                    for x in range(nx):
                        of_edges, of_corners = leaning_sums(below, y, x, lower, upper, left, right)
                        of_given[y, x] = (
                            down[y, x] * below[y + 1, x + 1]
                            + sides[y, x] * of_edges
                            + corners[y, x] * of_corners
                            + through[y, x] * of_load[n, y, x]
                            + onto_rock[y, x] * readings[n, y, x]
                        )
                if by_relaxation:
                    field = result.relaxation[n, k - 1]
                    _of_receptivity(
                        (down, sides, corners), given, of_given, coupling, of_load[n], field
                    )
                    for y in range(ny):
                        for x in range(nx):
                            r = receptivity[y + 1, x + 1]
                            felt = code[k - 1, y, x] == MOVEMENT and r > LEAST_RECEPTIVITY
                            field[y, x] *= r if felt else 0.0
                for y in range(ny):
                    for x in range(nx):
                        of_load[n, y, x] = by_load[y, x] * of_given[y, x]
                if by_transmission:
                    for y in range(ny):
                        for x in range(nx):
                            result.shed[n, k, y, x] = by_shed[y, x] * of_given[y, x]
                if shares_excess:
                    for y in range(ny):
                        for x in range(nx):
                            if code[k, y, x] == MOVEMENT:
                                of_zone = of_excess[n, coupling.zone_root[k, y, x]]
                                of_load[n, y, x] += excess_by[0, y, x] * of_zone
                                if by_transmission:
                                    result.shed[n, k, y, x] += excess_by[1, y, x] * of_zone
                                    result.own_shed[n, k, y, x] = excess_by[2, y, x] * of_zone
            if coupling.cohesion > 0.0:
                _of_handed_aside(code[k], load[k], coupling.cohesion, of_load[n])
            if shares_excess:
                _of_shared_excess(code[k], coupling.zone_root[k], of_load[n], of_excess[n])
            scale = top_fraction if k == nz - 1 else 1.0
            for y in range(ny):
                for x in range(nx):
                    result.weight[n, k, y, x] = scale * of_load[n, y, x]
        _receptivity(code, k, relaxation, coupling.relaxation, receptivity)
        for n in range(count):
            for y in range(ny):
                for x in range(nx):
                    shared[n, y + 1, x + 1] = receptivity[y + 1, x + 1] * of_load[n, y, x]


@njit(nogil=True, cache=True, error_model="numpy")
def _of_receptivity(shares, given, of_given, coupling, of_load, field):
    """Derivative with respect to the receptivity of each place of a level, into `field` (y, x).

    What a place receives rises by its part of what each giver above hands down; as the givers'
    weights are normalised, what all their receivers get falls by as much.
    """
    ny, nx = given.shape
    lower, upper = math.exp(-coupling.lean_y), math.exp(coupling.lean_y)
    left, right = math.exp(-coupling.lean_x), math.exp(coupling.lean_x)
    down, sides, corners = shares
    for y in range(ny):
        for x in range(nx):
            total = down[y, x] * given[y, x] * (of_load[y, x] - of_given[y, x])
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    inside = 0 <= y + dy < ny and 0 <= x + dx < nx
                    if (dy == 0 and dx == 0) or not inside:
                        continue
                    lean = upper if dy < 0 else (lower if dy > 0 else 1.0)
                    lean *= right if dx < 0 else (left if dx > 0 else 1.0)
                    ring = sides if dy == 0 or dx == 0 else corners
                    part = lean * ring[y + dy, x + dx] * given[y + dy, x + dx]
                    total += part * (of_load[y, x] - of_given[y + dy, x + dx])
            field[y, x] = total


@njit(nogil=True, cache=True)
def _of_handed_aside(code, load, cohesion, of_load):
    """Derivatives before `stress._hand_aside` from those after it, in place (y, x)."""
    ny, nx = code.shape
    for y in range(ny):
        for x in range(nx):
            if code[y, x] != MOVEMENT or load[y, x] > FULL * cohesion:
                continue  # what it hands aside is the cohesion, whatever it carries
            faces, total = 0, 0.0
            for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                inside = 0 <= y + dy < ny and 0 <= x + dx < nx
                if inside and code[y + dy, x + dx] == STAGNANT:
                    faces += 1
                    total += of_load[y + dy, x + dx]
            if faces > 0:
                of_load[y, x] = total / faces


@njit(nogil=True, cache=True)
def _of_shared_excess(code, zone_root, of_load, of_excess):
    """Derivative with respect to each zone's excess: the mean over the cells that share it."""
    ny, nx = code.shape
    touching = np.zeros(len(of_excess))
    found = np.empty(8, np.int64)
    of_excess[:] = 0.0
    for y in range(ny):
        for x in range(nx):
            if code[y, x] == STAGNANT:
                for i in range(_zones_around(zone_root, y, x, found)):
                    touching[found[i]] += 1.0
                    of_excess[found[i]] += of_load[y, x]
    for root in range(len(of_excess)):
        if touching[root] > 0.0:
            of_excess[root] /= touching[root]
