"""Exports through Snakemake: made when asked for, and from what has run already."""

import pytest

pytestmark = pytest.mark.workflow

FOLDER = "results/experiments/beta/export"
FILES = ("vtk", "base_stress.csv", "block_model.csv", "block_model_vulcan.csv")


def test_exports_are_made_from_finished_results_and_not_twice(done):
    targets = [f"{FOLDER}/{file}" for file in FILES]
    process = done.snakemake(*targets)
    assert process.returncode == 0, process.stdout
    for other in ("rule block_model", "rule replicates"):
        assert other not in process.stdout
    made = sorted(path.name for path in (done.folder / FOLDER).iterdir())
    assert made == sorted(FILES)
    series = sorted(path.name for path in (done.folder / FOLDER / "vtk").glob("beta*"))
    assert series == ["beta.pvd", "beta_0000.vti", "beta_0001.vti"]
    rows = (done.folder / FOLDER / "base_stress.csv").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows[1:]] == [["beta", "0"], ["beta", "1"]]
    assert "Nothing to be done" in done.snakemake("--dry-run", *targets).stdout


def test_the_command_writes_the_same_files(done):
    process = done.snakemake(f"{FOLDER}/base_stress.csv")
    assert process.returncode == 0, process.stdout
    process = done.python(
        "-m", "pipeline", "export", "beta", "--to", "csv", "--into", str(done.folder)
    )
    assert process.returncode == 0, process.stdout
    written = (done.folder / "base_stress.csv").read_text()
    assert written == (done.folder / FOLDER / "base_stress.csv").read_text()
