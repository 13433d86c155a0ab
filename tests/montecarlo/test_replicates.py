"""Replicates do not depend on who computes them, in which portions, or with how many others."""

import numpy as np
import pytest

from pipeline.montecarlo import replicates, workers
from pipeline.montecarlo.replicates import run_experiment, run_replicates
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup, visits


@pytest.mark.parametrize("chunk", [1, 3, 8, 100, None])
@pytest.mark.parametrize("threads", [1, 2])
def test_no_bit_depends_on_chunks_or_threads(setup, alone, run, assert_same_bits, chunk, threads):
    assert_same_bits(run(setup, Execution(threads, chunk=chunk)), alone)


@pytest.mark.parametrize("chunk", [3, None])
def test_no_bit_depends_on_processes(setup, alone, run, assert_same_bits, chunk, monkeypatch):
    monkeypatch.setattr(replicates, "SECONDS_A_REPLICATE", 10.0)  # long enough for processes
    monkeypatch.delattr(workers, "_each_in_threads")
    assert_same_bits(run(setup, Execution(2, chunk=chunk)), alone)


def test_a_replicate_does_not_depend_on_how_many_there_are(setup):
    declared = declared_parameters(setup.experiment)
    few, _ = run_replicates(setup, declared, 3, fields=False)
    many, _ = run_replicates(setup, declared, 9, fields=False)
    for name in few.data_vars:
        if few[name].dims[:1] == ("replicate",):
            kept = few[name].values
            other = many[name].values[:3]
            width = min(kept.shape[-1], other.shape[-1]) if "extraction" in few[name].dims else None
            np.testing.assert_array_equal(kept[..., :width], other[..., :width], err_msg=name)


def test_replicates_and_experiments_differ_from_each_other(setup, alone, run):
    base = alone[0]["base_vertical_stress_std"].values[:, -1]
    assert len(set(base)) == len(base)
    other = make_setup(setup.experiment.at("elsewhere.yaml"))
    assert not np.any(np.isin(run(other)[0]["base_vertical_stress_std"], base))


def test_what_calibration_changed_stands_beside_the_declared_run(setup, alone):
    declared = declared_parameters(setup.experiment)
    expected, _ = run_replicates(setup, declared, 10, fields=False)
    np.testing.assert_array_equal(
        alone[0]["vertical_stress_as_declared"], expected["vertical_stress"]
    )
    only, _ = run_experiment(setup, declared, declared)
    assert not any("as_declared" in name for name in only)


def test_kept_fields_are_what_the_fields_average(setup, alone):
    readings, fields = alone
    kept = readings["replicate_vertical_stress"].values
    stress = np.where(kept > 0, kept, np.nan)
    some = np.isfinite(stress).any(axis=0)
    mean = np.nanmean(stress[:, some], axis=0)
    np.testing.assert_allclose(fields["vertical_stress_mean"].values[some], mean, rtol=1e-5)


def test_the_first_replicate_stands_beside_the_mean(setup, alone):
    readings, fields = alone
    first = readings["replicate_vertical_stress"].values[0]
    material = first > 0
    np.testing.assert_allclose(
        fields["vertical_stress_first"].values[material], first[material], rtol=1e-6
    )
    assert np.isnan(fields["vertical_stress_first"].values[~material]).all()


def test_draw_visits_the_line_in_turn_until_its_mass(drawn):
    points = [
        {"name": n, "x": x, "y": 0.25, "width": 0.1, "length": 0.1}
        for n, x in (("west", 0.1), ("east", 0.5))
    ]
    experiment = drawn(
        drawpoints=points,
        draw=[
            {"drawpoints": ["west", "east"], "mass": 2.5, "increment": 1.0},
            {"drawpoints": ["east"], "mass": 1.0, "increment": 1.0},
        ],
        readings={"every": 1.0},
    )
    assert list(visits(experiment)) == [(0, 1.0), (1, 2.0), (0, 2.5), (1, 3.5)]
