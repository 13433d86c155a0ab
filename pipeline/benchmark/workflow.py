"""What the workflow itself costs: whole runs beside jobs that only import NumPy and xarray."""

from __future__ import annotations

import ast
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.benchmark.figures import Figure, Target

REPOSITORY = Path(__file__).resolve().parents[2]
COPIED = ("Snakefile", "pipeline", "workflow_configs")
TESTS = (  # of Gómez & Castro 2022, Table 2
    "castro_2006",
    "orellana_2012",
    "castro_2020",
    *(
        f"seditest_{material}_{wall}"
        for material in ("gravel", "glass")
        for wall in ("paperboard", "fine_sandpaper", "coarse_sandpaper")
    ),
)
RULES = ("block_model", "calibrate", "replicates", "aggregate", "validate", "report")
BARE = """\
rule all:
    input: expand("done/{i}", i=range(COUNT))

rule one:
    output: "done/{i}"
    script: "bare.py"
"""
IMPORTS = "import numpy, xarray"
SCRIPT = IMPORTS + '\nopen(snakemake.output[0], "w").close()\n'


def workflow_figures(
    repeats: int, names: tuple[str, ...] = TESTS, source: Path = REPOSITORY
) -> Iterator[Figure]:
    """Wall time of the pages of some experiments, on all cores, in turn with as many bare jobs.

    Everything happens in a copy of the workflow in `source`: once with nothing there, kernels not
    compiled; again with kernels compiled and no results; again with nothing to do. Kernels count,
    so that a ratio is more than the workflow's own cost.

    Raises
    ------
    subprocess.CalledProcessError
        Where Snakemake fails, with what it printed as `output`.
    """
    cores = os.cpu_count() or 1
    pages = [f"results/experiments/{name}/report.html" for name in names]
    walls = []
    for _ in range(repeats):
        with TemporaryDirectory() as folder:
            ours, bare = Path(folder) / "ours", Path(folder) / "bare"
            _copy(source, ours)
            first, said = _snakemake(ours, cores, pages)
            _forget_runs(ours)
            again, _ = _snakemake(ours, cores, pages)
            idle, _ = _snakemake(ours, cores, pages)
            jobs = int(re.findall(r"(\d+) of \1 steps", said)[-1])
            bare.mkdir()
            (bare / "Snakefile").write_text(BARE.replace("COUNT", str(jobs)))
            (bare / "bare.py").write_text(SCRIPT)
            walls.append((first, again, idle, _snakemake(bare, cores, [])[0]))
    first, again, idle, empty = np.array(walls).T
    about = {
        "unit": "s",
        "yardstick": "as many Snakemake jobs that only import NumPy and xarray",
        "yardstick_values": empty,
        "shapes": (),
        "dtype": "",
        "remark": f"{len(names)} pages in {jobs} jobs on {cores} cores",
    }
    most = (Target("ratio", 1.5, is_most=True),)
    yield Figure("from nothing, kernels compiled too", values=first, targets=most, **about)
    yield Figure("again without results", values=again, targets=most, **about)
    at_once = (Target("value", 3.0, is_most=True),)
    yield Figure("nothing to do", values=idle, targets=at_once, **about)
    yield _imports_figure(repeats, source)


def _imports_figure(repeats: int, source: Path) -> Figure:
    """Processor seconds of an experiment's rules that go into imports: no run costs less."""
    scripts = [source / "pipeline" / "workflow" / "scripts" / f"{rule}.py" for rule in RULES]
    wanted = [imports_of(script) for script in scripts]
    seconds = []
    for _ in range(repeats):
        ours, bare = (
            [_import_seconds(text, source) for text in texts]
            for texts in (wanted, [IMPORTS] * len(RULES))
        )
        seconds.append((sum(ours), sum(bare)))
    ours, bare = np.array(seconds).T
    return Figure(
        "imports of an experiment's jobs, processor time",
        unit="s",
        values=ours,
        yardstick="as many processes that only import NumPy and xarray",
        yardstick_values=bare,
        shapes=(),
        dtype="",
        remark=f"the scripts of {len(RULES)} rules, once each",
    )


def imports_of(script: Path) -> str:
    """The import statements of a script, as code."""
    nodes = ast.parse(script.read_text("utf-8")).body
    found = (node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
    return "\n".join(map(ast.unparse, found))


def _import_seconds(text: str, folder: Path) -> float:
    """Processor seconds of a process that runs `text` as the workflow's jobs are run."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    alone = {"PYTHONPATH": str(folder), "BLOCK_CAVE_WITHOUT_DASK": "1"}
    subprocess.run([sys.executable, "-c", text], env=os.environ | alone, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _copy(source: Path, target: Path) -> None:
    target.mkdir()
    ignored = shutil.ignore_patterns("__pycache__")
    for name in COPIED:
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name, ignore=ignored)
        else:
            shutil.copy(source / name, target)


def _forget_runs(folder: Path) -> None:
    for name in ("results", ".snakemake"):
        shutil.rmtree(folder / name)


def _snakemake(folder: Path, cores: int, targets: list[str]) -> tuple[float, str]:
    """Seconds that a run in `folder` took, and what it said."""
    command = [sys.executable, "-m", "snakemake", "--cores", str(cores), *targets]
    start = time.perf_counter()
    process = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    return time.perf_counter() - start, process.stdout
