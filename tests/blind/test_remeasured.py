"""One more measurement of a world: files that load, readings that stay, and who is resolved."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from pipeline.blind import injection, remeasured, worlds
from pipeline.blind.remeasured import extended, measure_again, outcomes
from pipeline.blind.scored import CHOICES, Scored, is_resolved
from pipeline.blind.scores import score
from pipeline.blind.worlds import draw_world
from pipeline.config.load import check_measured, load_experiments, load_studies
from pipeline.files.atomic import read_json, write_json, write_text
from pipeline.loop.hypotheses import catalogue
from pipeline.loop.problem import make_problem

STD = {"std": 0.03}
GAIN = {"kind": "direct", "effect": "sensor_gain", "key": "C2", "what": "calibrate", **STD}
DENSITY = {"kind": "direct", "effect": "density_misdeclared", "key": "sand", "what": "w", **STD}
REPEAT = {"kind": "repeat", "experiment": "static_2", "what": "repeat"}
CELL = {"kind": "load_cell", "experiment": "isolated", "x": 0.12, "y": 0.12, "what": "add"}
LEVEL = {"kind": "fill_level", "experiment": "static_1", "fill_height": 1.125, "what": "read"}
NEW = {"repeat": 18, "load_cell": 6, "fill_level": 6, "direct": 0}
NOTHING = {"shows": None, "corrects": None}
EVERY = [REPEAT, CELL, LEVEL, GAIN, DENSITY]


@pytest.fixture(autouse=True, scope="module")
def quick():
    """Few replicates: these tests look at no figure that needs more."""
    patch = pytest.MonkeyPatch()
    for name in ("REPLICATES", "SCATTER", "COMMON", "LOOKS", "PROBES"):
        patch.setattr(injection, name, 2)
    yield
    patch.undo()


@pytest.fixture(scope="module", params=["lattice", "independent", "continuum"])
def world(request):
    """(files, truth) of a world with nothing missing."""
    generator = "lattice" if request.param == "lattice" else "independent"
    patch, physics = pytest.MonkeyPatch(), worlds._physics
    if request.param == "continuum":
        patch.setattr(worlds, "_physics", lambda *a: replace(physics(*a), continuum=True))
    yield draw_world(7, 1, kind="null_plain", generator=generator)
    patch.undo()


def loaded(files, folder):
    for path, text in files.items():
        write_text(folder / path, text)
    experiments = load_experiments(folder / "experiments")
    (study,) = load_studies(folder / "studies", experiments).values()
    return study, experiments


@pytest.mark.parametrize("asked", EVERY, ids=lambda a: a.get("effect", a["kind"]))
def test_files_load_and_what_was_read_stays(world, asked, tmp_path):
    files, truth = world
    more, says = extended(truth, asked, "then_recommended")
    assert says["shows"] is None
    table = "experiments/measured/data.csv"
    old, new = files[table].splitlines(), more[table].splitlines()
    assert new[: len(old)] == old
    assert len(new) - len(old) == NEW[asked["kind"]]
    study, experiments = loaded(more, tmp_path)
    assert study.name == "then_recommended"
    assert set(study.experiments) == set(experiments)
    rows = {name: check_measured(one) for name, one in experiments.items()}
    assert sum(map(len, rows.values())) == len(new) - 1
    again, _ = extended(truth, asked, "then_recommended")
    assert again == more


@pytest.mark.parametrize("asked", [CELL, LEVEL], ids=lambda a: a["kind"])
def test_readings_are_of_the_packing_that_was_measured(world, asked, monkeypatch):
    _, truth = world
    monkeypatch.setattr(remeasured, "_place", lambda row: tuple(row.values()))
    begun = worlds.begin_world(7, 1, truth["kind"], truth["generator"])
    documents = deepcopy(begun.declared)
    every = remeasured._read(documents, begun.source, begun.theta, truth, asked)
    key = ("load_cell", "fill_height", "mass_drawn")
    known = {
        tuple(row[k] for k in key): row["reading"]
        for row in truth["rows"]
        if row["experiment"] == asked["experiment"]
    }
    found = {tuple(row[k] for k in key): row["reading"] for row in every}
    assert {k: found[k] for k in known} == pytest.approx(known, rel=1e-12)
    assert len(found) == len(known) + 6


def test_a_repeat_is_another_packing(world):
    files, truth = world
    more, _ = extended(truth, REPEAT, "again")
    lines = more["experiments/measured/data.csv"].splitlines()
    first, second = (
        [float(line.split(",")[5]) for line in lines if line.startswith(f"{name},")]
        for name in ("static_2", "static_2_again")
    )
    assert len(first) == len(second)
    assert not set(first) & set(second)
    stem = "experiments/static_2{}.yaml"
    assert more[stem.format("_again")] == more[stem.format("")] == files[stem.format("")]


def test_a_load_cell_keeps_its_shared_error():
    rows = [{"experiment": "a", "load_cell": f"C{n}", "reading": 10.0} for n in (1, 1, 2)]
    random = np.random.default_rng(1)
    worlds.measure("null_plain", rows, random, {("a", "C1"): 0.5})
    assert [row["shared_error"] for row in rows[:2]] == [0.5, 0.5]
    assert rows[2]["shared_error"] != 0.5
    errors = np.log([row["measured"] / 10.0 for row in rows[:2]]) - 0.5
    assert np.ptp(errors) > 0.0
    assert np.abs(errors).max() < 5 * worlds.OWN


def test_what_was_measured_directly_is_no_candidate_any_more(world, tmp_path):
    _, truth = world

    def keys(asked, name):
        study, experiments = loaded(extended(truth, asked, "then")[0], tmp_path)
        problem = make_problem(study, experiments)
        found = catalogue(study, problem.model, problem.data.use)
        return {h.key for h in found if h.name == name}

    assert keys(GAIN, "sensor_gain") == {"C1", "C3", "C4", "C5", "C6"}
    assert keys(DENSITY, "density_misdeclared") == {"gravel"}
    level = DENSITY | {"effect": "fill_height_misdeclared", "key": "static_1", "std": 0.01}
    assert "static_1" not in keys(level, "fill_height_misdeclared")


@pytest.mark.parametrize(
    ("asked", "effect"),
    [(GAIN, {"gain": 1.4}), (DENSITY, {"factor": 0.7})],
    ids=["sensor_gain", "density_misdeclared"],
)
def test_a_direct_measurement_shows_a_large_fault(world, asked, effect):
    name, key = asked["effect"], asked["key"]
    truth = world[1] | {"effects": [{"name": name, "scope_key": key, "parameters": effect}]}
    assert extended(truth, asked, "then") == ({}, {"shows": [name, key], "corrects": None})
    elsewhere = asked | {"key": "C3" if key == "C2" else "gravel"}
    files, says = extended(truth, elsewhere, "then")
    assert files
    assert says["shows"] is None


def test_a_world_is_measured_again_only_where_it_is_undecided(world, tmp_path):
    _, truth = world
    folder, sealed = tmp_path / "world_0001", tmp_path / "truth.json"
    write_json(sealed, truth)
    result = {"verdict": "effect", "candidate_set": [], "possible_measurements": [REPEAT, LEVEL]}
    write_json(folder / "closed_loop.json", result)
    assert measure_again(folder, sealed, "recommended") is None
    assert outcomes(folder) is None
    undecided = result | {"verdict": "ambiguous", "candidate_set": ["tilt", "arching"]}
    write_json(folder / "closed_loop.json", undecided)
    made = measure_again(folder, sealed, "recommended")
    write_json(made / "closed_loop.json", result)
    assert read_json(made / "measurement.json")["measurement"] == REPEAT
    assert outcomes(folder) == {"recommended": {"measurement": REPEAT, **NOTHING, "result": result}}
    write_json(folder / "closed_loop.json", undecided | {"possible_measurements": []})
    assert measure_again(folder, sealed, "recommended") is None
    assert outcomes(folder) == {}


# ---------------------------------------------------------------------------------------------
# scores


def truth_of(kind, *claims):
    effects = [{"name": name, "scope_key": key, "delta": 4.0} for name, key in claims]
    return {"world": "w", "kind": kind, "generator": "lattice", "effects": effects, "rows": []}


def result_of(verdict, *named, open_names=(), left=()):
    return {
        "verdict": verdict,
        "effects_added": [{"name": n, "scope_key": k, "probability": 0.95} for n, k in named],
        "candidate_set": list(open_names),
        "candidates_left": [{"name": n, "scope_key": k} for n, k in left],
        "gate": [],
        "local_rules": [],
    }


AMBIGUOUS = result_of("ambiguous", open_names=["tilt", "wall_friction"])
WALL = ("wall_friction", "sand")


@pytest.mark.parametrize(
    ("after", "resolved"),
    [
        (result_of("effect", WALL), True),
        (result_of("effect", ("wall_friction", "gravel")), False),
        (result_of("effect", WALL, ("tilt", None)), False),
        (result_of("no_effect_detectable"), False),
        (AMBIGUOUS | {"candidates_left": [{"name": "wall_friction", "scope_key": "sand"}]}, False),
        (result_of("ambiguous", open_names=WALL[:1], left=[WALL, (WALL[0], "gravel")]), True),
        (result_of("ambiguous", open_names=WALL[:1], left=[(WALL[0], "gravel"), WALL]), False),
        (result_of("unexplained"), False),
    ],
)
def test_resolved_is_the_truth_alone(after, resolved):
    again = {"recommended": {"measurement": REPEAT, **NOTHING, "result": after}}
    world = Scored(truth_of("one", WALL), AMBIGUOUS, again=again)
    assert is_resolved(world, "recommended") is resolved
    assert not is_resolved(world, "random")


def test_a_set_of_one_that_was_there_before_resolves_nothing():
    alone = result_of("ambiguous", open_names=WALL[:1], left=[WALL])
    again = {"recommended": {"measurement": REPEAT, **NOTHING, "result": alone}}
    assert not is_resolved(Scored(truth_of("one", WALL), alone, again=again), "recommended")


def test_other_kinds_are_resolved_by_what_is_true_of_them():
    def resolved(truth, **outcome):
        again = {"random": {"measurement": GAIN, **NOTHING} | outcome}
        return is_resolved(Scored(truth, AMBIGUOUS, again=again), "random")

    null, gain = truth_of("null_plain"), ("sensor_gain", "C2")
    assert resolved(null, result=result_of("no_effect_detectable"))
    assert not resolved(null, result=result_of("unexplained"))
    assert not resolved(null, shows=list(gain))
    assert resolved(truth_of("sensor_or_input", gain), shows=list(gain))
    assert not resolved(truth_of("sensor_or_input", ("sensor_gain", "C3")), shows=list(gain))
    nothing, corrected = result_of("no_effect_detectable"), truth_of("sensor_or_input", gain)
    assert resolved(corrected, corrects=list(gain), result=nothing)
    assert not resolved(corrected, result=nothing)
    assert not resolved(corrected, corrects=list(gain), result=AMBIGUOUS)
    assert not resolved(null, corrects=list(gain), result=nothing)
    both = truth_of("two", WALL, ("tilt", None))
    assert resolved(both, result=result_of("effect", ("tilt", None), WALL))
    assert not resolved(both, result=result_of("effect", WALL))


def test_the_bar_counts_undecided_worlds_with_one_effect():
    def outcome(after):
        return {"measurement": {"what": "a", "where": "b"}, **NOTHING, "result": after}

    right, wrong = outcome(result_of("effect", WALL)), outcome(AMBIGUOUS)
    one = truth_of("one", WALL)
    scores = score(
        [
            Scored(one, AMBIGUOUS, again={"recommended": right, "random": wrong}),
            Scored(one, AMBIGUOUS, again={"recommended": right, "random": right}),
            Scored(one, AMBIGUOUS, again={}),
            Scored(one, result_of("effect", WALL)),
            Scored(truth_of("null_plain"), AMBIGUOUS, again={"recommended": wrong}),
        ]
    )
    found = scores["remeasured"]
    assert [(found[c]["count"], found[c]["of"]) for c in CHOICES] == [(2, 3), (1, 3)]
    assert len(scores["remeasured"]["each"]) == 3
    bars = {bar["quantity"]: bar for bar in scores["bars"]}
    (bar,) = (b for name, b in bars.items() if "recommended measurement" in name)
    assert (bar["figure"], bar["met"], bar["met_stretch"]) == (pytest.approx(2 / 3), True, True)
    beside = bars["the same by a measurement chosen at random"]
    assert (beside["figure"], beside["met"]) == (pytest.approx(1 / 3), None)
