"""Every malformed experiment of the corpus is refused by Snakemake itself, before any job."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.config.load import load_experiments
from pipeline.config.messages import ConfigError

pytestmark = pytest.mark.workflow

CORPUS = Path(__file__).parents[1] / "config" / "bad" / "experiments"
CASES = sorted(path.name for path in CORPUS.iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def folder(checkout, tmp_path_factory):
    """The workflow with the corpus under `bad/`."""
    folder = tmp_path_factory.mktemp("refusals") / "workflow"
    shutil.copytree(checkout.folder, folder)
    shutil.copytree(CORPUS, folder / "bad")
    return folder


@pytest.fixture(scope="module")
def refused(checkout, folder):
    """By case: exit status and output of bare `snakemake` on its files."""
    calls = [
        ["--cores", "1", "--config", f"experiments_dir=bad/{case}", f"results_dir=results_{case}"]
        for case in CASES
    ]
    process = subprocess.run(
        [sys.executable, Path(__file__).with_name("many_snakemakes.py")],
        input=json.dumps(calls),
        cwd=folder,
        env=checkout.environment | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(CASES, json.loads(process.stdout), strict=True))


def expectations(case: Path) -> list[str]:
    lines = [
        line
        for path in (*case.glob("*.yaml"), *case.glob("measured/*.csv"))
        for line in path.read_bytes().decode("utf-8", "replace").splitlines()
    ]
    return [line.removeprefix("# expect: ") for line in lines if line.startswith("# expect: ")]


@pytest.mark.parametrize("case", CASES)
def test_a_bad_experiment_ends_snakemake_with_its_message_once(refused, folder, case, monkeypatch):
    status, output = refused[case]
    assert status != 0
    expected = expectations(folder / "bad" / case)
    assert expected
    for text in expected:
        assert text in output
    monkeypatch.chdir(folder)
    with pytest.raises(ConfigError) as caught:
        load_experiments(Path("bad") / case)
    assert output.count(str(caught.value)) == 1
    assert "Traceback" not in output
    assert not (folder / f"results_{case}").exists()


def test_the_corpus_is_not_empty():
    assert len(CASES) > 100
