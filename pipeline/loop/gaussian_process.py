"""A discrepancy without a cause: a Gaussian process on what the calibrated model leaves over.

It is what a loop that finds causes is compared with.
Source: Kennedy & O'Hagan 2001, J. R. Stat. Soc. B 63.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from pipeline.loop.covariance import Noise
from pipeline.loop.data import Data
from pipeline.loop.model import Model
from pipeline.simulate.setup import load_cells

SCALES = (-3.0, 2.0)  # bounds of the logarithms of length scales; features have unit range
AMPLITUDES = (-5.0, 1.0)  # and of the discrepancy's sd


def correction(
    model: Model, data: Data, noise: Noise, residual: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """Expected discrepancy (wanted) of rows `wanted`, in the model's scale.

    A squared-exponential kernel with a length scale for each feature (place of the load cell,
    fill height, share of the mass drawn, hydraulic radius, wall angle), most likely ones; the
    readings' own covariance is kept.
    """
    features = _features(model)
    features = features[:, np.ptp(features[data.use], axis=0) > 0.0]
    x, new = features[data.use], features[wanted]
    covariance = noise.covariance

    def squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a.T[:, :, None] - b.T[:, None]) ** 2  # (feature, row of a, row of b)

    def kernel(apart: np.ndarray, log: np.ndarray) -> np.ndarray:
        return np.exp(2.0 * log[0] - 0.5 * np.tensordot(np.exp(-2.0 * log[1:]), apart, axes=1))

    def cost(log: np.ndarray) -> tuple[float, np.ndarray]:
        """Negative log likelihood and its gradient."""
        similar = kernel(own, log)
        factor = cho_factor(similar + covariance, lower=True)
        alpha = cho_solve(factor, residual)
        left = (cho_solve(factor, np.eye(len(alpha))) - np.outer(alpha, alpha)) * similar
        by_scale = 0.5 * np.exp(-2.0 * log[1:]) * np.tensordot(own, left, axes=2)
        value = 0.5 * residual @ alpha + np.log(np.diag(factor[0])).sum()
        return float(value), np.array([left.sum(), *by_scale])

    own = squares(x, x)
    start = np.array([-2.0, *np.zeros(x.shape[1])])
    bounds = [AMPLITUDES, *[SCALES] * x.shape[1]]
    options = {"maxiter": 40}
    log = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    similar = kernel(squares(new, x), log)
    return similar @ np.linalg.solve(kernel(own, log) + covariance, residual)


def _features(model: Model) -> np.ndarray:
    """Features (row, feature), each over its range."""
    rows = []
    for case, row in zip((model.cases[i] for i in model.case_of), model.rows, strict=True):
        experiment, g = case.experiment, case.experiment.geometry
        places = {cell.name: (cell.x, cell.y) for cell in load_cells(experiment)}
        x, y = places.get(row.load_cell, (g.width / 2, g.length / 2))
        drawn = (row.mass_drawn or 0.0) / (experiment.mass_scheduled or 1.0)
        angle = experiment.walls.friction_angle if experiment.walls else 0.0
        level = g.height if row.fill_height is None else row.fill_height
        rows.append([x / g.width, y / g.length, level, drawn, g.hydraulic_radius, angle])
    features = np.array(rows)
    return features / np.maximum(np.ptp(features, axis=0), 1e-12)
