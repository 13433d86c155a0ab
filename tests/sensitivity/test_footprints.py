"""Footprints of load cells add up to their readings and answer to E as the simulation does."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.effects import Active
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream, replicate_streams
from pipeline.parameters import declared_parameters
from pipeline.sensitivity import footprints
from pipeline.sensitivity.footprints import gradient_cost, influence_fields
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

LINEAR = (  # effects that leave the sweep linear in the weights
    Active("arching", {"transfer": 0.7}),
    Active("tilt", {"angle_x": 5.0, "angle_y": -3.0}),
    Active("surcharge", {"stress": 2.0}),
)


def streams():
    return [random_stream(3, "footprints", purpose, 0) for purpose in (PACKING, FLOW)]


@pytest.fixture(params=["filling", "cylinder", "draw", "draw with effects"])
def setup(request, column, drawn):
    if request.param.startswith("draw"):
        experiment = drawn()
    elif request.param == "cylinder":
        experiment = column(geometry={"length": 0.5, "mask": {"type": "cylinder"}})
    else:
        experiment = column(filling={"levels": [0.25, 0.7]}, geometry={"height": 0.95})
    effects = LINEAR if request.param.endswith("effects") else ()
    return make_setup(experiment, effects=effects)


@pytest.mark.parametrize("at", [0, -1])
def test_a_reading_is_the_sum_of_its_footprint_times_weights(setup, at):
    parameters = declared_parameters(setup.experiment)
    fields = influence_fields(setup, parameters, *streams(), at=at)
    readings = simulate(setup, parameters, *streams())
    np.testing.assert_allclose(fields["vertical_stress"], readings.vertical_stress[at], rtol=1e-12)
    total = (fields["weight_influence"] * fields["weight"]).sum(["z", "y", "x"])
    np.testing.assert_allclose(total, fields["vertical_stress"], rtol=1e-6)


def test_footprint_in_log_shed_is_the_slope_of_the_reading_in_E(column):
    experiment = column(
        filling={"levels": [0.7]},
        load_cells=[
            {"name": "middle", "x": 0.25, "y": 0.2, "width": 0.1, "length": 0.13},
        ],
    )
    setup = make_setup(experiment, dtype=np.float64)
    parameters = declared_parameters(experiment)
    fields = influence_fields(setup, parameters, *streams(), at=0)
    assert fields.sizes == {"load_cell": 1, "z": 7, "y": 4, "x": 5}
    ends = []
    for sign in (1, -1):
        moved = replace(parameters, E=1 - (1 - parameters.E) * np.exp(sign * 1e-4))
        ends.append(simulate(setup, moved, *streams()).vertical_stress[0, 0])
    expected = (ends[0] - ends[1]) / 2e-4
    assert float(fields["log_shed_influence"].sum()) == pytest.approx(expected, rel=1e-7)


def test_a_reading_that_does_not_exist_is_an_index_error(column):
    experiment = column()
    setup = make_setup(experiment)
    with pytest.raises(IndexError):
        influence_fields(setup, declared_parameters(experiment), *streams(), at=1)


def test_cost_of_a_gradient_is_measured_against_a_forward_sweep(column):
    experiment = column()
    setup = make_setup(experiment)
    cost = gradient_cost(setup, declared_parameters(experiment), streams()[0], repeats=2)
    assert cost["cells"] == 10 * 4 * 5
    assert cost["ratio"] == cost["gradient"] / cost["forward"] > 0


@pytest.mark.parametrize("cells", [1.0, 1e9])
def test_footprints_are_the_same_load_cell_by_load_cell_or_all_at_once(drawn, monkeypatch, cells):
    experiment = drawn(replicates=2)
    setup = make_setup(experiment)
    parameters = declared_parameters(experiment)
    expected = 0.0
    for replicate in range(2):
        random = replicate_streams(experiment, replicate)
        fields = influence_fields(setup, parameters, *random, at=0)
        share = fields["weight_influence"] * fields["weight"] / fields["vertical_stress"]
        expected = expected + share.sum("y").transpose("load_cell", "z", "x").values
    monkeypatch.setattr(footprints, "GROUP_CELLS", cells)
    found = footprints.load_cell_footprint(setup, parameters)
    np.testing.assert_array_equal(found, (expected / 2).astype(np.float32))
