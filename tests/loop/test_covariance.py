"""The noise of readings, against a computation by hand and against data of known noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from worlds import mixed_world

from pipeline.loop.covariance import (
    LEAST_FREEDOM,
    PRIOR_SD,
    SHRINK,
    Noise,
    noise,
    restricted_likelihood_factors,
)
from pipeline.loop.model import OTHERS, SCATTER
from pipeline.montecarlo.streams import LOOP_FLOW, LOOP_PACKING
from pipeline.observe import RowReader
from pipeline.simulate.replicate import simulate

# ---------------------------------------------------------------------------------------------
# as simulated and declared

STREAMS = LOOP_PACKING, LOOP_FLOW


@pytest.fixture(scope="module")
def problem(mixed):
    return mixed.problem()


def by_hand(problem, case):
    """Logarithms (replicate, row) of a case's rows, from streams of their own."""
    model = problem.model
    setup, parameters, _ = model.setup_at(model.start, case)
    reader = RowReader(setup, model.cases[case].rows)
    values = [
        reader.values(
            simulate(
                setup,
                parameters,
                *(model.stream(one, case, k) for one in STREAMS),
            )
        )
        for k in range(SCATTER + OTHERS)
    ]
    rows = reader.sensed(np.array(values), replace(setup, effects=()))
    is_log = model.is_log[model.slices[case]]
    return np.where(is_log, np.log(rows), rows)


def test_parts_are_the_replicates_covariance_and_the_declared_errors(problem, mixed):
    model, data = problem.model, problem.data
    found = noise(model, model.start, data)
    measured = [mixed.measured()[i] for i in data.use]
    rows = by_hand(problem, 0)[:, data.use]  # the draw; the column is held out
    block = np.cov(rows[:SCATTER].T)
    block = np.where(np.eye(len(block)), block, (1 - SHRINK) * block)
    weight = np.array([row.count**-0.5 if row.count else 0.0 for row in measured])
    expected = block * (np.outer(weight, weight) + 1 / (SCATTER + OTHERS))
    np.testing.assert_allclose(found.parts[0], expected, rtol=1e-10, atol=1e-14)
    assert not found.parts[1].any()
    size = [row.value if log else 1.0 for row, log in zip(measured, model.is_log, strict=False)]
    declared = np.array([row.std / one for row, one in zip(measured, size, strict=True)])
    np.testing.assert_allclose(found.parts[2], np.diag(declared**2), rtol=1e-12)
    np.testing.assert_allclose(found.covariance, sum(found.parts), rtol=1e-9, atol=1e-14)
    assert found.factors == (1.0, 1.0, 1.0)


def test_replicates_of_the_null_law_are_not_those_of_the_covariance(problem):
    model, data = problem.model, problem.data
    ((places, residuals),) = noise(model, model.start, data).residuals
    np.testing.assert_array_equal(places, np.arange(len(data.use)))
    others = by_hand(problem, 0)[SCATTER:, data.use]
    weight = np.sqrt(data.scatter**2 + 1 / (SCATTER + OTHERS))
    expected = (others - others.mean(axis=0)) * np.sqrt(OTHERS / (OTHERS - 1)) * weight
    np.testing.assert_allclose(residuals, expected, rtol=1e-9, atol=1e-12)


def test_readings_of_one_load_cell_share_their_shared_error(tmp_path):
    world = mixed_world(tmp_path / "w", study={"hold_out": ["drawn"]})
    problem = world.problem()
    found = noise(problem.model, problem.model.start, problem.data)
    shared = np.sqrt(np.diag(found.parts[1]))
    np.testing.assert_allclose(shared, [0.01, 0.01, 0, 0, 0], rtol=1e-12)
    expected = np.zeros((5, 5))
    expected[:2, :2] = 1e-4
    np.testing.assert_allclose(found.parts[1], expected, rtol=1e-12)


def test_whitening_inverts_the_covariance(problem):
    found = noise(problem.model, problem.model.start, problem.data).scaled((2.0, 3.0, 0.5))
    np.testing.assert_allclose(found.covariance, 2 * found.parts[0] + 0.5 * found.parts[2])
    white = found.whitened(found.covariance)
    np.testing.assert_allclose(white, found.lower.T, atol=1e-9)


def test_drawn_errors_have_the_parts_covariance():
    made = synthetic(12).scaled((0.0, 2.0, 3.0))
    draws = made.draws(40_000, np.random.default_rng(5))
    expected = 2.0 * made.parts[1] + 3.0 * made.parts[2]
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # 6 standard errors of a correlation: one false alarm in 10⁷ tests of 78 entries
    np.testing.assert_allclose(np.cov(draws) / size, expected / size, atol=6 / np.sqrt(40_000))
    np.testing.assert_allclose(made.of_draws, expected, atol=1e-12)


def test_drawn_scatter_comes_from_the_replicates_whole():
    made = synthetic(6)
    rows = np.random.default_rng(1).standard_normal((5, 4))
    alone = replace(
        made, parts=tuple(0.0 * part for part in made.parts), residuals=((np.arange(1, 5), rows),)
    )
    np.testing.assert_allclose(alone.of_draws[1:5, 1:5], rows.T @ rows / 5, rtol=1e-12)
    draws = alone.draws(50, np.random.default_rng(2))
    assert not draws[[0, 5]].any()
    for column in draws[1:5].T:
        assert np.isclose(rows, column).all(axis=1).any()


# ---------------------------------------------------------------------------------------------
# as the data say


def synthetic(size: int, scatter: float = 0.0) -> Noise:
    """Readings in blocks of six: scatter alike from block to block, shared errors within one."""
    block = np.arange(size) // 6
    parts = (
        scatter**2 * np.exp(-0.3 * np.abs(np.subtract.outer(np.arange(size), np.arange(size)))),
        0.03**2 * (block[:, None] == block[None, :]).astype(float),
        0.1**2 * np.eye(size),
    )
    lower = np.linalg.cholesky(sum(parts))
    return Noise(parts, (1.0, 1.0, 1.0), lower, ())


def explained(size: int, columns: int) -> np.ndarray:
    """Smooth directions (n, column)."""
    return np.cos(np.outer(np.linspace(0.0, 1.0, size), np.arange(columns)) * np.pi)


def factors_of(made, truth, columns, seeds):
    """Estimates (seed, part) from data whose parts have the true factors."""
    random = np.random.default_rng(seeds)
    lower = made.scaled(truth).lower
    directions = explained(len(lower), columns)
    found = []
    for _ in range(seeds):
        errors = lower @ random.standard_normal(len(lower))
        errors += directions @ random.normal(0.0, 1.0, columns)  # what is explained does not count
        factors, freedom = restricted_likelihood_factors(made, errors, directions)
        assert freedom == len(lower) - columns
        found.append(factors)
    return np.array(found)


@pytest.mark.parametrize("truth", [1.0, 2.25, 0.5])
def test_independent_noise_is_recovered(truth):
    """60 readings; a two-sided z test of 40 fixed data sets, false alarm rate 0.1 % each."""
    seeds, freedom = 40, 57
    made = synthetic(60)
    made = replace(made, parts=(made.parts[0], 0.0 * made.parts[1], made.parts[2])).scaled((1,) * 3)
    found = factors_of(made, (1.0, 1.0, truth), 60 - freedom, seeds)
    np.testing.assert_array_equal(found[:, :2], 1.0)  # parts that are not there
    prior, data = PRIOR_SD**-2, 2.0 * freedom  # information on the logarithm of the sd
    log_sd = 0.5 * np.log(found[:, 2])
    expected = 0.5 * np.log(truth) * data / (data + prior)
    z = (log_sd.mean() - expected) / (log_sd.std(ddof=1) / np.sqrt(seeds))
    assert abs(z) < norm.isf(5e-4), (z, np.exp(2 * log_sd.mean()))
    assert log_sd.std(ddof=1) == pytest.approx(np.sqrt(data) / (data + prior), rel=0.4)


def test_the_part_that_is_wrong_is_the_one_that_changes():
    """Factor of the independent part 2.25 among three; 30 fixed data sets, their mean alone."""
    found = np.log(factors_of(synthetic(60, 0.1), (1.0, 1.0, 2.25), 3, 30)).mean(axis=0)
    assert np.exp(found[2]) == pytest.approx(2.25, rel=0.25)
    np.testing.assert_allclose(np.exp(found[:2]), 1.0, atol=0.35)


def test_declared_noise_stands_with_few_degrees_of_freedom():
    made = synthetic(30)
    residual = 5.0 * made.lower @ np.random.default_rng(1).standard_normal(30)
    for columns, stands in ((30 - LEAST_FREEDOM, False), (31 - LEAST_FREEDOM, True), (30, True)):
        directions = np.eye(30)[:, :columns]
        factors, freedom = restricted_likelihood_factors(made, residual, directions)
        assert freedom == 30 - columns
        assert (factors == (1.0, 1.0, 1.0)) == stands
        assert stands or max(factors) > 2.0


def test_directions_without_effect_and_twice_the_same_take_no_freedom():
    made = synthetic(30)
    residual = made.lower @ np.random.default_rng(1).standard_normal(30)
    some = explained(30, 4)
    both = np.column_stack([some, 7.0 * some, np.zeros((30, 3))])
    one, other = (restricted_likelihood_factors(made, residual, part) for part in (some, both))
    assert one[1] == other[1] == 26
    np.testing.assert_allclose(one[0], other[0], rtol=1e-3)
