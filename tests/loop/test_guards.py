"""Held-out values are read for the scores alone: nothing else can know them."""

from copy import deepcopy

import numpy as np
import pytest
from worlds import CELLS, WALLED, at_levels, drawn_world, make_world, walled, walled_world

from pipeline.loop.documents import point_from
from pipeline.loop.improved import improved_documents
from pipeline.loop.steps import attribution, closed, residual

TRUTH = {"wall_friction": {"K": 0.5}}


def whole_loop(world):
    """All that the loop makes of a study, as it is written."""
    problem, measured = world.problem(), world.measured()
    content, start = residual(problem, measured)
    found, rounds = attribution(problem, start)
    found = world.as_written(found)
    document, predictions = closed(problem, measured, start, found)
    final = point_from(found["final"]["point"])
    improved = improved_documents(world.study, problem.model, final, world.folder / "improved")
    return {
        "residual": content,
        "start": start,
        "rounds": rounds,
        "attribution": found,
        "closed": world.as_written(document),
        "predictions": predictions,
        "improved": improved,
    }


def cells_world(folder):
    """Static columns with two load cells, one of them held out."""
    files = {
        name: walled(0.5, WALLED[name][1], geometry={"length": 0.4}, load_cells=CELLS)
        for name in "abc"
    }
    rows = [{**row, "load_cell": cell["name"]} for cell in CELLS for row in at_levels()]
    study = {
        "experiments": list("abc"),
        "hold_out": {"load_cells": ["east"]},
        "parameters": [{"name": "E", "shared_by": "material"}],
    }
    return make_world(folder, files, dict.fromkeys("abc", rows), study, truth=TRUTH, true_E=0.97)


WORLDS = {
    "experiments": (
        lambda folder: walled_world(folder, "abcd", truth=TRUTH, true_E=0.97),
        lambda row: row["experiment"] == "d",
    ),
    "load cells": (cells_world, lambda row: row["load_cell"] == "east"),
    "tail": (drawn_world, lambda row: float(row["mass_drawn"] or 0.0) > 8.0),
}


@pytest.fixture(scope="module", params=list(WORLDS))
def pair(request, tmp_path_factory):
    """What the loop makes of a study, and of the same with garbage for its held-out values."""
    make, is_held_out = WORLDS[request.param]
    world = make(tmp_path_factory.mktemp("guard") / "w")
    before = whole_loop(world)
    garbage = np.random.default_rng(1)

    def spoiled(row):
        if not is_held_out(row):
            return None
        value = float(np.exp(garbage.normal(0.0, 4.0)))
        return {"value": value, "std": value * garbage.uniform(0.01, 2.0), "std_shared": value}

    world.edit(spoiled)
    return before, whole_loop(world)


def without_held_out(document):
    """`closed_loop.json` without the errors on held-out readings."""
    document = deepcopy(document)
    error = document["error"]
    del error["held_out"]
    for name in ("recalibrated_only", "gaussian_process"):
        del error[name]["held_out"]
    for part in document["folds"]:
        del part["error"]
    for part in document["sharing"]:
        del part["held_out"]
    return document


def rows_without_measured(found):
    """Predictions, without the measured values that stand beside them."""
    return [
        {key: value for key, value in row.items() if key != "measured"}
        for row in found["predictions"]["rows"]
    ]


def test_held_out_values_reach_no_residual(pair):
    before, after = pair
    assert before["residual"].identical(after["residual"])
    assert before["start"].identical(after["start"])
    assert before["residual"].sizes["reading"] > 0


def test_held_out_values_reach_no_choice(pair):
    before, after = pair
    assert before["attribution"] == after["attribution"]
    for one, other in zip(before["rounds"], after["rounds"], strict=True):
        assert one.identical(other)


def test_held_out_values_reach_no_prediction_and_no_improved_model(pair):
    before, after = pair
    one, other = (rows_without_measured(found) for found in pair)
    assert one == other
    assert one
    assert before["improved"] == after["improved"]


def test_held_out_values_change_the_held_out_errors_alone(pair):
    before, after = (one["closed"] for one in pair)
    assert without_held_out(before) == without_held_out(after)
    for when in ("before", "after"):
        old, new = (one["error"]["held_out"][when]["rms_log"] for one in (before, after))
        assert old != new


def test_a_fold_does_not_know_the_experiment_that_it_leaves_out(tmp_path):
    """Leave-one-out: garbage for one experiment changes all folds but its own."""
    names = ["wall_friction", "density_misdeclared", "surcharge"]
    study = {"hold_out": "leave_one_out", "candidates": names, "max_effects": 1}
    world = walled_world(tmp_path / "w", "abcd", truth=TRUTH, true_E=0.97, study=study)
    before = whole_loop(world)
    world.edit(
        lambda row: {"value": 1.3 * float(row["value"])} if row["experiment"] == "c" else None
    )
    after = whole_loop(world)

    def fold(found, name):
        (one,) = (f for f in found["closed"]["folds"] if f["name"] == name)
        return {key: value for key, value in one.items() if key != "error"}

    def predicted(found, name):
        return [row for row in rows_without_measured(found) if row["experiment"] == name]

    assert fold(before, "c") == fold(after, "c")
    assert predicted(before, "c") == predicted(after, "c")
    assert fold(before, "c")["added"] == ["wall_friction [gravel]"]
    for name in "abd":
        assert predicted(before, name) != predicted(after, name)
    assert before["closed"]["gate"] != after["closed"]["gate"]


def test_an_experiment_alone_in_its_material_is_not_predictable(tmp_path):
    """Its E has no other data, so that its errors are not averaged with the others'."""
    files = {name: walled(*WALLED[name]) for name in "abc"}
    files["d"] = walled(*WALLED["d"], material={"name": "sand"})
    study = {
        "experiments": list("abcd"),
        "parameters": [{"name": "E", "shared_by": "material"}],
        "candidates": ["wall_friction"],
    }
    world = make_world(tmp_path / "w", files, dict.fromkeys("abcd", at_levels()), study)
    found = whole_loop(world)
    folds = {one["name"]: one for one in found["closed"]["folds"]}
    assert folds["d"]["not_predictable"] == ["d"]
    assert folds["d"]["error"] is None
    assert all(folds[name]["not_predictable"] == [] for name in "abc")
    assert {row["experiment"] for row in found["predictions"]["rows"]} == set("abc")
    assert found["closed"]["error"]["held_out"]["before"]["n"] == 9
