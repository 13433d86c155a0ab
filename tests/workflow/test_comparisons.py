"""A tiny pair of draw experiments through Snakemake to the page that compares them."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from specs import COLUMN, DRAWN, merged

from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset

pytestmark = pytest.mark.workflow

COMPARISON = {"title": "Two rates", "experiments": ["slow", "fast"], "threshold_mpa": 0.004}
FAST = {"draw": [{"drawpoints": ["west"], "mass": 12.0, "increment": 4.0}]}
OTHER = {"readings": {"every": 6.0}}


@dataclass(frozen=True)
class Pair:
    """The folder of the experiments and the comparison, and the workflow that runs them."""

    workspace: Any
    folder: Path
    results: Path

    @property
    def made(self) -> Path:
        """Folder of the comparison's results."""
        return self.results / "comparisons" / "rates"

    def config(self, **changes) -> list[str]:
        """Arguments that lead the workflow to this folder."""
        config = {
            "experiments_dir": self.folder / "experiments",
            "comparisons_dir": self.folder / "comparisons",
            "results_dir": self.results,
        } | changes
        return ["--config", *(f"{key}={value}" for key, value in config.items() if value)]

    def jobs(self, *targets, **changes) -> list[str]:
        """Messages of the jobs that a run would do."""
        process = self.workspace.snakemake("--dry-run", *targets, *self.config(**changes))
        assert process.returncode == 0, process.stdout
        return re.findall(r"^Job \d+: (.*)$", process.stdout, re.MULTILINE)


def write(folder: Path, kind: str, name: str, content: dict) -> None:
    (folder / kind).mkdir(parents=True, exist_ok=True)
    (folder / kind / f"{name}.yaml").write_text(yaml.safe_dump(content))


@pytest.fixture(scope="module")
def pair(checkout, copy_of, tmp_path_factory) -> Pair:
    """Two experiments that differ in their increments, and one that neither names; made once."""
    folder = tmp_path_factory.mktemp("own")
    drawn = merged(COLUMN, DRAWN) | {"replicates": 3}
    for name, changes in (("slow", {}), ("fast", FAST), ("other", OTHER)):
        write(folder, "experiments", name, merged(drawn, changes))
    write(folder, "comparisons", "rates", COMPARISON)
    workspace = copy_of(checkout, tmp_path_factory.mktemp("comparison"))
    made = Pair(workspace, folder, folder / "results")
    process = workspace.snakemake(f"{made.made}/report.html", *made.config())
    assert process.returncode == 0, process.stdout
    return made


def test_the_page_and_its_tables_come_from_the_replicates(pair):
    document = read_json(pair.made / "comparison.json")
    assert [one["experiment"] for one in document["experiments"]] == ["slow", "fast"]
    stress = read_dataset(pair.results / "experiments/slow/replicates.nc")["vertical_stress"]
    expected = stress.values[:, 2, 0].mean() / 1000
    with open(pair.made / "comparison.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["load_cell"] == "beside"]
    assert float(rows[2]["first_mean_mpa"]) == pytest.approx(expected, rel=1e-9)
    assert "Two rates" in (pair.made / "report.html").read_text("utf-8")
    assert (pair.made / "load_cells.csv").is_file()
    assert (pair.results / "logs/comparisons/rates/compare.log").is_file()


def test_a_second_run_has_nothing_to_do_and_another_threshold_runs_the_comparison_alone(pair):
    target = f"{pair.made}/report.html"
    assert pair.jobs(target) == []
    changed = pair.folder.parent / "changed"
    write(changed, "comparisons", "rates", COMPARISON | {"threshold_mpa": 0.005})
    jobs = pair.jobs(target, comparisons_dir=changed / "comparisons")
    assert jobs == ["rates: comparison", "rates: report"]


def test_everything_has_the_comparison_on_the_index(pair):
    jobs = pair.jobs()
    assert "index" in jobs
    assert any(job.startswith("other: ") for job in jobs)
    process = pair.workspace.snakemake(f"{pair.results}/index.html", *pair.config())
    assert process.returncode == 0, process.stdout
    assert 'href="comparisons/rates/report.html"' in (pair.results / "index.html").read_text()


def test_own_experiments_alone_bring_no_comparisons(pair):
    jobs = pair.jobs(comparisons_dir=None, results_dir=pair.results.parent / "others")
    assert any(job.startswith("slow: ") for job in jobs)
    assert not any(job.startswith("rates: ") for job in jobs)


def test_own_comparisons_alone_run_the_repository_s_experiments_that_they_name(pair, copy_of):
    workspace = copy_of(pair.workspace, pair.folder.parent / "repository")
    for name in ("slow", "fast"):
        text = (pair.folder / "experiments" / f"{name}.yaml").read_text()
        (workspace.folder / f"workflow_configs/experiments/{name}.yaml").write_text(text)
    inside = Pair(workspace, pair.folder, pair.results.parent / "inside")
    jobs = inside.jobs(experiments_dir=None)
    assert {job.split(":")[0] for job in jobs if ": " in job} >= {"slow", "fast", "rates"}
    assert not any(job.startswith(("alpha: ", "beta: ")) for job in jobs)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"experiments": ["slow", "fats"]}, "fats: no such experiment; did you mean fast?"),
        ({"experiments": ["slow", "other"]}, "reading 1 is at 6 kg, 4 kg in slow"),
        ({"threshold_mpa": -1}, "threshold_mpa = -1: expected a stress in MPa, above 0"),
    ],
)
def test_a_comparison_that_cannot_be_made_is_refused_before_anything_runs(
    pair, tmp_path, changes, expected
):
    write(tmp_path, "comparisons", "rates", COMPARISON | changes)
    process = pair.workspace.snakemake(
        *pair.config(comparisons_dir=tmp_path / "comparisons", results_dir=tmp_path / "results")
    )
    assert process.returncode != 0
    assert process.stdout.count(expected) == 1
    assert "Traceback" not in process.stdout
    assert not (tmp_path / "results").exists()
