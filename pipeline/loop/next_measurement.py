"""What to measure next: additions ranked by how well they would answer the open question."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp, ndtr

from pipeline.config.experiment import LoadCell
from pipeline.config.measured import MeasuredRow
from pipeline.loop import SURE
from pipeline.loop.attribution import Attribution
from pipeline.loop.data import Data
from pipeline.loop.fit import box
from pipeline.loop.hypotheses import Hypothesis, terms_of
from pipeline.loop.model import Case, Model, Point, Term
from pipeline.loop.rounds import Round

AMPLITUDES = (0.5, 1.0, 2.0)  # of an effect's scale, over which the chance to find it is averaged
WEIGHED, CALIBRATED, LEVELED = 0.03, 0.03, 0.01  # relative errors of direct measurements
SAMPLED = 0.02  # error of a sample's porosity
CONFUSED, LIKELY = 8, 0.01  # hypotheses that are compared, at most; and how probable, at least
WIDEST = 3  # gaps between load cells, and between fill levels, that are looked at
OUTCOMES = 400  # of an addition, drawn for each hypothesis
SHOWN = 8
BLANK = MeasuredRow(None, None, None, "vertical_stress", np.nan, np.nan, np.nan, 1, 0)


@dataclass(frozen=True)
class Addition:
    """More readings: derivatives (reading, unknown + term) over what is new in their errors."""

    what: str
    where: str
    asked: dict[str, Any]
    rows: np.ndarray


@dataclass(frozen=True)
class New:
    """New readings of an experiment; `like` (new, old) says which old ones they resemble.

    Errors of the same load cell and packing scatter are of the old readings' size. They are the
    old ones where `tie` says how much of the scatter is: 1 for all; None: nothing is, for another
    load cell or packing.
    """

    what: str
    where: str
    asked: dict[str, Any]
    like: np.ndarray
    tie: float | None = None
    rows: tuple[MeasuredRow, ...] = ()


def next_measurements(model: Model, data: Data, last: Round) -> list[dict]:
    """All additions that can be asked for, best first.

    Each has `what`, `where` and `expected_gain` to read, and the same for a script: its `kind`,
    and for `repeat` the experiment; for `load_cell` also `x` and `y`, for `fill_level` also
    `fill_height`, in m; for `direct`, of an amplitude by itself, the `effect`, its `key` (None:
    the whole study) and the `std` that it is measured to.

    Where the last round left names open, the gain is the chance that the right one then has a
    posterior of `SURE`, over what may be missing and by how much, as the readings so far have it.
    Else it is the gain in the chance to find an effect, averaged over the catalogue and usual
    amplitudes.
    """
    is_open = last.attribution is not None and max(last.attribution.by_name.values()) < SURE
    compared = _confused(last.attribution) if is_open else _catalogue(last)
    terms = terms_of(compared)
    slopes = np.column_stack([last.seen.slopes[:, last.seen.terms.index(t)] for t in terms])
    old = np.hstack([last.fit.slopes, slopes])[data.use]
    additions = [*_direct(model, last, terms), *_repeats(model, data, last, terms, old)]
    if is_open:
        additions += _simulated(model, data, last, terms, old)
        gain = _Decision(model, last, compared, terms, old)
    else:
        gain = _Detection(model, last, compared, terms, old)
    ranked = []
    for one in additions:
        chance, then = gain(one.rows)
        words = {"what": one.what, "where": one.where, "expected_gain": chance}
        ranked.append((chance, then, words | one.asked))
    ranked.sort(key=lambda one: (-one[0], -one[1]))
    return [document for _, _, document in ranked]


def recommended(ranked: Sequence[dict]) -> list[dict]:
    """The best of them that gain anything."""
    return [one for one in ranked if one["expected_gain"] > 1e-3][:SHOWN]


# ---------------------------------------------------------------------------------------------
# what an addition is worth


def _confused(found: Attribution) -> list[Hypothesis]:
    """The most probable hypotheses; of each name in the 90 % set the best one at least."""
    ordered = [e.hypothesis for e in found.evidence]
    first = [next(h for h in ordered if h.name == name) for name in found.smallest_set]
    likely = [h for h, p in zip(ordered, found.probabilities, strict=True) if p >= LIKELY]
    return list(dict.fromkeys([*first, *likely]))[:CONFUSED]


def _catalogue(last: Round) -> list[Hypothesis]:
    """One hypothesis of each name, the one with the largest signal."""
    best: dict[str, tuple[float, Hypothesis]] = {}
    for h in last.hypotheses:
        if h.kind != "rule":
            size = float((last.seen.of(h) ** 2).sum())
            if size > best.get(h.name, (-1.0, h))[0]:
                best[h.name] = size, h
    return [h for _, h in best.values()]


def _system(model: Model, last: Round, old: np.ndarray) -> np.ndarray:
    """Whitened derivatives (reading and prior, unknown + term)."""
    _, sd, _, _ = box(model, last.fit.point)
    prior = np.zeros((len(sd), old.shape[1]))
    prior[:, : len(sd)] = np.diag(1.0 / sd)
    return np.vstack([last.noise.whitened(old), prior])


class _Decision:
    """Chance that an addition leaves the right name alone, and its mean posterior then.

    Under each hypothesis its amplitudes and the calibrated unknowns are what the readings so far
    leave of their priors, all linear; what an addition will read follows, and from that the
    posterior of every hypothesis.
    """

    def __init__(self, model: Model, last: Round, compared, terms, old: np.ndarray):
        whole = _system(model, last, old)
        center, sd, _, _ = box(model, last.fit.point)
        at = np.array([*last.fit.point.coordinates, *last.fit.point.amplitudes])
        z = np.concatenate([last.noise.whitened(last.fit.residual), (center - at) / sd])
        count = len(sd)
        found = last.attribution
        posterior = {
            e.hypothesis.label: p for e, p in zip(found.evidence, found.probabilities, strict=True)
        }
        self.names = [h.name for h in compared] + [""]
        self.weights = np.array([*(posterior[h.label] for h in compared), found.none])
        self.weights = np.maximum(self.weights / self.weights.sum(), 1e-300)
        self.states = []
        for own in (*(h.terms for h in compared), ()):
            columns = [*range(count), *(count + terms.index(t) for t in own)]
            scale = np.array([t.described.scale for t in own])
            prior = np.hstack([np.zeros((len(own), count)), np.diag(1.0 / scale)])
            system = np.vstack([whole[:, columns], prior])
            covariance = np.linalg.pinv(system.T @ system)
            mean = covariance @ (whole[:, columns].T @ z)
            self.states.append((columns, mean, covariance))

    def __call__(self, rows: np.ndarray) -> tuple[float, float]:
        expected, lower = [], []
        for columns, mean, covariance in self.states:
            part = rows[:, columns]
            expected.append(part @ mean)
            spread = part @ covariance @ part.T + np.eye(len(part))
            lower.append(np.linalg.cholesky(spread))
        normal = np.random.default_rng(0).standard_normal((len(rows), OUTCOMES))
        chance = mean_posterior = 0.0
        for true, weight in enumerate(self.weights[:-1]):
            read = expected[true][:, None] + lower[true] @ normal
            logs = np.array(
                [
                    np.log(w) - np.log(np.diag(factor)).sum() - 0.5 * (off**2).sum(axis=0)
                    for w, center, factor in zip(self.weights, expected, lower, strict=True)
                    for off in [solve_triangular(factor, read - center[:, None], lower=True)]
                ]
            )
            posterior = np.exp(logs - logsumexp(logs, axis=0))
            same = np.array([name == self.names[true] for name in self.names])
            of_name = posterior[same].sum(axis=0)
            best = posterior[true] >= posterior[same].max(axis=0)
            chance += weight * np.mean((of_name >= SURE) & best)
            mean_posterior += weight * np.mean(of_name)
        return float(chance), float(mean_posterior)


class _Detection:
    """Gain in the chance to find an effect, averaged over hypotheses and usual amplitudes."""

    def __init__(self, model: Model, last: Round, compared, terms, old: np.ndarray):
        self.whole = _system(model, last, old)
        self.count = old.shape[1] - len(terms)
        self.threshold = last.gate.threshold
        self.signals = [
            ([terms.index(t) for t in h.terms], [t.described.scale for t in h.terms])
            for h in compared
        ]
        self.before = self._power(self.whole)

    def __call__(self, rows: np.ndarray) -> tuple[float, float]:
        gain = self._power(np.vstack([self.whole, rows])) - self.before
        return gain, gain

    def _power(self, whole: np.ndarray) -> float:
        left = _rest(whole[:, : self.count], whole[:, self.count :])
        amplitudes = np.array(AMPLITUDES)
        sizes = [np.linalg.norm(left[:, columns] @ scale) for columns, scale in self.signals]
        return float(np.mean([ndtr(size * amplitudes - self.threshold).mean() for size in sizes]))


def _rest(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    q, r = np.linalg.qr(basis)
    q = q[:, np.abs(np.diag(r)) > 1e-9 * max(1e-300, np.abs(np.diag(r)).max(initial=0.0))]
    return values - q @ (q.T @ values)


# ---------------------------------------------------------------------------------------------
# what can be added


def _direct(model: Model, last: Round, terms: Sequence[Term]) -> Iterator[Addition]:
    """Inputs and sensors measured by themselves: each bears on its own amplitude alone."""
    count = last.fit.slopes.shape[1]

    def addition(term: Term, what: str, where: str, std: float) -> Addition:
        row = np.zeros((1, count + len(terms)))
        row[0, count + terms.index(term)] = 1.0 / std
        asked = {"kind": "direct", "effect": term.effect, "key": term.key, "std": std}
        return Addition(what, where, asked, row)

    stress = float(np.exp(np.nanmedian(last.fit.expected[model.is_log])))
    for term in terms:
        match term.effect:
            case "density_misdeclared":
                yield addition(term, "weigh the bed (3 %)", f"material {term.key}", WEIGHED)
            case "fill_height_misdeclared":
                where = term.key or "every experiment"
                yield addition(term, "level the surface (1 %)", where, LEVELED)
            case "sensor_gain":
                what = "calibrate the load cell in place (3 %)"
                yield addition(term, what, f"load cell {term.key}", CALIBRATED)
            case "sensor_offset":
                what = "read the load cell unloaded (3 % of the median stress)"
                yield addition(term, what, f"load cell {term.key}", CALIBRATED * stress)
            case "loosening_density":
                what = "weigh a sample of the movement zone (porosity to 0.02)"
                yield addition(term, what, "movement zone", SAMPLED)


def _repeats(model, data: Data, last: Round, terms, old) -> Iterator[Addition]:
    """Another packing of an experiment, read as before; what was wrong with one filling is not."""
    of_one_filling = len(last.fit.point.coordinates) + np.flatnonzero(
        [t.scope == "experiment" for t in (*last.fit.point.terms, *terms)]
    )
    for case in model.active:
        like = np.eye(len(data.use))[model.case_of[data.use] == case]
        name = model.cases[case].experiment.name
        asked = {"kind": "repeat", "experiment": name}
        slopes = like @ old
        slopes[:, of_one_filling] = 0.0
        yield _addition(New("repeat the experiment", name, asked, like), slopes, last, old)


def _simulated(model: Model, data: Data, last: Round, terms, old) -> Iterator[Addition]:
    """Load cells between those there are, and fill levels between those that were read."""
    for case in model.active:
        subject = model.cases[case]
        places = {
            (row.load_cell, row.fill_height, row.mass_drawn): place
            for place, row in enumerate(model.rows[i] for i in data.use)
            if model.case_of[data.use[place]] == case and row.quantity == "vertical_stress"
        }
        cells, new = _new_cells(subject, places, len(data.use))
        new += _new_levels(subject, places, last.noise.parts[0])
        if not new:
            continue
        grown = subject.experiment.model_copy(
            update={"load_cells": (*subject.experiment.load_cells, *cells)}
        )
        rows = tuple(row for one in new for row in one.rows)
        extended = Case(grown.at(subject.experiment.path), rows, subject.declared)
        slopes = _slopes_of_one_case(model, case, extended, last.fit.point, terms)
        for one in new:
            own, slopes = slopes[: len(one.rows)], slopes[len(one.rows) :]
            yield _addition(one, own, last, old)


def _addition(one: New, slopes: np.ndarray, last: Round, old: np.ndarray) -> Addition:
    """The new readings, less what the old ones say of their errors, over the rest of these."""
    noise, like = last.noise, one.like
    pairs = zip(noise.factors, noise.parts, strict=True)
    scatter, shared, independent = (factor * part for factor, part in pairs)
    own = like @ (scatter + shared) @ like.T + np.diag(like @ np.diag(independent))
    if one.tie is not None:
        kept = one.tie**2 * like @ scatter @ like.T
        other = np.diag(like @ np.diag(scatter) - np.diag(kept))
        own += kept + other - like @ scatter @ like.T
        common = noise.whitened((one.tie * scatter + shared) @ like.T)
        own -= common.T @ common
        slopes = slopes - common.T @ noise.whitened(old)
    lower = np.linalg.cholesky(own)
    rows = solve_triangular(lower, slopes, lower=True)
    return Addition(one.what, one.where, one.asked, rows)


def _new_cells(case: Case, places, count: int) -> tuple[list[LoadCell], list[New]]:
    """A load cell in the widest gaps between two in a row, read whenever their first one was."""
    experiment, cells, found = case.experiment, [], []
    ordered = sorted(experiment.load_cells, key=lambda c: (c.y, c.x))
    gaps = [(a, b) for a, b in pairwise(ordered) if a.y == b.y]
    for a, b in sorted(gaps, key=lambda gap: gap[0].x - gap[1].x)[:WIDEST]:
        read = [place for place in places if place[0] == a.name]
        if not read:
            continue
        x = round((a.x + b.x) / 2, 6)
        cell = LoadCell(name=f"new_{len(cells)}", x=x, y=a.y, width=a.width, length=a.length)
        rows = tuple(
            replace(BLANK, load_cell=cell.name, fill_height=h, mass_drawn=m) for _, h, m in read
        )
        like = np.eye(count)[[places[place] for place in read]]
        asked = {"kind": "load_cell", "experiment": experiment.name, "x": x, "y": a.y}
        where = f"{experiment.name}: x = {x:.3g} m, y = {a.y:.3g} m"
        cells.append(cell)
        found.append(New("add a load cell", where, asked, like, rows=rows))
    return cells, found


def _new_levels(case: Case, places, scatter: np.ndarray) -> list[New]:
    """All that is read, once more in the widest gaps between fill levels, or below the lowest."""
    experiment = case.experiment
    if experiment.is_draw:
        return []
    full = experiment.geometry.height
    read: dict[str | None, dict[float, int]] = {}
    for (cell, height, _), place in places.items():
        read.setdefault(cell, {})[height or full] = place
    levels = sorted({height for of_cell in read.values() for height in of_cell})
    gaps = sorted(pairwise([0.0, *levels]), key=lambda gap: gap[0] - gap[1])
    found = []
    for low, high in gaps[:WIDEST]:
        level = round((low + high) / 2, 4)
        near = {cell: [at[h] for h in (low, high) if h in at] for cell, at in read.items()}
        near = {cell: old for cell, old in near.items() if old}
        rows = tuple(replace(BLANK, load_cell=cell, fill_height=level) for cell in near)
        like = np.array([np.eye(len(scatter))[old].mean(axis=0) for old in near.values()])
        tie = 1.0 if low > 0.0 else _correlation(scatter, read.values(), levels[:2])
        asked = {"kind": "fill_level", "experiment": experiment.name, "fill_height": level}
        where = f"{experiment.name}: {level:.4g} m"
        found.append(New("read at one more fill level", where, asked, like, tie, rows))
    return found


def _correlation(scatter: np.ndarray, read: Iterable[dict[float, int]], levels) -> float:
    """Mean correlation of the packing scatter at two fill levels; 0 where no cell read both.

    What does not scatter has none.
    """
    pairs = [[at[h] for h in levels] for at in read if all(h in at for h in levels)]
    sizes = np.sqrt(np.diag(scatter))
    found = [
        scatter[a, b] / (sizes[a] * sizes[b])
        for a, b in (pair for pair in pairs if len(pair) == 2)
        if sizes[a] * sizes[b] > 0.0
    ]
    return float(np.clip(np.mean(found), 0.0, 1.0)) if found else 0.0


def _slopes_of_one_case(model: Model, case: int, extended: Case, point: Point, terms) -> np.ndarray:
    """Derivatives (reading, unknown + term) of a case's new rows."""
    parameters, _ = model.at(point, case)
    alone = Model((replace(extended, declared=parameters),), model.shared, model.execution)
    local = {term: replace(term, cases=(0,)) for term in (*point.terms, *terms)}
    here = [(t, a) for t, a in zip(point.terms, point.amplitudes, strict=True) if case in t.cases]
    start = alone.start.with_terms([local[t] for t, _ in here], [a for _, a in here])
    wanted = [t for t in (*point.terms, *terms) if case in t.cases]
    of_coordinates, of_terms = alone.jacobian(start, [local[t] for t in wanted])
    names = [c.name for c in alone.coordinates]
    columns = [
        of_coordinates[:, names.index(c.name)] if case in c.cases else np.zeros(len(alone.rows))
        for c in model.coordinates
    ]
    columns += [
        of_terms[:, wanted.index(t)] if t in wanted else np.zeros(len(alone.rows))
        for t in (*point.terms, *terms)
    ]
    return np.column_stack(columns)
