"""`python -m pipeline check`: a line for what is sound, all that is wrong otherwise, and fast."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from specs import expectations

CORPUS = Path(__file__).parents[1] / "config" / "bad"
EXPERIMENTS = sorted((CORPUS / "experiments").glob("*/*.yaml"))
STUDIES = sorted((CORPUS / "studies").glob("*.yaml"))
PREDICTIONS = sorted((CORPUS / "predictions").glob("*/experiments/predicted.yaml"))
OTHERS = sorted(path for kind in ("comparisons", "imports") for path in (CORPUS / kind).glob("*"))
TABLES = sorted((CORPUS / "experiments").glob("*/measured/*.csv"))
OTHERS_ONLY = "other_experiments_only"  # told in other words where the table itself is checked


@pytest.mark.parametrize(
    "path",
    [
        *(*EXPERIMENTS, *STUDIES, *OTHERS, *PREDICTIONS),
        *(table for table in TABLES if table.stem != OTHERS_ONLY),
    ],
    ids=lambda path: path.parents[1].name if path in PREDICTIONS else path.stem,
)
def test_what_the_workflow_refuses_is_refused(path, call, assert_in_house_style):
    answer = call("check", path)
    assert (answer.status, answer.out) == (1, "")
    assert_in_house_style(answer.err.rstrip("\n"))
    assert expectations(path)
    for text in expectations(path):
        assert text in answer.err


def test_a_line_says_what_each_sound_file_holds(mine, call):
    answer = call("check", "mine")
    assert (answer.status, answer.err) == (0, "")
    assert answer.out.splitlines() == [
        "mine/experiments/box.yaml: static experiment, 1536 cells, 12 measured values, "
        "20 replicates",
        "mine/studies/loop.yaml: study of 1 experiment, 12 measured values, 2 held out",
        "mine/experiments/measured/box.csv: 12 values of box",
    ]


def test_a_comparison_is_checked_with_its_experiments(mine, call):
    """Judged by its keys where its folder has another name; the line says what it compares."""
    for name in ("slow", "fast"):
        assert call("new", name, "--kind", "draw", "--dir", mine / "experiments").status == 0
    for folder in ("comparisons", "elsewhere"):
        (mine / folder).mkdir()
        text = "title: Two rates\nexperiments: [slow, fast]\nthreshold_mpa: 0.02\n"
        (mine / folder / "rates.yaml").write_text(text, "utf-8")
        answer = call("check", mine / folder / "rates.yaml")
        assert (answer.status, answer.err) == (0, "")
        assert "comparison of slow and fast, 3 load cells, threshold 0.02 MPa" in answer.out
    assert "mine/comparisons/rates.yaml: comparison of" in call("check", "mine").out

    path = mine / "comparisons" / "rates.yaml"
    path.write_text(path.read_text("utf-8").replace("fast", "box"), "utf-8")
    answer = call("check", "mine")
    assert answer.status == 1
    assert "experiments[1] = box: a static experiment; expected one with draw" in answer.err
    path.write_text(path.read_text("utf-8").replace("box", "fats"), "utf-8")
    assert (
        "experiments[1] = fats: no such experiment; did you mean fast?" in call("check", path).err
    )


def test_a_prediction_is_checked_with_its_study(mine, call):
    """It is looked for in the folder beside the experiment's, or where it is said to be."""
    path = mine / "experiments" / "box.yaml"
    path.write_text(path.read_text("utf-8") + "\nprediction: {study: loop}\n", "utf-8")
    assert call("check", path).status == 0
    (mine / "studies").rename(mine / "elsewhere")
    answer = call("check", path)
    assert answer.status == 1
    assert "prediction.study = loop: no such study; there are none in mine/studies" in answer.err
    assert call("check", path, "--studies", mine / "elsewhere").status == 0


def test_import_settings_are_checked_wherever_they_lie(mine, call, repository):
    settings = mine / "settings.yaml"
    settings.write_text("columns: {x: XMID}\ngaps: outside\n", "utf-8")
    assert "settings.yaml: import settings: columns, gaps\n" in call("check", settings).out
    own = repository / "tests" / "files"
    files = [*own.glob("mine_files/*settings.yaml"), *own.glob("bad_imports/*/settings.yaml")]
    said = {str(path): call("check", path) for path in files}
    refused = {path for path, answer in said.items() if answer.status}
    assert {path.split("/")[-2] for path in refused} == {
        "region_grade_without_unit",
        "settings_key_unknown",
        "settings_unit_unknown",
    }
    assert all("import settings: " in said[path].out for path in said.keys() - refused)


def test_problems_of_several_files_come_together_and_sound_files_are_still_told(mine, call):
    folder = mine / "experiments"
    for name, change in (("steep", "E: 95"), ("flat", "E: 0")):
        text = (folder / "box.yaml").read_text("utf-8").replace("E: 0.95", change)
        (folder / f"{name}.yaml").write_text(text.replace("measured: ", "#measured: "), "utf-8")
    answer = call("check", folder)
    assert answer.status == 1
    assert [line.split(":")[0] for line in answer.out.splitlines()] == [
        "mine/experiments/box.yaml",
        "mine/experiments/measured/box.csv",
    ]
    assert [line for line in answer.err.splitlines() if not line.startswith(" ")] == [
        "mine/experiments/flat.yaml",
        "mine/experiments/steep.yaml",
    ]
    assert "did you mean 0.95?" in answer.err


def test_rows_that_no_experiment_reads_are_told(mine, call):
    table = mine / "experiments" / "measured" / "box.csv"
    text = table.read_text("utf-8")
    table.write_text(text.replace("box,C6", "bux,C6"), "utf-8")
    answer = call("check", table)
    assert answer.status == 0
    assert (
        "10 values of box; not read, as there is no experiment bux: 2 rows; did you" in answer.out
    )


def test_studies_and_tables_elsewhere_find_their_experiments_where_they_are_told(mine, call):
    lone = mine / "else" / "where"
    lone.mkdir(parents=True)
    shutil.copy(mine / "studies" / "loop.yaml", lone)
    shutil.copy(mine / "experiments" / "measured" / "box.csv", lone)
    assert call("check", lone / "loop.yaml", lone / "box.csv").status == 1
    told = ("--experiments", mine / "experiments")
    assert call("check", lone / "loop.yaml", lone / "box.csv", *told).status == 0


def test_a_comment_that_a_spreadsheet_has_put_in_quotes_is_one(mine, call):
    table = mine / "experiments" / "measured" / "box.csv"
    table.write_text('"# one, two",,,,,,,,\n' + table.read_text("utf-8"), "utf-8")
    assert call("check", table).status == 0


def test_a_folder_s_tables_may_be_anywhere(mine, call):
    table = mine / "experiments" / "measured" / "box.csv"
    table.rename(mine / "readings.csv")
    box = mine / "experiments" / "box.yaml"
    box.write_text(box.read_text("utf-8").replace("measured/box.csv", "../readings.csv"), "utf-8")
    answer = call("check", mine / "experiments")
    assert (answer.status, answer.err) == (0, "")
    assert answer.out.splitlines()[-1].endswith("readings.csv: 12 values of box")


def test_a_study_beside_no_experiments_means_the_repository_s(mine, call, repository):
    studies = mine / "alone" / "studies"
    studies.mkdir(parents=True)
    shutil.copy(repository / "workflow_configs" / "studies" / "dem_columns.yaml", studies)
    answer = call("check", studies)
    assert answer.status == 0
    assert "study of 6 experiments, 29 measured values, each experiment held out" in answer.out


def test_the_repository_s_own_files_and_the_contract_s_are_sound(call, repository):
    answer = call("check", repository / "workflow_configs")
    assert (answer.status, answer.err) == (0, "")
    assert call("check", repository / "tests" / "contract" / "experiments").status == 0


def test_a_check_loads_neither_numba_nor_xarray(mine):
    code = (
        "import sys; from pipeline.__main__ import main; status = main(['check', 'mine']); "
        "print(status, sorted({'numba', 'numpy', 'xarray', 'scipy'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout.splitlines()[-1] == "0 []"


def test_regions_that_do_not_fit_the_lattice_are_found(mine, call):
    path = mine / "experiments" / "box.yaml"
    regions = 'regions: [{name: ore, box: {z: [0, 0.1]}, grade: {Cu: {value: 1, unit: "%"}}}]\n'
    path.write_text(path.read_text("utf-8") + regions, "utf-8")
    answer = call("check", path)
    assert (answer.status, answer.out) == (1, "")
    assert "ground cells lie in no region, so that their grade Cu is not known" in answer.err
