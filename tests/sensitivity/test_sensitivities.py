"""Sensitivities against closed forms, the simulation itself and their own errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline import effects as catalogue
from pipeline.config.measured import MeasuredRow
from pipeline.config.stress import EMinPower, EMinTable
from pipeline.effects import Active, Effect, Parameter
from pipeline.lattice.cells import MOVEMENT, STAGNANT
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import CALIBRATION_FLOW, CALIBRATION_PACKING, replicate_streams
from pipeline.montecarlo.workers import Execution
from pipeline.observe import simulated_rows
from pipeline.parameters import declared_parameters
from pipeline.sensitivity.footprints import row_gradients
from pipeline.sensitivity.sensitivities import (
    STEP,
    STEPPED_REPLICATES,
    Case,
    coordinates,
    sensitivities,
)
from pipeline.simulate.setup import make_setup

COUNT = 4
DRAW_ONLY = ("R", "E_min", "exponent", "bulking")
LAWS = {
    "power": EMinPower(type="power", at_height=0.4, value=0.5),
    "power that meets E": EMinPower(type="power", at_height=0.1, value=0.85, exponent=1.0),
    "table that meets E": EMinTable(type="table", height=[0.0, 0.5], value=[0.9, 0.9]),
    "none": None,
}


def row(quantity="vertical_stress", load_cell=None, fill_height=None, mass_drawn=None):
    return MeasuredRow(
        load_cell,
        fill_height,
        mass_drawn,
        quantity,
        value=1.0,
        std=0.1,
        std_shared=0.0,
        count=None,
        line=1,
    )


COLUMN_ROWS = [
    row(),
    row(fill_height=0.45),
    row("vertical_stress_spatial_std"),
    row(load_cell="corner", fill_height=0.45),
]
DRAWN_ROWS = [
    row(load_cell="beside", mass_drawn=8.0),
    row("vertical_stress_ratio", "above", mass_drawn=8.0),
    row("vertical_stress_ratio", mass_drawn=12.0),
    row("vertical_stress_spatial_std", mass_drawn=8.0),
    row("movement_zone_height", mass_drawn=8.0),
]


@pytest.fixture
def column_case(column):
    def make(effects=(), **changes) -> Case:
        cell = {"name": "corner", "x": 0.1, "y": 0.1, "width": 0.15, "length": 0.2}
        defaults = {"load_cells": [cell], "walls": {"friction_angle": 25}}
        experiment = column(**(defaults | changes))
        setup = make_setup(experiment, rows=COLUMN_ROWS, dtype=np.float64)
        return Case(setup, declared_parameters(experiment), tuple(effects), COLUMN_ROWS)

    return make


@pytest.fixture
def drawn_case(drawn):
    def make(effects=(), **changes) -> Case:
        experiment = drawn(**changes)
        setup = make_setup(experiment, rows=DRAWN_ROWS, dtype=np.float64)
        return Case(setup, declared_parameters(experiment), tuple(effects), DRAWN_ROWS)

    return make


def simulated(case, parameters=None, count=COUNT, effects=None) -> np.ndarray:
    """Mean rows (row) on the streams of the sensitivities."""
    setup = case.setup
    if effects is not None:
        setup = make_setup(setup.experiment, rows=case.rows, dtype=np.float64, effects=effects)
    purposes = (CALIBRATION_PACKING, CALIBRATION_FLOW)
    dataset, _ = run_replicates(
        setup, parameters or case.parameters, count, Execution(), purposes, fields=False
    )
    return simulated_rows(setup.experiment, dataset, case.rows).mean(axis=0)


def slope_in_log_shed(case, step=1e-4) -> np.ndarray:
    ends = []
    for sign in (1, -1):
        shed = (1 - case.parameters.E) * math.exp(sign * step)
        ends.append(simulated(case, replace(case.parameters, E=1 - shed)))
    return (ends[0] - ends[1]) / (2 * step)


# ---------------------------------------------------------------------------------------------
# the adjoint


def test_E_of_a_filling_comes_from_the_adjoint_and_equals_differences(column_case):
    case = column_case()
    found = sensitivities([case], COUNT, ["E"])
    assert set(found.method.values.flat) == {"adjoint"}
    assert np.isnan(found.step).all()
    assert not found.step_error.any()
    np.testing.assert_allclose(found.sensitivity[:, 0], slope_in_log_shed(case), rtol=1e-6)
    np.testing.assert_allclose(found.simulated, simulated(case), rtol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_E_during_draw_equals_differences_for_each_law_of_E_min(drawn_case, law):
    case = drawn_case()
    case = case._replace(parameters=replace(case.parameters, E_min=LAWS[law]))
    found = sensitivities([case], COUNT, ["E"])
    assert set(found.method.values.flat) == {"adjoint"}
    np.testing.assert_allclose(
        found.sensitivity[:, 0], slope_in_log_shed(case), rtol=1e-5, atol=1e-9
    )
    assert found.sensitivity[-1, 0] == 0.0  # the zone's height has nothing to do with E


def test_mean_base_stress_has_the_closed_form_slope_in_E(column_case):
    case = column_case()
    E, levels = case.parameters.E, 10
    weight = 1600 * 9.81 * 0.1 * 1e-3
    slope = weight * sum(n * E ** (n - 1) for n in range(levels))
    found = sensitivities([case], COUNT, ["E"])
    assert float(found.sensitivity[0, 0]) == pytest.approx(-(1 - E) * slope, rel=1e-6)


def test_without_draw_a_factor_on_density_moves_readings_in_proportion(column_case):
    found = sensitivities([column_case()], COUNT, ["density_misdeclared.factor"])
    assert set(found.method.values.flat) == {"adjoint"}
    np.testing.assert_allclose(found.sensitivity[:, 0], found.simulated, rtol=1e-9)


def test_gradients_along_any_directions_come_from_one_simulation(drawn_case):
    case = drawn_case([Active("arching", {"transfer": 0.7}), Active("surcharge", {"stress": 1.0})])
    found = sensitivities([case], 1, ["R", "surcharge.stress"])
    setup = replace(case.setup, effects=case.effects)
    area = setup.lattice.cell_area * 1e3

    def project(t, sweep, influence):
        granular = np.isin(sweep.code, (STAGNANT, MOVEMENT))
        top = sweep.code.shape[0] - 1 - np.argmax(granular[::-1], axis=0)[None]
        of_top = np.take_along_axis(influence.weight, top[None], axis=1)
        return np.column_stack(
            [influence.relaxation.sum(axis=(1, 2, 3)), area * of_top.sum(axis=(1, 2, 3))]
        )

    experiment = setup.experiment
    purposes = (CALIBRATION_PACKING, CALIBRATION_FLOW)
    streams = replicate_streams(experiment, 0, purposes)
    slopes = row_gradients(setup, case.parameters, case.rows, project, *streams, of_relaxation=True)
    slopes[:, 0] /= case.parameters.R  # from log R
    np.testing.assert_allclose(slopes, found.sensitivity, rtol=1e-4, atol=1e-9)
    assert not slopes[-1].any()


def test_with_an_effect_in_force_E_comes_from_differences(column_case):
    gain = Active("sensor_gain", {"gain": 1.5}, "corner")
    plain = sensitivities([column_case()], COUNT, ["E"])
    found = sensitivities([column_case([gain])], COUNT, ["E", "sensor_gain.gain"])
    assert set(found.method.values.flat) == {"difference"}
    factor = [1.0, 1.0, 1.0, 1.5]
    np.testing.assert_allclose(found.sensitivity[:, 0], factor * plain.sensitivity[:, 0], rtol=1e-5)
    np.testing.assert_allclose(found.simulated, factor * plain.simulated, rtol=1e-12)
    np.testing.assert_allclose(found["value"][:, 1], [math.nan, math.nan, math.nan, 1.5])
    np.testing.assert_allclose(
        found.sensitivity[:, 1], [0, 0, 0, plain.simulated[3]], rtol=1e-9, atol=1e-12
    )


# ---------------------------------------------------------------------------------------------
# differences


def test_differences_equal_small_ones_of_the_simulation(drawn_case):
    case = drawn_case()
    found = sensitivities([case], COUNT, ["s.std", "s.mean", "R", "E_min"])
    assert found.step_ok.all()
    assert set(found.method.values.flat) == {"difference"}
    for name, step in (("s.std", 2e-3), ("s.mean", 4e-3), ("R", 1e-3), ("E_min", 1e-3)):
        ends = []
        for sign in (1, -1):
            value = case.parameters.value(name)
            value = value * math.exp(sign * step) if name == "s.std" else value + sign * step
            ends.append(simulated(case, case.parameters.with_values({name: value})))
        expected = (ends[0] - ends[1]) / (2 * step)
        column = found.sel(parameter=name)
        limit = column.step_error + 1e-4 * abs(expected) + 1e-9
        assert (abs(column.sensitivity - expected) <= limit).all(), name


def test_wall_friction_at_its_neutral_value_is_taken_from_one_side(column_case):
    case = column_case()
    found = sensitivities([case], COUNT, ["wall_friction.K"])
    E, radius = case.parameters.E, 0.5 * 0.4 / 1.8
    share = math.tan(math.radians(25)) * 0.1 / radius  # of a level's load, for K = 1
    weight = 1600 * 9.81 * 0.1 * 1e-3
    expected = -weight * sum(n * share * E**n for n in range(10))
    assert found.step_ok.all()
    assert float(found.sensitivity[0, 0]) == pytest.approx(expected, rel=2e-3)
    assert float(found["value"][0, 0]) == 0.0


def test_sensors_move_their_own_load_cell_alone(column_case):
    names = ["sensor_gain.gain", "sensor_offset.offset", "sensor_drift.rate"]
    found = sensitivities([column_case()], COUNT, names)
    expected = np.zeros((4, 3))
    expected[3] = found.simulated[3], 1.0, 0.0
    np.testing.assert_allclose(found.sensitivity, expected, rtol=1e-9, atol=1e-12)
    published = column_case(data_label="published simulation")
    assert set(sensitivities([published], COUNT, names).method.values.flat) == {"absent"}


def test_a_misdeclared_height_is_simulated_at_its_true_levels(column_case):
    case = column_case()
    found = sensitivities([case], COUNT, ["fill_height_misdeclared.factor"])
    step = STEP * coordinates()["fill_height_misdeclared.factor"].scale
    ends = [
        simulated(case, effects=(Active("fill_height_misdeclared", {"factor": 1 + sign * step}),))
        for sign in (1, -1)
    ]
    expected = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(found.sensitivity[:, 0], expected, rtol=0.02)
    assert (found.sensitivity[:2, 0] > 0).all()


def test_flow_parameters_take_a_larger_step_and_more_replicates(drawn_case):
    case = drawn_case()
    found = sensitivities([case], COUNT, ["bulking", "density_misdeclared.factor", "R"])
    np.testing.assert_array_equal(
        found.replicate_count[0], np.array([STEPPED_REPLICATES, STEPPED_REPLICATES, 1]) * COUNT
    )
    assert float(found.step[0, 0]) > float(found.step[0, 2])
    # more of the drawn volume stays as voids: the zone is lower
    height = found.sel(parameter="bulking").isel(reading=-1)
    assert float(height.sensitivity) < -2 * float(height.standard_error)
    ends = []
    for sign in (1, -1):
        value = case.parameters.bulking * math.exp(sign * float(found.step[0, 0]))
        moved = replace(case.parameters, bulking=value)
        ends.append(simulated(case, moved, COUNT * STEPPED_REPLICATES))
    expected = (ends[0] - ends[1]) / (2 * float(found.step[0, 0]))
    np.testing.assert_allclose(found.sensitivity[:, 0], expected, rtol=1e-9, atol=1e-12)


def test_a_step_that_cannot_be_made_small_enough_is_flagged(column_case, monkeypatch):
    def settle(cells, values):
        return replace(cells, weight=cells.weight * (1 + math.sqrt(values["amount"])))

    parameter = Parameter("amount", "1", 0.0, 0.0, 1.0, 0.5, 1, "with a slope without bounds at 0")
    effect = Effect("d", "e", "s", "study", (parameter,), "m", {"amount": 0.1}, packing=settle)
    monkeypatch.setattr(catalogue, "effects", lambda: {"steep": effect})
    found = sensitivities([column_case()], COUNT, ["steep.amount"])
    assert not found.step_ok.any()
    assert (found.step_error > 0.02 * abs(found.sensitivity)).all()
    assert float(found.step[0, 0]) == pytest.approx(0.5 * STEP / 8)


# ---------------------------------------------------------------------------------------------
# the table


def test_what_an_experiment_lacks_is_absent_and_moves_nothing(column_case):
    case = column_case(walls=None)
    found = sensitivities([case], COUNT, [*DRAW_ONLY, "wall_friction.K", "s.std"])
    assert list(found.method[0].values) == ["absent"] * 5 + ["difference"]
    assert not found.sensitivity[:, :5].any()
    assert np.isnan(found["value"][:, :5]).all()


def test_experiments_stand_one_below_the_other(column_case, drawn_case):
    cases = [column_case(), drawn_case()]
    together = sensitivities(cases, COUNT, ["E", "R"])
    assert list(together.experiment.values) == ["column"] * 4 + ["drawn"] * 5
    assert list(together.quantity.values) == [r.quantity for r in COLUMN_ROWS + DRAWN_ROWS]
    assert list(together.coordinate.values) == ["log(1 - E)", "R"]
    assert together.unit.values[-1] == "m"
    assert math.isnan(together.fill_height.values[0])
    for case, part in zip(cases, (slice(0, 4), slice(4, 9)), strict=True):
        alone = sensitivities([case], COUNT, ["E", "R"], Execution(2))
        for name in ("sensitivity", "standard_error", "simulated", "simulated_se"):
            np.testing.assert_array_equal(together[name][part], alone[name])


def test_every_parameter_of_every_effect_has_a_column(column_case):
    names = list(coordinates())
    assert names[:7] == ["E", "s.std", "s.mean", "R", "E_min", "exponent", "bulking"]
    assert len(names) == 7 + sum(len(e.parameters) for e in catalogue.effects().values())
    found = sensitivities([column_case()], 1)
    assert list(found.parameter.values) == names
    assert np.isfinite(found.sensitivity).all()
    assert np.isnan(found.standard_error).all()  # of one replicate


def test_an_unknown_parameter_is_refused_by_name(column_case):
    with pytest.raises(KeyError, match="nothing"):
        sensitivities([column_case()], COUNT, ["nothing"])
