"""Where a user's files lie, and the Snakemake command that runs them."""

from __future__ import annotations

import shlex
from pathlib import Path

from pipeline.config.messages import shown_path

REPOSITORY = Path(__file__).resolve().parents[2]
OWN = Path("workflow_configs")
"""What the repository runs by itself, in its folders ``experiments`` and ``studies``."""


def experiments_of_study(path: Path) -> Path:
    """Folder of the experiments that a study's file names.

    It is the folder ``experiments`` beside the study's, or the repository's where there is none.
    """
    beside = path.absolute().parent.with_name("experiments")
    return beside if beside.is_dir() else REPOSITORY / OWN / "experiments"


def studies_of_experiment(path: Path) -> Path:
    """Folder of the studies that an experiment's prediction may name: the one beside its own."""
    return path.absolute().parent.with_name("studies")


def experiments_of_table(path: Path) -> Path:
    """Folder of the experiments that a measured table names.

    It is the folder above a folder ``measured``, that of the studies' experiments for a table in a
    folder ``studies``, or else the table's own.
    """
    folder = path.absolute().parent
    if folder.name == "studies":
        return experiments_of_study(path)
    return folder.parent if folder.name == "measured" else folder


def run_command(path: Path, experiments: Path | None = None) -> str:
    """The command that makes the page of an experiment, or of a study of ``experiments``.

    Results go into the folder ``results`` beside the folder ``experiments`` or ``studies``, into
    the file's folder where that has another name, or to where the repository has its own.
    """
    folder = path.absolute().parent
    kind = "experiments" if experiments is None else "studies"
    if folder == (REPOSITORY / OWN / kind):
        return _snakemake(f"results/{kind}/{path.stem}/report.html")
    base = folder.parent if folder.name in ("experiments", "studies") else folder
    results = _as_typed(base / "results")
    config = [f"{kind}_dir={_as_typed(folder)}", f"results_dir={results}"]
    if experiments is not None and experiments.absolute() != REPOSITORY / OWN / "experiments":
        config.insert(0, f"experiments_dir={_as_typed(experiments)}")
    return _snakemake(f"{results}/{kind}/{path.stem}/report.html", "--config", *config)


def next_steps(path: Path, experiments: Path | None = None) -> str:
    """What to type after an experiment was written, or a study of ``experiments``."""
    there = [] if Path.cwd() == REPOSITORY else [f"cd {REPOSITORY}"]
    check = shlex.join(["python", "-m", "pipeline", "check", _as_typed(path)])
    return "\n  ".join(["next:", *there, check, run_command(path, experiments)])


def _snakemake(*words: str) -> str:
    return shlex.join(["snakemake", "--cores", "all", *words])


def _as_typed(path: Path) -> str:
    """A path as it is typed in the repository's folder, where Snakemake runs."""
    return shown_path(path) if Path.cwd() == REPOSITORY else str(path.absolute())
