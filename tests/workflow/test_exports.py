"""Exports through Snakemake: made when asked for, and from what has run already."""

import pytest

pytestmark = pytest.mark.workflow

FOLDER = "results/experiments/beta/export"
FILES = ("vtk", "block_model.csv", "block_model_vulcan.csv")


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
    assert "Nothing to be done" in done.snakemake("--dry-run", *targets).stdout


def test_the_command_writes_the_table_that_the_workflow_has(done):
    process = done.python(
        "-m", "pipeline", "export", "beta", "--to", "csv", "--into", str(done.folder)
    )
    assert process.returncode == 0, process.stdout
    written = (done.folder / "base_stress.csv").read_text()
    assert written == (done.folder / "results/experiments/beta/base_stress.csv").read_text()
    rows = [row.split(",")[:2] for row in written.splitlines()]
    assert rows[1:] == [["beta", "0"], ["beta", "1"]]
