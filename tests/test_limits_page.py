"""The figures of docs/limits.md and docs/physics.md are those of a run."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.files.atomic import read_json

REPOSITORY = Path(__file__).parents[1]
EXPERIMENTS = (
    "castro_2006",
    "castro_2006_1452",
    "orellana_2012",
    "seditest_gravel_paperboard",
    "castro_2020_block_15cm",
    "castro_2020_block_30cm",
    "dem_box_block_wide",
)
STUDIES = ("seditest_walls", "table5_inputs", "dem_columns", "dem_draw_box", "large_models_1452")


def row(page: str, file: str, start: str = "") -> str:
    """The table row of a page that names a file of results, or begins so."""
    rows = [line for line in page.splitlines() if line.startswith(f"| {start}") and file in line]
    assert len(rows) == 1, (file, start)
    return rows[0]


def check_limits(page: str, results: Path) -> None:
    """Assert that the page has the figures of the folder of results."""

    def experiment(name: str, file: str = "validation"):
        return read_json(results / "experiments" / name / f"{file}.json")

    for name, form in (("castro_2006", ".1f"), ("seditest_gravel_paperboard", ".3f")):
        published = experiment(name)["published"]
        text = row(page, f"experiments/{name}/validation.json")
        assert f"{published['ours_mean']:{form}} kPa" in text
        assert f"{published['vertical_stress_mean']}" in text
    said = " ".join(experiment("orellana_2012")["statements"])
    ceiling, measured = re.search(
        r"ceiling is [\d.]+, ([\d.]+) of the mean \(measured: (.+?)\)", said
    ).groups()
    text = row(page, "experiments/orellana_2012")
    assert f"{ceiling} of the mean at most" in text
    assert f"measured {measured} |" in text
    for name in ("castro_2020_block_15cm", "castro_2020_block_30cm"):
        facts = experiment(name)["published"]["facts"]
        pillar = next(fact for fact in facts if fact["change"] == "rises")
        assert f"up to {max(pillar['highest']):.2f}" in row(page, f"experiments/{name}/")
        if name.endswith("15cm"):
            assert f"{pillar['last'][0]:.2f} at the end" in row(page, f"experiments/{name}/")
    said = " ".join(experiment("dem_box_block_wide")["statements"])
    laboratory, simulated = re.search(
        r"load is ([\d.]+) times .* simulated ([\d.]+) times", said
    ).groups()
    text = row(page, "experiments/dem_box_block_wide")
    assert f"{simulated} times" in text
    assert f"the laboratory {laboratory} |" in text
    assert experiment("castro_2006_1452", "calibration")["parameters"]["E"]["interval_open"]
    box = _error(results, "dem_draw_box")
    text = row(page, "studies/dem_draw_box")
    assert f"{box['before']['rms_log']:.2f} before, {box['after']['rms_log']:.2f} after" in text
    large = _error(results, "large_models_1452")
    assert f"{large['before']['rms_kpa']:.1f} kPa rms before and after" in row(
        page, "large_models_1452"
    )
    assert large["ratio"] == pytest.approx(1.0)


def check_physics(page: str, results: Path) -> None:
    """The same of the table of what studies have found."""
    for name in ("seditest_walls", "table5_inputs", "dem_columns", "dem_draw_box"):
        error = _error(results, name)
        text = row(page, f"`{name}`")
        before, after = re.search(r"([\d.]+) → ([\d.]+) kPa", text).groups()
        for told, found in ((before, error["before"]), (after, error["after"])):
            decimals = len(told.partition(".")[2])
            assert told == f"{found['rms_kpa']:.{decimals}f}", name
        found = read_json(results / "studies" / name / "closed_loop.json")["effects_added"]
        for effect in found:
            for key, value in effect["parameters"].items():
                if key == "K":
                    assert f"{value['value']:.2f}" in text
                if key == "factor" and abs(value["value"] - 1) > 0.02:
                    assert re.search(rf"\b{value['value']:.2f}", text), effect["scope_key"]


def _error(results: Path, study: str) -> dict:
    return read_json(results / "studies" / study / "closed_loop.json")["error"]["held_out"]


@pytest.mark.slow
@pytest.mark.workflow
def test_the_figures_are_those_of_a_run(tmp_path):
    for part in ("pipeline", "profiles", "workflow_configs"):
        shutil.copytree(REPOSITORY / part, tmp_path / part)
    shutil.copy(REPOSITORY / "Snakefile", tmp_path)
    targets = [f"results/experiments/{name}/validation.json" for name in EXPERIMENTS]
    targets += [f"results/studies/{name}/closed_loop.json" for name in STUDIES]
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *targets]
    subprocess.run(command, cwd=tmp_path, check=True)
    check_limits((REPOSITORY / "docs" / "limits.md").read_text("utf-8"), tmp_path / "results")
    check_physics((REPOSITORY / "docs" / "physics.md").read_text("utf-8"), tmp_path / "results")


def test_the_benchmark_s_figures_are_those_of_its_page():
    """In percent, as docs/blind_benchmark.md has them of the logged run."""
    limits = (REPOSITORY / "docs" / "limits.md").read_text("utf-8")
    benchmark = (REPOSITORY / "docs" / "blind_benchmark.md").read_text("utf-8")
    part = " ".join(limits.partition("## What the loop misses")[2].partition("\n## ")[0].split())
    for quantity, words in (
        ("two effects, both with delta of at least 5: exact set", "no third, in {} % of"),
        ("outside the catalogue, delta of at least 5: right rule", "the right one in {} %"),
        (
            "undecided worlds with one effect resolved by the recommended",
            "settles {} % of the open",
        ),
        ("the same by a measurement chosen at random", "one at random {} %"),
    ):
        count, of = map(int, re.search(r"\((\d+) of (\d+);", row(benchmark, "", quantity)).groups())
        assert words.format(f"{100 * count / of:.0f}") in part
    missed = len(re.findall(r"\*\*missed", benchmark))
    words = "zero one two three four five six seven eight nine ten"
    counts = words.split()
    assert f"it missed {counts[missed]} of its fourteen bars" in part
    readme = (REPOSITORY / "README.md").read_text("utf-8")
    physics = (REPOSITORY / "docs" / "physics.md").read_text("utf-8")
    before, after = re.search(r"([\d.]+) → ([\d.]+) kPa", row(physics, "`seditest_walls`")).groups()
    assert f"not seen to {before} kPa (rms)" in readme
    assert f"the error is {after} kPa" in readme
