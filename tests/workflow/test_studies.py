"""A tiny study through Snakemake, from a folder outside the repository."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from worlds import walled_world

from pipeline.config.load import load_experiments
from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset, variable_table

pytestmark = pytest.mark.workflow

NAMES = "abcd"
RULES = ["residual", "attribute", "close_loop", "improved", "study_report"]
STUDY = {"candidates": ["wall_friction", "surcharge", "density_misdeclared", "local_rule"]}


@dataclass(frozen=True)
class Run:
    """The study's folder and results, and the copy of the workflow that made them."""

    workspace: Any
    folder: Path
    results: Path

    @property
    def made(self) -> Path:
        """Folder of the study's results."""
        return self.results / "studies" / "tiny"

    @property
    def report(self) -> str:
        """The study's page, as a target."""
        return f"{self.made}/report.html"

    def config(self, **changes) -> list[str]:
        """Arguments that lead the workflow to this folder."""
        config = {
            "experiments_dir": self.folder / "experiments",
            "studies_dir": self.folder / "studies",
            "results_dir": self.results,
        } | changes
        return ["--config", *(f"{key}={value}" for key, value in config.items() if value)]


@pytest.fixture(scope="module")
def run(checkout, copy_of, tmp_path_factory) -> Run:
    """A study of columns between walls that nobody declared, made once."""
    folder = tmp_path_factory.mktemp("mine")
    truth = {"wall_friction": {"K": 0.5}}
    walled_world(folder / "world", NAMES, truth=truth, true_E=0.97, study=STUDY)
    workspace = copy_of(checkout, tmp_path_factory.mktemp("study"))
    made = Run(workspace, folder / "world", folder / "results")
    process = workspace.snakemake(made.report, *made.config())
    assert process.returncode == 0, process.stdout
    return made


def pending(run, *targets, **config):
    """Messages of the jobs that a run would do, in order."""
    process = run.workspace.snakemake("--dry-run", *targets, *run.config(**config))
    assert process.returncode == 0, process.stdout
    return re.findall(r"^Job \d+: (.*)$", process.stdout, re.MULTILINE), process.stdout


def test_the_loop_is_closed_from_readings_to_the_page(run):
    document = read_json(run.made / "closed_loop.json")
    assert document["verdict"] == "effect"
    assert document["effects_added"][0]["name"] == "wall_friction"
    assert document["error"]["held_out"]["ratio"] < 0.5
    residual = read_dataset(run.made / "residual.nc")
    assert residual.sizes["reading"] == 9
    told = {n: e["in"]["residual"] for n, e in variable_table().items() if "residual" in e["in"]}
    assert told == {str(name): " ".join(map(str, v.dims)) for name, v in residual.variables.items()}
    assert (run.made / "rounds" / "round_1.nc").is_file()
    assert read_json(run.made / "attribution.json")["verdict"] == "effect"
    assert read_json(run.made / "improved.json")["experiments"].keys() == set(NAMES)
    assert "wall_friction" in (run.made / "report.html").read_text("utf-8")
    assert (run.made / "report_data.csv").is_file()
    for rule in RULES:
        assert (run.results / "logs" / "studies" / "tiny" / f"{rule}.log").is_file()
    assert not (run.workspace.folder / "results").exists()


def test_improved_experiments_have_the_effect_in_them(run):
    improved = load_experiments(run.made / "improved")
    assert set(improved) == set(NAMES)
    added = read_json(run.made / "closed_loop.json")["effects_added"][0]
    for one in improved.values():
        assert one.effects["wall_friction"]["K"] == added["parameters"]["K"]["value"]


def test_a_second_run_of_a_study_has_nothing_to_do(run):
    jobs, text = pending(run, run.report)
    assert jobs == []
    assert "Nothing to be done" in text


def test_changed_candidates_run_their_study_again_and_no_experiment(run, tmp_path):
    world = shutil.copytree(run.folder, tmp_path / "world")
    path = world / "studies" / "tiny.yaml"
    path.write_text(path.read_text().replace("- surcharge\n", ""))
    changed = {"experiments_dir": world / "experiments", "studies_dir": world / "studies"}
    jobs, _ = pending(run, run.report, **changed)
    assert len(jobs) == len(RULES)
    assert all(job.startswith("tiny: ") for job in jobs)


def test_experiments_of_one_s_own_bring_no_studies(run):
    process = run.workspace.snakemake("--dry-run", run.report, *run.config(studies_dir=None))
    assert process.returncode != 0
    jobs, _ = pending(run, studies_dir=None, results_dir=run.results.parent / "others")
    assert any(job.startswith("a: ") for job in jobs)
    assert not any(job.startswith("tiny: ") for job in jobs)


def test_the_improved_folder_runs_as_experiments_of_its_own(run):
    config = {
        "experiments_dir": run.made / "improved",
        "studies_dir": None,
        "results_dir": run.results.parent / "improved results",
    }
    jobs, _ = pending(run, **config)
    for name in NAMES:
        assert any(job.startswith(f"{name}: ") for job in jobs)
    assert not any(job.startswith("tiny: ") for job in jobs)
