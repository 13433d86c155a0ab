"""The stress sweep written for the eye: eqs 1-4 cell by cell, slow and obvious.

The kernel of `stress.py` must equal it, couplings included; nothing else uses it.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT
from pipeline.lattice.stress import LEAST_RECEPTIVITY, UNCOUPLED, Coupling

BELOW = ((0, 0),)
EDGES = ((-1, 0), (0, -1), (0, 1), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))


def stress_sweep_reference(
    weight,
    shed_fraction,
    edge,
    corner,
    code,
    relaxation,
    top_fraction,
    coupling: Coupling = UNCOUPLED,
):
    """Carry all weights down the lattice; arguments as in `stress.stress_sweep`.

    Returns
    -------
    load : (z, y, x) float64, N
    base_load : (y, x) float64, N
    shed : float, N
    """
    nz, ny, nx = weight.shape
    load = np.zeros(weight.shape)
    base_load = np.zeros((ny, nx))
    handed_down = np.zeros((ny, nx))
    shares = np.zeros((ny, nx, 3, 3))  # what each cell of the level above gives to its nine
    excess = {}  # movement zone → what it shed in the level above and others shall carry
    shed = 0.0

    def is_granular(k, y, x):
        inside = 0 <= y < ny and 0 <= x < nx
        return inside and code[k, y, x] in (STAGNANT, MOVEMENT)

    def given(y, x, dy, dx):
        """What (y, x) of the level above gives to the place at this offset."""
        inside = 0 <= y < ny and 0 <= x < nx
        return shares[y, x, 1 + dy, 1 + dx] if inside else 0.0

    for k in reversed(range(nz)):
        for y in range(ny):
            for x in range(nx):
                if not is_granular(k, y, x):
                    continue
                level, before, after = (
                    given(y + dy, x, -dy, 0)
                    + (given(y + dy, x - 1, -dy, 1) + given(y + dy, x + 1, -dy, -1))
                    for dy in (0, -1, 1)  # rows of three givers above
                )
                received = level + (before + after)
                own = float(weight[k, y, x]) * (top_fraction if k == nz - 1 else 1.0)
                load[k, y, x] = own + received + handed_down[y, x]
        shed -= _arch(code[k], coupling, k, excess, load[k])
        _hand_aside(code[k], coupling.cohesion, load[k])
        passing = np.where(np.isin(code[k], (STAGNANT, MOVEMENT)), load[k], handed_down)
        if k == 0:
            return load, base_load + passing, shed
        shares[:] = 0.0
        handed_down[:] = 0.0
        excess = {}
        for y in range(ny):
            for x in range(nx):
                passed = passing[y, x]
                if is_granular(k, y, x):
                    fraction = _bent(shed_fraction[k, y, x], passed, coupling)
                    lost = passed * fraction
                    shed += lost
                    if coupling.transfer > 0.0 and code[k, y, x] == MOVEMENT:
                        own = coupling.own_shed[k, y, x]
                        beyond = max(fraction - _bent(own, passed, coupling, cap=math.inf), 0.0)
                        root = coupling.zone_root[k, y, x]
                        excess[root] = excess.get(root, 0.0) + coupling.transfer * beyond * passed
                    passed -= lost
                    below = [
                        [(dy, dx) for dy, dx in ring if is_granular(k - 1, y + dy, x + dx)]
                        for ring in (BELOW, EDGES, CORNERS)
                    ]
                    factors = _receiver_factors(
                        code[k - 1], below, y, x, k - 1, relaxation, coupling
                    )
                    straight = float(coupling.straight[k, y, x]) if coupling.straight.size else 1.0
                    ring_weights = (straight, float(edge[k, y, x]), float(corner[k, y, x]))
                    total = sum(
                        w * sum(of_ring) for w, of_ring in zip(ring_weights, factors, strict=True)
                    )
                    if total > 0.0:
                        for ring, w, of_ring in zip(below, ring_weights, factors, strict=True):
                            for (dy, dx), factor in zip(ring, of_ring, strict=True):
                                shares[y, x, 1 + dy, 1 + dx] = passed / total * w * factor
                        continue
                if code[k - 1, y, x] == OUTSIDE:
                    base_load[y, x] += passed
                else:
                    handed_down[y, x] = passed


def _bent(fraction, load, coupling, cap=1.0):
    """1 − E of a cell under its load; rounding may leave a cell that handed all aside below 0."""
    if coupling.slope == 0.0 or load <= 0.0:
        return float(fraction)
    return min(float(fraction) * (load / coupling.reference) ** coupling.slope, cap)


def _receiver_factors(below_code, below, y, x, k, relaxation, coupling):
    """R and lean of the receivers of (y, x), ring by ring.

    R acts on movement-zone receivers where at least one receiver is stagnant; an R of each place
    acts everywhere.
    """
    by_place = coupling.relaxation.size > 0
    mixed = any(below_code[y + dy, x + dx] == STAGNANT for ring in below for dy, dx in ring)

    def factor(dy, dx):
        r = 1.0
        if below_code[y + dy, x + dx] == MOVEMENT and by_place:
            r = max(float(coupling.relaxation[k, y + dy, x + dx]), LEAST_RECEPTIVITY)
        elif below_code[y + dy, x + dx] == MOVEMENT and mixed:
            r = relaxation
        return r * math.exp(coupling.lean_x * dx) * math.exp(coupling.lean_y * dy)

    return [[factor(dy, dx) for dy, dx in ring] for ring in below]


def _arch(code, coupling, k, excess, load):
    """Share each zone's excess among the stagnant cells that touch it; what was handed on, N."""
    handed = 0.0
    for root, force in excess.items():
        touching = [
            (y, x)
            for y, x in np.argwhere(code == STAGNANT)
            if root in coupling.zone_root[k, max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        ]
        for y, x in touching:
            load[y, x] += force / len(touching)
            handed += force / len(touching)
    return handed


def _hand_aside(code, cohesion, load):
    """Let movement-zone cells hand load to the stagnant cells that share a face with them."""
    before = load.copy()
    for y, x in np.argwhere(code == MOVEMENT):
        faces = [
            (y + dy, x + dx)
            for dy, dx in EDGES
            if 0 <= y + dy < code.shape[0]
            and 0 <= x + dx < code.shape[1]
            and code[y + dy, x + dx] == STAGNANT
        ]
        for face in faces:
            handed = min(before[y, x] / len(faces), cohesion)
            load[face] += handed
            load[y, x] -= handed
