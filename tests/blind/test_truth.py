"""How far an effect moves the readings, and the rows that it moves."""

import numpy as np
import pytest

from pipeline.blind import laboratory
from pipeline.blind.independent import Physics
from pipeline.blind.truth import (
    SHRINKAGE,
    THETA,
    Added,
    IndependentGenerator,
    LatticeGenerator,
    Metric,
    Row,
    rows_of,
    true_parameters,
)


@pytest.fixture
def small():
    """Log readings of two experiments, rows, and derivatives by two parameters."""
    rng = np.random.default_rng(5)
    rows = {
        "a": [Row("a", cell, 1.0, None) for cell in ("C1", "C1", "C2")],
        "b": [Row("b", cell, 1.0, None) for cell in ("C1", "C2")],
    }
    mixing = rng.normal(size=(3, 3))
    logs = {"a": 0.1 * rng.normal(size=(50, 3)) @ mixing, "b": 0.1 * rng.normal(size=(50, 2))}
    jacobian = [
        {"a": rng.normal(size=(1, 3)), "b": rng.normal(size=(1, 2))},
        {"b": rng.normal(size=(1, 2))},
    ]
    return rows, logs, jacobian


def generalised_norm(shift, covariance, columns):
    """|g|² − g'J (J'J)⁻¹ J'g in the metric of the covariance, as a length."""
    weights = np.linalg.inv(covariance)
    cross = columns.T @ weights @ shift
    explained = cross @ np.linalg.solve(columns.T @ weights @ columns, cross)
    return np.sqrt(shift @ weights @ shift - explained)


def covariance_of(rows, logs, shared, own):
    covariance = np.zeros((5, 5))
    for name, place in (("a", slice(0, 3)), ("b", slice(3, 5))):
        scatter = np.cov(logs[name], rowvar=False)
        scatter = (1 - SHRINKAGE) * scatter + SHRINKAGE * np.diag(np.diag(scatter))
        cells = np.array([row.load_cell for row in rows[name]])
        scatter += shared**2 * (cells[:, None] == cells) + own**2 * np.eye(len(cells))
        covariance[place, place] = scatter
    return covariance


def test_delta_is_the_norm_that_calibration_leaves(small):
    rows, logs, jacobian = small
    shift = np.array([0.3, -0.1, 0.2, 0.05, 0.4])
    columns = np.column_stack(
        [np.concatenate([one.get("a", np.zeros((1, 3)))[0], one["b"][0]]) for one in jacobian]
    )
    by_experiment = {"a": np.tile(shift[:3], (4, 1)), "b": np.tile(shift[3:], (4, 1))}
    metric = Metric(logs, rows, (0.08, 0.055), jacobian)
    wanted = generalised_norm(shift, covariance_of(rows, logs, 0.08, 0.055), columns)
    assert metric.norm(by_experiment) == pytest.approx(wanted, rel=1e-9)


def test_what_calibration_can_follow_does_not_count(small):
    rows, logs, jacobian = small
    metric = Metric(logs, rows, (0.08, 0.055), jacobian)
    followed = {name: np.tile(0.3 * values, (3, 1)) for name, values in jacobian[0].items()}
    assert metric.norm(followed) == pytest.approx(0.0, abs=1e-6)
    beside = {"a": np.tile([0.2, 0.1, 0.0], (3, 1)), "b": np.tile([0.0, 0.1], (3, 1))}
    assert metric.norm(beside) > 0.1
    assert metric.norm(beside, beside=[beside]) == pytest.approx(0.0, abs=1e-6)


def test_calibration_follows_a_shift_that_is_its_own(small):
    rows, logs, jacobian = small
    metric = Metric(logs, rows, (0.08, 0.055), jacobian)
    followed = {name: np.tile(0.3 * values, (3, 1)) for name, values in jacobian[0].items()}
    np.testing.assert_allclose(metric.step(followed), [0.3, 0.0], atol=1e-9)


def test_shifts_are_alike_up_to_what_calibration_follows(small):
    rows, logs, jacobian = small
    metric = Metric(logs, rows, (0.08, 0.055), jacobian)
    shift = {"a": np.tile([0.2, 0.1, 0.0], (3, 1)), "b": np.tile([0.0, 0.1], (3, 1))}
    more = {name: -2.0 * values - jacobian[0][name] for name, values in shift.items()}
    assert metric.cosine(shift, shift) == pytest.approx(1.0)
    assert metric.cosine(shift, more) == pytest.approx(-1.0)
    assert metric.norm({}) == 0.0


def test_scatter_alone_has_no_length(small):
    rows, logs, jacobian = small
    metric = Metric(logs, rows, (0.08, 0.055), jacobian)
    rng = np.random.default_rng(8)
    squares, plain = [], []
    for _ in range(200):
        noise = {"a": 0.2 * rng.normal(size=(8, 3)), "b": 0.2 * rng.normal(size=(8, 2))}
        squares.append(metric.norm(noise) ** 2)
        mean = {name: np.tile(values.mean(axis=0), (2, 1)) for name, values in noise.items()}
        plain.append(metric.norm(mean) ** 2)
    assert np.mean(squares) < 0.6 * np.mean(plain)  # half the time below zero, taken as zero


def test_declared_parameters_are_those_without_shifts():
    values = true_parameters(np.zeros(len(THETA)))
    assert values["E"] == pytest.approx(laboratory.TRANSMISSION)
    assert (values["s"], values["E_min"]) == (laboratory.SPREADING["std"], 0.0)
    assert values["R"] == pytest.approx(laboratory.RELAXATION)


def test_rows_follow_the_simulated_array():
    documents = laboratory.documents(0)
    generator = LatticeGenerator(documents)
    for name in ("static_8", "isolated"):
        rows = rows_of(name, documents[name])
        stress = generator.stress(name, np.zeros(len(THETA)), (), (0, 0))
        assert stress.size == len(rows)
        assert [row.load_cell for row in rows[: stress.shape[1]]] == [
            cell["name"] for cell in documents[name]["load_cells"]
        ]


def test_both_generators_agree_on_a_plain_column():
    documents = laboratory.documents(0)
    theta = np.zeros(len(THETA))
    means = [
        np.mean([g.stress("static_1", theta, (), (0, i)) for i in range(8)], axis=0)
        for g in (LatticeGenerator(documents), IndependentGenerator(documents, Physics()))
    ]
    np.testing.assert_allclose(*means, rtol=0.10)
    assert np.mean(means[0]) == pytest.approx(np.mean(means[1]), rel=0.02)


@pytest.mark.parametrize("name", ["sensor_gain", "sensor_offset", "sensor_drift"])
def test_sensors_are_the_same_in_both_generators(name):
    documents = laboratory.documents(0)
    parameter, value = {
        "sensor_gain": ("gain", 1.3),
        "sensor_offset": ("offset", 0.7),
        "sensor_drift": ("rate", 0.01),
    }[name]
    added = [Added(name, "C2", {parameter: value})]
    ground = np.linspace(8.0, 20.0, 30).reshape(6, 5)
    lattice, independent = (
        g.as_read("isolated", ground, added)
        for g in (LatticeGenerator(documents), IndependentGenerator(documents, Physics()))
    )
    np.testing.assert_allclose(lattice, independent)
    assert (lattice[-1] != ground[-1]).tolist() == [False, True, False, False, False]
