"""Field sums: any order gives the same bits, and they are the numbers that NumPy gives."""

import tracemalloc
from copy import deepcopy
from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.lattice.cells import AIR, MOVEMENT, OUTSIDE, VOID
from pipeline.montecarlo.fields import FieldSums
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

SUMS = ("stress", "square", "granular", "movement", "void", "density")
COUNT = 7


def _setup(experiment):
    return make_setup(experiment, dtype=np.float64)


@pytest.fixture(scope="module", params=["column", "drawn", "cylinder"])
def kept(request, column, drawn):
    """A setup, the sums of single replicates and, for each, its states (time by time)."""
    if request.param == "drawn":
        experiment = drawn()
    elif request.param == "cylinder":
        experiment = column(geometry={"length": 0.5, "mask": {"type": "cylinder"}})
    else:
        experiment = column(filling={"levels": [0.25, 0.7]}, geometry={"height": 0.95})
    setup, parts, states = _setup(experiment), [], []
    for k in range(COUNT):
        sums, state = FieldSums.empty(setup), []

        def observe(t, code, cell_id, load, sums=sums, state=state):
            sums.observe(t, code, cell_id, load)
            state.append((code.copy(), cell_id.copy(), load.astype(np.float64)))

        streams = (random_stream(1, "fields", purpose, k) for purpose in (PACKING, FLOW))
        simulate(setup, declared_parameters(experiment), *streams, observe)
        sums.count = 1
        parts.append(sums)
        states.append(state)
    return setup, parts, states


def _add(parts):
    return reduce(lambda total, part: total.__iadd__(part), parts, FieldSums.empty(parts[0].setup))


@given(order=st.permutations(range(COUNT)), cut=st.integers(0, COUNT))
def test_sums_merge_in_any_order_and_grouping_to_the_same_bits(kept, order, cut):
    _, parts, _ = kept
    shuffled = [parts[k] for k in order]
    grouped = _add([_add(shuffled[:cut] or [FieldSums.empty(parts[0].setup)]), *shuffled[cut:]])
    straight = _add(parts)
    assert grouped.count == straight.count == COUNT
    for name in SUMS:
        np.testing.assert_array_equal(getattr(grouped, name), getattr(straight, name))
    assert grouped.finalise().identical(straight.finalise())


def test_merging_leaves_the_other_sums_alone(kept):
    _, parts, _ = kept
    before = deepcopy(parts[1].stress)
    _add(parts)
    np.testing.assert_array_equal(parts[1].stress, before)


def test_fields_equal_plain_mean_and_standard_deviation(kept):
    setup, parts, states = kept
    fields = _add(parts).finalise()
    area = setup.lattice.cell_area
    overburden = 1.6 * 9.81 * setup.experiment.geometry.height
    for t in range(setup.times):
        levels = len(states[0][t][0])
        codes = np.array([state[t][0] for state in states])
        loads = np.array([state[t][2] for state in states]) / area / 1000
        stress = np.where(loads > 0, loads, np.nan)
        n = (loads > 0).sum(axis=0)
        where = n > 1
        np.testing.assert_allclose(
            fields["vertical_stress_mean"].values[t, :levels][where],
            np.nanmean(stress[:, where], axis=0),
            rtol=1e-6,
        )
        std = np.nanstd(stress[:, where], axis=0, ddof=1)
        ours = fields["vertical_stress_std"].values[t, :levels][where]
        # the grid of squares, 2^-36 of the overburden's, is felt below 1 % of it
        scattered = std > 0.01 * overburden
        np.testing.assert_allclose(ours[scattered], std[scattered], rtol=1e-6)
        np.testing.assert_allclose(ours, std, atol=1e-5 * overburden)
        assert np.isnan(fields["vertical_stress_std"].values[t, :levels][n < 2]).all()
        void = ((codes == VOID) | (codes == AIR)).mean(axis=0)
        inside = codes[0] != OUTSIDE
        np.testing.assert_allclose(
            fields["void_probability"].values[t, :levels][inside], void[inside], rtol=1e-6
        )
        zone = np.isin(codes, [MOVEMENT, VOID, AIR]).mean(axis=0)
        np.testing.assert_allclose(
            fields["movement_zone_probability"].values[t, :levels][inside], zone[inside], rtol=1e-6
        )
        above = fields.isel(time=t, z=slice(levels, None))
        assert all(np.isnan(above[name]).all() for name in above if "z" in above[name].dims)


def test_mass_of_the_fields_is_the_mass_in_the_model(kept):
    setup, parts, states = kept
    fields = _add(parts).finalise()
    last = fields["bulk_density_mean"].isel(time=-1).sum() * setup.lattice.cell_volume
    masses = [
        setup.cell_weight.astype(np.float64)[cell_id[load > 0]].sum() / 9.81
        for *_, (_, cell_id, load) in states
    ]
    assert float(last) == pytest.approx(np.mean(masses), rel=1e-5)


def test_nothing_is_said_of_stress_outside_the_ground(kept):
    setup, parts, _ = kept
    fields = _add(parts).finalise()
    outside = setup.code == OUTSIDE
    for name in ("vertical_stress_mean", "bulk_density_mean", "void_probability"):
        assert np.isnan(fields[name].values[:, outside]).all()


def test_one_replicate_has_a_mean_and_no_standard_deviation(column):
    experiment = column(replicates=1)
    _, sums = run_replicates(_setup(experiment), declared_parameters(experiment), 1, Execution())
    fields = sums.finalise()
    assert np.isfinite(fields["vertical_stress_mean"]).all()
    assert np.isnan(fields["vertical_stress_std"]).all()
    assert int(fields["replicate_count"]) == 1


def test_many_times_take_less_memory_than_their_sums(column):
    levels = np.linspace(0.3, 0.9, 30).tolist()
    sums = FieldSums.empty(_setup(column(filling={"levels": levels}, geometry={"cell_size": 0.05})))
    sums.count = 1
    held = sum(getattr(sums, name).nbytes for name in SUMS)
    tracemalloc.start()
    sums.finalise()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < held
