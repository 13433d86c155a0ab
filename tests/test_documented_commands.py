"""Every command in a code block of the documents: run, or at least parsed and dry-run.

Each has to stand in one of the lists below, so that a new one is not overlooked. Words in capitals
that a reader replaces (NAME, DIR, ...) are files and folders of the workspace here.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pipeline.__main__ import command_line

REPOSITORY = Path(__file__).parents[1]
PAGES = [REPOSITORY / "README.md", REPOSITORY / "config" / "README.md"]
PAGES += sorted(REPOSITORY.glob("docs/*.md"))
COMMAND = re.compile(
    r"(?:cdo|cd|dask|gdal\w*|git|make|nc\w+|pip|python|Rscript|snakemake|source)(?: .*)?"
)

ELSEWHERE = {  # pages whose commands another test runs in their order, all or those that begin so
    "tutorial.md": ("", "workflow/test_tutorial.py"),
    "mine_files.md": ("python -m pipeline ", "files/test_mine_files_page.py"),
    "regions.md": ("", "workflow/test_regions_page.py"),
    "prediction.md": ("", "workflow/test_tutorial.py"),
}
RUN = (  # here, as they stand
    "python -m pipeline new NAME --dir DIR",
    "python -m pipeline check DIR",
    "python -m pipeline import blocks model.csv --name NAME",
    "python workflow_configs/experiments/make_mine.py --cell-size 0.7 --cells-drawn 100000 "
    "--periods 1 --replicates 1 --folder DIR",
    "snakemake --rulegraph",
    "snakemake results/experiments/castro_2020/report.html --rulegraph mermaid-js",
    "snakemake --summary",
    "snakemake --detailed-summary",
    "snakemake --dry-run",
)
DRY_RUN = (  # with --dry-run only: these take minutes to hours, or make what others make already
    "make",
    "make test",
    'make TARGETS="results/experiments/castro_2020/report.html"',
    "snakemake --cores all --config experiments_dir=DIR results_dir=DIR2",
    "snakemake --cores all blind_benchmark --config blind_worlds=200",
    "snakemake --cores all --config dask_scheduler=tcp://HOST:8786",
    "snakemake --profile workflow_configs/profiles/slurm --workflow-profile none",
    "snakemake --cores all results/comparisons/mine_strategies/report.html",
    "snakemake --cores all DIR2/experiments/mine_panel/report.html --config experiments_dir=DIR "
    "results_dir=DIR2",
    "snakemake --cores all --config experiments_dir=DIR comparisons_dir=DIR2 results_dir=DIR3",
    "snakemake --cores all results/experiments/NAME/export/block_model.csv",
    "snakemake --cores all results/experiments/castro_2020_panel/report.html",
    "snakemake --cores all results/studies/NAME/report.html",
    "snakemake --cores all --config experiments_dir=results/studies/NAME/improved results_dir=DIR",
    "snakemake --cores all DIR3/studies/NAME/report.html --config experiments_dir=DIR "
    "studies_dir=DIR2 results_dir=DIR3",
    "snakemake --cores all results/comparisons/NAME/report.html",
    # run by tests/workflow/test_what_snakemake_offers.py on a small experiment
    "snakemake --report report.html",
    "snakemake results/experiments/castro_2020/report.html --report report.html",
)
PARSED = (  # by the command's own parser only: they need results, or idle minutes
    "python -m pipeline export NAME --to vtk --to csv --to block_model",
    "python -m pipeline export castro_2020_panel --to vtk",
    "python -m pipeline figures results/experiments/NAME/report.html",
    "python -m pipeline figures results/studies/seditest_walls/report.html --only held_out",
    "python -m pipeline figures results/experiments/castro_2020_panel/report.html "
    "--only stress_sections",
    "python -m pipeline.stages DIR/mine_panel.yaml",
    "python -m pipeline.benchmark",
    "python -m pipeline.benchmark --quick",
    "python -m pipeline.benchmark --json",
    "python -m pipeline.benchmark --workflow",
)
NOT_RUN = (  # other programs; nothing here can tell whether they are right
    "git clone URL block-cave-stress",
    "cd block-cave-stress",
    "git checkout ed9878044327",
    "dask scheduler",
    "dask worker tcp://HOST:8786 --nthreads 1 --nworkers 16",
    'pip install -e ".[slurm]"',
    "gdallocationinfo -b 1 NETCDF:fields.nc:vertical_stress_mean 3 2",
    "ncdump -v base_vertical_stress_mean statistics.nc | tail -3",
    'ncks -H -C -v mass_drawn fields.nc | grep "mass_drawn ="',
)
STANDS_FOR = {  # what a word of a command is here
    "comparisons_dir=DIR2": "comparisons_dir=DIR4",  # DIR2 holds studies
    "blind_worlds=200": "blind_worlds=200 blind_seed=1",  # a copy has no commit to take it from
}


def commands_of(path: Path) -> list[str]:
    """Commands of a page's code blocks (fenced or indented), continued lines joined."""
    text = re.sub(r"\\\n\s*", " ", path.read_text("utf-8"))
    found, language = [], None
    for line in text.splitlines():
        if fence := re.match(r"```(\w*)", line):
            language = None if language is not None else fence[1]
            continue
        if language is None:
            line = line[4:] if line.startswith("    ") else ""
        elif language == "console":
            line = line[2:] if line.startswith("$ ") else ""
        elif language not in ("sh", "bash"):
            line = ""
        line = " ".join(re.sub(r"(^| )# .*| {2,}#.*", "", line).split())
        if COMMAND.fullmatch(line):
            found.append(line)
    return found


def here() -> dict[str, str]:
    """Command → page, of all that no other test runs."""
    found = {}
    for page in PAGES:
        prefix, _ = ELSEWHERE.get(page.name, (None, None))
        for command in commands_of(page):
            if prefix is None or not command.startswith(prefix):
                found[command] = page.name
    return found


def test_every_command_is_in_one_list_and_every_entry_on_a_page():
    listed = [*RUN, *DRY_RUN, *PARSED, *NOT_RUN]
    assert len(listed) == len(set(listed))
    documented = here()
    assert {command: page for command, page in documented.items() if command not in listed} == {}
    assert [command for command in listed if command not in documented] == []


def test_the_pages_that_are_run_elsewhere_are():
    for page, (_, test) in ELSEWHERE.items():
        assert commands_of(REPOSITORY / "docs" / page)
        assert page in (REPOSITORY / "tests" / test).read_text("utf-8")


def test_every_page_is_reached_from_the_readme():
    links = set(re.findall(r"\]\(([\w./]+\.md)\)", (REPOSITORY / "README.md").read_text("utf-8")))
    pages = {path.relative_to(REPOSITORY).as_posix() for path in REPOSITORY.glob("docs/**/*.md")}
    assert pages <= links


def test_links_lead_somewhere():
    for page in (*PAGES, *REPOSITORY.glob("docs/reference/*.md")):
        for link in re.findall(r"\]\(([^)#:]+)(?:#[\w-]*)?\)", page.read_text("utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


# ---------------------------------------------------------------------------------------------
# where they are run


def _python(folder: Path, *words: str) -> None:
    command = [sys.executable, *words]
    process = subprocess.run(
        command, cwd=folder, env=_environment(folder), capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stdout + process.stderr


def _environment(folder: Path) -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return os.environ | {"PYTHONPATH": str(folder), "PATH": path}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The workflow with an experiment, a study and a comparison NAME, and folders DIR, DIR2."""
    folder = tmp_path_factory.mktemp("documents") / "workflow"
    skipped = shutil.ignore_patterns("__pycache__")
    for part in ("pipeline", "profiles", "workflow_configs"):
        shutil.copytree(REPOSITORY / part, folder / part, ignore=skipped)
    for file in ("Snakefile", "Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / file, folder)
    shutil.copy(REPOSITORY / "tests" / "files" / "mine_files" / "blocks.csv", folder / "model.csv")
    rates = "experiments: [slow, NAME]\nthreshold_mpa: 0.02\n"
    for own, studies, comparisons in (
        (
            "workflow_configs/experiments",
            "workflow_configs/studies",
            "workflow_configs/comparisons",
        ),
        ("DIR", "DIR2", "DIR4"),
    ):
        for name in ("slow", "NAME"):
            _python(folder, "-m", "pipeline", "new", name, "--kind", "draw", "--dir", own)
        words = ("--study", "NAME", "--dir", studies, "--experiments", own)
        _python(folder, "-m", "pipeline", "new", "NAME", *words)
        (folder / comparisons).mkdir(exist_ok=True)
        (folder / comparisons / "NAME.yaml").write_text(rates, "utf-8")
    _python(folder, *shlex.split(next(one for one in RUN if "make_mine" in one))[1:])
    improved = folder / "results" / "studies" / "NAME" / "improved"
    shutil.copytree(folder / "DIR", improved)
    return folder


@pytest.fixture(scope="module")
def snakemake(folder):
    """Command → (status, output) of all Snakemake commands, those of DRY_RUN dry."""
    commands = [one for one in (*RUN, *DRY_RUN) if one.startswith("snakemake ")]
    calls = []
    for command in commands:
        words = shlex.split(command)[1:]
        if command in DRY_RUN:
            dry = ["--dry-run", "--quiet", "rules"]
            words = [word for word in words if word not in ("--report", "report.html")]
            place = words.index("--config") if "--config" in words else len(words)
            words = [*words[:place], *dry, *words[place:]]
        calls.append([part for word in words for part in STANDS_FOR.get(word, word).split()])
    process = subprocess.run(
        [sys.executable, REPOSITORY / "tests" / "workflow" / "many_snakemakes.py"],
        input=json.dumps(calls),
        cwd=folder,
        env=_environment(folder),
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(commands, json.loads(process.stdout), strict=True))


@pytest.mark.workflow
@pytest.mark.parametrize(
    "command", [one for one in (*RUN, *DRY_RUN) if one.startswith("snakemake")]
)
def test_snakemake_takes_the_command(snakemake, command):
    status, output = snakemake[command]
    assert status == 0, output
    targets = [word for word in shlex.split(command) if "/report.html" in word]
    if command in DRY_RUN and targets:
        assert re.search(r"(?m)^(report|study_report|comparison_report) +1$", output), output


@pytest.mark.workflow
@pytest.mark.parametrize("command", [one for one in RUN if one.startswith("python -m pipeline ")])
def test_the_command_runs(folder, tmp_path, command):
    shutil.copy(folder / "model.csv", tmp_path)
    (tmp_path / "workflow_configs" / "experiments").mkdir(parents=True)
    if "check" in command:
        shutil.copytree(folder / "DIR", tmp_path / "DIR")
    process = subprocess.run(
        [sys.executable, *shlex.split(command)[1:]],
        cwd=tmp_path,
        env=_environment(folder),
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout


@pytest.mark.parametrize("command", [one for one in DRY_RUN if one.startswith("make")])
def test_make_knows_the_target(folder, command):
    shown = subprocess.run(
        ["make", "--dry-run", *shlex.split(command)[1:]],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert ("pytest" if "test" in command.split() else "pipeline.workflow.run") in shown


@pytest.mark.parametrize("command", PARSED)
def test_the_parser_takes_the_command(command):
    _, _, module, *words = shlex.split(command)
    if module == "pipeline":
        assert command_line().parse_args(words).run
        return
    process = subprocess.run(
        [sys.executable, "-m", module, "--help"], capture_output=True, text=True, check=True
    )
    for word in words:
        assert not word.startswith("--") or word in process.stdout


def test_the_extra_that_is_installed_exists():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    for command in NOT_RUN:
        if extra := re.search(r"\.\[(\w+)\]", command):
            assert extra[1] in project["optional-dependencies"]
