"""Long runs through Snakemake: on a cluster that loses a worker, killed, and asked for more."""

import os
import re
import signal
import subprocess
import sys
import time

import netCDF4
import numpy as np
import pytest
from clusters import dask_cluster, kill

pytestmark = pytest.mark.workflow

FOLDER = "results/experiments/alpha"
FILES = [f"{FOLDER}/{name}.nc" for name in ("replicates", "statistics", "fields")]
TARGETS = [FILES[1]]
KEPT = "results/checkpoints/alpha"
LOG = "results/logs/experiments/alpha/replicates.log"
COUNT = 6000  # a few seconds of them, in eight parts or more


def enlarge(workspace, count=COUNT, more=""):
    """Alpha with so many replicates, calibrated as before."""
    workspace.edit(
        "workflow_configs/experiments/alpha.yaml",
        lambda text: re.sub("replicates: .*", f"replicates: {count}{more}", text),
    )
    return workspace


@pytest.fixture
def long(fresh):
    """A copy of its own in which alpha has many replicates and nothing has run."""
    return enlarge(fresh)


@pytest.fixture(scope="module")
def expected(checkout, copy_of, tmp_path_factory):
    """The workflow after an uninterrupted local run of as many."""
    workspace = enlarge(copy_of(checkout, tmp_path_factory.mktemp("expected")))
    process = workspace.snakemake(*TARGETS)
    assert process.returncode == 0, process.stdout
    return workspace


def assert_same_variables(workspace, other):
    """All variables of all files, bit for bit."""
    for file in FILES:
        with (
            netCDF4.Dataset(workspace.folder / file) as ours,
            netCDF4.Dataset(other.folder / file) as theirs,
        ):
            assert list(ours.variables) == list(theirs.variables)
            for name in ours.variables:
                values, others = (np.asarray(data[name][...].data) for data in (ours, theirs))
                assert values.dtype == others.dtype
                assert values.tobytes() == others.tobytes(), f"{file}: {name}"


def start(workspace, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.workflow.run", *TARGETS, *arguments],
        cwd=workspace.folder,
        env=workspace.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def wait_for_parts(workspace, count, process):
    """Kept parts of an unfinished run, as soon as there are so many."""
    deadline = time.monotonic() + 300
    while len(parts := kept(workspace)) < count:
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert process.poll() is None, "it ended too early to tell"
    return parts


def kept(workspace):
    return sorted(
        (int(first), int(last), path.stat().st_mtime_ns)
        for path in (workspace.folder / KEPT).glob("*.npz")
        for first, last in [path.stem.split("_")[1].split("-")]
    )


def found_again(workspace):
    """(kept, wanted) of each set of parameters, as the log has it."""
    text = (workspace.folder / LOG).read_text()
    found = re.findall(r"(\d+) of (\d+) replicates were kept by an earlier run", text)
    return [(int(a), int(b)) for a, b in found]


def test_a_cluster_that_loses_a_worker_makes_the_same_files(long, expected, tmp_path):
    with dask_cluster(tmp_path / "dask", code=long.folder) as cluster:
        config = ("--config", f"dask_scheduler={cluster.address}")
        process = start(long, "--cores", "2", *config)
        wait_for_parts(long, 1, process)
        kill(cluster.workers.pop(0))
        output, _ = process.communicate(timeout=300)
        assert process.returncode == 0, output
        assert cluster.address in (long.folder / LOG).read_text()
    assert_same_variables(long, expected)


def test_a_cluster_that_is_lost_ends_the_job_with_its_reason_and_no_file(long, expected, tmp_path):
    with dask_cluster(tmp_path / "dask", code=long.folder) as cluster:
        config = ("--config", f"dask_scheduler={cluster.address}")
        process = start(long, "--cores", "2", *config)
        wait_for_parts(long, 1, process)
        kill(cluster.scheduler)
        output, _ = process.communicate(timeout=300)
    assert process.returncode != 0
    assert f"alpha: the Dask cluster at {cluster.address} was lost" in output
    assert not any((long.folder / file).exists() for file in FILES)
    assert not list((long.folder / FOLDER).glob(".*"))
    again = long.snakemake(*TARGETS)  # here, with what the cluster had finished
    assert again.returncode == 0, again.stdout
    assert found_again(long)
    assert_same_variables(long, expected)


def test_a_killed_run_goes_on_from_its_finished_parts(long, expected):
    process = start(long, "--cores", "1")
    parts = wait_for_parts(long, 2, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    survived = [part for part in kept(long) if part in parts]
    assert len(survived) >= 2
    again = start(long, "--cores", "1")
    output, _ = again.communicate(timeout=300)
    assert again.returncode == 0, output
    done = sum(last - first for first, last, _ in survived)
    assert found_again(long)[0][0] >= done
    assert found_again(long)[0][1] == COUNT
    assert_same_variables(long, expected)
    assert {(first, last) for first, last, _ in kept(long)} == {(0, COUNT)}


def test_more_replicates_reuse_the_first(expected, copy_of, tmp_path):
    more = 7000
    raised = enlarge(copy_of(expected, tmp_path / "raised"), more)
    process = raised.snakemake(*TARGETS)
    assert process.returncode == 0, process.stdout
    assert found_again(raised) == [(COUNT, more)] * len(kept(expected))
    assert {(first, last) for first, last, _ in kept(raised)} == {(0, more)}
    with (
        netCDF4.Dataset(expected.folder / FILES[0]) as few,
        netCDF4.Dataset(raised.folder / FILES[0]) as many,
    ):
        for name, variable in few.variables.items():
            values, others = variable[...], many[name][...]
            if variable.dimensions[:1] == ("replicate",):
                assert len(others) == more
                others = others[:COUNT]
            np.testing.assert_array_equal(values, others, err_msg=name)


def test_a_changed_line_of_code_reuses_nothing(expected, copy_of, tmp_path):
    changed = copy_of(expected, tmp_path / "changed")
    changed.edit(
        "pipeline/lattice/spreading.py",
        lambda text: text.replace("S_LIMIT = 128.0", "S_LIMIT = 127.0"),
    )
    process = changed.snakemake(*TARGETS)
    assert process.returncode == 0, process.stdout
    assert found_again(changed) == []
    old, new = (
        {path.name.split("_")[0] for path in (one.folder / KEPT).iterdir()}
        for one in (expected, changed)
    )
    assert old
    assert new
    assert not old & new


def test_a_precision_that_is_reached_ends_the_run(fresh):
    enlarge(fresh, 500, "\nstop_at: {standard_error: 1000.0, at_least: 30}")
    process = fresh.snakemake(*TARGETS)
    assert process.returncode == 0, process.stdout
    with netCDF4.Dataset(fresh.folder / FILES[1]) as statistics:
        assert int(statistics["replicate_count"][...]) == 30
    assert "the largest standard error of 30 replicates" in (fresh.folder / LOG).read_text()
