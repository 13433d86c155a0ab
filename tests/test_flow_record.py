"""A recorded flow stands for its stream."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.effects import Active
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import record_flow, simulate
from pipeline.simulate.setup import make_setup

EFFECTS = (
    (),
    (Active("arching", {"transfer": 0.7}),),
    (Active("density_misdeclared", {"factor": 1.3}), Active("surcharge", {"stress": 1.0})),
)
DRAWS = {
    "flow": st.fixed_dictionaries(
        {"exponent": st.sampled_from([0.5, 2, 6]), "bulking": st.sampled_from([0.0, 0.2, 0.5])}
    ),
    "stress": st.fixed_dictionaries({"E": st.sampled_from([0.8, 0.97])}),
    "readings": st.fixed_dictionaries({"every": st.sampled_from([1.5, 4.0, 12.0])}),
    "seed": st.just(2022),
}


def streams(seed):
    return [random_stream(seed, "record", purpose, 0) for purpose in (PACKING, FLOW)]


def assert_same(one, other):
    """Every field of two replicates' readings, bit for bit."""
    for name, value in vars(one).items():
        np.testing.assert_array_equal(value, vars(other)[name], err_msg=name)


@settings(max_examples=15)
@given(
    changes=st.fixed_dictionaries(DRAWS),
    effects=st.sampled_from(EFFECTS),
    seed=st.integers(0, 2**31),
)
def test_a_recorded_flow_gives_the_bits_of_its_stream(drawn, changes, effects, seed):
    experiment = drawn(keep_fields=True, **changes)
    setup = make_setup(experiment, effects=effects)
    parameters = declared_parameters(experiment)
    flow = record_flow(setup, parameters, *streams(seed))
    packing, stream = streams(seed)
    expected = simulate(setup, parameters, packing, stream)
    for _ in range(2):  # it can be used again
        assert_same(simulate(setup, parameters, streams(seed)[0], flow), expected)


def test_recording_draws_from_the_flow_stream_what_simulating_draws(drawn):
    experiment = drawn()
    setup = make_setup(experiment)
    parameters = declared_parameters(experiment)
    after = []
    for use in (record_flow, simulate):
        packing, flow = streams(1)
        use(setup, parameters, packing, flow)
        after.append(flow.random(4))
    np.testing.assert_array_equal(*after)


def test_recording_leaves_other_streams_and_the_setup_as_they_were(drawn):
    experiment = drawn()
    setup = make_setup(experiment)
    parameters = declared_parameters(experiment)
    before = simulate(setup, parameters, *streams(1))
    kept = setup.code.copy(), setup.cell_weight.copy()
    record_flow(setup, parameters, *streams(2))
    assert_same(simulate(setup, parameters, *streams(1)), before)
    np.testing.assert_array_equal(setup.code, kept[0])
    np.testing.assert_array_equal(setup.cell_weight, kept[1])


@pytest.mark.parametrize("other", [{"E": 0.8}, {"s_mean": 1.0, "s_std": 0.5}, {"R": 0.9}])
def test_stress_parameters_leave_the_flow_as_it_was(drawn, other):
    experiment = drawn()
    setup = make_setup(experiment)
    parameters = declared_parameters(experiment)
    changed = type(parameters)(**(vars(parameters) | other))
    one, two = (record_flow(setup, p, *streams(3)) for p in (parameters, changed))
    for a, b in zip(one, two, strict=True):
        for name in a._fields:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_its_size_is_that_of_its_arrays(drawn):
    experiment = drawn()
    setup = make_setup(experiment)
    record = record_flow(setup, declared_parameters(experiment), *streams(1))
    assert len(list(record)) == setup.times
    assert record.nbytes > setup.times * setup.code.size * (1 + 4)  # codes and identities
