"""What is missing: the evidence of each hypothesis, refitted for the best few."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from pipeline.loop import SURE
from pipeline.loop.covariance import Noise
from pipeline.loop.data import Data
from pipeline.loop.fit import Fit, fit
from pipeline.loop.gate import Projected, projected
from pipeline.loop.hypotheses import PRIOR, Hypothesis
from pipeline.loop.model import Model, Point, limits

REFITTED = 5  # hypotheses that are refitted, at most
WORTH = 7.0  # difference of log posterior from the best beyond which none is refitted
# width in its scale τ and share of the normal priors that an amplitude's prior is a mix of: many τ
# are then less likely than one by a power, not by an exponential
WIDTHS = {1.0: 1 / 2, 2.0: 1 / 4, 4.0: 1 / 8, 8.0: 1 / 16, 16.0: 1 / 16}


@dataclass(frozen=True)
class Evidence:
    """Log evidence of a hypothesis against the model without it, and its refit where made."""

    hypothesis: Hypothesis
    log_evidence: float
    refit: Fit | None

    @property
    def log_posterior(self) -> float:
        """Not normalized."""
        return self.log_evidence + math.log(self.hypothesis.prior)


@dataclass(frozen=True)
class Attribution:
    """Posterior over hypotheses, best first, and of nothing missing."""

    evidence: tuple[Evidence, ...]
    probabilities: np.ndarray
    none: float

    @property
    def by_name(self) -> dict[str, float]:
        """Probability of each name, largest first."""
        sums: dict[str, float] = {}
        for one, probability in zip(self.evidence, self.probabilities, strict=True):
            sums[one.hypothesis.name] = sums.get(one.hypothesis.name, 0.0) + float(probability)
        return dict(sorted(sums.items(), key=lambda item: -item[1]))

    @property
    def smallest_set(self) -> list[str]:
        """Fewest names that hold 90 % of what is not none, largest first."""
        names, total = [], 0.0
        whole = sum(self.by_name.values())
        for name, probability in self.by_name.items():
            names.append(name)
            total += probability
            if total >= SURE * whole:
                break
        return names

    @property
    def best(self) -> Evidence:
        """Most probable hypothesis of the most probable name, refitted where any of them is."""
        name = next(iter(self.by_name))
        own = [e for e in self.evidence if e.hypothesis.name == name]
        return next((e for e in own if e.refit is not None), own[0])


def attribute(
    model: Model,
    data: Data,
    noise: Noise,
    found: Fit,
    seen: Projected,
    hypotheses: Sequence[Hypothesis],
    inflation: float,
) -> Attribution:
    """Evidence of one more hypothesis: linear for all, refitted where it matters.

    `inflation` is the null variance of scores: χ² counts by as much less.
    """
    tested = [h for h in hypotheses if np.any(seen.of(h))]
    linear = [Evidence(h, _best_way(seen, h, inflation)[0], None) for h in tested]
    ranked = sorted(linear, key=lambda e: -e.log_posterior)
    refitted: list[Evidence] = []
    for one in ranked[: 2 * REFITTED]:
        best = max((e.log_posterior for e in refitted), default=-math.inf)
        if len(refitted) >= REFITTED or one.log_posterior < best - WORTH:
            continue
        refitted.append(_refitted(model, data, noise, found, seen, one.hypothesis, inflation))
    known = {e.hypothesis.label: e for e in refitted}
    evidence = [known.get(e.hypothesis.label, e) for e in linear]
    evidence.sort(key=lambda e: -e.log_posterior)
    logs = np.array([math.log(PRIOR["none"]), *(e.log_posterior for e in evidence)])
    probabilities = np.exp(logs - logsumexp(logs))
    return Attribution(tuple(evidence), probabilities[1:], float(probabilities[0]))


def _best_way(seen: Projected, hypothesis: Hypothesis, inflation: float) -> tuple[float, int]:
    """Log evidence of the better of a hypothesis' ways, and which it is."""
    ways = seen.ways(hypothesis)
    return max((_log_evidence(way, seen.z, hypothesis, inflation), i) for i, way in enumerate(ways))


def _log_evidence(columns, z, hypothesis: Hypothesis, inflation: float) -> float:
    """Closed form for a ~ N(0, τ²), half-normal where physics fixes the side; all `WIDTHS` of τ."""
    logs = [_posterior(columns, z, hypothesis, inflation, width)[1] for width in WIDTHS]
    return _over_widths(logs)


def _over_widths(logs: Sequence[float]) -> float:
    """Log evidence under the mix of priors, from that under each."""
    return float(logsumexp(np.array(logs) + np.log(list(WIDTHS.values()))))


def _posterior(columns, z, hypothesis, inflation, width=1.0) -> tuple[np.ndarray, float]:
    """Amplitudes (term) at their posterior mean, wrong sides at 0, and the log evidence."""
    tau = width * np.array([term.described.scale for term in hypothesis.terms])
    sign = np.array([term.described.sign for term in hypothesis.terms])
    scaled = columns * tau / math.sqrt(inflation)
    z = z / math.sqrt(inflation)
    used = np.ones(len(tau), dtype=bool)
    while True:
        part = scaled[:, used]
        precision = np.eye(part.shape[1]) + part.T @ part
        mean = np.linalg.solve(precision, part.T @ z)
        wrong = sign[used] * mean < 0
        if not wrong.any() or len(tau) == 1:
            break
        used[np.flatnonzero(used)[wrong]] = False
    log_evidence = 0.5 * mean @ (part.T @ z) - 0.5 * np.linalg.slogdet(precision)[1]
    sd = np.sqrt(np.diag(np.linalg.inv(precision)))
    one_sided = sign[used] != 0
    log_evidence += np.sum(log_ndtr((sign[used] * mean / sd)[one_sided]) + math.log(2.0))
    amplitudes = np.zeros(len(tau))
    amplitudes[used] = mean * tau[used]
    amplitudes[sign * amplitudes < 0] = 0.0
    return amplitudes, float(log_evidence)


def _refitted(model, data, noise, found, seen, hypothesis, inflation) -> Evidence:
    """Laplace's approximation at the refitted amplitudes."""
    terms = hypothesis.terms
    way = _best_way(seen, hypothesis, inflation)[1]
    width = max(WIDTHS) if way else 1.0
    columns = seen.ways(hypothesis)[way]
    amplitudes, _ = _posterior(columns, seen.z, hypothesis, inflation, width)
    start = [t.described.neutral + a for t, a in zip(terms, amplitudes, strict=True)]
    bounds = [limits(term) for term in terms]
    start = [min(max(a, low), high) for a, (low, high) in zip(start, bounds, strict=True)]
    slopes = None if way else np.hstack([found.slopes, seen.slopes_of(hypothesis)])
    refit = fit(model, data, noise, found.point.with_terms(terms, start), found.reference, slopes)
    added = len(terms)
    whole = projected(model, data, noise, _first(refit, added), terms, refit.slopes[:, -added:])
    neutral = np.array([term.described.neutral for term in terms])
    amplitude = np.array(refit.point.amplitudes[-added:]) - neutral
    log_evidence = 0.5 * (found.cost - refit.cost) / inflation
    log_evidence -= _surprise(refit.point, added) - _surprise(found.point, 0)
    columns = whole.columns / math.sqrt(inflation)
    log_evidence += _over_widths([_of_prior(terms, amplitude, columns, w) for w in WIDTHS])
    return Evidence(hypothesis, float(log_evidence), refit)


def _of_prior(terms, amplitude: np.ndarray, columns: np.ndarray, width: float) -> float:
    """What the prior makes of the evidence for amplitudes (term), one of `WIDTHS`."""
    tau = width * np.array([term.described.scale for term in terms])
    scaled = columns * tau
    information = scaled.T @ scaled  # of amplitudes in units of τ
    one = np.eye(len(tau))
    spread = one + np.linalg.pinv(information)
    part = -0.5 * (amplitude / tau) @ np.linalg.solve(spread, amplitude / tau)
    part -= 0.5 * np.linalg.slogdet(one + information)[1]
    sd = np.sqrt(np.diag(np.linalg.inv(one + information))) * tau
    for term, a, s in zip(terms, amplitude, sd, strict=True):
        if sign := term.described.sign:
            part += float(log_ndtr(sign * a / s)) + math.log(2.0)
    return float(part)


def _surprise(point: Point, added: int) -> float:
    """Half the sum of squares, in their priors' sd, of the amplitudes that were there before."""
    count = len(point.terms) - added
    pairs = zip(point.terms[:count], point.amplitudes[:count], strict=True)
    return 0.5 * sum(((a - t.described.neutral) / t.described.scale) ** 2 for t, a in pairs)


def _first(found: Fit, added: int) -> Fit:
    """A fit as if its last terms were not unknowns."""
    point = found.point
    shorter = Point(point.coordinates, point.terms[:-added], point.amplitudes[:-added])
    return replace(found, point=shorter, slopes=found.slopes[:, :-added])
