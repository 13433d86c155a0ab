"""Is anything missing: one test of all that could be, at a stated rate of false alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from pipeline.loop.covariance import LEAST_FREEDOM, Noise
from pipeline.loop.data import Data
from pipeline.loop.fit import Fit, box
from pipeline.loop.hypotheses import Hypothesis
from pipeline.loop.model import Model, Term

DRAWS = 2000
OMNIBUS = 0.2  # of alpha for the sum of squares
STRAIGHT = 0.98  # cosine from which a response far out points where its derivative does
TINY = 1e-10  # of a direction's square: what is left of one that the parameters explain


@dataclass(frozen=True)
class Projected:
    """Residual and derivatives, whitened, without what calibration can explain.

    Vectors have the readings first, then the priors' rows. `z` (m) is the residual; `columns`
    (m, term) the derivatives by each amplitude, `unprojected` (term) their squared lengths before.
    `basis` (m, unknown) spans what was projected out. `slopes` (row, term) are the derivatives
    themselves. `far` (m, term) are the mean changes by amplitudes of many scales; the derivatives
    where nobody looked that far.
    """

    z: np.ndarray
    terms: tuple[Term, ...]
    slopes: np.ndarray
    columns: np.ndarray
    unprojected: np.ndarray
    basis: np.ndarray
    far: np.ndarray

    def of(self, hypothesis: Hypothesis) -> np.ndarray:
        """Columns (m, term) of a hypothesis."""
        return self.columns[:, self._places(hypothesis)]

    def ways(self, hypothesis: Hypothesis) -> list[np.ndarray]:
        """Columns (m, term) of a hypothesis, and those far out where they point elsewhere."""
        near, far = self.of(hypothesis), self.far[:, self._places(hypothesis)]
        scale = np.array([term.described.scale for term in hypothesis.terms])
        one, other = near @ scale, far @ scale
        size = float(np.linalg.norm(one) * np.linalg.norm(other))
        return [near] if one @ other >= STRAIGHT * size else [near, far]

    def slopes_of(self, hypothesis: Hypothesis) -> np.ndarray:
        """Derivatives (row, term) of the model's rows."""
        return self.slopes[:, self._places(hypothesis)]

    def survives(self, hypothesis: Hypothesis) -> float:
        """Part of a hypothesis' signal, for all its amplitudes alike, that calibration leaves."""
        places = self._places(hypothesis)
        before = float(self.unprojected[places].sum())
        return float((self.columns[:, places] ** 2).sum()) / before if before > 0.0 else 0.0

    def _places(self, hypothesis: Hypothesis) -> list[int]:
        return [self.terms.index(term) for term in hypothesis.terms]


@dataclass(frozen=True)
class Gate:
    """Outcome of the lack-of-fit test.

    `scores` (hypothesis) are standardized, `statistic` is the largest; `threshold` is the score
    that alpha allows. `inflation` (hypothesis) is the null variance of the raw score, which
    exceeds 1 as the covariance is itself estimated; it is free of the chance of the null's draws
    where the scores are no t statistics.
    """

    statistic: float
    p_value: float
    alpha: float
    labels: tuple[str, ...]
    scores: np.ndarray
    inflation: np.ndarray
    threshold: float
    omnibus: float
    omnibus_p_value: float
    largest_p_value: float

    @property
    def rejected(self) -> bool:
        """Whether the model lacks something."""
        return self.p_value <= self.alpha

    @property
    def points_somewhere(self) -> bool:
        """Whether a candidate or a rule is among what rejects, not the sum of squares alone."""
        return self.largest_p_value <= (1.0 - OMNIBUS) * self.alpha


def projected(
    model: Model,
    data: Data,
    noise: Noise,
    found: Fit,
    terms: Sequence[Term],
    slopes: np.ndarray,
    chords: np.ndarray | None = None,
) -> Projected:
    """`slopes` (row, term) are derivatives of the model's rows by `terms`, `chords` as `far`."""
    point = found.point
    center, sd, _, _ = box(model, point)
    at = np.array([*point.coordinates, *point.amplitudes])
    basis = np.vstack([noise.whitened(found.slopes[data.use]), np.diag(1.0 / sd)])
    basis = np.linalg.qr(basis)[0] if basis.shape[1] else basis
    z = np.concatenate([noise.whitened(found.residual), (center - at) / sd])
    before, columns = _columns(data, noise, basis, slopes)
    far = columns if chords is None else _columns(data, noise, basis, chords)[1]
    return Projected(_without(basis, z), tuple(terms), slopes, columns, before, basis, far)


def _columns(data: Data, noise: Noise, basis: np.ndarray, slopes: np.ndarray):
    """Whitened squares (term) of derivatives (row, term), and what calibration leaves (m, term)."""
    of_readings = noise.whitened(slopes[data.use])
    whole = np.vstack([of_readings, np.zeros((len(basis) - len(of_readings), slopes.shape[1]))])
    before = (whole**2).sum(axis=0)
    columns = _without(basis, whole)
    columns[:, (columns**2).sum(axis=0) <= TINY * before] = 0.0
    return before, columns


def lack_of_fit(
    seen: Projected,
    noise: Noise,
    hypotheses: Sequence[Hypothesis],
    alpha: float,
    random: np.random.Generator,
) -> Gate:
    """Joint maximum over the score statistics of all hypotheses, with a part for |z|².

    A hypothesis with several amplitudes enters with all of them alike; each of them is one of the
    others. One that points elsewhere far out enters that way too, with the larger score. Scores on
    the side that physics excludes count nothing. Where enough degrees of freedom are beyond all
    hypotheses, scores are measured by the residual there, as a t statistic is.
    """
    directions, signs, labels = [], [], []
    for hypothesis in hypotheses:
        scale = np.array([term.described.scale for term in hypothesis.terms])
        for columns in seen.ways(hypothesis):
            direction = columns @ scale
            size = np.linalg.norm(direction)
            if size > 1e-6:
                directions.append(direction / size)
                signs.append(hypothesis.terms[0].described.sign)
                labels.append(hypothesis.label)
    z = seen.z
    errors = noise.draws(DRAWS, random)
    null = np.vstack(
        [noise.whitened(errors), random.standard_normal((len(z) - len(errors), DRAWS))]
    )
    null = _without(seen.basis, null)
    null_sums = (null**2).sum(axis=0)
    omnibus = float(z @ z)
    omnibus_p = (1.0 + np.sum(null_sums >= omnibus)) / (DRAWS + 1.0)
    if not directions:
        p = min(1.0, omnibus_p)
        return Gate(0.0, p, alpha, (), np.zeros(0), np.ones(0), np.inf, omnibus, omnibus_p, 1.0)
    matrix, side = np.array(directions), np.array(signs)
    spread, null_spread = _beyond(seen, matrix, z), _beyond(seen, matrix, null)
    raw, null_raw = matrix @ z / spread, matrix @ null / null_spread
    drawn, exact = (matrix @ null).var(axis=1), _null_variance(seen, noise, matrix)
    inflation = null_raw.var(axis=1) * exact / drawn
    scores = _one_sided(raw / np.sqrt(inflation), side)
    null_largest = _one_sided(null_raw / np.sqrt(inflation)[:, None], side[:, None]).max(axis=0)
    largest = float(scores.max())
    p_largest = (1.0 + np.sum(null_largest >= largest)) / (DRAWS + 1.0)
    p = min(1.0, p_largest / (1.0 - OMNIBUS), omnibus_p / OMNIBUS)
    threshold = float(np.quantile(null_largest, 1.0 - alpha * (1.0 - OMNIBUS)))
    best: dict[str, int] = {}  # of each label's directions
    for place, label in enumerate(labels):
        if scores[place] > scores[best.setdefault(label, place)]:
            best[label] = place
    kept = list(best.values())
    return Gate(
        largest,
        float(p),
        alpha,
        tuple(best),
        scores[kept],
        inflation[kept],
        threshold,
        omnibus,
        float(omnibus_p),
        float(p_largest),
    )


def _null_variance(seen: Projected, noise: Noise, directions: np.ndarray) -> np.ndarray:
    """Variance (direction) of the null's scores before they are measured by the residual."""
    inside = _without(seen.basis, directions.T)
    readings, priors = np.split(inside, [len(noise.lower)])
    unwhitened = solve_triangular(noise.lower, readings, lower=True, trans="T")
    return ((noise.of_draws @ unwhitened) * unwhitened).sum(axis=0) + (priors**2).sum(axis=0)


def _beyond(seen: Projected, directions: np.ndarray, values: np.ndarray) -> np.ndarray | float:
    """Root mean square of `values` (m, ...) where no hypothesis reaches; 1 with little left."""
    left, size, _ = np.linalg.svd(np.column_stack([seen.basis, directions.T]), full_matrices=True)
    rest = left[:, int((size > 1e-2).sum()) :]
    if rest.shape[1] < LEAST_FREEDOM:
        return 1.0
    return np.sqrt(((rest.T @ values) ** 2).mean(axis=0))


def _one_sided(scores: np.ndarray, sign: np.ndarray) -> np.ndarray:
    return np.where(sign == 0, np.abs(scores), np.maximum(sign * scores, 0.0))


def _without(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    return values - basis @ (basis.T @ values)
