"""The SLURM profile: Snakemake takes it, and asks for the cores and memory that it says."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytestmark = pytest.mark.workflow

TARGETS = ("results/experiments/alpha/statistics.nc", "results/effects/pictures.nc")
# commands of SLURM: `sbatch` writes down how it was called, and refuses
SBATCH = '#!/bin/sh\necho "$@" >> "$CALLS"\necho "no queue here" >&2\nexit 1\n'
OTHERS = ("sacct", "sacctmgr", "scontrol", "sinfo", "squeue", "sshare")


@pytest.fixture
def profile(repository):
    """Its path."""
    return str(repository / "workflow_configs" / "profiles" / "slurm")


@pytest.mark.parametrize("more", [(), ("--workflow-profile", "none")])
def test_a_dry_run_with_the_profile_lists_the_jobs(fresh, profile, more):
    process = fresh.python("-m", "snakemake", "--profile", profile, *more, "--dry-run", *TARGETS)
    assert process.returncode == 0, process.stdout
    jobs = re.findall(r"^Job \d+: (.*)$", process.stdout, re.MULTILINE)
    assert len(jobs) == 5, process.stdout
    assert "alpha: replicates" in jobs


def test_jobs_ask_for_the_cores_and_the_memory_of_the_profile(fresh, profile, tmp_path):
    commands = tmp_path / "bin"
    commands.mkdir()
    for name in ("sbatch", *OTHERS):
        (commands / name).write_text(SBATCH if name == "sbatch" else "#!/bin/sh\n")
        (commands / name).chmod(0o755)
    calls = tmp_path / "calls"
    environment = fresh.environment | {
        "PATH": os.pathsep.join([str(commands), os.environ["PATH"]]),
        "CALLS": str(calls),
    }
    arguments = ["--profile", profile, "--workflow-profile", "none", "--slurm-no-account"]
    arguments += ["--slurm-init-seconds-before-status-checks", "1", *TARGETS]
    process = subprocess.run(
        [sys.executable, "-m", "snakemake", *arguments],
        cwd=fresh.folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode != 0
    assert "no queue here" in process.stdout + process.stderr
    asked = {
        rule: call
        for call in calls.read_text().splitlines()
        for rule in re.findall(r"--comment rule_(block_model|\w+)", call)
    }
    settings = yaml.safe_load(Path(profile, "config.yaml").read_text())
    assert asked.keys() == {"block_model", "effect_pictures"}  # what waits for nothing
    assert "--cpus-per-task=1 " in asked["block_model"]
    assert f"--cpus-per-task={settings['max-threads']} " in asked["effect_pictures"]
    for call in asked.values():
        assert f"--mem {settings['default-resources']['mem_mb']} " in call
        assert re.search(r"-t \S+", call)
