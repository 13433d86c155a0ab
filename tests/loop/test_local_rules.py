"""Derivatives by local rules, from adjoint sweeps, against the model's own differences."""

import numpy as np
import pytest

from pipeline.effects.local_rule import CHANNELS
from pipeline.loop.hypotheses import rules
from pipeline.loop.local_rules import rule_slopes

STEP = 0.02
RULES = {  # experiment: channel and feature
    "filled": [("E", "walls"), ("E", "height"), ("weight", "upper_third"), ("weight", "along_x")],
    "drawn": [
        ("E", "lower_third"),
        ("E", "shell"),
        ("E", "zone"),
        ("weight", "zone_top"),
        ("weight", "surface"),
        ("R", "zone"),
        ("R", "zone_edge"),
        ("R", "height"),
    ],
}


@pytest.fixture(scope="module")
def model(mixed):
    return mixed.problem().model


@pytest.fixture(scope="module")
def slopes(mixed, model):
    """(channel, feature) → the rule, and its derivatives (row)."""
    every = rules(mixed.study, model)
    names = [tuple(dict(rule.terms[0].options).values()) for rule in every]
    columns = rule_slopes(model, model.start, every).T
    return dict(zip(names, zip(every, columns, strict=True), strict=True))


@pytest.mark.parametrize(
    ("experiment", "rule"), [(name, rule) for name, found in RULES.items() for rule in found]
)
def test_adjoint_derivatives_are_the_model_s_differences(model, slopes, experiment, rule):
    hypothesis, found = slopes[rule]
    ends = [
        model.mean(model.start.with_terms(hypothesis.terms, [sign * STEP]), model.start)
        for sign in (1, -1)
    ]
    expected = (ends[0] - ends[1]) / (2 * STEP)
    case = [one.experiment.name for one in model.cases].index(experiment)
    rows = np.arange(len(model.rows))[model.slices[case]]
    rows = rows[model.is_log[rows]]
    size = np.abs(expected[rows]).max()
    assert size > 1e-4
    np.testing.assert_allclose(found[rows], expected[rows], rtol=1e-3, atol=1e-3 * size)


def test_what_takes_no_load_from_the_ground_has_no_derivative(model, slopes):
    rows = np.arange(len(model.rows))
    static = rows[model.slices[1]]
    geometry = rows[~model.is_log]
    for (channel, _), (rule, found) in slopes.items():
        assert not found[geometry].any()
        assert channel in CHANNELS
        if channel == "R":
            assert not found[static].any()
            assert rule.terms[0].cases == (0,)
