"""Bad command lines: one clear error each, no traceback, and no file made, changed or lost."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BOX = "mine/experiments/box.yaml"
TABLE = "mine/experiments/measured/box.csv"
LOOP = "mine/studies/loop.yaml"
HEAD = "experiment,quantity,value,std\n"


def edit(file: str, old: str, new: str):
    """A change of one of the user's files."""

    def change(folder: Path) -> None:
        path = folder / file
        text = path.read_text("utf-8")
        assert old in text
        path.write_text(text.replace(old, new), "utf-8")

    return change


def write(file: str, content: str | bytes = ""):
    """A file that the user has."""

    def change(folder: Path) -> None:
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def remove(file: str):
    """A file that is not there any more."""
    return lambda folder: (folder / file).unlink()


def make(name: str):
    """A folder that the user has."""
    return lambda folder: (folder / name).mkdir(parents=True)


NEW, STUDY = ("new", "dig", "--dir", "mine/experiments"), ("new", "dig", "--dir", "mine/studies")
USAGE = {  # what argparse refuses: words → what it says
    ("new", "dig", "--kind", "dynamic"): "invalid choice: 'dynamic' (choose from 'static', 'draw')",
    ("new",): "the following arguments are required: NAME",
    ("new", "dig", "--kind", "draw", "--study", "box"): "not allowed with argument --kind",
    ("new", "dig", "--study"): "argument --study: expected at least one argument",
    ("new", "dig", "--dir"): "argument --dir: expected one argument",
    ("new", "my", "box"): "unrecognized arguments: box",
    ("check",): "the following arguments are required: FILE",
    ("chek", BOX): "invalid choice: 'chek'",
    (): "the following arguments are required: COMMAND",
    ("check", BOX, "--strict"): "unrecognized arguments: --strict",
}
CASES = {  # name: (what is there, words, what the error has)
    # new
    "name_with_a_space": ((), ("new", "my box", *NEW[2:]), ["NAME = my box", "letters, digits"]),
    "name_with_a_slash": ((), ("new", "a/b", *NEW[2:]), ["NAME = a/b", "letters, digits"]),
    "name_that_climbs": ((), ("new", "..", *NEW[2:]), ["NAME = ..", "letters, digits"]),
    "name_with_suffix": ((), ("new", "dig.yaml", *NEW[2:]), ["did you mean dig?"]),
    "name_empty": ((), ("new", "", *NEW[2:]), ['NAME = ""', "letters, digits"]),
    "name_with_umlaut": ((), ("new", "säule", *NEW[2:]), ["NAME = säule", "letters, digits"]),
    "name_with_line_end": ((), ("new", "dig\n", *NEW[2:]), ["letters, digits"]),
    "name_too_long": ((), ("new", "x" * 300, *NEW[2:]), ["cannot be written: File name too long"]),
    "experiment_exists": ((), ("new", "box", *NEW[2:]), [BOX, "exists already; choose another"]),
    "other_suffix_exists": ((write("mine/experiments/dig.yml"),), NEW, ["dig.yml", "exists alr"]),
    "table_exists": (
        (write("mine/experiments/measured/dig.csv", "my own"),),
        NEW,
        ["measured/dig.csv", "exists already"],
    ),
    "folder_of_that_name": ((make("mine/experiments/dig.yaml"),), NEW, ["exists already"]),
    "folder_is_a_file": (
        (),
        ("new", "dig", "--dir", BOX),
        ["cannot be written", "box.yaml is no folder"],
    ),
    "measured_is_a_file": (
        (write("here/measured"),),
        ("new", "dig", "--dir", "here"),
        ["here/measured/dig.csv", "cannot be written: here/measured is no folder"],
    ),
    "schema_is_a_file": (
        (write("here/schema"),),
        ("new", "dig", "--dir", "here"),
        ["cannot be written: here/schema is no folder"],
    ),
    # new --study
    "study_exists": ((), ("new", "loop", "--study", "box", *STUDY[2:]), [LOOP, "exists already"]),
    "study_of_unknown": (
        (),
        (*STUDY, "--study", "bix"),
        ["--study bix: no such experiment in", "did you mean box?"],
    ),
    "study_of_one_twice": ((), (*STUDY, "--study", "box", "box"), ["experiments", "named twice"]),
    "study_of_a_file": (
        (),
        (*STUDY, "--study", BOX),
        [f"--study {BOX}: no such", "did you mean box?"],
    ),
    "study_of_unmeasured": (
        (edit(BOX, "measured: ", "#measured: "),),
        (*STUDY, "--study", "box"),
        ["has no measured values"],
    ),
    "study_of_one_reading": (
        (write(TABLE, HEAD + "box,vertical_stress,9,1\n"),),
        (*STUDY, "--study", "box"),
        ["nothing to hold out", "name another experiment too"],
    ),
    "study_of_a_broken_experiment": (
        (edit(BOX, "E: 0.95", "E: 95"),),
        (*STUDY, "--study", "box"),
        [BOX, "stress.E = 95", "did you mean 0.95?"],
    ),
    "study_without_experiments_there": (
        (make("other"),),
        (*STUDY, "--study", "box", "--experiments", "other"),
        ["other", "holds no experiments"],
    ),
    "experiments_without_study": (
        (),
        (*NEW, "--experiments", "mine/experiments"),
        ["mine/experiments", "name them after --study"],
    ),
    "study_of_others_in_the_repository": (
        (),
        ("new", "dig", "--study", "box", "--experiments", "mine/experiments"),
        ["mine/experiments", "give --dir too"],
    ),
    "study_with_experiments_nowhere": (
        (),
        (*STUDY, "--study", "box", "--experiments", "nowhere"),
        ["nowhere", "no such folder"],
    ),
    # check: what is named
    "file_missing": (
        (),
        ("check", "mine/experiments/bix.yaml"),
        ["no such file", "mean box.yaml?"],
    ),
    "file_in_no_folder": ((), ("check", "nowhere/box.yaml"), ["nowhere/box.yaml", "no such file"]),
    "table_missing": ((), ("check", TABLE + ".csv"), ["no such file", "did you mean box.csv?"]),
    "folder_empty": (
        (make("empty"),),
        ("check", "empty"),
        ["no experiments, studies or comp"],
    ),
    "folder_named_as_a_file": ((make("a.yaml"),), ("check", "a.yaml"), ["holds no experiments"]),
    "neither_yaml_nor_table": (
        (write("notes.txt", "x"),),
        ("check", "notes.txt"),
        ["expected an experiment, a study, a comparison or import settings (.yaml), or a meas"],
    ),
    "spreadsheet": ((write("box.xlsx", b"PK"),), ("check", "box.xlsx"), ["measured table (.csv"]),
    # check: YAML
    "yaml_empty": ((write("a.yaml"),), ("check", "a.yaml"), ["the file is empty; expected keys"]),
    "yaml_with_tabs": ((write("a.yaml", "a:\n\tb: 1\n"),), ("check", "a.yaml"), ["not tabs"]),
    "yaml_not_utf8": ((write("a.yaml", b"title: \xff\n"),), ("check", "a.yaml"), ["UTF-8 text"]),
    "yaml_is_binary": ((write("a.yaml", b"\x00\x01"),), ("check", "a.yaml"), ["control character"]),
    "yaml_is_a_csv": ((write("a.yaml", HEAD),), ("check", "a.yaml"), ["found a single value"]),
    "yaml_of_two_experiments": (
        (write("a.yaml", "title: a\n---\ntitle: b\n"),),
        ("check", "a.yaml"),
        ["a second document starts here"],
    ),
    "key_misspelled": (
        (edit(BOX, "cell_size", "cell_sise"),),
        ("check", BOX),
        ["geometry.cell_sise: unknown key; did you mean cell_size?", "geometry.cell_size: missing"],
    ),
    "unit_in_the_value": ((edit(BOX, "0.80", "80 cm"),), ("check", BOX), ["without unit"]),
    "source_of_stress_unknown": (
        (edit(BOX, "#  from: OTHER", "  from: bax"), edit(BOX, "  E: 0.95", "#  E: 0.95")),
        ("check", BOX),
        ["stress.from = bax: no such experiment in this folder"],
    ),
    "table_not_there": ((remove(TABLE),), ("check", BOX), ["measured = measured/box.csv: no such"]),
    "study_names_unknown": (
        (edit(LOOP, "[box]", "[bix]"),),
        ("check", LOOP),
        [LOOP, "experiments[0] = bix: no such experiment; did you mean box?"],
    ),
    "study_holds_out_unknown": (
        (edit(LOOP, "[C6]", "[C7]"),),
        ("check", LOOP),
        ["hold_out.load_cells[0] = C7: no such load cell"],
    ),
    "study_with_a_wrong_effect": (
        (edit(LOOP, "candidates: all", "candidates: [tillt]"),),
        ("check", LOOP),
        ["candidates[0] = tillt: unknown effect; did you mean tilt?"],
    ),
    "study_that_lacks_its_experiments": (
        (edit(LOOP, "experiments: [box]", "# "),),
        ("check", LOOP),
        [LOOP, "experiments: missing"],
    ),
    "study_beside_a_broken_experiment": (
        (edit(BOX, "E: 0.95", "E: 95"),),
        ("check", LOOP),
        [BOX, "stress.E = 95"],
    ),
    # check: tables
    "csv_empty": ((write(TABLE),), ("check", TABLE), ["empty; expected the columns experiment,"]),
    "csv_of_comments": (
        (write(TABLE, "# a\n"),),
        ("check", TABLE),
        ["empty; expected the columns"],
    ),
    "csv_without_rows": ((write(TABLE, HEAD),), ("check", TABLE), ["no row names its experiment"]),
    "csv_with_semicolons": (
        (write(TABLE, HEAD.replace(",", ";")),),
        ("check", TABLE),
        ["line 1: columns are separated by semicolons"],
    ),
    "csv_with_a_unit_in_the_column": (
        (edit(TABLE, "quantity,value", "quantity,value_kpa"),),
        ("check", TABLE),
        ["unknown column value_kpa; did you mean value?", "column value is missing"],
    ),
    "csv_in_pa": (
        (edit(TABLE, "9.57,0.19", "957000,19000"),),
        ("check", TABLE),
        ["value = 957000", "this looks like Pa, did you mean 957?"],
    ),
    "csv_with_a_unit_in_the_value": (
        (edit(TABLE, ",9.57,", ",9.57 kPa,"),),
        ("check", TABLE),
        ["value = 9.57 kPa", "a number in kPa", "write a bare number"],
    ),
    "csv_with_another_quantity": (
        (edit(TABLE, "vertical_stress,9.57", "stress_mpa,9.57"),),
        ("check", TABLE),
        ["quantity = stress_mpa: unknown quantity"],
    ),
    "csv_of_another_load_cell": (
        (edit(TABLE, "box,C6,,", "box,C7,,"),),
        ("check", TABLE),
        ["load_cell = C7: unknown load cell"],
    ),
    "csv_of_another_experiment": (
        (edit(TABLE, "\nbox,", "\nbax,"),),
        ("check", TABLE),
        ["experiment = bax: no such experiment in mine/experiments; did you mean box?"],
    ),
    "csv_not_utf8": ((write(TABLE, b"experiment\xb5\n"),), ("check", TABLE), ["line 1: not UTF-8"]),
    "csv_is_a_spreadsheet": ((write(TABLE, b"PK\x03\x04\xff"),), ("check", TABLE), ["not UTF-8"]),
    "netcdf_that_is_none": ((write("a.nc", "x"),), ("check", "a.nc"), ["not readable as netCDF"]),
}


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize("case", CASES)
def test_one_clear_error_and_everything_as_it_was(
    case, mine, tmp_path, call, assert_in_house_style
):
    there, words, expected = CASES[case]
    for change in there:
        change(tmp_path)
    before = contents(tmp_path)
    answer = call(*words)
    assert (answer.status, answer.out) == (1, ""), answer
    assert_in_house_style(answer.err.rstrip("\n"))
    for text in expected:
        assert text in answer.err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("words", USAGE, ids=" ".join)
def test_what_is_no_command_line_is_refused_with_what_it_lacks(words, mine, tmp_path, call):
    before = contents(tmp_path)
    answer = call(*words)
    assert (answer.status, answer.out) == (2, "")
    usage, *_, last = answer.err.strip().splitlines()
    assert usage.startswith("usage: python -m pipeline")
    assert USAGE[words] in last
    assert contents(tmp_path) == before


def test_a_folder_that_takes_no_files_is_left_without_any(mine, tmp_path, call, monkeypatch):
    from pipeline.commands import new

    written = []

    def fail_at_the_second(path, text):
        if written:
            raise OSError(28, "No space left on device")
        path.parent.mkdir(parents=True)
        path.write_text(text, "utf-8")
        written.append(path)

    monkeypatch.setattr(new, "write_text", fail_at_the_second)
    before = contents(tmp_path)
    answer = call("new", "dig", "--dir", "another/place")
    assert (answer.status, answer.out) == (1, "")
    assert "cannot be written: No space left on device" in answer.err
    assert written
    assert contents(tmp_path) == before


def test_in_a_process_of_its_own_the_error_is_all_that_is_printed(mine):
    shutil.copy(mine / "experiments" / "box.yaml", mine / "studies" / "box two.yaml")
    process = subprocess.run(
        [sys.executable, "-m", "pipeline", "check", "mine/studies/box two.yaml"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (process.returncode, process.stdout) == (1, "")
    assert process.stderr == (
        "mine/studies/box two.yaml\n"
        "  box two.yaml: the file's name names the results; expected letters, digits, _ and -\n"
    )


def test_the_corpus_is_large_enough():
    assert len(CASES) + len(USAGE) >= 60
