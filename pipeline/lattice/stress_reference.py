"""The stress sweep written for the eye: eqs 1-4 cell by cell, slow and obvious.

The kernel of `stress.py` must equal it; nothing else uses it.
"""

from __future__ import annotations

import numpy as np

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT

BELOW = ((0, 0),)
EDGES = ((-1, 0), (0, -1), (0, 1), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))


def stress_sweep_reference(weight, shed_fraction, edge, corner, code, relaxation, top_fraction):
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
    shed = 0.0

    def is_granular(k, y, x):
        inside = 0 <= y < ny and 0 <= x < nx
        return inside and code[k, y, x] in (STAGNANT, MOVEMENT)

    for k in reversed(range(nz)):
        passing = handed_down.copy()
        for y in range(ny):
            for x in range(nx):
                if not is_granular(k, y, x):
                    continue
                received = 0.0
                for ring in (BELOW, EDGES, CORNERS):
                    of_ring = 0.0
                    for dy, dx in ring:  # the giver above stands at (y + dy, x + dx)
                        if 0 <= y + dy < ny and 0 <= x + dx < nx:
                            of_ring += shares[y + dy, x + dx, 1 - dy, 1 - dx]
                    received += of_ring
                own = float(weight[k, y, x]) * (top_fraction if k == nz - 1 else 1.0)
                load[k, y, x] = own + received + handed_down[y, x]
                passing[y, x] = load[k, y, x]
        if k == 0:
            return load, base_load + passing, shed
        shares[:] = 0.0
        handed_down[:] = 0.0
        for y in range(ny):
            for x in range(nx):
                given = passing[y, x]
                if is_granular(k, y, x):
                    lost = load[k, y, x] * float(shed_fraction[k, y, x])
                    shed += lost
                    given = load[k, y, x] - lost
                    below = [
                        [(dy, dx) for dy, dx in ring if is_granular(k - 1, y + dy, x + dx)]
                        for ring in (BELOW, EDGES, CORNERS)
                    ]
                    codes = [[code[k - 1, y + dy, x + dx] for dy, dx in ring] for ring in below]
                    factors = _relaxation_factors(codes, relaxation)
                    ring_weights = (1.0, float(edge[k, y, x]), float(corner[k, y, x]))
                    total = sum(
                        w * sum(of_ring) for w, of_ring in zip(ring_weights, factors, strict=True)
                    )
                    if total > 0.0:
                        for ring, w, of_ring in zip(below, ring_weights, factors, strict=True):
                            for (dy, dx), factor in zip(ring, of_ring, strict=True):
                                shares[y, x, 1 + dy, 1 + dx] = given / total * w * factor
                        continue
                if code[k - 1, y, x] == OUTSIDE:
                    base_load[y, x] += given
                else:
                    handed_down[y, x] = given


def _relaxation_factors(codes, relaxation):
    """R for movement-zone receivers where at least one receiver is stagnant, else 1."""
    mixed = any(STAGNANT in ring for ring in codes)
    return [[relaxation if mixed and c == MOVEMENT else 1.0 for c in ring] for ring in codes]
