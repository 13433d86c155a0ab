"""What to measure next: additions ranked by how well they would answer the open question."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import ndtr

from pipeline.config.experiment import LoadCell
from pipeline.config.measured import MeasuredRow
from pipeline.loop.data import Data
from pipeline.loop.fit import box
from pipeline.loop.hypotheses import Hypothesis, terms_of
from pipeline.loop.model import Case, Model, Point, Term
from pipeline.loop.rounds import Round

AMPLITUDES = (0.5, 1.0, 2.0)  # of an effect's scale, over which the expected gain is averaged
WEIGHED, CALIBRATED, LEVELED = 0.03, 0.03, 0.01  # relative errors of direct measurements
SAMPLED = 0.02  # error of a sample's porosity
CONFUSED = 6  # hypotheses that are compared, at most
SHOWN = 8


@dataclass(frozen=True)
class Addition:
    """More readings: derivatives (reading, unknown + term) over their standard deviations."""

    what: str
    where: str
    rows: np.ndarray
    asked: dict[str, Any]


def next_measurements(model: Model, data: Data, last: Round, threshold: float) -> list[dict]:
    """All additions that can be asked for, best first.

    Each has `what`, `where` and `expected_gain` to read, and the same for a script: its `kind`,
    and for `repeat` the experiment; for `load_cell` also `x` and `y`, for `fill_level` also
    `fill_height`, in m; for `direct`, of an amplitude by itself, the `effect`, its `key` (None:
    the whole study) and the `std` that it is measured to.

    With several names left in the 90 % set the gain is in the chance to tell any two of them
    apart; else in the chance to find an effect, averaged over the catalogue. Amplitudes are
    averaged over the prior, not taken from the fit.
    """
    open_set = _open(last)
    compared = open_set if len({h.name for h in open_set}) > 1 else _catalogue(last)
    terms = terms_of(compared)
    base = _system(model, data, last, terms)
    before = _power(base, compared, terms, model, last, threshold, open_set)
    additions = [*_direct(model, last, terms), *_repeats(model, data, last, terms, base)]
    if len({h.name for h in open_set}) > 1:
        additions += _simulated(model, data, last, terms)
    ranked = []
    for one in additions:
        whole = np.vstack([base, one.rows])
        gain = _power(whole, compared, terms, model, last, threshold, open_set) - before
        words = {"what": one.what, "where": one.where, "expected_gain": float(gain)}
        ranked.append(words | one.asked)
    return sorted(ranked, key=lambda r: -r["expected_gain"])


def recommended(ranked: Sequence[dict]) -> list[dict]:
    """The best of them that gain anything."""
    return [one for one in ranked if one["expected_gain"] > 1e-3][:SHOWN]


def _open(last: Round) -> list[Hypothesis]:
    if last.attribution is None:
        return []
    names = last.attribution.smallest_set
    best: dict[str, Hypothesis] = {}
    for evidence in last.attribution.evidence:
        if evidence.hypothesis.name in names:
            best.setdefault(evidence.hypothesis.name, evidence.hypothesis)
    return list(best.values())[:CONFUSED]


def _catalogue(last: Round) -> list[Hypothesis]:
    """One hypothesis of each name, the one with the largest signal."""
    best: dict[str, tuple[float, Hypothesis]] = {}
    for h in last.hypotheses:
        if h.kind != "rule":
            size = float((last.seen.of(h) ** 2).sum())
            if size > best.get(h.name, (-1.0, h))[0]:
                best[h.name] = size, h
    return [h for _, h in best.values()]


def _system(model: Model, data: Data, last: Round, terms: Sequence[Term]) -> np.ndarray:
    """Whitened derivatives (reading and prior, unknown + term)."""
    noise = last.noise
    _, sd, _, _ = box(model, last.fit.point)
    slopes = np.column_stack([last.seen.slopes[:, last.seen.terms.index(t)] for t in terms])
    top = noise.whitened(np.hstack([last.fit.slopes, slopes])[data.use])
    return np.vstack([top, np.hstack([np.diag(1.0 / sd), np.zeros((len(sd), len(terms)))])])


def _power(whole, compared, terms, model, last, threshold, open_set) -> float:
    """Chance of the right answer, averaged over hypotheses and amplitudes."""
    count = whole.shape[1] - len(terms)
    left = _rest(whole[:, :count], whole[:, count:])
    scale = np.array([t.described.scale for t in terms])
    signal = {
        h.label: left[:, [terms.index(t) for t in h.terms]]
        @ scale[[terms.index(t) for t in h.terms]]
        for h in compared
    }
    amplitudes = np.array(AMPLITUDES)
    if len({h.name for h in open_set}) > 1:
        chances = []
        for a in compared:
            distance = min(
                np.linalg.norm(_rest(signal[b.label][:, None], signal[a.label][:, None]))
                for b in compared
                if b.name != a.name
            )
            chances.append(ndtr(0.5 * distance * amplitudes).mean())
        return float(np.mean(chances))
    sizes = [np.linalg.norm(s) for s in signal.values()]
    return float(np.mean([ndtr(size * amplitudes - threshold).mean() for size in sizes]))


def _rest(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    q, r = np.linalg.qr(basis)
    q = q[:, np.abs(np.diag(r)) > 1e-9 * max(1e-300, np.abs(np.diag(r)).max(initial=0.0))]
    return values - q @ (q.T @ values)


def _direct(model: Model, last: Round, terms: Sequence[Term]) -> Iterator[Addition]:
    """Inputs and sensors measured by themselves: each bears on its own amplitude alone."""
    count = last.fit.slopes.shape[1]

    def addition(term: Term, what: str, where: str, std: float) -> Addition:
        row = np.zeros((1, count + len(terms)))
        row[0, count + terms.index(term)] = 1.0 / std
        asked = {"kind": "direct", "effect": term.effect, "key": term.key, "std": std}
        return Addition(what, where, row, asked)

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


def _repeats(model, data: Data, last: Round, terms, base) -> Iterator[Addition]:
    """Another packing of an experiment, read as before; what was wrong with one filling is not."""
    noise = last.noise
    of_one_filling = len(last.fit.point.coordinates) + np.flatnonzero(
        [t.scope == "experiment" for t in (*last.fit.point.terms, *terms)]
    )
    slopes = np.column_stack([last.seen.slopes[:, last.seen.terms.index(t)] for t in terms])
    whole = np.hstack([last.fit.slopes, slopes])[data.use]
    for case in model.active:
        places = np.flatnonzero(model.case_of[data.use] == case)
        block = noise.covariance[np.ix_(places, places)]
        rows = np.linalg.solve(np.linalg.cholesky(block), whole[places])
        rows[:, of_one_filling] = 0.0
        name = model.cases[case].experiment.name
        yield Addition("repeat the experiment", name, rows, {"kind": "repeat", "experiment": name})


def _simulated(model: Model, data: Data, last: Round, terms) -> Iterator[Addition]:
    """Load cells between those there are, and fill levels between those that were read."""
    instrument = float(np.median(data.independent + np.diag(data.shared)))
    for case in model.active:
        for what, where, asked, extended in _extensions(model.cases[case]):
            slopes, scatter = _of_one_case(model, case, extended, last.fit.point, terms)
            rows = slopes / np.sqrt(scatter + instrument)[:, None]
            name = model.cases[case].experiment.name
            yield Addition(what, f"{name}: {where}", rows, asked | {"experiment": name})


def _extensions(case: Case) -> Iterator[tuple[str, str, dict[str, Any], Case]]:
    """The case read at one more place, or at one more fill level."""
    experiment = case.experiment
    blank = MeasuredRow(None, None, None, "vertical_stress", np.nan, np.nan, np.nan, 1, 0)
    cells = sorted(experiment.load_cells, key=lambda c: (c.x, c.y))
    gaps = [(b.x - a.x, a, b) for a, b in pairwise(cells) if b.x > a.x]
    if gaps:
        _, a, b = max(gaps, key=lambda gap: gap[0])
        new = LoadCell(name="new", x=(a.x + b.x) / 2, y=a.y, width=a.width, length=a.length)
        cells = (*experiment.load_cells, new)
        grown = experiment.model_copy(update={"load_cells": cells}).at(experiment.path)
        times = {(row.mass_drawn, row.fill_height) for row in case.rows}
        rows = [replace(blank, load_cell="new", mass_drawn=m, fill_height=h) for m, h in times]
        where = f"x = {new.x:.3g} m, y = {new.y:.3g} m"
        asked = {"kind": "load_cell", "x": new.x, "y": new.y}
        yield "add a load cell", where, asked, Case(grown, tuple(rows), case.declared)
    if not experiment.is_draw:
        levels = sorted({row.fill_height or experiment.geometry.height for row in case.rows})
        low = round(levels[0] / 2 if len(levels) < 2 else (levels[0] + levels[1]) / 2, 4)
        names = sorted({row.load_cell for row in case.rows}, key=str)
        rows = [replace(blank, load_cell=name, fill_height=low) for name in names]
        what, where = "read at one more fill level", f"{low:.4g} m"
        asked = {"kind": "fill_level", "fill_height": low}
        yield what, where, asked, Case(experiment, tuple(rows), case.declared)


def _of_one_case(model: Model, case: int, extended: Case, point: Point, terms):
    """Derivatives (reading, unknown + term) of a case's new rows, and their scatter's variance."""
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
    scatter = alone.scatter(start, 0, alone.common(0)).var(axis=0, ddof=1)
    return np.column_stack(columns), scatter
