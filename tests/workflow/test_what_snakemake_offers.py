"""Snakemake's own report, rule graph, summary and reasons; its catalogue's files."""

import json
import re

import pytest
import yaml

from pipeline.config.load import load_experiments

pytestmark = pytest.mark.workflow

PAGE = "results/experiments/alpha/report.html"


@pytest.fixture(scope="module")
def reported(finished, copy_of, tmp_path_factory):
    """A copy in which alpha's page and the report of it have been made."""
    workspace = copy_of(finished, tmp_path_factory.mktemp("reported"))
    for words in ([PAGE], ["--report", "report.html", PAGE]):
        process = workspace.snakemake(*words)
        assert process.returncode == 0, process.stdout
    return workspace


def embedded(workspace, name: str):
    """A value that the report's script holds."""
    text = (workspace.folder / "report.html").read_text("utf-8")
    return json.loads(re.search(rf"(?m)^\s*var {name} = (\{{.*\}});?$", text)[1])


def test_the_report_has_categories_captions_and_labels(reported):
    table = "results/experiments/alpha/base_stress.csv"
    assert embedded(reported, "categories") == {"Experiments": {"alpha": [table, PAGE]}}
    results = embedded(reported, "results")
    assert "alpha: simulated vertical stress beside what was measured" in results[PAGE]["caption"]
    assert results[PAGE]["labels"] == {"result": "page"}
    assert results[table]["labels"] == {"result": "base stress"}


def test_the_report_needs_nothing_from_elsewhere(reported):
    """Its scripts and styles are in it: nothing is loaded when it is opened."""
    text = (reported.folder / "report.html").read_text("utf-8")
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?https?://", text)


def test_every_page_of_the_workflow_is_marked_for_the_report(repository):
    """All .html and .svg that a rule makes, with a caption that is there."""
    rules = repository / "pipeline" / "workflow" / "rules"
    text = "".join(path.read_text("utf-8") for path in sorted(rules.glob("*.smk")))
    outputs = re.findall(r'"(<results>/[^"]+\.(?:html|svg))"', text)
    marked = re.findall(r'report\(\s+"(<results>/[^"]+)",\s+caption="\.\./([^"]+)"', text)
    assert set(outputs) <= {path for path, _ in marked}
    assert len(outputs) >= 6
    for _, caption in marked:
        assert (rules.parent / caption).is_file()


def test_the_rule_graph_goes_from_block_model_to_report(finished):
    dot = finished.snakemake(PAGE, "--rulegraph").stdout
    names = dict(re.findall(r'(\d+)\[label = "(\w+)"', dot))
    arrows = {(names[a], names[b]) for a, b in re.findall(r"(\d+) -> (\d+)", dot)}
    assert {("block_model", "calibrate"), ("calibrate", "replicates")} <= arrows
    assert {("replicates", "aggregate"), ("aggregate", "report")} <= arrows
    mermaid = finished.snakemake(PAGE, "--rulegraph", "mermaid-js").stdout
    assert "flowchart TB" in mermaid
    assert "[block_model]" in mermaid


def test_the_summary_has_each_file_with_its_rule_and_a_log_that_is_there(finished):
    lines = finished.snakemake("--summary", *_targets(finished)).stdout.splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith("output_file"))
    rows = [line.split("\t") for line in lines[start + 1 :] if "\t" in line]
    files = {row[0]: row for row in rows}
    assert files["results/experiments/alpha/statistics.nc"][2] == "aggregate"
    for row in rows:
        assert row[-2:] == ["ok", "no update"], row
        assert (finished.folder / row[3]).is_file()


def _targets(workspace):
    return [
        f"results/experiments/{name}/{file}"
        for name in load_experiments(workspace.folder / "workflow_configs" / "experiments")
        for file in ("statistics.nc", "validation.json")
    ]


def test_a_rerun_says_why(done):
    path = "workflow_configs/experiments/alpha.yaml"
    done.edit(path, lambda text: text.replace("replicates: 4", "replicates: 5"))
    said = done.snakemake("--dry-run", *_targets(done)).stdout
    reasons = dict(re.findall(r"Job \d+: (alpha: [\w ]+)\nReason: (.*)", said))
    assert "Params have changed since last execution" in reasons["alpha: block model"]
    assert "Input files updated by another job" in reasons["alpha: statistics"]
    assert "beta:" not in said


def test_an_unknown_setting_is_refused_with_the_nearest_one(fresh):
    process = fresh.snakemake("--dry-run", "--config", "experimentsdir=mine")
    assert process.returncode != 0
    assert "experimentsdir: unknown key; did you mean experiments_dir?" in process.stdout
    assert "Traceback" not in process.stdout


def test_the_config_readme_has_every_setting_with_its_default(repository):
    defaults = yaml.safe_load((repository / "workflow_configs" / "default.yaml").read_text("utf-8"))
    text = (repository / "config" / "README.md").read_text("utf-8")
    told = dict(re.findall(r"(?m)^\| `(\w+)` \| (.+?) \|", text))
    shown = {key: "none" if value is None else f"`{value}`" for key, value in defaults.items()}
    assert told == shown


def test_the_catalogue_finds_what_it_asks_for(repository):
    """As its pages had it when this was written: README, Snakefile, config/README.md, its file."""
    readme = (repository / "README.md").read_text("utf-8").lower()
    assert "snakemake" in readme
    assert "workflow" in readme
    assert (repository / "Snakefile").is_file()
    usage = yaml.safe_load((repository / ".snakemake-workflow-catalog.yml").read_text("utf-8"))
    assert usage["usage"]["software-stack-deployment"]["report"] is True
