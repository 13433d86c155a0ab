"""A run killed at any moment goes on with the same command, to the same numbers."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import netCDF4
import numpy as np
import pytest

from pipeline.files.netcdf import read_dataset

pytestmark = pytest.mark.workflow

TARGETS = [f"results/experiments/alpha/{file}" for file in ("statistics.nc", "validation.json")]
COMMAND = ("-m", "pipeline.workflow.run", *TARGETS, "--cores", "2")  # what `make` runs
SEED, KILLS = 2022, 3


def start(workspace, *arguments):
    """A process group of its own."""
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=workspace.folder,
        env=workspace.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def results(workspace):
    return sorted((workspace.folder / "results" / "experiments").glob("*/*"))


@pytest.fixture(scope="module")
def uninterrupted(checkout, copy_of, tmp_path_factory):
    """The workflow after an uninterrupted run, and the seconds that this took."""
    workspace = copy_of(checkout, tmp_path_factory.mktemp("uninterrupted"))
    begin = time.monotonic()
    process = workspace.python(*COMMAND)
    assert process.returncode == 0, process.stdout
    return workspace, time.monotonic() - begin


def test_a_run_killed_three_times_ends_with_the_numbers_of_an_uninterrupted_one(
    fresh, uninterrupted
):
    finished, duration = uninterrupted
    moments = random.Random(SEED)
    killed = 0
    for _ in range(KILLS):
        process = start(fresh, *COMMAND)
        time.sleep(duration * moments.uniform(0.15, 0.45))
        killed += process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for path in results(fresh):  # what is there is whole
            if path.suffix == ".nc":
                read_dataset(path)
            elif path.suffix == ".json":
                json.loads(path.read_text())
    assert killed == KILLS
    process = fresh.python(*COMMAND)
    assert process.returncode == 0, process.stdout
    assert [path.name for path in results(fresh)] == [path.name for path in results(finished)]
    for path, other in zip(results(fresh), results(finished), strict=True):
        if path.suffix == ".json":
            assert json.loads(path.read_text()) == json.loads(other.read_text())
            continue
        if path.suffix == ".csv":
            assert path.read_text() == other.read_text()
            continue
        with netCDF4.Dataset(path) as ours, netCDF4.Dataset(other) as theirs:
            assert list(ours.variables) == list(theirs.variables)
            for name in ours.variables:
                np.testing.assert_array_equal(ours[name][...], theirs[name][...], err_msg=name)


def test_the_lock_of_a_killed_run_is_cleared_and_said(fresh):
    process = start(fresh, *COMMAND)
    wait_for_lock(fresh, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert locks(fresh)
    again = fresh.python(*COMMAND, "--dry-run")
    assert again.returncode == 0, again.stdout
    assert "A run that was stopped left its lock behind; clearing it." in again.stdout


def test_the_command_refuses_beside_a_live_snakemake_and_leaves_its_lock(fresh):
    target = "results/experiments/beta/block_model.nc"
    alive = start(fresh, "-m", "snakemake", "--cores", "1", target)
    wait_for_lock(fresh, alive)
    held = locks(fresh)
    refused = fresh.python(*COMMAND)
    assert alive.poll() is None, "it ended too early to tell"
    assert refused.returncode == 1
    assert f"Snakemake is already working in {fresh.folder} (process {alive.pid}" in refused.stdout
    assert "wait until it has finished, or stop it" in refused.stdout
    assert locks(fresh) == held
    assert alive.wait(timeout=300) == 0
    assert (fresh.folder / target).is_file()


def locks(workspace):
    return sorted((workspace.folder / ".snakemake" / "locks").glob("*"))


def wait_for_lock(workspace, process):
    deadline = time.monotonic() + 300
    while not locks(workspace):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
