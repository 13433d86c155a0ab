"""What `python -m pipeline new` writes is sound and in step with the models; nothing is lost."""

import csv
import json
import re
import shlex
import shutil

import jsonschema
import pytest
import yaml

from pipeline.commands.new import STARTERS
from pipeline.config.commented import commented, meaning
from pipeline.config.experiment import Experiment
from pipeline.config.load import check_measured, load_experiment, load_studies, load_study
from pipeline.config.measured import COLUMNS
from pipeline.config.schema import FOLDER
from pipeline.config.study import Study

KINDS = ("static", "draw")
IN_PLACE_OF = {"attenuation_length": "E", "from": "E", "at_mass_drawn": "every"}
LEFT_OUT = re.compile(r"#((?:  )*)(\w+):")


@pytest.fixture(params=KINDS)
def written(request, call, tmp_path):
    """A fresh experiment of each kind."""
    answer = call("new", "fresh", "--kind", request.param, "--dir", tmp_path / "mine")
    assert answer.status == 0
    return tmp_path / "mine" / "fresh.yaml"


def test_an_experiment_is_sound_and_has_readings_at_all_its_load_cells(written):
    experiment = load_experiment(written)
    rows = check_measured(experiment)
    assert experiment.is_draw == (experiment.draw != ())
    assert {row.load_cell for row in rows} >= {cell.name for cell in experiment.load_cells}
    assert experiment.data_label == "synthetic"
    assert experiment.calibrate == ("E",)


def test_the_kinds_together_show_every_key_but_what_was_published(call, tmp_path):
    shown = set()
    for kind in KINDS:
        call("new", kind, "--kind", kind, "--dir", tmp_path)
        shown |= set(re.findall(r"(?m)^#?(\w+):", (tmp_path / f"{kind}.yaml").read_text("utf-8")))
    keys = {field.alias or name for name, field in Experiment.model_fields.items()}
    assert keys - shown == {"published"}


def test_a_study_shows_every_key(mine):
    shown = set(re.findall(r"(?m)^#?(\w+):", (mine / "studies" / "loop.yaml").read_text("utf-8")))
    assert shown == set(Study.model_fields)


def uncommented(text: str, key: str) -> str:
    """The file with a left-out key, and all below it, put in; its alternative taken out."""
    lines, depth = [], None
    for line in _without_comments_that_go_on(text):
        found = LEFT_OUT.match(line)
        inside = depth is not None and found and len(found[1]) > depth
        if found and (inside or found[2] == key):
            depth = depth if inside else len(found[1])
            line = line[1:]
        else:
            depth = None
            if key in IN_PLACE_OF and re.match(rf" *{IN_PLACE_OF[key]}:", line):
                continue
        lines.append(line)
    return "\n".join(lines) + "\n"


def _without_comments_that_go_on(text: str) -> list[str]:
    return [line for line in text.splitlines() if not re.match(r" +# ", line)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_that_is_left_out_can_be_put_in(kind, call, tmp_path):
    for name in ("fresh", "OTHER"):
        call("new", name, "--kind", kind, "--dir", tmp_path)
    path = tmp_path / "fresh.yaml"
    text = path.read_text("utf-8")
    keys, depth = [], None
    for found in map(LEFT_OUT.match, _without_comments_that_go_on(text)):
        if not found or depth is None or len(found[1]) <= depth:
            depth = found and len(found[1])
            keys += [found[2]] if found else []
    assert {"mask", "walls", "attenuation_length", "rule"} <= set(keys)
    for key in keys:
        path.write_text(uncommented(text, key), "utf-8")
        load_experiment(path)
        assert yaml.safe_load(path.read_text("utf-8")) != yaml.safe_load(text), key


def test_comments_come_from_the_models(written):
    text = written.read_text("utf-8")
    said = re.sub(r"\n +# ", " ", text)
    description = Experiment.model_fields["geometry"].annotation.model_fields["width"].description
    assert f"# {description.rstrip('.')}; from 1e-06 to 10000\n" in said
    for name, field in Experiment.model_fields.items():
        if re.search(rf"(?m)^#?{name}:", text):
            assert field.description.replace("``", "").rstrip(".") in said, name


def test_a_starter_with_a_key_that_no_model_has_is_an_error():
    with pytest.raises(KeyError, match=r"geometry\.depth"):
        commented("geometry:\n  depth: 1\n", Experiment)


def test_meanings_tell_ranges_choices_and_defaults():
    assert meaning(Experiment, ["replicates"]).endswith("; from 1 to 1000000; default 10")
    assert meaning(Experiment, ["walls", "friction_angle"]).endswith("; from 0 to below 90")
    assert meaning(Experiment, ["stress", "E_min", "type"]).endswith("; one of table, power")
    assert "any of E, s, s.mean" in meaning(Experiment, ["calibrate"])
    assert meaning(Experiment, ["stress", "E"]).endswith(", in (0, 1]")
    assert meaning(Study, ["parameters", "shared_by"]).endswith(
        "one of material, study, experiment"
    )


def modeline(path):
    first = path.read_text("utf-8").splitlines()[0]
    return path.parent / first.removeprefix("# yaml-language-server: $schema=")


@pytest.mark.parametrize("words", [["--kind", "static"], ["--kind", "draw"], ["--study", "box"]])
def test_editors_find_a_schema_that_the_file_keeps_to(words, mine, call):
    folder = mine / ("studies" if "--study" in words else "experiments")
    assert call("new", "another", *words, "--dir", folder).status == 0
    path = folder / "another.yaml"
    schema = json.loads(modeline(path).read_text("utf-8"))
    content = yaml.safe_load(path.read_text("utf-8"))
    jsonschema.Draft202012Validator(schema).validate(content)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(schema).validate(content | {"titel": "?"})


def test_in_the_repository_the_schema_is_the_repository_s(call, monkeypatch, repository):
    monkeypatch.chdir(repository)
    assert call("new", "never_kept", "--dir", "results/never_kept").status == 0
    folder = repository / "results" / "never_kept"
    try:
        assert modeline(folder / "never_kept.yaml").resolve() == FOLDER / "experiment.schema.json"
        assert not (folder / "schema").exists()
    finally:
        shutil.rmtree(folder)


def test_an_old_copy_of_the_schema_is_renewed(mine, call):
    copy = mine / "experiments" / "schema" / "experiment.schema.json"
    copy.write_text("{}", "utf-8")
    assert call("new", "another", "--dir", mine / "experiments").status == 0
    assert json.loads(copy.read_text("utf-8"))["title"] == "Experiment"


def test_a_spreadsheet_can_save_the_table_and_nothing_changes(written):
    before = check_measured(load_experiment(written))
    path = written.parent / "measured" / "fresh.csv"
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert len({len(row) for row in rows if not row[0].startswith("#")}) == 1
    with open(path, "w", encoding="utf-8-sig", newline="") as file:
        csv.writer(file).writerows([*row, *[""] * (len(COLUMNS) - len(row))] for row in rows)
    assert check_measured(load_experiment(written)) == before


@pytest.mark.parametrize("taken", ["box.yaml", "box.yml", "measured/box.csv"])
def test_what_exists_is_left_as_it_is(taken, tmp_path, call):
    path = tmp_path / taken
    path.parent.mkdir(exist_ok=True)
    path.write_text("my own", "utf-8")
    answer = call("new", "box", "--dir", tmp_path)
    assert answer.status == 1
    assert answer.err.splitlines()[0].endswith(taken)
    assert "exists already" in answer.err
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [path]
    assert path.read_text("utf-8") == "my own"


def test_a_study_of_several_leaves_one_out(mine, call):
    assert call("new", "pull", "--kind", "draw", "--dir", mine / "experiments").status == 0
    assert call("new", "both", "--study", "box", "pull", "--dir", mine / "studies").status == 0
    assert load_study(mine / "studies" / "both.yaml").hold_out == "leave_one_out"


def test_a_study_of_one_draw_that_one_load_cell_reads_holds_out_its_end(mine, call):
    folder = mine / "experiments"
    assert call("new", "pull", "--kind", "draw", "--dir", folder).status == 0
    table = folder / "measured" / "pull.csv"
    lines = table.read_text("utf-8").splitlines()
    kept = [line for line in lines if not re.match("pull,(C[23]|,,)", line)]
    table.write_text("\n".join(kept), "utf-8")
    assert call("new", "end", "--study", "pull", "--dir", mine / "studies").status == 0
    assert load_study(mine / "studies" / "end.yaml").hold_out.mass_drawn_above == 0.6


def test_next_commands_name_the_files_where_they_are(mine, call, monkeypatch):
    answer = call("new", "more", "--study", "box", "--dir", "mine/studies")
    *_, folder, check, run = (line.strip() for line in answer.out.splitlines())
    assert folder.startswith("cd ")
    assert call(*shlex.split(check)[3:]).status == 0
    base = mine.resolve()
    assert shlex.split(run) == [
        *["snakemake", "--cores", "all", f"{base}/results/studies/more/report.html", "--config"],
        *[f"experiments_dir={base}/experiments", f"studies_dir={base}/studies"],
        f"results_dir={base}/results",
    ]
    studies = load_studies(
        mine / "studies", {"box": load_experiment(mine / "experiments/box.yaml")}
    )
    assert set(studies) == {"loop", "more"}


def test_starters_are_all_used():
    names = {path.stem for path in STARTERS.iterdir()}
    assert names == {*KINDS, "study"}
