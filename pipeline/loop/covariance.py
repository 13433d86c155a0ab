"""How far readings may be off a right model: replicates' scatter and the instruments' errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from pipeline.loop.data import Data
from pipeline.loop.model import Model, Point

SHRINK = 0.1  # of the replicates' covariance to its diagonal
LEAST_FREEDOM = 10  # degrees of freedom from which the components are estimated
COMPONENTS = ("scatter", "shared", "independent")
PRIOR_SD = 0.25  # of the logarithm of a component's sd about what was declared


@dataclass(frozen=True)
class Noise:
    """Covariance of the readings of `Data`, and draws of their errors.

    Attributes
    ----------
    parts : the components (n, n) as simulated and declared, in the order of `COMPONENTS`
    factors : what each is multiplied with; 1: as declared
    lower : (n, n) Cholesky factor of the sum
    residuals : for each case its rows' places among n, and residuals (replicate, row) of
        replicates that did not go into `parts`
    """

    parts: tuple[np.ndarray, np.ndarray, np.ndarray]
    factors: tuple[float, float, float]
    lower: np.ndarray
    residuals: tuple[tuple[np.ndarray, np.ndarray], ...]

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """L⁻¹ times columns (n, ...)."""
        return solve_triangular(self.lower, values, lower=True)

    @property
    def covariance(self) -> np.ndarray:
        """The sum (n, n)."""
        return self.lower @ self.lower.T

    def scaled(self, factors: tuple[float, float, float]) -> Noise:
        """The same with other factors."""
        lower = _lower(self.parts, factors)
        return Noise(self.parts, tuple(map(float, factors)), lower, self.residuals)

    def draws(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Errors (n, count): replicates drawn for each experiment, and normal instrument errors."""
        scatter, shared, independent = np.sqrt(self.factors)
        errors = np.zeros((len(self.lower), count))
        for places, residuals in self.residuals:
            chosen = random.integers(len(residuals), size=count)
            errors[places] = scatter * residuals[chosen].T
        normal = random.standard_normal((2, len(errors), count))
        errors += independent * np.sqrt(np.diag(self.parts[2]))[:, None] * normal[0]
        return errors + shared * _root(self.parts[1]) @ normal[1]

    @property
    def of_draws(self) -> np.ndarray:
        """Covariance (n, n) that `draws` have in the limit of many."""
        scatter, shared, independent = self.factors
        found = shared * self.parts[1] + independent * self.parts[2]
        for places, residuals in self.residuals:
            found[np.ix_(places, places)] += scatter * (residuals.T @ residuals) / len(residuals)
        return found


def noise(model: Model, point: Point, data: Data, rough: bool = False) -> Noise:
    """Noise at a point of the model, with the instruments' errors as declared.

    `rough`: from the common replicates alone, each row by itself; enough to come near a fit.
    """
    size = len(data.use)
    scatter = np.zeros((size, size))
    residuals = []
    for case, where in enumerate(model.slices):
        half, others = (model.common(case), 0) if rough else model.counts(case)
        places = np.flatnonzero((data.use >= where.start) & (data.use < where.stop))
        if not len(places):
            continue
        rows = model.scatter(point, case, half + others)[:, data.use[places] - where.start]
        weight = data.scatter[places]
        block = np.atleast_2d(np.cov(rows[:half], rowvar=False))
        shrink = 1.0 if rough else SHRINK
        block = (1.0 - shrink) * block + shrink * np.diag(np.diag(block))
        # a mean over all replicates stands in for the expectation
        scatter[np.ix_(places, places)] = block * (np.outer(weight, weight) + 1.0 / len(rows))
        if others:
            off = (rows[half:] - rows[half:].mean(axis=0)) * np.sqrt(others / (others - 1))
            residuals.append((places, off * np.sqrt(weight**2 + 1.0 / len(rows))))
    parts = (scatter, data.shared, np.diag(data.independent))
    factors = (1.0, 1.0, 1.0)
    return Noise(parts, factors, _lower(parts, factors), tuple(residuals))


def restricted_likelihood_factors(
    noise: Noise, residual: np.ndarray, explained: np.ndarray
) -> tuple[tuple[float, float, float], int]:
    """Variance factors that the data speak for (REML), and the degrees of freedom they leave.

    Everything that a parameter, a candidate or a rule could explain is projected out first:
    `explained` (n, column) are those directions, not whitened. Each log sd has a normal prior
    about what was declared, so that data which say little change little. With fewer than
    `LEAST_FREEDOM` degrees of freedom, the declared noise stands.

    Source: Patterson & Thompson 1971, Biometrika 58.
    """
    directions = noise.whitened(explained)
    scale = np.linalg.norm(directions, axis=0)
    directions = directions[:, scale > 1e-9] / scale[scale > 1e-9]
    left, size, _ = np.linalg.svd(directions, full_matrices=True)
    rank = int((size > 1e-2 * size.max(initial=1.0)).sum()) if size.size else 0
    rest = left[:, rank:]
    freedom = rest.shape[1]
    if freedom < LEAST_FREEDOM:
        return noise.factors, freedom
    contrast = rest.T @ solve_triangular(noise.lower, np.eye(len(noise.lower)), lower=True)
    seen = contrast @ residual
    parts = [contrast @ part @ contrast.T for part in noise.parts]
    present = [i for i, part in enumerate(parts) if np.trace(part) > 1e-6 * freedom]

    def cost(log_sd: np.ndarray) -> float:
        total = sum(np.exp(2.0 * v) * parts[i] for v, i in zip(log_sd, present, strict=True))
        lower = cholesky(total + 1e-9 * np.eye(freedom), lower=True)
        white = solve_triangular(lower, seen, lower=True)
        likelihood = np.log(np.diag(lower)).sum() + 0.5 * white @ white
        return likelihood + 0.5 * np.sum((log_sd / PRIOR_SD) ** 2)

    found = minimize(cost, np.zeros(len(present)), method="Nelder-Mead", options={"xatol": 0.01})
    factors = np.ones(len(parts))
    factors[present] = np.exp(2.0 * found.x)
    return tuple(factors), freedom


def _lower(parts, factors) -> np.ndarray:
    return cholesky(sum(f * part for f, part in zip(factors, parts, strict=True)), lower=True)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Symmetric root of a covariance that may be singular."""
    size, directions = np.linalg.eigh(covariance)
    return directions * np.sqrt(np.maximum(size, 0.0)) @ directions.T
