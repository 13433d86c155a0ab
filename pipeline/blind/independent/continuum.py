"""Static columns as a continuum."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.blind.independent.ground import GRAVITY, Box, lattice_variance, overlap

SLICE = 0.005  # m
STRIPS = 24
PACKING_SCATTER = 0.035  # sd of log stress under a load cell, from packing to packing


def as_continuum(experiment, theta, acting, physics, packing):
    """Janssen's slices with lateral diffusion and drift along x, walls that let nothing through.

    dσ/dz = ρ g − σ/ℓ (σ/σ_ref)^slope − σ K tan φ / R_h − ∂/∂x (tan θ σ − D ∂σ/∂x)
    """
    box = Box(experiment, acting)
    rate = -math.log(theta["E"][experiment["material"]["name"]]) / box.declared_cell
    wall = 0.0
    if "wall_friction" in acting:
        angle = math.radians(experiment["walls"]["friction_angle"])
        wall = acting["wall_friction"]["K"] * math.tan(angle) / box.area_over_perimeter
    width = experiment["geometry"]["width"]
    edges = np.linspace(0.0, width, STRIPS + 1)
    under = np.array([overlap(edges, c["x"], c["width"]) for c in experiment["load_cells"]])
    under /= under.sum(axis=1, keepdims=True)
    diffusion = 0.5 * lattice_variance(experiment["stress"]["s"]["mean"]) * box.declared_cell
    drift = math.tan(math.radians(acting.get("tilt", {"angle_x": 0.0})["angle_x"]))
    scatter = PACKING_SCATTER * theta["s"] / 1.5 * packing.standard_normal(len(under))
    rows = []
    for level in experiment["filling"]["levels"]:
        height = level * box.height_factor
        depth = (np.arange(round(height / SLICE)) + 0.5) * SLICE
        density = depth ** acting.get("compaction", {"index": 0.0})["index"]
        density *= box.density * height / (density.sum() * SLICE)
        stress = np.full(STRIPS, 1e3 * acting.get("surcharge", {"stress": 0.0})["stress"])
        _descend(
            stress,
            GRAVITY * density,
            rate,
            wall,
            acting.get("stress_dependent_transmission", {"slope": 0.0})["slope"],
            box.half_overburden,
            drift * STRIPS / width,
            physics.spread * diffusion * (STRIPS / width) ** 2,
        )
        rows.append(under @ stress * 1e-3 * np.exp(scatter))
    return np.array(rows)


@njit(nogil=True, cache=True, error_model="numpy")
def _descend(stress, gained, rate, wall, slope, reference, drift, diffusion):
    """Take the stress (strip) in Pa down the column, slice by slice.

    `gained` (slice) in N m⁻³; `drift` and `diffusion` for each meter down, in strips.
    """
    flux = np.zeros(len(stress) + 1)
    for own in gained:
        for i in range(1, len(stress)):
            middle = 0.5 * (stress[i] + stress[i - 1])
            flux[i] = drift * middle - diffusion * (stress[i] - stress[i - 1])
        for i in range(len(stress)):
            by_stress = (max(stress[i], 1.0) / reference) ** slope
            lost = (rate * by_stress + wall) * stress[i] + flux[i + 1] - flux[i]
            stress[i] += SLICE * (own - lost)
