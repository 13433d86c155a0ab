"""A draw experiment as a whole: what draw must leave alone, conserve and mirror."""

import numpy as np
import pytest

from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.parameters import carry_transmission, declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup, visits


def run(experiment, replicate=0, parameters=None):
    setup = make_setup(experiment)
    streams = (
        random_stream(experiment.seed, "draw", purpose, replicate) for purpose in (PACKING, FLOW)
    )
    return simulate(setup, parameters or declared_parameters(experiment), *streams), setup


def test_before_draw_the_reading_is_that_of_the_static_experiment_bit_for_bit(column, drawn):
    in_draw, _ = run(drawn())
    cells = [cell.model_dump() for cell in drawn().load_cells]
    at_rest, _ = run(
        column(
            geometry={"width": 0.6, "length": 0.5, "height": 0.8, "cell_size": 0.05},
            load_cells=cells,
        )
    )
    np.testing.assert_array_equal(in_draw.vertical_stress[0], at_rest.vertical_stress[0])
    assert in_draw.base_vertical_stress_std[0] == at_rest.base_vertical_stress_std[0]


def test_weight_is_conserved_at_every_reading_of_a_draw(drawn):
    readings, _ = run(drawn())
    assert readings.weight_balance_error.max() < 1e-12


def test_every_drawn_cell_is_in_the_extraction_record_once(drawn):
    readings, setup = run(drawn())
    assert len(np.unique(readings.drawn_cell)) == len(readings.drawn_cell)
    masses = setup.cell_weight[readings.drawn_cell].astype(float) / 9.81
    np.testing.assert_allclose(np.cumsum(masses), readings.drawn_mass, rtol=1e-9)
    assert readings.drawn_mass[-1] == pytest.approx(12.0, abs=masses.max())


def test_readings_do_not_change_the_flow(drawn):
    often, _ = run(drawn(readings={"every": 0.7}))
    seldom, _ = run(drawn(readings={"every": 6.0}))
    np.testing.assert_array_equal(often.drawn_cell, seldom.drawn_cell)
    np.testing.assert_array_equal(often.drawn_mass, seldom.drawn_mass)
    assert often.movement_zone_height[-1] == seldom.movement_zone_height[-1]


def test_stress_parameters_do_not_change_the_flow(drawn):
    one, _ = run(drawn())
    other, _ = run(drawn(stress={"R": 1.0, "s": {"mean": 0, "std": 1}}))
    np.testing.assert_array_equal(one.drawn_cell, other.drawn_cell)
    assert not np.array_equal(one.vertical_stress[0], other.vertical_stress[0])


def test_an_empty_drawpoint_is_reported_and_the_schedule_goes_on(drawn):
    """A one-cell opening with full bulking hangs up at once; the second drawpoint is drawn."""
    points = [
        {"name": "stuck", "x": 0.125, "y": 0.125, "width": 0.05, "length": 0.05},
        {"name": "free", "x": 0.45, "y": 0.25, "width": 0.2, "length": 0.2},
    ]
    draw = [
        {"drawpoints": ["stuck"], "mass": 12.0, "increment": 1.0},
        {"drawpoints": ["free"], "mass": 3.0, "increment": 1.0},
    ]
    readings, _ = run(drawn(drawpoints=points, draw=draw, flow={"bulking": 1.0}))
    assert readings.drawpoint_shortfall[0] > 1.0
    assert readings.drawpoint_shortfall[1] == 0.0
    from_free = readings.drawn_drawpoint == 1
    cell = 0.05**3 * 1600
    assert np.count_nonzero(from_free) * cell == pytest.approx(3.0, abs=cell)
    drawn_mass = readings.drawn_mass[-1]
    assert drawn_mass + readings.drawpoint_shortfall.sum() == pytest.approx(15.0, abs=2 * cell)


def test_the_schedule_draws_in_turn_up_to_each_lines_mass(drawn):
    points = [
        {"name": name, "x": x, "y": 0.25, "width": 0.1, "length": 0.1}
        for name, x in (("a", 0.15), ("b", 0.45))
    ]
    draw = [
        {"drawpoints": ["a", "b"], "mass": 2.5, "increment": 1.0},
        {"drawpoints": ["b"], "mass": 0.5, "increment": 0.5},
    ]
    schedule = list(visits(drawn(drawpoints=points, draw=draw, readings={"every": 1.0})))
    assert schedule == [(0, 1.0), (1, 2.0), (0, 2.5), (1, 3.0)]


def test_stress_falls_in_the_movement_zone_and_rises_beside_it(drawn):
    experiment = drawn(replicates=12)
    setup = make_setup(experiment)
    readings, _ = run_replicates(setup, declared_parameters(experiment), 12, fields=False)
    stress = readings["vertical_stress"].values
    ratio = (stress[:, -1] / stress[:, 0]).mean(axis=0)
    beside, above = ratio
    assert above < 0.9
    assert beside > above


def test_a_mirrored_layout_gives_mirrored_statistics(drawn):
    """Two-sample z-tests of 2 cells, 30 fixed seeds each side; family error 0.01."""

    def ends(mirror):
        def x(value):
            return 0.6 - value if mirror else value

        points = [{"name": "p", "x": x(0.2), "y": 0.25, "width": 0.1, "length": 0.1}]
        cells = [
            {"name": name, "x": x(at), "y": 0.25, "width": 0.1, "length": 0.2}
            for name, at in (("near", 0.1), ("far", 0.5))
        ]
        experiment = drawn(
            name="mirror" if mirror else "straight",
            drawpoints=points,
            load_cells=cells,
            draw=[{"drawpoints": ["p"], "mass": 12.0, "increment": 1.0}],
        )
        setup = make_setup(experiment)
        readings, _ = run_replicates(setup, declared_parameters(experiment), 30, fields=False)
        return readings["vertical_stress"].values[:, -1]

    one, other = ends(False), ends(True)
    error = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / 30)
    z = np.abs(one.mean(axis=0) - other.mean(axis=0)) / error
    assert z.max() < 2.81, z  # two-sided 0.005 for each of two cells


def test_connected_zones_have_their_own_height(drawn):
    """A zone drawn much and one drawn little transmit by their own heights."""
    parameters = declared_parameters(drawn())
    shed = parameters.shed_in_zone(np.array([0.1, 0.4, 10.0]))
    assert shed[0] > shed[1] == pytest.approx(0.5)
    assert shed[2] == pytest.approx(0.1)  # never below 1 − E


def test_transmission_carried_to_other_cells_keeps_the_base_stress():
    for E, fine in ((0.9895, 0.01), (0.54, 0.0025)):
        carried = carry_transmission(E, 0.02, fine, 0.5)

        def column(cell, e):
            return cell * (1 - e ** (0.5 / cell)) / (1 - e)

        assert column(fine, carried) == pytest.approx(column(0.02, E), rel=1e-9)
    assert carry_transmission(0.9, 0.02, 0.02, 0.5) == 0.9
    with pytest.raises(ValueError, match="less than one cell"):
        carry_transmission(0.1, 0.01, 0.1, 0.5)
