"""The model of a study's readings: reproducible, cheap where it can be, and in logarithms."""

import math
from dataclasses import replace
from pickle import dumps, loads

import numpy as np
import pytest
from worlds import at_levels, make_world, walled

from pipeline.effects import effects
from pipeline.loop.covariance import noise
from pipeline.loop.fit import calibrated, fit
from pipeline.loop.model import STEP, Term, limits
from pipeline.montecarlo.workers import Execution


def term(name, parameter, model, key=None, scope="study", cases=None):
    """A term of an effect, of all cases unless they are given."""
    return Term(name, parameter, scope, key, cases or tuple(range(len(model.cases))))


def elsewhere(model):
    """A point away from the start, with a ground effect, an input and a sensor."""
    terms = [
        term("surcharge", "stress", model),
        term("density_misdeclared", "factor", model),
        term("sensor_gain", "gain", model, "west", "load_cell"),
    ]
    point = model.start.with_terms(terms, [0.4, 1.1, 0.9])
    return point.moved([c - 0.3 for c in point.coordinates], point.amplitudes)


@pytest.fixture(scope="module")
def model(mixed):
    return mixed.problem().model


# ---------------------------------------------------------------------------------------------
# how it is computed changes no bit


def test_workers_chunks_and_order_change_no_bit(mixed, monkeypatch):
    one, two = mixed.problem().model, mixed.problem(workers=2).model
    assert two.execution == Execution(2)
    point = elsewhere(one)
    other = one.start
    two.prepare([(point, None), (other, None), (point, other)])  # all at once, and before the rest
    for model_at in ((other, None), (point, None), (point, other)):
        np.testing.assert_array_equal(one.mean(*model_at), two.mean(*model_at))
    whole = [one.scatter(point, case, 21) for case in range(2)]
    monkeypatch.setattr("pipeline.loop.model.CHUNK", 4)
    for case, expected in enumerate(whole):
        np.testing.assert_array_equal(two.scatter(point, case, 21), expected)


def test_common_replicates_are_the_first_of_the_scatter(model):
    point = elsewhere(model)
    for case, where in enumerate(model.slices):
        rows = model.scatter(point, case, 6)
        few = model.scatter(point, case, model.common(case))
        np.testing.assert_array_equal(rows[: model.common(case)], few)
        assert rows.shape == (6, where.stop - where.start)


def test_the_flow_of_another_point_is_kept_where_asked(model):
    """Only what acts on mass or flow itself moves the movement zone's height."""
    height = [row.quantity for row in model.rows].index("movement_zone_height")
    denser = model.start.with_terms([term("density_misdeclared", "factor", model)], [1.5])
    fixed, free = model.mean(denser, model.start), model.mean(denser)
    assert fixed[height] == model.mean(model.start)[height] != free[height]


def test_a_view_of_some_rows_simulates_their_cases_alone(mixed):
    model = mixed.problem().model
    view = model.only(range(model.slices[1].start, model.slices[1].stop))
    rows = view.mean(model.start)
    assert np.isnan(rows[model.slices[0]]).all()
    assert model.simulated == model.common(1)
    np.testing.assert_array_equal(rows[model.slices[1]], model.mean(model.start)[model.slices[1]])


# ---------------------------------------------------------------------------------------------
# terms


@pytest.mark.parametrize("name", [n for n in effects() if n != "local_rule"])
def test_a_neutral_term_changes_nothing_and_needs_no_simulation(model, name):
    expected, effect = model.mean(model.start), effects()[name]
    before = model.simulated
    key = "west" if effect.scope == "load_cell" else None
    terms = [term(name, p.name, model, key, effect.scope) for p in effect.parameters]
    same = model.start.with_terms(terms, [p.neutral for p in effect.parameters])
    np.testing.assert_array_equal(model.mean(same), expected)
    assert model.simulated == before


def test_density_raises_static_stresses_in_proportion(mixed):
    model = mixed.problem().model
    factor = term("density_misdeclared", "factor", model)
    _, slopes = model.jacobian(model.start, [factor])
    step = STEP * factor.described.scale
    static = slopes[model.slices[1], 0]
    np.testing.assert_allclose(static, math.log1p(step) / step, rtol=1e-4)
    double = model.mean(model.start.with_terms([factor], [2.0])) - model.mean(model.start)
    np.testing.assert_allclose(double[model.slices[1]], math.log(2.0), rtol=1e-6)


def test_sensors_need_no_simulation(mixed):
    model = mixed.problem().model
    base = model.mean(model.start)
    model.scatter(model.start, 1, 6)
    model.jacobian(model.start)
    before = model.simulated
    gain = term("sensor_gain", "gain", model, "west", "load_cell")
    offset = term("sensor_offset", "offset", model, "west", "load_cell")
    point = model.start.with_terms([gain, offset], [0.8, 0.0])
    west = np.array([row.load_cell == "west" for row in model.rows])
    np.testing.assert_allclose((model.mean(point) - base)[west], math.log(0.8), rtol=1e-12)
    np.testing.assert_array_equal(model.mean(point)[~west], base[~west])
    model.scatter(point, 1, 6)
    _, slopes = model.jacobian(model.start, [gain, offset])
    assert slopes[west].all()
    assert not slopes[~west].any()
    assert model.simulated == before


def test_load_cells_of_one_name_are_those_that_an_experiment_has(model):
    gain = term("sensor_gain", "gain", model, "west", "load_cell")
    point = model.start.with_terms([gain], [0.8])
    assert [len(model.at(point, case)[1]) for case in range(2)] == [0, 1]


def test_amplitudes_stay_on_the_side_that_physics_leaves_them(model):
    for effect in effects().values():
        for parameter in effect.parameters:
            name = next(n for n, e in effects().items() if e is effect)
            low, high = limits(term(name, parameter.name, model))
            assert parameter.low <= low <= parameter.neutral <= high <= parameter.high
            assert parameter.sign <= 0 or low == parameter.neutral
            assert parameter.sign >= 0 or high == parameter.neutral


# ---------------------------------------------------------------------------------------------
# expectations


@pytest.fixture(scope="module")
def counted(tmp_path_factory):
    """A column whose three readings are of one packing, of five, and of no stated number."""
    rows = [{**row, "count": n} for row, n in zip(at_levels(), (1, 5, None), strict=True)]
    folder = tmp_path_factory.mktemp("counted") / "w"
    study = {"experiments": ["a", "b"], "hold_out": ["b"]}
    files = {name: walled(0.3, 20) for name in "ab"}
    return make_world(folder, files, dict.fromkeys("ab", rows), study).problem().model


def test_expected_values_lie_between_mean_log_and_log_mean(counted):
    rows = np.random.default_rng(3).lognormal(1.0, 0.5, (40, 3))
    whole, each = np.log(rows.mean(axis=0)), np.log(rows).mean(axis=0)
    found = counted._expected(0, rows)
    assert found[0] == pytest.approx(each[0], rel=1e-12)
    assert found[1] == pytest.approx(0.2 * each[1] + 0.8 * whole[1], rel=1e-12)
    assert found[2] == pytest.approx(whole[2], rel=1e-12)
    assert (each < whole).all()


def test_geometry_is_expected_as_it_is(model):
    height = [row.quantity for row in model.rows].index("movement_zone_height")
    assert not model.is_log[height]
    rows = model.scatter(model.start, 0, model.common(0))
    assert model.mean(model.start)[height] == rows[:, height].mean()


def test_a_stress_that_vanishes_is_floored(counted):
    rows = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    found = counted._expected(0, rows)
    assert found[0] == pytest.approx(0.5 * math.log(0.01))
    assert np.isfinite(found).all()


# ---------------------------------------------------------------------------------------------
# what is taken up from an earlier run


def test_recalled_replicates_stand_for_simulated_ones(mixed):
    problem = mixed.problem()
    first, data = problem.model.only(problem.data.use), problem.data
    found, here = calibrated(first, data, first.start)
    kept = {case: first.kept(found.reference, case) for case in first.active}

    later = mixed.problem().model.only(data.use)
    for case, values in kept.items():
        later.recall(found.reference, case, values)
    again = noise(later, found.reference, data)
    for a, b in zip((*here.parts, here.lower), (*again.parts, again.lower), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(later.mean(found.reference), first.mean(found.reference))
    assert later.simulated == 0
    one, other = (
        fit(model, data, here, found.point, found.reference, found.slopes)
        for model in (first, later)
    )
    assert one.point == other.point
    assert one.cost == other.cost


def test_a_model_for_another_process_remembers_nothing_and_says_the_same(mixed):
    model = mixed.problem(workers=2).model
    expected = model.mean(model.start)
    other = loads(dumps(model.alone()))
    assert other.execution == Execution()
    assert not other._values
    assert not other._flows
    np.testing.assert_array_equal(other.mean(model.start), expected)


def test_the_model_knows_no_measured_value(model):
    for case in model.cases:
        for row in case.rows:
            assert all(math.isnan(v) for v in (row.value, row.std, row.std_shared))


def test_E_is_carried_to_each_lattice(model):
    """One E for a material: its length ℓ is the same where cells have other sizes."""
    coordinate = next(c for c in model.coordinates if c.name == "E")
    assert coordinate.cases == (0, 1)
    point = replace(model.start, coordinates=tuple(c.start - 0.4 for c in model.coordinates))
    lengths = [model.at(point, case)[0].attenuation_length for case in range(2)]
    # exactly the same stress under a full column, so nearly the same length
    assert lengths[0] == pytest.approx(lengths[1], rel=0.15)
