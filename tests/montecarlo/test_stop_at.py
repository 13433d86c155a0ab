"""A run that stops when it is precise enough: at the same count whoever computes."""

import numpy as np
import pytest

from pipeline.config.experiment import StopAt
from pipeline.montecarlo import checkpoints
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.workers import Execution
from pipeline.simulate.setup import make_setup

CELLS = [{"name": "C", "x": 0.25, "y": 0.2, "width": 0.1, "length": 0.1}]
MOST = 100


@pytest.fixture(scope="module")
def stopping(column):
    """stopping(standard_error, at_least, most): a setup with a load cell that scatters."""

    def make(standard_error=None, at_least=5, most=MOST):
        experiment = column(replicates=most, load_cells=CELLS)
        if standard_error is not None:
            stop_at = StopAt(standard_error=standard_error, at_least=at_least)
            experiment = experiment.model_copy(update={"stop_at": stop_at})
        return make_setup(experiment)

    return make


@pytest.fixture(scope="module")
def errors(stopping, run):
    """Largest standard error, kPa, by the number of replicates."""
    stress = run(stopping())[0]["vertical_stress"].values
    return {
        n: (stress[:n].std(axis=0, ddof=1) / np.sqrt(n)).max() for n in (5, 10, 20, 40, 80, MOST)
    }


@pytest.fixture(scope="module")
def target(errors):
    """A standard error first reached with 40 replicates, kPa."""
    between = (min(errors[n] for n in (5, 10, 20)), errors[40])
    assert between[0] > between[1]
    return sum(between) / 2


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("chunk", [1, 3, 50, None])
def test_it_stops_at_the_first_doubling_that_is_precise_whoever_computes(
    stopping, target, run, assert_same_bits, workers, chunk
):
    results = run(stopping(target), Execution(workers, chunk=chunk))
    assert results[0].sizes["replicate"] == 40
    assert int(results[1]["replicate_count"]) == 40
    assert_same_bits(results, run(stopping(most=40)))


def test_it_runs_to_the_end_where_the_precision_is_not_reached(stopping, run, assert_same_bits):
    assert_same_bits(run(stopping(1e-9)), run(stopping()))


def test_the_largest_of_all_readings_and_load_cells_counts(stopping, errors, run):
    loose = run(stopping(1.001 * errors[5]))[0]
    tight = run(stopping(0.999 * errors[5]))[0]
    assert loose.sizes["replicate"] == 5
    assert tight.sizes["replicate"] > 5


def test_what_an_earlier_run_kept_changes_no_count_and_no_bit(
    stopping, target, run, assert_same_bits, tmp_path, monkeypatch
):
    monkeypatch.setattr(checkpoints, "WRITING", np.inf)
    expected = run(stopping(target))
    for earlier in (stopping(), stopping(most=30), stopping(target)):
        run(earlier, Execution(chunk=7), Checkpoints(tmp_path, "key"))
        again = run(stopping(target), Execution(), Checkpoints(tmp_path, "key"))
        assert_same_bits(again, expected)
