"""The reference pages say what the code says, all of it."""

import re

import pytest

from pipeline.config.experiment import Experiment
from pipeline.effects import effects
from pipeline.files.netcdf import variable_table
from pipeline.report.reference import FOLDER, KINDS, pages, stale_lines


@pytest.fixture(scope="module")
def text():
    return pages()


def section(page: str, heading: str) -> str:
    return page.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def rows(text: str) -> dict[str, list[str]]:
    """First cell → the others, of the rows of all tables."""
    lines = [re.split(r"(?<!\\) ?\| ?", line)[1:-1] for line in text.splitlines() if "|" in line]
    return {cells[0].strip("`"): cells[1:] for cells in lines}


def test_the_committed_pages_are_up_to_date():
    assert stale_lines(FOLDER) == [], "run python -m pipeline reference"


def test_the_command_writes_them_and_sees_what_is_stale(call_main, tmp_path):
    status, out = call_main("reference", "--dir", tmp_path)
    assert status == 0
    assert [line.rpartition("/")[2] for line in out.splitlines()] == list(pages())
    assert call_main("reference", "--check", "--dir", tmp_path) == (0, "")
    page = tmp_path / "effects.md"
    page.write_text(page.read_text("utf-8").replace("wall_friction", "wall_fiction"), "utf-8")
    status, out = call_main("reference", "--check", "--dir", tmp_path)
    assert status == 1
    assert "+## wall_friction" in out


@pytest.fixture
def call_main(capsys):
    from pipeline.__main__ import main

    def call(*words):
        status = main([str(word) for word in words])
        return status, capsys.readouterr().out

    return call


def test_every_key_of_every_kind_of_file_is_on_the_page(text):
    for name, (model, _) in KINDS.items():
        shown = rows(section(text["config.md"], name))
        keys = {field.alias or key for key, field in model.model_fields.items()}
        assert keys <= shown.keys(), name
        for key, field in model.model_fields.items():
            required = shown[field.alias or key][2] == "required"
            assert required == field.is_required(), key


def test_a_key_has_its_unit_bounds_default_and_meaning(text):
    shown = rows(section(text["config.md"], "Experiment"))
    width = Experiment.model_fields["geometry"].annotation.model_fields["width"].description
    assert shown["geometry.width"] == ["number from 1e-06 to 10000", "m", "required", width]
    assert shown["replicates"][:3] == ["whole number from 1 to 1000000", "–", "`10`"]
    assert shown["walls.friction_angle"][1] == "degrees"
    assert shown["draw[].mass"][:2] == ["number above 0", "kg"]
    assert "`type: drawbells`" in shown["geometry.mask.wall_angle"][3]
    study = rows(section(text["config.md"], "Study"))
    assert study["hold_out"][0] == "`leave_one_out` or mapping, or list of text"


def test_every_variable_is_on_the_page_with_its_file(text):
    for name, entry in variable_table().items():
        for file in entry["in"]:
            folder = "studies" if file == "residual" else "experiments"
            shown = rows(section(text["variables.md"], f"`{folder}/NAME/{file}.nc`"))
            assert shown[name][1] == entry.get("units", "–")


def test_every_effect_is_on_the_page_with_its_parameters(text):
    for name, effect in effects().items():
        part = section(text["effects.md"], name)
        assert effect.equation in part
        assert f"Source: {effect.source}" in part
        shown = rows(part)
        for parameter in effect.parameters:
            cells = shown[parameter.name]
            assert cells[:3] == [
                parameter.unit,
                f"{parameter.neutral:g}",
                f"{parameter.low:g} to {parameter.high:g}",
            ]
