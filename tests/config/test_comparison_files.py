"""Comparisons: what a file may say, and one clear error for each thing that cannot be compared."""

from pathlib import Path

import pytest

from pipeline.config.load import load_comparison, load_comparisons, load_experiments

GOOD = "experiments: [panel, block]\nthreshold_mpa: 0.3\n"


@pytest.fixture
def folder(tmp_path):
    """folder(text): a folder with a comparison `strategies` of this text."""

    def make(text: str) -> Path:
        (tmp_path / "strategies.yaml").write_text(text)
        return tmp_path

    return make


@pytest.fixture
def experiments(drawn, column):
    """Experiments by name: two draws that compare, and others that do not."""
    cells = [cell.model_dump() for cell in drawn().load_cells]
    moved = [cells[0], cells[1] | {"x": 0.31}]
    different = {
        "panel": {},
        "block": {"draw": [{"drawpoints": ["west"], "mass": 12.0, "increment": 2.0}]},
        "fewer_cells": {"load_cells": cells[:1]},
        "no_cells": {"load_cells": []},
        "moved_cell": {"load_cells": moved},
        "turned_cells": {"load_cells": cells[::-1]},
        "other_readings": {"readings": {"every": 3.0}},
        "less_drawn": {"draw": [{"drawpoints": ["west"], "mass": 8.0, "increment": 1.0}]},
        "unread": {"readings": {"every": None, "at_mass_drawn": [0.0]}},
    }
    known = {name: drawn(name, **changes) for name, changes in different.items()}
    return known | {"static": column("static")}


def test_a_good_comparison_says_what_it_says(folder, experiments):
    found = load_comparisons(folder(f"title: Two\n{GOOD}"), experiments)["strategies"]
    assert (found.name, found.title) == ("strategies", "Two")
    assert found.experiments == ("panel", "block")
    assert found.threshold_mpa == 0.3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("experiments: [panel, block]\n", "threshold_mpa: missing"),
        (GOOD.replace("0.3", "0"), "threshold_mpa = 0: expected a stress in MPa, above 0"),
        (GOOD.replace("0.3", "-1"), "threshold_mpa = -1: expected a stress in MPa, above 0"),
        (GOOD.replace("0.3", "300"), "did you mean 0.3?"),  # kPa
        (GOOD.replace("0.3", "0.3 MPa"), "write the bare number 0.3, without unit"),
        (GOOD.replace("[panel, block]", "[panel]"), "expected two experiments, these are 1"),
        (GOOD.replace("[panel, block]", "[panel, panel]"), "named twice"),
        (GOOD.replace("[panel, block]", "panel"), "experiments = panel: expected a list"),
        (GOOD + "threshhold: 1\n", "threshhold: unknown key; did you mean threshold_mpa?"),
    ],
)
def test_a_bad_file_is_named_with_key_and_remedy(folder, message, text, expected):
    found = message(load_comparison, folder(text) / "strategies.yaml")
    assert found.splitlines()[0].endswith("strategies.yaml")
    assert expected in found


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ("blok", "experiments[1] = blok: no such experiment; did you mean block?"),
        ("static", "experiments[1] = static: a static experiment; expected one with draw"),
        ("fewer_cells", "it lacks load cell above; expected the load cells of panel"),
        ("no_cells", "it has 0 load cells, panel has 2"),
        ("moved_cell", "load cell above has x = 0.31 m, not 0.3 m"),
        ("turned_cells", "its load cells stand in another order"),
        ("other_readings", "reading 1 is at 3 kg, 4 kg in panel; expected the same masses"),
        ("less_drawn", "it has 3 readings with the one before draw, 4 in panel"),
        ("unread", "experiments[1] = unread: read only before draw"),
    ],
)
def test_experiments_that_do_not_compare_give_one_error(
    folder, experiments, message, other, expected
):
    text = message(load_comparisons, folder(GOOD.replace("block", other)), experiments)
    assert expected in text
    problems = [line for line in text.splitlines() if line.startswith("  ")]
    assert len(problems) == (2 if other == "unread" else 1)


def test_the_repository_s_comparisons_load(repository):
    experiments = load_experiments(repository / "workflow_configs" / "experiments")
    assert load_comparisons(repository / "workflow_configs" / "comparisons", experiments)
