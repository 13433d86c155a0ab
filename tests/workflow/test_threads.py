"""How many cores a job asks for: nobody computes with more than it asked for."""

import pytest

from pipeline.workflow.catalog import Catalog


@pytest.fixture
def catalog(repository):
    """catalog(dask_scheduler): of the repository's experiments."""

    def make(scheduler=None):
        folder = repository / "workflow_configs" / "experiments"
        config = {"experiments_dir": folder, "studies_dir": folder.parent / "studies"}
        config["comparisons_dir"] = folder.parent / "comparisons"
        return Catalog(config | {"results_dir": "results", "dask_scheduler": scheduler})

    return make


def test_a_large_experiment_takes_all_cores_and_a_small_one_takes_one(catalog):
    local = catalog()
    assert local.threads("castro_2020_panel", 8) == 8
    assert local.threads("seditest_gravel_paperboard", 8) == 1


def test_a_job_that_waits_for_a_cluster_takes_one_core(catalog):
    remote = catalog("tcp://127.0.0.1:8786")
    assert {remote.threads(name, 8) for name in remote.experiments} == {1}
