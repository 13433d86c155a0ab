"""The stress sweep against its reference, the equations and the laws of statics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gamma
from strategies import lattice_states, sweep, uniform_state

from pipeline.lattice.block_model import build_block_model
from pipeline.lattice.cells import AIR, MOVEMENT, OUTSIDE, STAGNANT, VOID
from pipeline.lattice.closed_form import closed_form_stress
from pipeline.lattice.grid import GRAVITY, levels_of
from pipeline.lattice.ranks import RANKS, draw_ranks
from pipeline.lattice.spreading import RULES, S_LIMIT, spreading_weights
from pipeline.lattice.stress import Moved, Ranked, place_cells
from pipeline.lattice.stress_reference import stress_sweep_reference
from pipeline.montecarlo.streams import PACKING, random_stream
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup
from pipeline.simulate.sweeps import WeightBalanceError

DISTANCES = np.sqrt([1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0])
RELAXATIONS = st.sampled_from([0.0, 0.29]) | st.floats(0.0, 1.0)

# ---------------------------------------------------------------------------------------------
# the kernel is its reference


SOLID = lattice_states(codes=(STAGNANT,))  # rows that are computed several cells at a time
ANY = lattice_states() | SOLID


@given(ANY)
def test_sweep_equals_reference_bit_for_bit_without_relaxation(state):
    load, base_load, shed = stress_sweep_reference(*state.arguments())
    swept = sweep(state)
    np.testing.assert_array_equal(swept.load, load)
    np.testing.assert_array_equal(swept.base_load, base_load)
    assert swept.shed == pytest.approx(shed, rel=1e-13, abs=1e-300)  # summed in another order


@given(ANY)
def test_sweep_equals_reference_bit_for_bit_in_float32_storage(state):
    stored = state.with_arrays(lambda a: a if a.dtype == np.int8 else a.astype(np.float32))
    load, base_load, shed = stress_sweep_reference(*stored.arguments())
    swept = sweep(state, np.float32)
    np.testing.assert_array_equal(swept.load, load.astype(np.float32))
    np.testing.assert_array_equal(swept.base_load, base_load)
    assert swept.shed == pytest.approx(shed, rel=1e-13, abs=1e-300)


@given(SOLID, st.integers(0, 2**32 - 1))
def test_ranks_stand_for_the_weights_of_their_cells_bit_for_bit(state, seed):
    weights = np.random.default_rng(seed).random((RANKS, 2))
    rank = draw_ranks(np.random.default_rng(seed), state.code.shape)
    edge, corner = weights[:, 0][rank], weights[:, 1][rank]
    expected = sweep(replace(state, edge=edge, corner=corner))
    found = sweep(state, ranked=Ranked(rank, weights))
    np.testing.assert_array_equal(found.load, expected.load)
    assert (found.total_weight, found.shed) == (expected.total_weight, expected.shed)


@given(lattice_states(relaxations=RELAXATIONS))
def test_sweep_equals_reference_to_1e12_with_relaxation(state):
    load, base_load, shed = stress_sweep_reference(*state.arguments())
    swept = sweep(state)
    scale = 1e-12 * swept.total_weight
    np.testing.assert_allclose(swept.load, load, rtol=1e-12, atol=scale)
    np.testing.assert_allclose(swept.base_load, base_load, rtol=1e-12, atol=scale)
    assert swept.shed == pytest.approx(shed, rel=1e-12, abs=scale)


# ---------------------------------------------------------------------------------------------
# eqs 3 and 4

EXPONENTS = st.floats(-120, 120) | st.sampled_from([0.0, 1.0, -1.0, 4.0])


@given(EXPONENTS)
def test_weights_equal_eq_4(s):
    beta = DISTANCES**-s / np.sum(DISTANCES**-s)
    edge, corner = spreading_weights(np.array([s]), "inverse_distance", np.float64)
    total = 1 + 4 * edge[0] + 4 * corner[0]
    shares = [1 / total, edge[0] / total, corner[0] / total]
    np.testing.assert_allclose(shares, beta[[0, 1, 5]], rtol=1e-12)


@given(EXPONENTS)
def test_multinomial_weights_equal_eq_3_with_gamma_functions(s):
    p = DISTANCES**-s / np.sum(DISTANCES**-s)
    beta = p**DISTANCES / gamma(DISTANCES + 1)
    beta /= beta.sum()
    edge, corner = spreading_weights(np.array([s]), "multinomial", np.float64)
    total = 1 + 4 * edge[0] + 4 * corner[0]
    shares = [1 / total, edge[0] / total, corner[0] / total]
    np.testing.assert_allclose(shares, beta[[0, 1, 5]], rtol=1e-11, atol=2e-38)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_of_any_exponent_are_finite_and_positive(rule, dtype):
    s = np.array([-1e6, -1000.0, -S_LIMIT, 0.0, S_LIMIT, 1000.0, 1e6], dtype)
    for weights in spreading_weights(s, rule, dtype):
        assert weights.dtype == dtype
        assert np.all(np.isfinite(weights))
        assert np.all(weights > 0)
        assert np.all(np.diff(weights) <= 0)  # a larger s draws the load together


def test_unknown_rule_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'eq_5'.*inverse_distance, multinomial"):
        spreading_weights(np.zeros(1), "eq_5")


def test_a_point_load_spreads_over_nine_receivers_as_eq_4_says():
    s = 2.0
    state = uniform_state((2, 3, 3), 0.8, s)
    weight = np.zeros((2, 3, 3))
    weight[1, 1, 1] = 100.0
    base = sweep(replace(state, weight=weight)).base_load
    below, edge, corner = 80.0 * np.array([1, 1 / 2, 1 / 3]) / (1 + 4 / 2 + 4 / 3)
    expected = [[corner, edge, corner], [edge, below, edge], [corner, edge, corner]]
    np.testing.assert_allclose(base, expected, rtol=1e-14)


# ---------------------------------------------------------------------------------------------
# statics


@given(lattice_states(relaxations=RELAXATIONS))
def test_weight_in_is_base_load_plus_load_shed(state):
    swept = sweep(state)
    assert swept.base_load.sum() + swept.shed == pytest.approx(swept.total_weight, rel=1e-12)
    own = state.weight.sum() - (1 - state.top_fraction) * state.weight[-1].sum()
    assert swept.total_weight == pytest.approx(own, rel=1e-12)


@given(lattice_states(relaxations=RELAXATIONS), st.sampled_from([1, 2]))
def test_mirrored_ground_carries_mirrored_loads(state, axis):
    swept = sweep(state)
    mirrored = sweep(state.with_arrays(lambda a: np.flip(a, axis)))
    scale = 1e-12 * swept.total_weight
    np.testing.assert_allclose(np.flip(mirrored.load, axis), swept.load, rtol=1e-11, atol=scale)
    np.testing.assert_allclose(
        np.flip(mirrored.base_load, axis - 1), swept.base_load, rtol=1e-11, atol=scale
    )


@given(ANY, st.sampled_from([1, 2]))
def test_mirrored_ground_carries_mirrored_loads_bit_for_bit_without_relaxation(state, axis):
    swept = sweep(state)
    mirrored = sweep(state.with_arrays(lambda a: np.flip(a, axis)))
    np.testing.assert_array_equal(np.flip(mirrored.load, axis), swept.load)
    np.testing.assert_array_equal(np.flip(mirrored.base_load, axis - 1), swept.base_load)


@given(lattice_states(relaxations=RELAXATIONS))
def test_x_and_y_are_alike(state):
    swept, turned = sweep(state), sweep(state.with_arrays(lambda a: a.transpose(0, 2, 1)))
    scale = 1e-12 * swept.total_weight
    np.testing.assert_allclose(turned.base_load.T, swept.base_load, rtol=1e-11, atol=scale)


@given(lattice_states(relaxations=RELAXATIONS), st.floats(0.0, 1.0))
def test_no_load_falls_where_E_rises(state, share):
    higher = replace(state, shed_fraction=state.shed_fraction * share)
    swept, raised = sweep(state), sweep(higher)
    slack = 1e-12 * swept.total_weight
    assert np.all(raised.load >= swept.load - slack)
    assert np.all(raised.base_load >= swept.base_load - slack)
    assert raised.shed <= swept.shed + slack


@given(lattice_states(), st.floats(0.1, 10.0))
def test_loads_are_proportional_to_density(state, factor):
    swept, heavier = sweep(state), sweep(replace(state, weight=factor * state.weight))
    np.testing.assert_allclose(heavier.load, factor * swept.load, rtol=1e-12)


@pytest.mark.parametrize("hollow", [VOID, AIR])
def test_void_below_hands_the_load_straight_down_unchanged(hollow):
    code = np.full((5, 3, 3), STAGNANT)
    code[1:4] = hollow
    state = uniform_state((5, 3, 3), 0.5, 2.0)
    weight = np.where(code == STAGNANT, np.arange(1.0, 10.0).reshape(3, 3), 0.0)
    swept = sweep(replace(state, code=code, weight=weight))
    np.testing.assert_array_equal(swept.load[4], weight[4])
    np.testing.assert_array_equal(swept.load[1:4], 0.0)  # the voids carry nothing themselves
    np.testing.assert_array_equal(swept.base_load, weight[0] + 0.5 * weight[4])


def test_load_above_rock_rests_on_the_rock_of_its_column():
    code = np.full((4, 3, 3), STAGNANT)
    code[:3] = OUTSIDE
    code[2, 0, 0] = VOID  # a void on rock: the load falls through it
    code[1:, 2, 2] = STAGNANT
    code[1:3, 1:, 1:] = STAGNANT
    state = uniform_state((4, 3, 3), 1.0, 8.0)
    weight = np.where(code == STAGNANT, 1.0, 0.0)
    swept = sweep(replace(state, code=code, weight=weight))
    assert swept.base_load.sum() == pytest.approx(weight.sum(), rel=1e-14)
    assert swept.base_load[0, 0] == 0.0  # it has granular receivers: all goes to those
    lone = replace(state, code=code.copy(), weight=weight.copy())
    lone.code[:3] = OUTSIDE
    lone.weight[:3] = 0.0
    np.testing.assert_array_equal(sweep(lone).base_load, np.ones((3, 3)))


def test_movement_zone_receivers_get_the_share_that_relaxation_leaves():
    code = np.full((2, 1, 3), STAGNANT)
    code[0, 0, 0] = MOVEMENT
    state = uniform_state((2, 1, 3), 1.0, 0.0)
    weight = np.zeros((2, 1, 3))
    weight[1, 0, 1] = 1.0
    base = sweep(replace(state, code=code, weight=weight, relaxation=0.25)).base_load
    np.testing.assert_allclose(base, [[0.25 / 2.25, 1 / 2.25, 1 / 2.25]], rtol=1e-14)


@pytest.mark.parametrize("relaxation", [0.0, 0.29, 1.0])
def test_relaxation_acts_only_beside_stagnant_receivers(relaxation):
    state = uniform_state((3, 4, 4), 0.9, 2.0)
    moving = replace(state, code=np.full(state.code.shape, MOVEMENT), relaxation=relaxation)
    np.testing.assert_allclose(sweep(moving).base_load, sweep(state).base_load, rtol=1e-12)


@pytest.mark.parametrize("s", [-128.0, 0.0, 4.0, 128.0])
def test_no_relaxed_load_reaches_the_movement_zone_at_R_0(s):
    code = np.full((2, 3, 3), MOVEMENT)
    code[0, 0, 0] = STAGNANT  # the farthest receiver of the middle cell
    weight = np.zeros((2, 3, 3))
    weight[1, 1, 1] = 1.0
    state = replace(uniform_state((2, 3, 3), 1.0, s), code=code, weight=weight, relaxation=0.0)
    assert sweep(state).base_load[0, 0] == pytest.approx(1.0, rel=1e-12)


# ---------------------------------------------------------------------------------------------
# the uniform column


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-10), (np.float32, 1e-5)])
@pytest.mark.parametrize("transmission", [0.54, 0.9895, 0.9999999, 1.0])
@pytest.mark.parametrize("top_fraction", [1.0, 0.37])
def test_uniform_column_has_the_closed_form_mean(dtype, tolerance, transmission, top_fraction):
    levels = 125
    s = np.random.default_rng(1).normal(4.0, 3.0, (levels, 6, 5))
    state = uniform_state(s.shape, transmission, s, top_fraction, weight=1420 * GRAVITY * 0.02**3)
    mean = sweep(state, dtype).base_load.mean() / 0.02**2
    expected = closed_form_stress(1420, GRAVITY, 0.02, transmission, levels - 1 + top_fraction)
    assert mean == pytest.approx(expected, rel=tolerance)


def test_closed_form_is_the_sum_of_eqs_1_and_2():
    depth = 0.0
    for own in (0.5, 1.0, 1.0, 1.0):  # half a top cell, then whole ones
        depth = depth * 0.7 + own
    assert closed_form_stress(1000, 10, 0.1, 0.7, 3.5) == pytest.approx(1000 * depth, rel=1e-14)
    assert closed_form_stress(1000, 10, 0.1, 1.0, 3.5) == 3500


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-10), (np.float32, 1e-5)])
def test_filling_follows_the_closed_form_at_every_level(column, dtype, tolerance):
    # 0.95 m is 9.5 cells; a level may end inside a cell, and inside the partial top cell
    levels = [0.04, 0.1, 0.55, 0.92]
    experiment = column(geometry={"height": 0.95}, filling={"levels": levels})
    setup = make_setup(experiment, build_block_model(experiment), dtype=dtype)
    stream = random_stream(1, "column", PACKING, 0)
    readings = simulate(setup, declared_parameters(experiment), stream)
    expected = [
        closed_form_stress(1600, GRAVITY, 0.1, 0.9, height / 0.1) / 1000
        for height in (*levels, 0.95)
    ]
    np.testing.assert_allclose(readings.base_vertical_stress, expected, rtol=tolerance)
    assert np.all(readings.weight_balance_error < 1e-6)


def test_a_lost_load_stops_the_run(column, monkeypatch):
    experiment = column()
    setup = make_setup(experiment, build_block_model(experiment))

    def leaky(*arguments):
        base_load = arguments[8]
        base_load[:] = 1.0
        return 2.0 * base_load.sum(), 0.0

    monkeypatch.setattr("pipeline.simulate.sweeps.stress_sweep", leaky)
    with pytest.raises(WeightBalanceError, match=r"column: weight balance is off by 0\.5"):
        simulate(setup, declared_parameters(experiment), random_stream(1, "column", PACKING, 0))


def test_cells_keep_their_weight_and_take_the_friction_of_their_zone():
    code = np.array([STAGNANT, MOVEMENT, VOID, AIR, OUTSIDE, MOVEMENT], np.int8).reshape(6, 1, 1)
    cell_id = np.array([3, 0, -1, -1, -1, 1], np.int32).reshape(6, 1, 1)
    zone = np.array([-1, 1, 0, -1, -1, 0], np.int16).reshape(6, 1, 1)
    moved = Moved(cell_id, zone, np.array([0.7, 0.8]))
    cell_weight = np.array([10.0, 11, 12, 13, 14, 15]).reshape(6, 1, 1)
    cell_shed = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]).reshape(6, 1, 1)
    weight, shed = place_cells(code, moved, cell_weight, cell_shed)
    np.testing.assert_array_equal(weight.ravel(), [13, 10, 0, 0, 0, 11])
    np.testing.assert_array_equal(shed.ravel(), [0.4, 0.8, 0, 0, 0, 0.7])
    _, shed = place_cells(code, moved, cell_weight, cell_shed[:1])
    np.testing.assert_array_equal(shed.ravel(), [0.1, 0.8, 0, 0, 0, 0.7])


@given(lattice_states(relaxations=RELAXATIONS), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_sweep_finds_cells_that_have_moved(state, alike, seed):
    """As one of the cells where `place_cells` puts them, bit for bit."""
    rng = np.random.default_rng(seed)
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    cells = rng.permutation(granular.size).reshape(granular.shape)
    cell_id = np.where(granular, cells, -1).astype(np.int32)
    zone = np.where(granular, rng.integers(0, 2, granular.shape), -1).astype(np.int16)
    moved = Moved(cell_id, zone, rng.random(2))
    cell_shed = state.shed_fraction[:1, :1, :1] if alike else state.shed_fraction
    weight, shed = place_cells(state.code, moved, state.weight, cell_shed)
    expected = sweep(replace(state, weight=weight, shed_fraction=shed))
    found = sweep(replace(state, shed_fraction=cell_shed), moved=moved)
    np.testing.assert_array_equal(found.base_load, expected.base_load)
    np.testing.assert_array_equal(found.load, expected.load)
    assert (found.total_weight, found.shed) == (expected.total_weight, expected.shed)


@given(lattice_states(), st.floats(0.0, 1.0))
def test_one_shed_fraction_stands_for_all(state, shed):
    one, each = (
        sweep(replace(state, shed_fraction=np.full(shape, shed)))
        for shape in ((1, 1, 1), state.code.shape)
    )
    np.testing.assert_array_equal(one.load, each.load)
    assert one.shed == each.shed


@pytest.mark.parametrize(
    ("height", "levels", "fraction"),
    [(0.5, 25, 1.0), (0.51, 26, 0.5), (0.015, 1, 0.75), (0.3, 15, 1.0), (2.5, 125, 1.0)],
)
def test_levels_and_the_filled_part_of_the_topmost(height, levels, fraction):
    assert levels_of(height, 0.02) == (levels, pytest.approx(fraction, rel=1e-6))
