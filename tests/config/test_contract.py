"""The contract's own example files load unchanged; `tests/contract` holds copies of them."""

from pathlib import Path

import pytest

from pipeline.config.load import check_measured, load_experiments, load_studies, resolved

CONTRACT = Path(__file__).parents[1] / "contract"


@pytest.fixture(scope="module")
def experiments():
    return load_experiments(CONTRACT / "experiments")


def test_the_static_example_says_what_it_says(experiments):
    example = experiments["example_static"]
    assert not example.is_draw
    assert example.E == 0.54
    assert example.filling.levels == (0.20, 0.35, 0.50)
    assert [row.fill_height for row in check_measured(example)] == [0.20, 0.35, None]


def test_the_draw_example_says_what_it_says(experiments):
    example = experiments["example_draw"]
    assert example.is_draw
    assert example.stress.R == 0.29
    assert [line.mass for line in example.draw] == [8.0]
    assert len(check_measured(example)) == 8
    assert resolved(example)["stress"]["E_min"]["type"] == "table"


def test_the_study_example_says_what_it_says():
    study = load_studies(CONTRACT / "studies")["example"]
    assert len(study.experiments) == 6
    assert study.hold_out == "leave_one_out"
    assert [(p.name, p.shared_by) for p in study.parameters] == [("E", "material")]


def test_every_experiment_of_the_repository_loads():
    folder = Path(__file__).parents[2] / "workflow_configs" / "experiments"
    assert len(load_experiments(folder)) >= 22
