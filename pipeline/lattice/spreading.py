"""What a cell gives to the receivers around the one straight down (eqs 3, 4)."""

from __future__ import annotations

import math

import numpy as np

RULES = ("inverse_distance", "multinomial")
S_LIMIT = 128.0  # beyond it the weights differ by 2^64 and more: their limit, in double precision


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
