"""Replicates on a real Dask cluster: the same bits, and clear words where it fails."""

import shutil

import distributed
import pytest
from clusters import Counted, break_at_three, dask_cluster, kill, slowly

from pipeline.montecarlo import workers
from pipeline.montecarlo.progress import Progress
from pipeline.montecarlo.workers import Execution, WorkersLostError, crew
from pipeline.simulate.setup import make_setup

pytestmark = pytest.mark.workflow


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers; a test that kills one starts another."""
    with dask_cluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


@pytest.fixture
def two(cluster):
    """The cluster with both workers there."""
    wait_for_workers(cluster, 2)
    return cluster


def wait_for_workers(cluster, count):
    with distributed.Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=60)


@pytest.fixture
def once(monkeypatch):
    """once(action): done when the first part of a run has come back; gives what was counted."""

    def arrange(action):
        computed, counts = Progress.computed, []

        def watched(progress, count):
            counts.append(count)
            if len(counts) == 1:
                action()
            computed(progress, count)

        monkeypatch.setattr(Progress, "computed", watched)
        return counts

    return arrange


@pytest.fixture(scope="module")
def many(column):
    """A setup with replicates for a second or two, and not all of them done at once."""
    experiment = column(replicates=4000)
    return make_setup(experiment)


@pytest.mark.parametrize("chunk", [1, 4, None])
def test_no_bit_depends_on_a_cluster(setup, alone, two, run, assert_same_bits, chunk):
    assert_same_bits(run(setup, Execution(1, two.address, chunk)), alone)


def test_both_workers_work_and_get_the_setup_once(two):
    with crew(Execution(1, two.address)) as team:
        assert team.workers == 2
        shared = Counted(0.01)
        results = [result for _, result in team.each(slowly, [(k,) for k in range(60)], shared)]
    assert sorted(number for number, *_ in results) == list(range(60))
    assert len({address for _, address, _ in results}) == 2
    assert len({unpickled for *_, unpickled in results}) <= 2


def test_a_worker_killed_in_the_middle_changes_no_bit(many, two, run, assert_same_bits, once):
    counts = once(lambda: kill(two.workers.pop(0)))
    results = run(many, Execution(1, two.address, chunk=100))
    two.add_worker()
    assert len(counts) > 20
    assert_same_bits(results, run(many))


def test_the_error_of_a_replicate_is_its_own(two):
    with (
        crew(Execution(1, two.address)) as team,
        pytest.raises(ZeroDivisionError, match="in replicate 3"),
    ):
        list(team.each(break_at_three, [(k,) for k in range(5)], None))


def test_a_worker_out_of_memory_says_what_ran_where_and_what_helps(column, tmp_path, run):
    levels = [0.05 * k for k in range(1, 60)]
    geometry = {"width": 1.5, "length": 1.5, "height": 3.0, "cell_size": 0.05}
    experiment = column("heavy", geometry=geometry, filling={"levels": levels}, replicates=2)
    setup = make_setup(experiment)
    allowed = {"DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": 0}
    with dask_cluster(tmp_path, 1, memory="400MB", **allowed) as small:
        with pytest.raises(WorkersLostError) as caught:
            run(setup, Execution(1, small.address))
        for words in ("heavy", small.address, "memory", "the next run goes on", "--memory-limit"):
            assert words in str(caught.value)


def test_a_lost_scheduler_says_what_ran_where_and_what_helps(
    many, tmp_path, run, once, monkeypatch
):
    monkeypatch.setattr(workers, "CONNECT", "2s")
    with dask_cluster(tmp_path, 1) as doomed:
        once(lambda: kill(doomed.scheduler))
        with pytest.raises(WorkersLostError) as caught:
            run(many, Execution(1, doomed.address, chunk=100))
    for words in ("column", doomed.address, "was lost", "the next run goes on", "dask scheduler"):
        assert words in str(caught.value)


def test_a_cluster_that_loses_its_last_worker_says_so(many, tmp_path, run, once, monkeypatch):
    monkeypatch.setattr(workers, "PATIENCE", 3.0)
    with dask_cluster(tmp_path, 1) as empty:
        wait_for_workers(empty, 1)
        once(lambda: kill(empty.workers[0]))
        with pytest.raises(WorkersLostError) as caught:
            run(many, Execution(1, empty.address, chunk=100))
    for words in ("column", empty.address, "no worker", f"dask worker {empty.address}"):
        assert words in str(caught.value)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere:1", "tcp://", "smtp://a:1"])
def test_a_scheduler_that_does_not_answer_is_named(address, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT", "1s")
    with (
        pytest.raises(WorkersLostError) as caught,
        crew(Execution(1, address), "column"),
    ):
        pass
    for words in ("column", address, "tcp://HOST:PORT", "dask scheduler"):
        assert words in str(caught.value)


def test_workers_with_other_code_are_refused(column, tmp_path, run, repository):
    code = tmp_path / "code" / "pipeline"
    shutil.copytree(repository / "pipeline", code, ignore=shutil.ignore_patterns("__pycache__"))
    with open(code / "simulate" / "__init__.py", "a") as file:
        file.write("\nGRAVITY = 9.8\n")
    experiment = column(replicates=2)
    setup = make_setup(experiment)
    with dask_cluster(tmp_path / "dask", 1, code=tmp_path / "code") as other:
        with pytest.raises(WorkersLostError) as caught:
            run(setup, Execution(1, other.address))
        assert "other code" in str(caught.value)
        assert "same environment" in str(caught.value)
