"""Other ways to name a missing effect from the same residual: what the loop is compared with.

Each is a pure function of arrays and returns the names of the candidates that it would claim, in
order. Readings are rows; `residual` r, derivatives by calibrated parameters J (row, parameter) and
by candidates' amplitudes G (row, candidate) are of log readings, `names` are the candidates', and
`std` (row) is each reading's total sd, of readings taken for independent unless their `covariance`
(row, row) is given.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import numpy as np
from scipy.linalg import solve_triangular

MOST = 3  # claims of a method that does not stop by itself
THRESHOLD = 2.0  # of sequentially thresholded least squares, in standard errors of a coefficient
RIDGE = 1e-3

Name = Hashable


def raw_correlation(residual: np.ndarray, G: np.ndarray, names: Sequence[Name]) -> list[Name]:
    """The candidate whose sensitivities correlate best with the residual.

    Neither is whitened or freed of what calibration can follow, and there is always an answer.
    """
    return [names[int(np.argmax(np.abs(_correlations(residual, G))))]]


def forward_selection(
    residual: np.ndarray,
    J: np.ndarray,
    G: np.ndarray,
    names: Sequence[Name],
    std: np.ndarray,
    covariance: np.ndarray | None = None,
) -> list[Name]:
    """Candidates added one by one while the Bayesian information criterion falls.

    Schwarz 1978: BIC = |z|² + k ln n, the covariance taken as known; at most `MOST` of them.
    """
    z, J, G = _whitened((residual, J, G), std, covariance)
    chosen: list[int] = []
    best = _rest(J, z)
    while len(chosen) < min(MOST, len(names)):
        others = [k for k in range(len(names)) if k not in chosen]
        left = {k: _rest(np.column_stack([J, G[:, [*chosen, k]]]), z) for k in others}
        nearest = min(left, key=left.get)
        if left[nearest] + math.log(len(z)) >= best:
            break
        chosen.append(nearest)
        best = left[nearest]
    return [names[k] for k in chosen]


def thresholded_least_squares(
    residual: np.ndarray,
    J: np.ndarray,
    G: np.ndarray,
    names: Sequence[Name],
    std: np.ndarray,
    covariance: np.ndarray | None = None,
) -> list[Name]:
    """All candidates at once, the small ones struck out, again until none is small.

    Brunton, Proctor & Kutz 2016. Sensitivities are whitened, freed of what calibration can follow
    and of unit length, so that an amplitude is in standard errors of a lone candidate; a small
    ridge keeps collinear ones apart. Those that stay are ordered by size.
    """
    z, J, G = _whitened((residual, J, G), std, covariance)
    z, G = (one - J @ np.linalg.lstsq(J, one, rcond=None)[0] for one in (z, G))
    norms = np.linalg.norm(G, axis=0)
    kept = np.flatnonzero(norms > 1e-9)
    while kept.size:
        active = G[:, kept] / norms[kept]
        normal = active.T @ active + RIDGE * np.eye(kept.size)
        amplitude = np.linalg.solve(normal, active.T @ z)
        small = np.abs(amplitude) < THRESHOLD
        if not small.any():
            return [names[k] for k in kept[np.argsort(-np.abs(amplitude))]]
        kept = kept[~small]
    return []


def _correlations(residual: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Correlation of the residual with each column; 0 of one that is constant."""
    r, columns = residual - residual.mean(), G - G.mean(axis=0)
    norms = np.linalg.norm(columns, axis=0) * np.linalg.norm(r)
    return np.divide(r @ columns, norms, out=np.zeros(G.shape[1]), where=norms > 0.0)


def _whitened(values, std, covariance):
    """Each of the arrays (row, ...) in standard deviations, uncorrelated."""
    factor = np.diag(std) if covariance is None else np.linalg.cholesky(covariance)
    return [solve_triangular(factor, one, lower=True) for one in values]


def _rest(columns: np.ndarray, z: np.ndarray) -> float:
    """Squared length of what least squares leaves of z."""
    left = z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0]
    return float(left @ left)
