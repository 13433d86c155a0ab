"""The loop on one set of readings: calibrate, test, attribute, add, again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import expit

from pipeline.config.study import Study
from pipeline.loop import SURE
from pipeline.loop.attribution import Attribution, Evidence, attribute
from pipeline.loop.covariance import Noise, restricted_likelihood_factors
from pipeline.loop.data import Data
from pipeline.loop.fit import Fit, calibrated, fit, posterior_covariance
from pipeline.loop.gate import Gate, Projected, lack_of_fit, projected
from pipeline.loop.hypotheses import Hypothesis, catalogue, rules, terms_of
from pipeline.loop.local_rules import rule_slopes
from pipeline.loop.model import Model, Point, Term, has_chord
from pipeline.montecarlo.streams import LOOP_NULL, random_stream

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    fit, noise : the model so far, and the covariance at it
    hypotheses : what might be missing
    seen : residual and derivatives, whitened and projected
    gate : whether anything is missing
    attribution : what, if so
    freedom : degrees of freedom beyond all hypotheses
    """

    fit: Fit
    noise: Noise
    hypotheses: tuple[Hypothesis, ...]
    seen: Projected
    gate: Gate
    attribution: Attribution | None
    freedom: int


@dataclass(frozen=True)
class Outcome:
    """What the loop did: its rounds, and the hypotheses that it added.

    `sure` has for each of these the probability of its keys: its name's posterior, and where
    several keys were added at once times that of the key, whose odds were even. `dropped` are
    labels of those that the backward check took out again.
    """

    rounds: tuple[Round, ...]
    added: tuple[Evidence, ...]
    sure: tuple[dict[str | None, float], ...]
    dropped: tuple[str, ...]
    verdict: str

    @property
    def fit(self) -> Fit:
        """The final model."""
        return self.rounds[-1].fit


def close(
    study: Study, model: Model, data: Data, begin: tuple[Fit, Noise] | None = None
) -> Outcome:
    """Run the loop on `data`, from a calibrated baseline where there is one already."""
    model = model.only(data.use)
    rounds: list[Round] = []
    added: list[Evidence] = []
    sure: list[dict[str | None, float]] = []
    dropped: list[str] = []
    found, here = begin or calibrated(model, data, model.start)
    while True:
        alpha = study.alpha * 0.5 ** len(rounds)
        one = turn(study, model, data, found, here, alpha, len(rounds))
        rounds.append(one)
        _log(study, one)
        if one.attribution is None or len(added) >= study.max_effects:
            break
        if len(rounds) > 2 * study.max_effects:  # what is taken out may come back, not for ever
            break
        named = one.attribution.best
        probability = one.attribution.by_name[named.hypothesis.name]
        if probability < SURE or named.refit is None or not one.gate.points_somewhere:
            break
        factors = one.noise.factors
        found, here = calibrated(model, data, named.refit.point, factors, settled=True)
        covariance = posterior_covariance(model, data, found, here)
        if idle := _idle(named.hypothesis, found, covariance):
            named = replace(named, hypothesis=named.hypothesis.without(idle))
            found, here = calibrated(model, data, found.point.without(idle), factors, settled=True)
            covariance = posterior_covariance(model, data, found, here)
        added.append(named)
        sure.append(_of_keys(probability, named.hypothesis, found, covariance))
        for number in _spoken_for_no_more(found, covariance, added):
            dropped.append(added[number].hypothesis.label)
            terms = added.pop(number).hypothesis.terms
            sure.pop(number)
            found, here = calibrated(model, data, found.point.without(terms), factors)
    verdict = _verdict(rounds[-1], added)
    return Outcome(tuple(rounds), tuple(added), tuple(sure), tuple(dropped), verdict)


def _idle(hypothesis: Hypothesis, found: Fit, covariance: np.ndarray) -> list[Term]:
    """Terms of the keys of an addition that have no evidence of their own; [] if none has."""
    own = _own_evidence(hypothesis, found, covariance)
    idle = [key for key, evidence in own.items() if evidence < 0.0]
    return [t for t in hypothesis.terms if t.key in idle] if len(idle) < len(own) else []


def _of_keys(probability: float, hypothesis: Hypothesis, found: Fit, covariance: np.ndarray):
    """Probability of each key of an addition whose name has `probability`, see `Outcome`."""
    own = _own_evidence(hypothesis, found, covariance)
    if len(own) == 1:
        return dict.fromkeys(own, probability)
    return {key: probability * float(expit(evidence)) for key, evidence in own.items()}


def _own_evidence(hypothesis: Hypothesis, found: Fit, covariance: np.ndarray):
    """Log evidence by key of a hypothesis, given its other keys."""
    keys: dict[str | None, list[Term]] = {}
    for term in hypothesis.terms:
        keys.setdefault(term.key, []).append(term)
    return {key: _log_evidence(terms, found, covariance) for key, terms in keys.items()}


def _spoken_for_no_more(found: Fit, covariance: np.ndarray, added: Sequence[Evidence]) -> list[int]:
    """Numbers of earlier additions, last first, whose evidence later ones have taken away."""
    left = (_log_evidence(one.hypothesis.terms, found, covariance) for one in added[:-1])
    return [number for number, evidence in enumerate(left) if evidence < 0.0][::-1]


def _log_evidence(terms: Sequence[Term], found: Fit, covariance: np.ndarray) -> float:
    """Log evidence for terms of a fit against the fit without them, by Laplace's approximation.

    `covariance` (unknown, unknown) is `posterior_covariance`.
    """
    places = [found.point.terms.index(term) for term in terms]
    tau = np.array([term.described.scale for term in terms])
    neutral = np.array([term.described.neutral for term in terms])
    a = (np.array(found.point.amplitudes)[places] - neutral) / tau
    at = np.array(places) + len(found.point.coordinates)
    information = np.linalg.pinv(covariance[np.ix_(at, at)] / np.outer(tau, tau))
    occam = 0.5 * np.linalg.slogdet(np.eye(len(a)) + information)[1]
    return float(0.5 * a @ information @ a - occam)


def turn(
    study: Study, model: Model, data: Data, found: Fit, noise: Noise, alpha: float, number: int
) -> Round:
    """One round at a calibrated model: derivatives, noise, gate, attribution."""
    hypotheses = [*catalogue(study, model, data.use), *rules(study, model)]
    ruled = any(t.effect == "local_rule" for t in found.point.terms)
    hypotheses = [
        h
        for h in hypotheses
        if not any(_is_there(t, found.point) for t in h.terms) and not (ruled and h.kind == "rule")
    ]
    by_effect = [h for h in hypotheses if h.kind != "rule"]
    by_rule = [h for h in hypotheses if h.kind == "rule"]
    terms = terms_of(by_effect)
    slopes = _by_key(terms, lambda single: model.jacobian(found.point, single)[1])
    if by_rule:
        slopes = np.hstack([slopes, rule_slopes(model, found.point, by_rule)])
        terms = [*terms, *terms_of(by_rule)]
    far = [i for i, term in enumerate(terms) if has_chord(term)]
    chords = slopes.copy()
    chords[:, far] = _by_key([terms[i] for i in far], partial(model.chords, found.point))
    declared = noise.scaled((1.0, 1.0, 1.0))
    explained = np.hstack([found.slopes, slopes])[data.use]
    factors, freedom = restricted_likelihood_factors(declared, found.residual, explained)
    noise = declared.scaled(factors)
    found = fit(model, data, noise, found.point, found.reference, found.slopes)
    seen = projected(model, data, noise, found, terms, slopes, chords)
    random = random_stream(0, study.name, LOOP_NULL, number)
    gate = lack_of_fit(seen, noise, hypotheses, alpha, random)
    found_out = None
    if gate.rejected and gate.labels:
        inflation = max(1.0, float(np.mean(gate.inflation)))
        found_out = attribute(model, data, noise, found, seen, hypotheses, inflation)
    return Round(found, noise, tuple(hypotheses), seen, gate, found_out, freedom)


def _is_there(term: Term, point: Point) -> bool:
    """Whether a term of the point sets the same value somewhere."""
    return any(
        (term.effect, term.parameter, term.options) == (one.effect, one.parameter, one.options)
        and set(term.cases) & set(one.cases)
        and (one.scope != "load_cell" or term.key == one.key)
        for one in point.terms
    )


def _by_key(terms: Sequence[Term], columns: Callable[[Sequence[Term]], np.ndarray]) -> np.ndarray:
    """Columns (row, term) of all terms; a value that keys share moves what they move together."""
    keys: dict[tuple[str, str], list[Term]] = {}
    for term in terms:
        if term.key is not None:
            keys.setdefault((term.effect, term.parameter), []).append(term)
    single = [t for t in terms if t.key is not None or (t.effect, t.parameter) not in keys]
    found = columns(single)
    column = dict(zip(single, found.T, strict=True))
    for term in terms:
        if term not in column:
            column[term] = sum(column[t] for t in keys[term.effect, term.parameter])
    return np.column_stack([column[t] for t in terms]) if terms else found


def _verdict(last: Round, added: Sequence[Evidence]) -> str:
    if added:
        only_rules = all(e.hypothesis.kind == "rule" for e in added)
        return "unknown_effect" if only_rules else "effect"
    if not last.gate.rejected:
        return "no_effect_detectable"
    return "ambiguous" if last.gate.points_somewhere else "unexplained"


def _log(study: Study, one: Round) -> None:
    gate = one.gate
    best = gate.labels[int(np.argmax(gate.scores))] if gate.labels else "nothing"
    log.info(
        "%s: %d terms; p = %.4g (alpha %.3g), largest score %.2f of %s, omnibus p %.3g; factors %s",
        study.name,
        len(one.fit.point.terms),
        gate.p_value,
        gate.alpha,
        gate.statistic,
        best,
        gate.omnibus_p_value,
        [round(f, 2) for f in one.noise.factors],
    )
    if one.attribution:
        log.info(
            "%s: %s",
            study.name,
            {n: round(p, 3) for n, p in list(one.attribution.by_name.items())[:5]},
        )
