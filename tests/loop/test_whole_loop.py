"""The loop from readings to the improved model, on columns whose walls nobody declared."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.loop.documents import point_from
from pipeline.loop.improved import improved_documents
from pipeline.loop.steps import attribution, closed, residual
from pipeline.loop.verify import improved_runs, rows_by_experiment

KEYS = {
    "study",
    "schema_version",
    "verdict",
    "effects_added",
    "candidate_set",
    "gate",
    "candidates",
    "local_rules",
    "error",
    "parameters",
    "next_measurement",
    "noise_floor",
    "replicate_count",
    "seeds",
    "versions",
}
ERROR = {"rms_kpa", "rms_log", "mean_absolute_kpa", "n"}


def loop(world):
    """`closed_loop.json`, `predictions.json`, `residual.nc` and `improved.json` of a study."""
    problem, measured = world.problem(), world.measured()
    content, start = residual(problem, measured)
    found, _ = attribution(problem, start)
    found = world.as_written(found)
    problem = world.problem()  # as another job of the workflow has it
    document, predictions = closed(problem, measured, start, found)
    folder = Path(world.folder) / "improved"
    folder.mkdir()
    final = point_from(found["final"]["point"])
    for name, text in improved_documents(world.study, problem.model, final, folder).items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    rows = rows_by_experiment(world.study, problem, measured)
    improved = improved_runs(problem, found, folder, rows)
    return world.as_written(document), world.as_written(predictions), content, improved


@pytest.fixture(scope="module")
def with_walls(walls):
    return loop(walls)


@pytest.fixture(scope="module")
def without(nothing):
    return loop(nothing)


@pytest.fixture(params=["with_walls", "without"])
def either(request):
    """Both in turn."""
    return request.getfixturevalue(request.param)


def test_walls_that_nobody_declared_are_found(with_walls):
    document, *_ = with_walls
    assert document["verdict"] == "effect"
    first = document["effects_added"][0]
    assert (first["name"], first["scope"], first["scope_key"]) == (
        "wall_friction",
        "material",
        "gravel",
    )
    assert first["probability"] >= 0.9
    low, high = first["parameters"]["K"]["interval_90"]
    assert low < first["parameters"]["K"]["value"] < high
    assert first["parameters"]["K"]["value"] == pytest.approx(0.5, abs=0.05)
    assert document["gate"][0]["rejected"]
    assert document["gate"][0]["p_value"] < document["gate"][0]["alpha"]
    assert document["candidates"][0]["name"] == "wall_friction"


def test_error_falls_on_what_was_held_out_and_on_what_was_not(with_walls):
    error = with_walls[0]["error"]
    assert error["held_out"]["ratio"] < 0.2
    for part in ("calibration", "held_out"):
        before, after = (error[part][when] for when in ("before", "after"))
        assert after["rms_kpa"] < 0.2 * before["rms_kpa"]
        assert after["rms_log"] < 0.03  # errors of 2 %
        assert error["recalibrated_only"][part]["rms_log"] > 3 * after["rms_log"]


def test_the_parameter_that_was_bent_comes_back(with_walls):
    """E in truth is 0.97; without walls it takes what they carry."""
    parameters = with_walls[0]["parameters"]
    before, after = (parameters[when]["E [gravel]"]["value"] for when in ("before", "after"))
    assert np.log1p(-after) == pytest.approx(np.log(0.03), abs=0.2)
    assert abs(np.log1p(-before) - np.log(0.03)) > 0.5


def test_nothing_is_found_where_nothing_is_missing(without):
    document, *_ = without
    assert document["verdict"] == "no_effect_detectable"
    assert document["effects_added"] == []
    assert document["candidate_set"] == []
    assert document["local_rules"] == []
    assert [one["rejected"] for one in document["gate"]] == [False]
    assert document["evidence"] == [None]
    error = document["error"]["held_out"]
    assert error["before"] == error["after"]
    assert error["ratio"] == 1.0
    assert document["parameters"]["before"] == document["parameters"]["after"]
    assert any(one["testable"] for one in document["candidates"])


def test_every_key_of_the_contract_is_there(either):
    document, predictions, _, _ = either
    assert set(document) >= KEYS
    error = document["error"]
    assert set(error) == {"calibration", "held_out", "recalibrated_only", "gaussian_process"}
    assert {"before", "after", "ratio", "ratio_interval_90"} == set(error["held_out"])
    for part in ("calibration", "held_out"):
        assert ERROR == set(error[part]["before"]) == set(error[part]["after"])
        for name in ("recalibrated_only", "gaussian_process"):
            assert set(error[name][part]) == ERROR
    assert error["calibration"]["before"]["n"] == 12
    assert error["held_out"]["before"]["n"] == 3 == len(predictions["rows"])
    for one in document["gate"]:
        assert {"round", "statistic", "p_value", "alpha", "rejected"} <= set(one)
    for one in document["candidates"]:
        keys = {"name", "probability", "score", "surviving_fraction", "minimal_detectable"}
        assert keys | {"nearest_mimic", "testable"} <= set(one)
    for one in document["effects_added"]:
        assert {"name", "scope", "scope_key", "parameters", "probability"} <= set(one)
        keys = {"value", "interval_90", "at_bound", "unit"}
        assert all(keys <= set(p) for p in one["parameters"].values())
    for one in document["next_measurement"]:
        assert {"what", "where", "expected_gain"} <= set(one)
    assert set(document["parameters"]) == {"before", "after"}
    assert document["seeds"] == dict.fromkeys("abcde", 2022)
    assert document["replicate_count"]["simulated"] > 0


def test_alpha_is_spent_over_rounds(with_walls):
    gates = with_walls[0]["gate"]
    assert [one["alpha"] for one in gates] == [0.05 * 0.5**n for n in range(len(gates))]
    assert not gates[-1]["rejected"]


def test_residuals_stand_against_the_calibrated_baseline(either):
    document, _, content, _ = either
    assert dict(content.sizes)["reading"] == 12
    np.testing.assert_allclose(content["residual"], content["measured"] - content["simulated"])
    log = np.log(content["measured"] / content["simulated"])
    np.testing.assert_allclose(content["log_residual"], log, rtol=1e-6, atol=1e-12)
    rms = float(np.sqrt(np.mean(content["residual"].values ** 2)))
    before = document["error"]["calibration"]["before"]
    assert rms == pytest.approx(before["rms_kpa"], rel=1e-9)


def test_predictions_have_the_errors_that_are_reported(either, walls, nothing):
    document, predictions, _, _ = either
    world = walls if document["effects_added"] else nothing
    value = [row.value for row in world.measured()][-3:]
    assert [row["measured"] for row in predictions["rows"]] == value
    for name in ("before", "after"):
        logs = np.log([row[name] for row in predictions["rows"]]) - np.log(value)
        rms = document["error"]["held_out"][name]["rms_log"]
        assert np.sqrt(np.mean(logs**2)) == pytest.approx(rms, rel=1e-9)


def test_improved_experiments_run_on_their_own_are_nearer_to_what_was_measured(with_walls):
    *_, improved = with_walls
    assert set(improved["experiments"]) == set("abcde")
    for one in improved["experiments"].values():
        assert one["after"]["rmse"] < one["before"]["rmse"]
        assert one["before"]["n"] == one["after"]["n"] == len(one["after"]["readings"]) == 3


def test_improved_runs_of_an_unchanged_model_are_the_same(without):
    *_, improved = without
    for one in improved["experiments"].values():
        assert one["after"]["rmse"] == pytest.approx(one["before"]["rmse"], rel=1e-6)


def test_the_same_study_gives_the_same_documents(walls, with_walls):
    problem = walls.problem()
    content, start = residual(problem, walls.measured())
    found, _ = attribution(problem, start)
    assert content.identical(with_walls[2])
    document = walls.as_written(found)
    for key in ("verdict", "effects_added", "gate", "candidates", "parameters", "evidence"):
        assert document[key] == with_walls[0][key]
