"""A static and a draw experiment, their results from one worker, and how to compare results."""

import numpy as np
import pytest

from pipeline.montecarlo.replicates import run_experiment
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup


@pytest.fixture(scope="session")
def run():
    """run(setup, execution, checkpoints): replicates and fields, s changed by a calibration."""

    def results(setup, execution=Execution(), checkpoints=None):
        declared = declared_parameters(setup.experiment)
        used = declared.with_values({"s": 2.0})
        return run_experiment(setup, used, declared, execution, checkpoints)

    return results


@pytest.fixture(scope="session", params=["static", "draw"])
def setup(request, column, drawn):
    """A setup of ten replicates."""
    make = column if request.param == "static" else drawn
    changes = {"filling": {"levels": [0.3]}} if request.param == "static" else {}
    experiment = make(replicates=10, keep_fields=True, **changes)
    return make_setup(experiment)


@pytest.fixture(scope="session")
def alone(setup, run):
    """Its replicates and fields from one worker."""
    return run(setup)


@pytest.fixture(scope="session")
def assert_same_bits():
    """assert_same_bits(results, others): every variable is the same."""

    def compare(results, others):
        for result, other in zip(results, others, strict=True):
            assert set(result.variables) == set(other.variables)
            for name in result.variables:
                assert result[name].dtype == other[name].dtype
                np.testing.assert_array_equal(result[name], other[name], err_msg=name)

    return compare
