"""What an addition is worth, against the whole covariance and on questions with known answers."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.loop import next_measurement
from pipeline.loop.attribution import Attribution, Evidence
from pipeline.loop.covariance import Noise
from pipeline.loop.hypotheses import Hypothesis
from pipeline.loop.model import Term
from pipeline.loop.next_measurement import New, _addition, _correlation, _Decision, recommended

ONE = Term("density_misdeclared", "factor", "material", "sand", (0,))
OTHER = Term("sensor_gain", "gain", "load_cell", "C1", (0,))


@pytest.fixture
def last():
    """A round with four readings, of two load cells at two levels, and one calibrated unknown."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4))
    cells = np.array([0, 0, 1, 1])
    parts = (root @ root.T, 0.5 * (cells[:, None] == cells), np.diag(rng.uniform(0.1, 0.3, 4)))
    factors = (1.3, 0.8, 1.1)
    whole = sum(f * part for f, part in zip(factors, parts, strict=True))
    noise = Noise(parts, factors, np.linalg.cholesky(whole), ())
    return SimpleNamespace(noise=noise)


@pytest.mark.parametrize("tie", [None, 0.0, 0.6, 1.0])
def test_an_addition_adds_what_the_whole_covariance_says(last, tie):
    rng = np.random.default_rng(4)
    old, new = rng.normal(size=(4, 3)), rng.normal(size=(2, 3))
    like = np.array([[0.5, 0.5, 0.0, 0.0], [0.0, 0.0, 0.5, 0.5]])
    pairs = zip(last.noise.factors, last.noise.parts, strict=True)
    scatter, shared, independent = (f * part for f, part in pairs)
    between = (tie or 0.0) * like @ scatter + (0.0 if tie is None else like @ shared)
    if tie is None:
        own = like @ (scatter + shared) @ like.T
    else:
        kept = tie**2 * like @ scatter @ like.T
        own = kept + np.diag(like @ np.diag(scatter) - np.diag(kept)) + like @ shared @ like.T
    own = own + np.diag(like @ np.diag(independent))
    whole = np.block([[last.noise.covariance, between.T], [between, own]])
    both = np.vstack([old, new])
    expected = both.T @ np.linalg.solve(whole, both)
    before = old.T @ np.linalg.solve(last.noise.covariance, old)
    rows = _addition(New("", "", {}, like, tie), new, last, old).rows
    np.testing.assert_allclose(before + rows.T @ rows, expected, rtol=1e-9)


def decision(monkeypatch, signal, probabilities=(0.5, 0.5)):
    """Two names that the old reading cannot tell apart, whose amplitude is about `signal`."""
    monkeypatch.setattr(
        next_measurement, "box", lambda *_: (np.zeros(1), np.full(1, 0.1), None, None)
    )
    one, other = (
        Hypothesis(term.effect, "physics", "study", None, (term,), 0.1) for term in (ONE, OTHER)
    )
    evidence = (Evidence(one, 0.0, None), Evidence(other, 0.0, None))
    noise = Noise((np.eye(1),), (1.0,), 0.01 * np.eye(1), ())
    point = SimpleNamespace(coordinates=(0.0,), amplitudes=())
    fit = SimpleNamespace(point=point, residual=np.array([signal]))
    found = Attribution(evidence, np.array(probabilities), 0.0)
    last = SimpleNamespace(noise=noise, fit=fit, attribution=found)
    return _Decision(None, last, [one, other], [ONE, OTHER], np.array([[0.0, 1.0, 1.0]]))


def test_the_answer_is_sure_where_the_readings_differ(monkeypatch):
    gain = decision(monkeypatch, 2.0)
    far, mean = gain(np.array([[0.0, 100.0, 0.0]]))
    assert far > 0.95
    assert mean > 0.95
    near, less = gain(np.array([[0.0, 0.3, 0.0]]))
    assert far > near
    assert mean > less > 0.5
    assert gain(np.array([[0.0, 1.0, 1.0]])) == (0.0, pytest.approx(0.5))


def test_the_amplitude_is_the_one_that_the_readings_leave(monkeypatch):
    row = np.array([[0.0, 3.0, 0.0]])
    assert decision(monkeypatch, 2.0)(row)[1] > decision(monkeypatch, 0.05)(row)[1] + 0.2


def test_what_is_probable_already_needs_less(monkeypatch):
    row = np.array([[0.0, 2.0, 0.0]])
    even = decision(monkeypatch, 1.0)(row)[0]
    assert decision(monkeypatch, 1.0, (0.85, 0.15))(row)[0] > even


def test_scatter_lasts_as_two_levels_correlate():
    scatter = np.array([[4.0, 1.2, 0.0], [1.2, 1.0, 0.0], [0.0, 0.0, 1.0]])
    read = [{0.5: 0, 1.0: 1}, {0.5: 2}]
    assert _correlation(scatter, read, [0.5, 1.0]) == pytest.approx(0.6)
    assert _correlation(scatter, read, [0.5]) == 0.0


def test_what_gains_nothing_is_not_recommended():
    ranked = [{"expected_gain": gain} for gain in (0.4, 0.1, 1e-4, -0.2)]
    assert recommended(ranked) == ranked[:2]


def test_levels_that_do_not_scatter_have_no_correlation():
    read = [{0.5: 0, 1.0: 1}]
    assert _correlation(np.zeros((2, 2)), read, [0.5, 1.0]) == 0.0
    assert _correlation(np.ones((2, 2)), read, [0.5, 1.0]) == 1.0
