"""Vertical stress on the lattice: one top-down sweep (eqs 1-4 of Gómez & Castro 2022).

Arrays are (z, y, x) with z index 0 at the base; loads are forces in newtons. The kernel knows the
nine receivers of a cell only through three spreading weights: 1 straight down, `edge` for the four
receivers at distance √2 and `corner` for the four at √3. `stress_reference.py` holds the same
sweep written for the eye.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT

RULES = ("inverse_distance", "multinomial")
S_LIMIT = 128.0  # beyond it the weights differ by 2^64 and more: their limit, in double precision
LEAST_RECEPTIVITY = 1e-100  # R = 0 still lets a cell without stagnant receivers hand its load on


def spreading_weights(
    s: np.ndarray, rule: str = "inverse_distance", dtype: type = np.float32
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the edge and corner receivers relative to the one straight down.

    Parameters
    ----------
    s : array of any shape
        Spreading exponent of each giving cell (eq 4), dimensionless; negative values spread
        outwards. Values beyond ±128 are taken at that limit.
    rule : {"inverse_distance", "multinomial"}
        Eq 4 alone, β ∝ (1/d)^s, or eq 3 with gamma functions for the factorials,
        β ∝ p^d / Γ(d + 1), p from eq 4 over all nine receivers.
    dtype : floating type of the returned arrays

    Returns
    -------
    edge, corner : arrays like `s`

    Raises
    ------
    ValueError
        If `rule` is not one of `RULES`.
    """
    s = np.clip(np.asarray(s), -S_LIMIT, S_LIMIT)
    edge = np.exp2(-0.5 * s)
    corner = np.exp2(-0.5 * math.log2(3.0) * s)
    if rule == "multinomial":
        d_edge, d_corner = math.sqrt(2.0), math.sqrt(3.0)
        edge, corner = edge.astype(np.float64), corner.astype(np.float64)
        total = 1.0 + 4.0 * edge + 4.0 * corner
        edge = edge**d_edge * total ** (1.0 - d_edge) / math.gamma(d_edge + 1.0)
        corner = corner**d_corner * total ** (1.0 - d_corner) / math.gamma(d_corner + 1.0)
        least = np.finfo(np.float32).tiny  # never 0: a lone far receiver still takes the load
        edge, corner = np.maximum(edge, least), np.maximum(corner, least)
    elif rule != "inverse_distance":
        raise ValueError(f"stress rule {rule!r}: expected one of {', '.join(RULES)}")
    return edge.astype(dtype), corner.astype(dtype)


def closed_form_stress(
    bulk_density: float, gravity: float, cell_size: float, transmission: float, depth: np.ndarray
) -> np.ndarray:
    """Stress below `depth` cells of a uniform column, Pa: ρ g c (1 − Eⁿ)/(1 − E).

    `depth` is the number of cells n above the plane (array or scalar, may hold a fraction of a
    top cell, which then passes through the whole cells below it); `transmission` is E. This is
    what eqs 1 and 2 add up to; eq 5 as printed has one more factor E.
    """
    depth = np.asarray(depth, dtype=np.float64)
    whole = np.floor(depth)
    fraction = depth - whole
    if transmission == 1.0:
        cells = depth
    else:
        cells = -np.expm1(whole * math.log(transmission)) / (1.0 - transmission)
        cells = cells + fraction * transmission**whole
    return bulk_density * gravity * cell_size * cells


@njit(nogil=True, cache=True, error_model="numpy")
def stress_sweep(
    weight,
    shed_fraction,
    edge,
    corner,
    code,
    relaxation,
    top_fraction,
    load,
    base_load,
):
    """Carry all weights down the lattice.

    Parameters
    ----------
    weight : (z, y, x) float
        Own weight γV of each granular cell, N; 0 in void cells and outside the ground.
    shed_fraction : (z, y, x) float
        1 − E of each cell: the share of its load that friction takes (eq 1).
    edge, corner : (z, y, x) float
        Spreading weights of the giving cell, from `spreading_weights`.
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

    Returns
    -------
    total_weight, shed : float
        Weight put in and load shed by (1 − E), N. Nothing vanishes:
        total_weight = base_load.sum() + shed.
    """
    nz, ny, nx = weight.shape
    keep = load.shape[0] > 0
    carried = np.zeros((ny, nx))
    straight = np.zeros((ny, nx))  # handed straight down because no receiver is granular
    down = np.zeros((ny + 2, nx + 2))  # transmitted load per unit of spreading weight, and that
    sides = np.zeros((ny + 2, nx + 2))  # times the edge weight,
    corners = np.zeros((ny + 2, nx + 2))  # times the corner weight
    receptivity = np.zeros((ny + 2, nx + 2))
    relaxed = max(relaxation, LEAST_RECEPTIVITY)
    total_weight = 0.0
    shed = 0.0
    base_load[:, :] = 0.0
    _receptivity(code[nz - 1], relaxed, receptivity)
    for k in range(nz - 1, -1, -1):
        scale = top_fraction if k == nz - 1 else 1.0
        for y in range(ny):
            for x in range(nx):
                own = scale * weight[k, y, x]
                total_weight += own
                from_edges = (
                    sides[y, x + 1] + sides[y + 1, x] + sides[y + 1, x + 2] + sides[y + 2, x + 1]
                )
                from_corners = (
                    corners[y, x] + corners[y, x + 2] + corners[y + 2, x] + corners[y + 2, x + 2]
                )
                received = down[y + 1, x + 1] + from_edges + from_corners
                carried[y, x] = own + receptivity[y + 1, x + 1] * received + straight[y, x]
        if keep:
            for y in range(ny):
                for x in range(nx):
                    granular = receptivity[y + 1, x + 1] > 0.0
                    load[k, y, x] = carried[y, x] if granular else 0.0
        if k == 0:
            break
        _receptivity(code[k - 1], relaxed, receptivity)
        for y in range(ny):
            for x in range(nx):
                cell = code[k, y, x]
                if cell in (STAGNANT, MOVEMENT):
                    lost = carried[y, x] * shed_fraction[k, y, x]
                    given = carried[y, x] - lost
                    shed += lost
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
                    w_edge = np.float64(edge[k, y, x])
                    w_corner = np.float64(corner[k, y, x])
                    total = receptivity[y + 1, x + 1] + w_edge * beside + w_corner * diagonal
                    if total > 0.0:
                        unit = given / total
                        down[y + 1, x + 1] = unit
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
    base_load += carried
    return total_weight, shed


@njit(nogil=True, cache=True)
def _receptivity(code, relaxed, receptivity):
    """Weight factor of each receiver of a level: 0 if not granular, R in the movement zone."""
    ny, nx = code.shape
    for y in range(ny):
        for x in range(nx):
            cell = code[y, x]
            receptivity[y + 1, x + 1] = (
                1.0 if cell == STAGNANT else (relaxed if cell == MOVEMENT else 0.0)
            )


@njit(nogil=True, cache=True)
def place_cells(code, cell_id, zone, cell_weight, cell_shed, zone_shed, weight, shed_fraction):
    """Weights and shed fractions of the cells where they now are.

    `code`, `cell_id`, `zone` (z, y, x) as in `flow.FlowState`; `cell_weight` (N) and `cell_shed`
    (1 − E) by cell identity; `zone_shed` (drawpoint) is 1 − E_min of each zone label. Fills
    `weight` and `shed_fraction` (z, y, x).
    """
    nz, ny, nx = code.shape
    for k in range(nz):
        for y in range(ny):
            for x in range(nx):
                cell = code[k, y, x]
                if cell == STAGNANT:
                    weight[k, y, x] = cell_weight[cell_id[k, y, x]]
                    shed_fraction[k, y, x] = cell_shed[cell_id[k, y, x]]
                elif cell == MOVEMENT:
                    weight[k, y, x] = cell_weight[cell_id[k, y, x]]
                    shed_fraction[k, y, x] = zone_shed[zone[k, y, x]]
                else:
                    weight[k, y, x] = 0.0
                    shed_fraction[k, y, x] = 0.0
