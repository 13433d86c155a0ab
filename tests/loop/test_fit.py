"""Fits find what made the readings, within their bounds."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import walled_world

from pipeline.config.study import Shared
from pipeline.loop.data import observed
from pipeline.loop.fit import box, calibrated, fit
from pipeline.loop.model import Model, Point, Term
from pipeline.loop.scores import predicted

K = Term("wall_friction", "K", "material", "gravel", (0, 1, 2, 3, 4))


@pytest.fixture(scope="module")
def problem(nothing):
    return nothing.problem()


def made_by(model, data, point, shift=0.0):
    """The same readings, of the values that a point of the model gives."""
    return replace(data, y=predicted(model, point, data.use)[data.use] + shift)


def at(model, E, *amplitudes):
    """A point with one E, and wall friction where it is given."""
    (coordinate,) = model.coordinates
    point = Point((coordinate.scale.forward(E),))
    return point.with_terms([K], amplitudes) if amplitudes else point


@pytest.mark.parametrize("E", [0.8, 0.93, 0.99])
def test_E_is_recovered_from_readings_without_noise(problem, E):
    model = problem.model.only(problem.data.use)
    truth = at(model, E)
    found, _ = calibrated(model, made_by(model, problem.data, truth), model.start)
    np.testing.assert_allclose(found.point.coordinates, truth.coordinates, atol=1e-3)
    assert np.abs(found.residual).max() < 1e-4
    assert found.cost < 1e-2


@pytest.mark.parametrize(("E", "friction"), [(0.97, 0.5), (0.9, 0.2), (0.95, 1.0)])
def test_E_and_wall_friction_are_recovered_together(problem, E, friction):
    model = problem.model.only(problem.data.use)
    data = made_by(model, problem.data, at(model, E, friction))
    found, _ = calibrated(model, data, at(model, 0.93, 0.3))
    np.testing.assert_allclose(found.point.coordinates, at(model, E).coordinates, atol=5e-3)
    np.testing.assert_allclose(found.point.amplitudes, friction, rtol=5e-3)
    assert found.point.terms == (K,)


@pytest.mark.parametrize("shift", [3.0, -6.0])
def test_bounds_are_kept_whatever_the_readings_say(problem, shift):
    """Loads twenty times the weight, or a four-hundredth of what the model says."""
    model = problem.model.only(problem.data.use)
    start = at(model, 0.95, 0.4)
    data = made_by(model, problem.data, start, shift)
    found, _ = calibrated(model, data, start)
    _, _, low, high = box(model, start)
    x = [*found.point.coordinates, *found.point.amplitudes]
    assert np.all(low <= x)
    assert np.all(x <= high)
    assert np.isfinite(found.cost)


def test_friction_that_would_push_upward_is_none(problem):
    """Readings that rise the more the narrower the column: no wall does that."""
    model = problem.model.only(problem.data.use)
    data = made_by(model, problem.data, at(model, 0.95, 0.0))
    widths = [model.cases[model.case_of[i]].experiment.geometry.width for i in data.use]
    data = replace(data, y=data.y + 0.05 / np.array(widths))
    found, _ = calibrated(model, data, at(model, 0.95, 0.2))
    assert found.point.amplitudes == (0.0,)


def test_what_has_no_reading_stays_at_its_start(problem, nothing):
    """E of the column that is held out, and the spread of s, on which no mean depends."""
    shared = (Shared(name="E", shared_by="experiment"), Shared(name="s", shared_by="study"))
    model = Model(problem.model.cases, shared)
    data = observed(model, nothing.measured(), problem.data.use)
    found, _ = calibrated(model.only(data.use), data, model.start)
    moved = np.abs(np.subtract(found.point.coordinates, model.start.coordinates)) > 1e-9
    labels = [c.label for c in model.coordinates]
    assert dict(zip(labels, moved, strict=True)) == {
        "E [a]": True,
        "E [b]": True,
        "E [c]": True,
        "E [d]": True,
        "E [e]": False,
        "s.std": False,
    }


def test_a_fit_from_its_own_result_stays(problem):
    model, data = problem.model.only(problem.data.use), problem.data
    found, here = calibrated(model, data, model.start)
    again = fit(model, data, here, found.point, found.reference, found.slopes)
    np.testing.assert_allclose(again.point.coordinates, found.point.coordinates, atol=1e-4)
    assert again.cost == pytest.approx(found.cost, abs=1e-3)


def test_residuals_are_measured_less_expected(problem):
    model, data = problem.model.only(problem.data.use), problem.data
    found, _ = calibrated(model, data, model.start)
    np.testing.assert_allclose(found.residual, data.y - found.expected[data.use], rtol=1e-12)
    expected = predicted(model, found.point, data.use)[data.use]
    np.testing.assert_allclose(found.expected[data.use], expected, atol=1e-6)


def test_noise_of_two_percent_moves_the_fit_by_its_standard_error(tmp_path):
    """Ten fixed data sets: the mean square of the errors over their standard errors is near 1.

    It has a χ² law with ten degrees of freedom over ten, within [0.15, 2.96] at 0.1 %.
    """
    squares = []
    for seed in range(10):
        world = walled_world(tmp_path / str(seed), true_E=0.9, seed=seed)
        problem = world.problem()
        model, data = problem.model.only(problem.data.use), problem.data
        found, here = calibrated(model, data, model.start)
        information = here.whitened(found.slopes[data.use])
        error = found.point.coordinates[0] - at(model, 0.9).coordinates[0]
        squares.append(error**2 * float((information**2).sum()))
    assert 0.15 < np.mean(squares) < 2.96, squares
