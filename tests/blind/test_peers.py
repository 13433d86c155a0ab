"""Peers on arrays whose answer is known."""

import numpy as np
import pytest

from pipeline.blind.peers import forward_selection, raw_correlation, thresholded_least_squares

NAMES = ["gain", "tilt", "wall", "heap"]
METHODS = {
    "forward": lambda r, J, G, std: forward_selection(r, J, G, NAMES, std),
    "thresholded": lambda r, J, G, std: thresholded_least_squares(r, J, G, NAMES, std),
}


@pytest.fixture
def arrays():
    rng = np.random.default_rng(12)
    return rng.normal(size=(120, 3)), rng.normal(size=(120, 4)), np.full(120, 0.1)


@pytest.mark.parametrize("method", METHODS)
def test_names_what_is_there_strongest_first(method, arrays):
    J, G, std = arrays
    noise = 0.1 * np.random.default_rng(1).normal(size=120)
    residual = J @ [0.5, -1.0, 0.3] + 0.1 * G[:, 2] - 0.3 * G[:, 1] + noise
    assert METHODS[method](residual, J, G, std)[:2] == ["tilt", "wall"]


@pytest.mark.parametrize("method", METHODS)
def test_what_calibration_follows_is_not_named(method, arrays):
    J, G, std = arrays
    assert METHODS[method](J @ [1.0, 2.0, -1.0], J, G, std) == []


@pytest.mark.parametrize("method", METHODS)
def test_a_candidate_that_calibration_can_follow_is_not_named(method, arrays):
    J, G, std = arrays
    G = np.column_stack([J[:, 0], G[:, 1:]])
    assert METHODS[method](J[:, 0] + 0.5 * G[:, 3], J, G, std) == ["heap"]


def test_raw_correlation_always_answers_and_does_not_project(arrays):
    J, G, _ = arrays
    assert raw_correlation(0.2 * G[:, 3] + 1.0, G, NAMES) == ["heap"]
    G = np.column_stack([J[:, 0], G[:, 1:]])
    assert raw_correlation(J[:, 0] + 0.1 * G[:, 3], G, NAMES) == ["gain"]
    assert len(raw_correlation(np.random.default_rng(0).normal(size=120), G, NAMES)) == 1


def test_raw_correlation_of_constant_sensitivities_is_none():
    G = np.column_stack([np.ones(5), np.arange(5.0)])
    assert raw_correlation(np.array([1.0, 1.1, 0.9, 1.0, 1.2]), G, ["same", "rising"]) == ["rising"]


def test_a_covariance_that_explains_the_residual_leaves_nothing_to_name(arrays):
    J, G, std = arrays
    shared = G[:, 0]  # what all readings share looks like the first candidate
    residual = 0.5 * shared
    assert forward_selection(residual, J, G, NAMES, std) == ["gain"]
    covariance = np.diag(std**2) + np.outer(shared, shared)
    assert forward_selection(residual, J, G, NAMES, std, covariance) == []
    assert thresholded_least_squares(residual, J, G, NAMES, std, covariance) == []
