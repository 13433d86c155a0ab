"""Copies of the workflow with two tiny experiments, and calls of Snakemake in them."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

ALPHA = """\
title: Alpha, calibrated
geometry: {width: 0.5, length: 0.4, height: 1.0, cell_size: 0.1}
material: {name: gravel, bulk_density: 1600, particle_density: 2700}
stress: {E: 0.9, s: {mean: 4, std: 3}}
calibrate: [E, s]
replicates: 4
seed: 1
measured: measured/table.csv
"""
BETA = """\
title: Beta, read at two fill levels
geometry: {width: 0.52, length: 0.4, height: 0.95, cell_size: 0.1}
material: {name: sand, bulk_density: 1500, particle_density: 2700}
filling: {levels: [0.4]}
stress: {E: 0.8, s: 2}
replicates: 4
measured: measured/table.csv
"""
TABLE = """\
# Made up.
experiment,fill_height,quantity,value,std
alpha,,vertical_stress,9.0,0.4
alpha,,vertical_stress_spatial_std,2.0,0.2
beta,0.4,vertical_stress,4.0,0.4
"""
LAST = ("statistics.nc", "validation.json")
TARGETS = [f"results/experiments/{name}/{file}" for name in ("alpha", "beta") for file in LAST]


@dataclass(frozen=True)
class Workspace:
    """A copy of the workflow's files; its code is what its runs import."""

    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        """Variables of a process that is to use this copy's code."""
        return os.environ | {"PYTHONPATH": str(self.folder)}

    def python(self, *arguments: str) -> subprocess.CompletedProcess:
        """Run Python here; stdout and stderr together, as text."""
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )

    def shell(self, command: str) -> str:
        """What a command of a page prints, run in the folder; it must succeed."""
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        process = subprocess.run(
            ["bash", "-euc", command],
            cwd=self.folder,
            env=self.environment | {"PATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert process.returncode == 0, process.stdout
        return process.stdout

    def snakemake(self, *arguments: str) -> subprocess.CompletedProcess:
        """Run Snakemake here on two cores."""
        return self.python("-m", "snakemake", "--cores", "2", *arguments)

    def pending(self, *arguments: str) -> set[tuple[str, str]]:
        """(experiment, rule) of each job that a run would do."""
        process = self.snakemake("--dry-run", *(arguments or TARGETS))
        assert process.returncode == 0, process.stdout
        names = {
            "block model": "block_model",
            "calibration": "calibrate",
            "statistics": "aggregate",
            "validation": "validate",
        }
        jobs = re.findall(r"^Job \d+: (\w+): ([\w ]+)", process.stdout, re.MULTILINE)
        assert jobs or "Nothing to be done" in process.stdout, process.stdout
        return {(experiment, names.get(job, job)) for experiment, job in jobs}

    def edit(self, file: str, change: Callable[[str], str]) -> None:
        """Change a text file; it is an error when nothing changes."""
        path = self.folder / file
        before = path.read_text("utf-8")
        after = change(before)
        assert after != before
        path.write_text(after, "utf-8")


def _copy(source: Path, target: Path) -> Workspace:
    shutil.copytree(source, target, dirs_exist_ok=True, copy_function=shutil.copy2)
    return Workspace(target)


@pytest.fixture(scope="session")
def checkout(repository, tmp_path_factory) -> Workspace:
    """The workflow with the experiments alpha and beta, nothing run yet."""
    folder = tmp_path_factory.mktemp("checkout")
    for part in ("pipeline", "profiles"):
        _copy(repository / part, folder / part)
    shutil.copy2(repository / "Snakefile", folder)
    experiments = folder / "workflow_configs" / "experiments"
    (experiments / "measured").mkdir(parents=True)
    shutil.copy2(repository / "workflow_configs" / "default.yaml", experiments.parent)
    (experiments / "alpha.yaml").write_text(ALPHA)
    (experiments / "beta.yaml").write_text(BETA)
    (experiments / "measured" / "table.csv").write_text(TABLE)
    return Workspace(folder)


@pytest.fixture(scope="session")
def copy_of():
    """copy_of(workspace, folder): a copy, with what has run there."""
    return lambda workspace, folder: _copy(workspace.folder, folder)


@pytest.fixture
def fresh(checkout, tmp_path) -> Workspace:
    """A copy of its own in which nothing has run."""
    return _copy(checkout.folder, tmp_path / "fresh")


@pytest.fixture(scope="session")
def finished(checkout, tmp_path_factory) -> Workspace:
    """A copy in which all targets have been made; not to be changed."""
    workspace = _copy(checkout.folder, tmp_path_factory.mktemp("finished"))
    process = workspace.snakemake(*TARGETS)
    assert process.returncode == 0, process.stdout
    return workspace


@pytest.fixture
def done(finished, tmp_path) -> Workspace:
    """A copy of its own of the finished one."""
    return _copy(finished.folder, tmp_path / "done")
