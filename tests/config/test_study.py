"""Studies: what loads, and what they may say of their experiments."""

from pathlib import Path

import pytest
import yaml

from pipeline.config.load import (
    digest,
    load_experiments,
    load_studies,
    load_study,
    resolved,
)

COLUMN = {
    "geometry": {"width": 0.1, "length": 0.08, "height": 0.5, "cell_size": 0.02},
    "material": {"name": "gravel", "bulk_density": 970, "particle_density": 2670},
    "stress": {"E": 0.54, "s": 2},
    "load_cells": [{"name": "C1", "x": 0.05, "y": 0.04, "width": 0.04, "length": 0.04}],
    "measured": "columns.csv",
}
TABLE = "experiment,quantity,value,std\na,vertical_stress,0.4,0.1\nb,vertical_stress,0.4,0.1\n"
STUDY = {"experiments": ["a", "b"], "parameters": [{"name": "E", "shared_by": "material"}]}


def write(path: Path, content: dict) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.fixture
def experiments(tmp_path):
    """Two columns a and b, measured in one table."""
    for name in "ab":
        write(tmp_path / "experiments" / f"{name}.yaml", COLUMN)
    (tmp_path / "experiments" / "columns.csv").write_text(TABLE)
    return load_experiments(tmp_path / "experiments")


def test_defaults_are_filled_in(tmp_path):
    study = load_study(write(tmp_path / "walls.yaml", STUDY))
    assert (study.name, study.path) == ("walls", tmp_path / "walls.yaml")
    assert (study.hold_out, study.candidates, study.alpha) == ("leave_one_out", "all", 0.05)
    assert (study.max_effects, study.data_path) == (3, None)
    again = load_study(write(tmp_path / "again.yaml", resolved(study)))
    assert digest(again) == digest(study)


@pytest.mark.parametrize(
    "hold_out",
    [
        "leave_one_out",
        ["b"],
        {"load_cells": ["C1"]},
        {"mass_drawn_above": 3.0},
    ],
)
def test_each_way_of_holding_out_comes_back(tmp_path, hold_out):
    study = load_study(write(tmp_path / "walls.yaml", STUDY | {"hold_out": hold_out}))
    assert resolved(study)["hold_out"] == hold_out


def test_study_of_known_measured_experiments_loads(tmp_path, experiments):
    write(tmp_path / "studies" / "walls.yaml", STUDY)
    assert list(load_studies(tmp_path / "studies", experiments)) == ["walls"]


def test_unknown_and_unmeasured_experiments_are_named(tmp_path, experiments, message):
    experiments["b"] = experiments["b"].model_copy(update={"measured": None})
    write(tmp_path / "studies" / "walls.yaml", STUDY | {"experiments": ["a", "b", "column"]})
    text = message(load_studies, tmp_path / "studies", experiments)
    assert "experiments[1] = b: has no measured values" in text
    assert "experiments[2] = column: no such experiment; known experiments: a, b" in text


def test_own_data_replace_measured_rows(tmp_path, experiments, message):
    experiments["b"] = experiments["b"].model_copy(update={"measured": None})
    data = {"file": "other.csv", "label": "published simulation"}
    path = write(tmp_path / "studies" / "walls.yaml", STUDY | {"data": data})
    (path.parent / "other.csv").write_text(TABLE)
    study = load_studies(path.parent, experiments)["walls"]
    assert study.data_path == path.parent / "other.csv"
    (path.parent / "other.csv").write_text(TABLE.replace("b,", "c,"))
    assert "no rows for experiment b; its experiments are a, c" in message(
        load_studies, path.parent, experiments
    )


def test_held_out_load_cells_must_exist(tmp_path, experiments, message):
    write(tmp_path / "studies" / "walls.yaml", STUDY | {"hold_out": {"load_cells": ["C1", "C7"]}})
    text = message(load_studies, tmp_path / "studies", experiments)
    assert "hold_out.load_cells[1] = C7: no such load cell; known load cells: C1" in text


def test_a_tail_needs_mass_beyond_it(tmp_path, experiments, message):
    write(tmp_path / "studies" / "walls.yaml", STUDY | {"hold_out": {"mass_drawn_above": 2}})
    assert "holds nothing out" in message(load_studies, tmp_path / "studies", experiments)


def test_a_held_out_experiment_may_take_its_stress_from_one_that_is_not(tmp_path, experiments):
    write(tmp_path / "experiments" / "b.yaml", COLUMN | {"stress": {"from": "a"}})
    experiments = load_experiments(tmp_path / "experiments")
    write(tmp_path / "studies" / "walls.yaml", STUDY | {"hold_out": ["b"]})
    assert load_studies(tmp_path / "studies", experiments)["walls"].hold_out == ("b",)


@pytest.mark.parametrize("hold_out", ["leave_one_out", ["a"]])
def test_stress_from_another_experiment_cannot_be_held_out(
    tmp_path, experiments, message, hold_out
):
    write(tmp_path / "experiments" / "b.yaml", COLUMN | {"stress": {"from": "a"}})
    experiments = load_experiments(tmp_path / "experiments")
    write(tmp_path / "studies" / "walls.yaml", STUDY | {"hold_out": hold_out})
    assert "hold_out: b takes its stress from a" in message(
        load_studies, tmp_path / "studies", experiments
    )


def test_every_study_is_reported_at_once(tmp_path, message):
    write(tmp_path / "a.yaml", STUDY | {"alpha": 5})
    write(tmp_path / "b.yaml", STUDY | {"max_effects": -1})
    text = message(load_studies, tmp_path)
    assert "a.yaml\n  alpha = 5" in text
    assert "b.yaml\n  max_effects = -1" in text
