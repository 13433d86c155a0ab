"""The commands of `docs/mine_files.md` run as they stand there."""

import re
import shlex
import textwrap
from pathlib import Path

import pytest

from pipeline.__main__ import main
from pipeline.commands.export import FORMATS
from pipeline.config.load import check_measured, load_experiment

FILES = Path(__file__).parent / "mine_files"


@pytest.fixture(scope="module")
def commands(repository):
    """Command lines of the page, continued lines joined, by the subcommand's first words."""
    text = (repository / "docs" / "mine_files.md").read_text(encoding="utf-8")
    lines = re.findall(r"(?m)^    python -m pipeline ((?:.*\\\n)*.*)", text)
    return [shlex.split(re.sub(r"\\\n\s*", "", line)) for line in lines]


def test_imports_run_as_the_page_says(commands, repository, tmp_path, monkeypatch, capsys):
    """They say what to type next, and the last one's readings belong to the experiment."""
    monkeypatch.chdir(tmp_path)
    page = (repository / "docs" / "mine_files.md").read_text(encoding="utf-8")
    cells, table = re.search(r"(?m)((?:    .*\n)+?)    (measured: \S+\.csv)", page).groups()
    path = tmp_path / "my_experiments" / "cave_m.yaml"
    imports = [command for command in commands if command[0] == "import"]
    assert [command[1] for command in imports] == ["blocks", "blocks", "massflow", "measured"]
    for command in imports:
        if command[1] == "measured":
            path.write_text(path.read_text() + textwrap.dedent(cells))
        assert main([word.replace("$FILES", str(FILES)) for word in command]) == 0
    assert capsys.readouterr().out.count(" python -m pipeline check ") == 3
    path.write_text(path.read_text() + table)
    for name in ("cave", "cave_v", "cave_m"):
        load_experiment(tmp_path / "my_experiments" / f"{name}.yaml")
    assert len(check_measured(load_experiment(path))) == 4


def test_the_export_runs_as_the_page_says(commands, written, tmp_path, monkeypatch):
    (command,) = [command for command in commands if command[0] == "export"]
    folder = tmp_path / "results" / "experiments" / "column"
    folder.mkdir(parents=True)
    for file in written("static")[1].glob("*.nc"):
        (folder / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert main([word.replace("NAME", "column") for word in command]) == 0
    made = {path.name for path in (folder / "export").iterdir()}
    assert len(made) == len(FORMATS) - 1  # the table of base stress stands beside it
    assert (folder / "base_stress.csv").is_file()


def test_every_key_of_the_settings_is_on_the_page(repository):
    import yaml

    from pipeline.config.imports import ImportSettings

    text = (repository / "docs" / "mine_files.md").read_text(encoding="utf-8")
    block = re.search(r"(?m)^    columns: .*(?:\n    \S.*)*", text)[0]
    given = yaml.safe_load(re.sub("(?m)^    ", "", block))
    ImportSettings.model_validate(given)
    assert set(given) == set(ImportSettings.model_fields)
