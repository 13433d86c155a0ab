"""Stress of a uniform column in closed form."""

from __future__ import annotations

import math

import numpy as np


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
