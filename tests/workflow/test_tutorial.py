"""The tutorial, done as a reader does it: commands run, files written, what it quotes found."""

import html
import re
import shutil
from pathlib import Path

import pytest

from pipeline.files.atomic import read_json
from pipeline.report.study import VERDICTS

pytestmark = pytest.mark.workflow

BLOCK = re.compile(r"^```(\w+) ?(\S*)\n(.*?)^```$|^((?:> [^\n]*\n)+)", re.MULTILINE | re.DOTALL)
SECTION = re.compile(r"^(\w+):.*\n(?:(?: .*)?\n)*", re.MULTILINE)
GAIN = 1.25  # of load cell C5 in the tutorial's readings


class Reader:
    """Does what one block after the other says."""

    def __init__(self, workspace):
        self.workspace = workspace
        self.said = ""
        self.page = Path()
        self.done: list[str] = []

    def follow(self, kind: str, file: str, content: str, quote: str) -> None:
        self.done.append(kind or "quote")
        if quote:
            self.find(quote)
        else:
            getattr(self, kind)(content, self.workspace.folder / file)

    def bash(self, content: str, _) -> None:
        """The commands that set everything up: known to make, and not run here."""
        target, activate = content.splitlines()
        assert activate == "source .venv/bin/activate"
        shown = self.run(f"{target.replace('make', 'make --dry-run')}")
        assert ".venv/bin/pip install" in shown

    def sh(self, content: str, _) -> None:
        self.said = self.run(content)
        if page := re.search(r"\S+/(?:report|prediction)\.html", content):
            self.page = self.workspace.folder / page[0]

    def text(self, content: str, _) -> None:
        for line in content.splitlines():
            assert line in self.said.splitlines()

    def csv(self, content: str, path: Path) -> None:
        assert path.is_file()
        path.write_text(content, "utf-8")

    def yaml(self, content: str, path: Path) -> None:
        """Sections of a file in place of those of the same name."""
        new = {found[1]: found[0] for found in SECTION.finditer(content)}
        old = path.read_text("utf-8")
        assert new.keys() <= {found[1] for found in SECTION.finditer(old)}
        path.write_text(SECTION.sub(lambda found: new.get(found[1], found[0]), old), "utf-8")

    def find(self, quote: str) -> None:
        page = re.sub(r"<[^>]+>", "", html.unescape(self.page.read_text("utf-8")))
        page = " ".join(page.split())
        for line in quote.splitlines():
            pieces = map(re.escape, line.removeprefix("> ").split("…"))
            assert re.search(r"\d*".join(pieces), page), line

    def run(self, command: str) -> str:
        return self.workspace.shell(command)


def test_the_tutorial_leads_from_six_load_cells_to_the_verdict(fresh, repository):
    shutil.copytree(
        repository / "workflow_configs" / "schema", fresh.folder / "workflow_configs" / "schema"
    )
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(repository / name, fresh.folder)
    text = (repository / "docs" / "tutorial.md").read_text("utf-8")
    assert text.count("```") == 2 * len(re.findall("(?m)^```\\w", text))
    reader = Reader(fresh)
    printed = []
    for block in BLOCK.finditer(text):
        reader.follow(*(part or "" for part in block.groups()))
        if block[1] == "sh" and "pipeline new" in block[3]:
            printed += [line.strip() for line in reader.said.splitlines() if "snakemake" in line]
    assert {"sh", "csv", "yaml", "text", "quote"} <= set(reader.done)
    for command in printed:
        assert f"\n{command}\n" in text
    assert len(printed) == 2
    made = fresh.folder / "mine" / "results" / "studies" / "loop"
    found = read_json(made / "closed_loop.json")
    (effect,) = found["effects_added"]
    low, high = effect["parameters"]["gain"]["interval_90"]
    assert (effect["name"], effect["scope_key"]) == ("sensor_gain", "C5")
    assert low < GAIN < high
    assert (made / "improved" / "box.yaml").is_file()


def test_the_page_on_predictions_does_what_it_says(fresh, repository):
    shutil.copytree(
        repository / "workflow_configs" / "schema", fresh.folder / "workflow_configs" / "schema"
    )
    reader = Reader(fresh)
    for block in BLOCK.finditer((repository / "docs" / "prediction.md").read_text("utf-8")):
        reader.follow(*(part or "" for part in block.groups()))
    assert reader.done == ["sh", "sh", "sh", "quote"]


def test_the_tutorial_names_every_verdict_as_the_page_does(repository):
    text = (repository / "docs" / "tutorial.md").read_text("utf-8")
    table = text.partition("|---|---|---|\n")[2].partition("\n\n")[0]
    named = {line.split(" | ")[0].removeprefix("| ") for line in table.splitlines()}
    assert named == {badge.text for badge in VERDICTS.values()}


def test_what_new_writes_into_the_repository_runs_as_it_is(fresh):
    kinds = ("static", "draw")
    for words in (*([kind, "--kind", kind] for kind in kinds), ["pair", "--study", *kinds]):
        process = fresh.python("-m", "pipeline", "new", *words)
        assert process.returncode == 0, process.stdout
    assert process.stdout.endswith("snakemake --cores all results/studies/pair/report.html\n")
    assert "pair: report" in fresh.snakemake("--dry-run", "results/studies/pair/report.html").stdout
    process = fresh.snakemake(*(f"results/experiments/{kind}/report.html" for kind in kinds))
    assert process.returncode == 0, process.stdout
    for kind in kinds:
        folder = fresh.folder / "results" / "experiments" / kind
        assert (folder / "report.html").is_file()
        parameters = read_json(folder / "calibration.json")["parameters"]
        assert {name for name, one in parameters.items() if one["calibrated"]} == {"E"}
        assert not parameters["E"]["at_bound"]
