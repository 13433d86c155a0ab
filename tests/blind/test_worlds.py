"""Blind worlds: reproducible, whole, loadable, and silent about their truth."""

import json
from collections import Counter

import numpy as np
import pytest

from pipeline.blind import injection, laboratory, worlds
from pipeline.blind.worlds import draw_world, kind_of, make_worlds, world_name
from pipeline.config.load import check_measured, load_experiments, load_studies

NULLS = (5000, 5001)


@pytest.fixture(autouse=True, scope="module")
def quick():
    """Few replicates: these tests look at no figure that needs more."""
    patch = pytest.MonkeyPatch()
    for name, count in {
        "REPLICATES": 2,
        "SCATTER": 6,
        "COMMON": 4,
        "LOOKS": 3,
        "PROBES": 2,
    }.items():
        patch.setattr(injection, name, count)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(root, sealed root, names) of the worlds 0, and one hard null of each kind."""
    root, sealed = (tmp_path_factory.mktemp(name) for name in ("worlds", "sealed"))
    return root, sealed, make_worlds(root, sealed, 1, seed=6, hard_nulls=1)


def truth_of(made, name):
    return json.loads((made[1] / f"{name}.json").read_text())


def test_names_and_kinds(made):
    assert made[2] == ["world_0000", "world_5000", "world_5001"]
    kinds = [truth_of(made, name)["kind"] for name in made[2][1:]]
    assert kinds == ["null_heavy_tails", "null_understated_noise"]


def test_experiments_and_study_load(made):
    for name in made[2]:
        experiments = load_experiments(made[0] / name / "experiments")
        (study,) = load_studies(made[0] / name / "studies", experiments).values()
        assert study.name == name
        assert set(study.hold_out) == set(laboratory.HELD_OUT)
        rows = {stem: check_measured(one) for stem, one in experiments.items()}
        fitted = sum(len(of) for stem, of in rows.items() if stem not in study.hold_out)
        assert fitted == 210
        assert not any(one.effects for one in experiments.values())


def test_the_table_holds_the_measured_values_of_the_truth(made):
    experiments = load_experiments(made[0] / "world_0000" / "experiments")
    of_truth = iter(truth_of(made, "world_0000")["rows"])
    for name in (*laboratory.STATIC, *laboratory.DRAWS):
        for row in check_measured(experiments[name]):
            true = next(of_truth)
            assert (name, row.load_cell) == (true["experiment"], true["load_cell"])
            assert row.mass_drawn == true["mass_drawn"]
            height = row.fill_height or experiments[name].geometry.height
            assert true["fill_height"] in (None, height)
            assert row.value == true["measured"]
            assert row.std == pytest.approx(injection.OWN * row.value, rel=1e-3)
            assert row.std_shared == pytest.approx(injection.SHARED * row.value, rel=1e-3)
            assert row.count == 1
    assert next(of_truth, None) is None


def test_a_world_does_not_hold_its_truth(made):
    for name in made[2]:
        truth = truth_of(made, name)
        files = [path for path in (made[0] / name).rglob("*") if path.is_file()]
        names = {str(path.relative_to(made[0] / name)) for path in files}
        assert names == set(truth["files"])
        text = "".join(path.read_text() for path in files)
        assert str(truth["parameters"]["R"]) not in text
        assert not any(f",{row['reading']:.6g}," in text for row in truth["rows"][:50])


def test_hashes_are_published(made):
    hashes = json.loads((made[0] / "hashes.json").read_text())
    for name in made[2]:
        sealed = (made[1] / f"{name}.json").read_bytes()
        assert hashes[name] == worlds.digest_of(sealed)


def test_same_seed_and_index_same_world(made):
    files, truth = draw_world(6, 5000)
    assert truth == truth_of(made, "world_5000")
    data = made[0] / "world_5000" / "experiments/measured/data.csv"
    assert files["experiments/measured/data.csv"] == data.read_text()
    other, _ = draw_world(12, 5000)
    assert other["experiments/measured/data.csv"] != data.read_text()


def test_worlds_that_are_whole_are_kept_and_others_mended(made):
    root, sealed, names = made
    data = root / names[1] / "experiments" / "measured" / "data.csv"
    kept = root / names[2] / "experiments" / "measured" / "data.csv"
    content, times = data.read_text(), kept.stat().st_mtime_ns
    data.write_text("spoiled")
    worlds.make_world(root, sealed, 6, NULLS[0])
    worlds.make_world(root, sealed, 6, NULLS[1])
    assert data.read_text() == content
    assert kept.stat().st_mtime_ns == times


def test_the_mix_is_the_one_that_was_asked_for():
    drawn = [kind_of(3, index) for index in range(400)]
    kinds = Counter(kind for kind, _ in drawn)
    assert kinds == {"null_plain": 120, "one": 140, "two": 40, "outside": 60, "sensor_or_input": 40}
    assert sum(generator == "independent" for _, generator in drawn) >= 100
    assert [kind_of(3, i) for i in range(20)] != [kind_of(4, i) for i in range(20)]


def test_a_sensor_fault_moves_readings_as_far_as_it_says():
    _, truth = draw_world(5, 0, kind="sensor_or_input", generator="lattice", delta_range=(6.0, 8.0))
    (effect,) = truth["effects"]
    assert 4.5 < effect["delta"] < 10.5
    changed = {
        (row["experiment"], row["load_cell"])
        for row in truth["rows"]
        if row["reading"] != row["packing"]
    }
    if effect["name"].startswith("sensor"):
        assert {cell for _, cell in changed} == {effect["scope_key"]}
    else:
        assert not changed


def test_noise_has_the_law_that_its_kind_says():
    cells = [f"C{n}" for n in range(4000) for _ in range(2)]
    std = {}
    for kind in ("null_plain", "null_heavy_tails", "null_understated_noise"):
        rows = [{"experiment": "a", "load_cell": cell, "reading": 1.0} for cell in cells]
        worlds.measure(kind, rows, np.random.default_rng(2), {})
        errors = np.log([row["measured"] for row in rows]).reshape(-1, 2)
        total = np.hypot(injection.SHARED, injection.OWN)
        std[kind] = errors.std() / total
        between = np.corrcoef(errors.T)[0, 1]
        if kind == "null_plain":
            assert between == pytest.approx(injection.SHARED**2 / total**2, abs=0.05)
        tails = np.mean(np.abs(errors) > 4 * total * (worlds.UNDERSTATED if "under" in kind else 1))
        assert (tails > 1e-3) == (kind == "null_heavy_tails")
    assert std["null_plain"] == pytest.approx(1.0, abs=0.03)
    assert std["null_understated_noise"] == pytest.approx(1.5, abs=0.05)


def test_names_have_four_digits():
    assert world_name(7) == "world_0007"
