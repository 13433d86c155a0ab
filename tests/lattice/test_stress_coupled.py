"""What effects add to the stress sweep, against the slow reference and the laws of statics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import State, lattice_states, uniform_state

from pipeline.lattice.cells import MOVEMENT
from pipeline.lattice.stress import UNCOUPLED, Coupling, stress_sweep
from pipeline.lattice.stress_reference import stress_sweep_reference

PARTS = ("relaxation", "straight", "lean", "transfer", "cohesion", "slope")


@st.composite
def coupled_states(draw, parts=st.sets(st.sampled_from(PARTS), min_size=1)):
    """A state with movement zones anywhere, and couplings of any strength."""
    state = draw(lattice_states(relaxations=st.sampled_from([0.0, 0.29, 1.0])))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape, chosen = state.code.shape, draw(parts)
    zone_root = np.where(state.code == MOVEMENT, rng.integers(0, 3, shape), -1).astype(np.int16)
    own_shed = state.shed_fraction * rng.uniform(0.0, 1.2, shape)
    parts = {
        "relaxation": {"relaxation": rng.choice([0.0, 0.3, 1.0], shape).astype(np.float32)},
        "straight": {"straight": rng.choice([1e-3, 0.5, 1.0], shape).astype(np.float32)},
        "lean": {"lean_x": rng.normal(), "lean_y": rng.normal()},
        "transfer": {
            "zone_root": zone_root,
            "own_shed": np.minimum(own_shed, 1.0),
            "transfer": draw(st.floats(0.01, 1.0)),
        },
        "cohesion": {"cohesion": 10.0 ** rng.uniform(-2, 3)},
        "slope": {"slope": rng.uniform(-1, 1), "reference": 10.0 ** rng.uniform(0, 3)},
    }
    coupling = UNCOUPLED
    for name in PARTS:
        if name in chosen:
            coupling = coupling._replace(**parts[name])
    return state, coupling


def swept(state: State, coupling: Coupling):
    """(load, base_load, total_weight, shed) of the kernel, cells stored in float64."""
    load, base_load = np.zeros(state.code.shape), np.zeros(state.code.shape[1:])
    total, shed = stress_sweep(*state.arguments(), load, base_load, coupling)
    return load, base_load, total, shed


@given(coupled_states())
def test_coupled_sweep_equals_the_reference(case):
    state, coupling = case
    load, base_load, total, shed = swept(state, coupling)
    expected = stress_sweep_reference(*state.arguments(), coupling)
    for found, wanted in zip((load, base_load, shed), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * total)


@given(coupled_states())
def test_weight_is_conserved_whatever_is_coupled(case):
    state, coupling = case
    _, base_load, total, shed = swept(state, coupling)
    assert base_load.sum() + shed == pytest.approx(total, rel=1e-11)


@given(coupled_states(parts=st.just({"straight", "lean", "cohesion", "relaxation"})))
def test_what_moves_load_aside_sheds_none_at_full_transmission(case):
    state, coupling = case
    state = replace(state, shed_fraction=np.zeros(state.code.shape))
    assert swept(state, coupling)[3] == 0.0


@given(lattice_states(relaxations=st.just(0.3)))
def test_couplings_that_are_off_change_no_bit(state):
    nowhere = np.full(state.code.shape, -1, np.int16)
    ones = np.ones(state.code.shape, np.float32)
    off = UNCOUPLED._replace(zone_root=nowhere, own_shed=ones, reference=7.0)
    for found, wanted in zip(swept(state, off), swept(state, UNCOUPLED), strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_all_excess_returns_where_a_zone_is_enclosed():
    state = uniform_state((4, 5, 5), 0.9, 2.0)
    code = state.code.copy()
    code[:, 2, 2] = MOVEMENT
    shed = np.where(code == MOVEMENT, 0.6, 0.1)
    coupling = UNCOUPLED._replace(
        zone_root=np.where(code == MOVEMENT, 0, -1).astype(np.int16),
        own_shed=np.full(code.shape, 0.1),
        transfer=1.0,
    )
    state = replace(state, code=code, shed_fraction=shed)
    load, _, _, lost = swept(state, coupling)
    assert lost == pytest.approx(0.1 * load[1:].sum(), rel=1e-12)  # as if nothing flowed
    assert swept(state, UNCOUPLED)[3] > lost


def test_a_cell_hands_aside_no_more_than_it_carries():
    state = uniform_state((1, 3, 3), 1.0, 2.0)
    code = state.code.copy()
    code[0, 1, 1] = MOVEMENT
    weight = np.where(code == MOVEMENT, 8.0, 1.0)
    state = replace(state, code=code, weight=weight)
    some = swept(state, UNCOUPLED._replace(cohesion=1.5))[1]
    np.testing.assert_allclose(some, [[1, 2.5, 1], [2.5, 2, 2.5], [1, 2.5, 1]])
    everything = swept(state, UNCOUPLED._replace(cohesion=1e3))[1]
    np.testing.assert_allclose(everything, [[1, 3, 1], [3, 0, 3], [1, 3, 1]])


def test_a_cell_that_handed_all_aside_and_rounds_below_zero_sheds_nothing():
    code = np.full((2, 3, 3), 1, np.int8)
    code[1, 1, 1], code[1, 0, 1] = MOVEMENT, MOVEMENT  # three faces on stagnant ground
    state = uniform_state(code.shape, 0.9, 2.0)
    weight = np.where(code == MOVEMENT, 2.1, 1.0)
    state = replace(state, code=code, weight=weight)
    coupling = UNCOUPLED._replace(cohesion=1e3, slope=-0.04, reference=5.0)
    load, base_load, total, shed = swept(state, coupling)
    expected = stress_sweep_reference(*state.arguments(), coupling)
    for found, wanted in zip((load, base_load, shed), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * total)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_lean_shifts_the_center_of_a_point_load(axis):
    state = uniform_state((6, 15, 15), 1.0, 2.0)
    weight = np.zeros(state.code.shape)
    weight[-1, 7, 7] = 1.0
    kappa = 0.3
    names = ("lean_y", "lean_x")
    base = swept(replace(state, weight=weight), UNCOUPLED._replace(**{names[axis]: kappa}))[1]
    beta = {0: np.array([1 / 2, 1 / 3, 1 / 3]), 1: np.array([1.0, 1 / 2, 1 / 2])}
    # along the axis: offset 0 has one below and two edges, offsets ±1 one edge and two corners
    middle, side = beta[1].sum(), beta[0].sum()
    shift = 2 * side * np.sinh(kappa) / (middle + 2 * side * np.cosh(kappa))
    place = np.arange(15) - 7
    center = (base.sum(axis=1 - axis) * place).sum() / base.sum()
    assert center == pytest.approx(5 * shift, rel=1e-12)
    assert (base.sum(axis=axis) * place).sum() == pytest.approx(0.0, abs=1e-12)


def test_shed_fraction_follows_a_power_of_the_load():
    state = uniform_state((2, 1, 1), 0.9, 2.0)
    weight = np.array([9.0, 0.0]).reshape(2, 1, 1)[::-1]
    bent = swept(replace(state, weight=weight), UNCOUPLED._replace(slope=0.5, reference=4.0))
    assert bent[3] == pytest.approx(9.0 * 0.1 * 1.5, rel=1e-14)
