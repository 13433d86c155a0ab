"""The adjoint of the stress sweep against the sweep itself: its differences and its linearity."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import lattice_states, uniform_state

from pipeline.lattice.adjoint import influence
from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT, VOID
from pipeline.lattice.stress import UNCOUPLED, Coupling, stress_sweep

RELAXATIONS = st.sampled_from([0.0, 0.29]) | st.floats(1e-3, 1.0)
STEP = 1e-4  # relative, of the differences
TOLERANCE = 1e-4
COUPLED = {
    "relaxation",
    "straight",
    "lean",
    "transfer",
    "cohesion",
    "slope",
}
LINEAR = COUPLED - {"cohesion", "slope"}


@st.composite
def couplings(draw, state, parts):
    """A coupling with some of `parts` switched on."""
    on = draw(st.sets(st.sampled_from(sorted(parts))))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = state.code.shape
    moving = (state.code == MOVEMENT) | (state.code == VOID)
    level = state.weight.sum() / shape[1] / shape[2]
    fields = {
        "relaxation": {"relaxation": rng.uniform(0.05, 1.0, shape)},
        "straight": {"straight": rng.uniform(0.1, 2.0, shape)},
        "lean": {"lean_x": rng.uniform(-1, 1), "lean_y": rng.uniform(-1, 1)},
        "transfer": {
            "zone_root": np.where(moving, rng.integers(0, 3, shape), -1).astype(np.int16),
            "own_shed": rng.uniform(0.0, 0.5, shape) * state.shed_fraction.max(),
            "transfer": rng.uniform(0.1, 1.0),
        },
        "cohesion": {"cohesion": rng.uniform(0.01, 0.6) * level},
        "slope": {"slope": rng.uniform(-0.5, 0.5), "reference": level},
    }
    return Coupling(**{key: value for name in on for key, value in fields[name].items()})


@st.composite
def coupled_states(draw, parts=COUPLED):
    state = draw(lattice_states(relaxations=RELAXATIONS))
    return state, draw(couplings(state, parts))


def swept(state, coupling=UNCOUPLED):
    """Loads (z, y, x) and base loads (y, x) of the forward sweep."""
    load, base_load = np.zeros(state.code.shape), np.zeros(state.code.shape[1:])
    stress_sweep(*state.arguments(), load, base_load, coupling)
    return load, base_load


def influence_of(readings, state, coupling=UNCOUPLED, **options):
    load, _ = swept(state, coupling)
    arguments = state.arguments()[1:]  # the adjoint needs no weights
    return influence(readings, *arguments, load, coupling, **options)


def some_readings(shape, count=2, seed=5):
    """Readings (reading, y, x) with weights that differ from place to place."""
    return np.random.default_rng(seed).uniform(0.1, 1.0, (count, *shape[1:]))


def assert_equals_differences(function, values, derivative, scale, places):
    """`derivative` (reading, *values.shape) of `function` (reading), place by place.

    Where the slopes on both sides of a value differ there is a kink between them: no derivative
    to compare with.
    """
    middle = function(values)
    for place in places:
        step = STEP * scale[place]
        if step == 0.0:
            continue
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved[place] += sign * step
            ends.append(function(moved))
        above, below = (ends[0] - middle) / step, (middle - ends[1]) / step
        smooth = np.abs(above - below) <= 1e-2 * (np.abs(above) + np.abs(below)) + 1e-6
        expected, found = (ends[0] - ends[1]) / (2 * step), derivative[(slice(None), *place)]
        rounding = 1e-13 * np.abs(middle).max() / step
        wrong = np.abs(found - expected) > TOLERANCE * np.abs(expected) + rounding
        assert not np.any(wrong & smooth), (place, found, expected)


def granular_places(state, rng, count=8):
    places = np.argwhere(np.isin(state.code, (STAGNANT, MOVEMENT)))
    chosen = rng.choice(len(places), min(count, len(places)), replace=False)
    return [tuple(place) for place in places[chosen]]


# ---------------------------------------------------------------------------------------------
# differences


@given(coupled_states(), st.integers(0, 99))
def test_derivatives_equal_central_differences_of_the_sweep(drawn, seed):
    state, coupling = drawn
    readings = some_readings(state.code.shape)
    found = influence_of(readings, state, coupling)
    places = granular_places(state, np.random.default_rng(seed))

    def read(name, values):
        _, base = swept(replace(state, **{name: values}), coupling)
        return np.tensordot(readings, base, axes=2)

    assert_equals_differences(
        lambda v: read("weight", v), state.weight, found.weight, state.weight, places
    )
    shed = state.shed_fraction  # the derivative in log(1 − E) is this one times 1 − E
    assert_equals_differences(lambda v: read("shed_fraction", v), shed, found.shed, shed, places)


@given(coupled_states(), st.integers(0, 99))
def test_derivatives_of_the_own_shed_fraction_equal_central_differences(drawn, seed):
    state, coupling = drawn
    readings = some_readings(state.code.shape)
    found = influence_of(readings, state, coupling).own_shed
    if coupling.transfer == 0.0:
        assert found.shape == (2, 0, 0, 0)
        return
    own = coupling.own_shed

    def read(values):
        _, base = swept(state, coupling._replace(own_shed=values))
        return np.tensordot(readings, base, axes=2)

    assert_equals_differences(
        read, own, found, own, granular_places(state, np.random.default_rng(seed))
    )


@given(coupled_states(), st.integers(0, 99))
def test_derivatives_in_log_R_equal_central_differences(drawn, seed):
    state, coupling = drawn
    field = coupling.relaxation
    if not field.size:
        field = np.full(state.code.shape, max(state.relaxation, 0.02))
        coupling = coupling._replace(relaxation=field)
    readings = some_readings(state.code.shape)
    found = influence_of(readings, state, coupling, of_relaxation=True).relaxation
    assert not found[:, state.code != MOVEMENT].any()

    def read(logarithm):
        _, base = swept(state, coupling._replace(relaxation=np.exp(logarithm)))
        return np.tensordot(readings, base, axes=2)

    assert_equals_differences(
        read,
        np.log(field),
        found,
        np.ones(field.shape),
        granular_places(state, np.random.default_rng(seed)),
    )


# ---------------------------------------------------------------------------------------------
# linear sweeps


@given(coupled_states(LINEAR))
def test_a_linear_reading_is_the_sum_of_weights_times_their_influence(drawn):
    state, coupling = drawn
    readings = some_readings(state.code.shape, 3)
    _, base = swept(state, coupling)
    read = np.tensordot(readings, base, axes=2)
    found = influence_of(readings, state, coupling).weight
    np.testing.assert_allclose(np.tensordot(found, state.weight, axes=3), read, rtol=1e-10)


@given(coupled_states(LINEAR), st.integers(0, 10**6))
@settings(max_examples=50)
def test_influence_of_a_cell_is_the_reading_of_its_weight_alone(drawn, number):
    state, coupling = drawn
    places = np.argwhere(np.isin(state.code, (STAGNANT, MOVEMENT)))
    place = tuple(places[number % len(places)])
    readings = some_readings(state.code.shape)
    alone = np.zeros(state.code.shape)
    alone[place] = 1.0
    _, base = swept(replace(state, weight=alone), coupling)
    found = influence_of(readings, state, coupling).weight[(slice(None), *place)]
    np.testing.assert_allclose(found, np.tensordot(readings, base, axes=2), rtol=1e-10)


@given(coupled_states())
def test_several_readings_at_once_are_each_as_if_alone(drawn):
    state, coupling = drawn
    readings = some_readings(state.code.shape, 3)
    together = influence_of(readings, state, coupling, of_relaxation=True)
    for n in range(3):
        alone = influence_of(readings[n : n + 1], state, coupling, of_relaxation=True)
        for one, many in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], many[n])


def test_weights_on_ground_that_sheds_nothing_reach_the_base_as_a_whole():
    state = uniform_state((5, 4, 3), 1.0, 2.0)
    found = influence_of(np.ones((1, 4, 3)), state)
    np.testing.assert_allclose(found.weight, 1.0, rtol=1e-14)


def test_a_uniform_column_has_the_closed_form_influence():
    E = 0.9
    state = uniform_state((6, 4, 3), E, 2.0)
    found = influence_of(np.ones((1, 4, 3)), state)
    powers = E ** np.arange(6.0)
    np.testing.assert_allclose(found.weight[0], powers[:, None, None] * np.ones((4, 3)))
    # d/dE of Σ w E^k: of each level, load · E^(k − 1)
    loads = np.array([sum(E**i for i in range(6 - k)) for k in range(6)])
    expected = -loads * np.concatenate([[0.0], powers[:-1]])
    np.testing.assert_allclose(found.shed[0].mean(axis=(1, 2)), expected)  # loads differ by place


def test_rock_under_a_column_reads_what_stands_on_it():
    state = uniform_state((3, 1, 2), 0.8, 0.0)
    code = state.code.copy()
    code[0] = OUTSIDE
    readings = np.array([[[1.0, 0.0]]])
    found = influence_of(readings, replace(state, code=code)).weight[0]
    np.testing.assert_allclose(found[1, 0], [0.8, 0.0])  # the lowest ground rests on the rock
    edge = state.edge[0, 0, 0]
    shares = np.array([1.0, edge]) / (1.0 + edge)
    np.testing.assert_allclose(found[2, 0], 0.8 * 0.8 * shares)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_influence_is_returned_in_the_asked_precision(dtype):
    state = uniform_state((3, 2, 2), 0.9, 1.0)
    found = influence_of(np.ones((1, 2, 2)), state, dtype=dtype)
    assert found.weight.dtype == found.shed.dtype == dtype
