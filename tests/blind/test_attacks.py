"""Attacks: whole worlds that load, with what a user would accept; tabled apart from all others."""

import json
import math

import pytest
from test_scores import effect, predictions, result, truth

from pipeline.blind import injection, laboratory
from pipeline.blind.attacks import ATTACKED, ATTACKS, attack_of
from pipeline.blind.scored import Scored
from pipeline.blind.scores import score
from pipeline.blind.worlds import draw_world, kind_of, make_worlds
from pipeline.config.load import check_measured, load_experiments, load_studies
from pipeline.report.blind import attack_tables
from pipeline.report.page import Data

SEED = 9


@pytest.fixture(autouse=True, scope="module")
def small():
    """A small laboratory and few replicates: these tests look at no figure that needs more."""
    patch = pytest.MonkeyPatch()
    columns = ("static_1", "static_4", "static_7")
    patch.setattr(laboratory, "CELL", 0.06)
    patch.setattr(laboratory, "STATIC", {name: laboratory.STATIC[name] for name in columns})
    draws = ("isolated", "block_narrow")
    patch.setattr(laboratory, "DRAWS", {name: laboratory.DRAWS[name] for name in draws})
    patch.setattr(laboratory, "HELD_OUT", ("block_narrow", "static_7"))
    for name in ("REPLICATES", "SCATTER", "COMMON", "LOOKS", "PROBES"):
        patch.setattr(injection, name, 3)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(root, truths by attack) of one world of each attack."""
    root, sealed = (tmp_path_factory.mktemp(name) for name in ("worlds", "sealed"))
    names = make_worlds(root, sealed, 0, seed=SEED, attacks=1)
    truths = [json.loads((sealed / f"{name}.json").read_text()) for name in names]
    return root, dict(zip(ATTACKS, truths, strict=True))


def test_worlds_are_of_all_attacks_in_turn():
    places = range(ATTACKED, ATTACKED + 2 * len(ATTACKS))
    assert [attack_of(index) for index in places] == 2 * list(ATTACKS)
    assert kind_of(SEED, ATTACKED) == ("attack_noise_everywhere", "lattice")


@pytest.mark.parametrize("name", ATTACKS)
def test_an_attack_is_a_world_that_loads(made, name):
    root, truths = made
    sealed = truths[name]
    assert sealed["kind"] == f"attack_{name}"
    folder = root / sealed["world"]
    experiments = load_experiments(folder / "experiments")
    (study,) = load_studies(folder / "studies", experiments).values()
    rows = [row.value for one in study.experiments for row in check_measured(experiments[one])]
    assert sorted(rows) == sorted(row["measured"] for row in sealed["rows"])
    files = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert files == set(sealed["files"])
    assert not any(name in (folder / path).read_text() for path in files)
    assert set(sealed["attack"]) == {"details", "joint_delta", "held_out_rms_log", "right"}
    assert set(sealed["attack"]["right"]) == {"verdicts", "must_name", "may_name"}


def test_hashes_of_attacks_are_published(made):
    root, truths = made
    assert set(json.loads((root / "hashes.json").read_text())) == {
        one["world"] for one in truths.values()
    }


def test_understated_noise_is_in_the_part_that_it_says(made):
    def errors(name):
        sealed = made[1][name]
        return {
            (row["experiment"], row["load_cell"], row["fill_height"], row["mass_drawn"]): math.log(
                row["measured"] / row["reading"]
            )
            for row in sealed["rows"]
        }

    sealed = made[1]["noise_of_one_cell"]
    broken = sealed["attack"]["details"]["load_cell"]
    sums = {True: [], False: []}
    for (_, cell, *_), error in errors("noise_of_one_cell").items():
        sums[cell == broken].append(error**2)
    of_cell, of_others = (math.sqrt(sum(v) / len(v)) for v in (sums[True], sums[False]))
    assert of_others == pytest.approx(math.hypot(injection.SHARED, injection.OWN), rel=0.35)
    assert of_cell > 1.3 * of_others


def test_an_effect_of_what_is_held_out_moves_nothing_else(made):
    sealed = made[1]["held_out_only"]
    (hidden,) = sealed["effects"]
    assert hidden["scope_key"] in laboratory.HELD_OUT
    assert hidden["delta"] == sealed["attack"]["joint_delta"] == 0.0
    assert sealed["attack"]["held_out_rms_log"] > 0.0
    assert sealed["attack"]["right"]["verdicts"] == ["no_effect_detectable"]


def test_a_stuck_load_cell_stays_at_its_first_reading(made):
    sealed = made[1]["stuck_beside_physics"]
    broken = sealed["attack"]["details"]["load_cell"]
    of_cell = [row for row in sealed["rows"] if row["load_cell"] == broken]
    for name in {row["experiment"] for row in of_cell}:
        assert len({row["reading"] for row in of_cell if row["experiment"] == name}) == 1
        assert len({row["packing"] for row in of_cell if row["experiment"] == name}) > 1
    assert ["sensor_*", broken] in sealed["attack"]["right"]["must_name"]


def test_a_half_gain_is_one_of_the_effects(made):
    sealed = made[1]["gain_beside_physics"]
    _, fault = sealed["effects"]
    for row in sealed["rows"]:
        half = row["load_cell"] == fault["scope_key"]
        assert row["reading"] == pytest.approx(row["packing"] * (0.5 if half else 1.0))


def test_a_wrong_angle_is_declared_as_ever(made):
    root, truths = made
    sealed = truths["wrong_angle"]
    experiments = load_experiments(root / sealed["world"] / "experiments")
    true = sealed["attack"]["details"]["true_internal_friction_angle"]
    for name, one in experiments.items():
        material = laboratory.MATERIALS[one.material.name]
        assert one.material.internal_friction_angle == material["internal_friction_angle"] > true
        assert one.walls.friction_angle > true, name


def test_exchanged_readings_are_each_others(made):
    sealed = made[1]["exchanged_files"]
    pair = sealed["attack"]["details"]["experiments"]
    assert pair == ["static_1", "static_4"]
    rows = {name: [r for r in sealed["rows"] if r["experiment"] == name] for name in pair}
    for one, other in zip(rows["static_1"], rows["static_4"], strict=True):
        assert abs(math.log(one["measured"] / other["reading"])) < 0.6
    assert not sealed["effects"]


def test_same_seed_and_index_same_attack(made):
    files, sealed = draw_world(SEED, ATTACKED + list(ATTACKS).index("exchanged_files"))
    assert json.loads(json.dumps(sealed)) == made[1]["exchanged_files"]
    data = made[0] / sealed["world"] / "experiments/measured/data.csv"
    assert files["experiments/measured/data.csv"] == data.read_text()


# ---------------------------------------------------------------------------------------------
# scores


def attacked(verdicts=None, must=(), may=(), *effects, name="exchanged_files", **more):
    attack = {
        "details": {"experiments": ["static_1", "static_4"], "times": 2.5, "load_cell": "C1"},
        "joint_delta": 4.0,
        "right": {"verdicts": verdicts, "must_name": must, "may_name": may},
    }
    return truth(f"attack_{name}", *effects, **more) | {"attack": attack}


@pytest.mark.parametrize(
    ("right", "said", "ending"),
    [
        ((["no_effect_detectable"],), result(), "yes"),
        ((["no_effect_detectable"],), result("unexplained"), "no"),
        ((None,), result("ambiguous", candidates=["tilt"]), "yes"),
        ((None,), result("effect", ("tilt", None, 0.95)), "fooled"),
        ((None, [], [["tilt", None]]), result("effect", ("tilt", None, 0.95)), "yes"),
        ((None, [["tilt", None]]), result(), "no"),
        ((None, [["tilt", None]]), result("effect", ("tilt", None, 0.9)), "yes"),
        ((None, [["sensor_*", "C3"]]), result("effect", ("sensor_gain", "C3", 0.9)), "yes"),
        ((None, [["sensor_*", "C3"]]), result("effect", ("sensor_gain", "C2", 0.9)), "fooled"),
        ((None, [], []), result("unknown_effect", ("local_rule", None, 0.9)), "fooled"),
        (
            (None, [["tilt", None]], [["sensor_*", "C3"]]),
            result("effect", ("tilt", None, 0.9), ("surcharge", None, 0.9)),
            "fooled",
        ),
    ],
)
def test_what_a_user_would_accept(right, said, ending):
    scores = score([Scored(attacked(*right), said)])
    _, each = attack_tables(scores, Data())
    assert each.rows[0][-1].text == ending


def test_attacks_count_in_their_own_table_alone():
    usual = [
        Scored(truth("null_plain"), result()),
        Scored(
            truth("one", effect("tilt")),
            result("effect", ("tilt", None, 0.95)),
            predictions(8.0, 10.0),
        ),
    ]
    attacks = [
        Scored(attacked(world="world_8009"), result("effect", ("tilt", None, 0.9)), seconds=9.0),
        Scored(
            attacked(world="world_8019"),
            result("ambiguous", candidates=["tilt", "surcharge"]),
            predictions(8.0, 9.0),
        ),
    ]
    alone, together = score(usual), score(usual + attacks)
    assert alone.pop("attacks") == {}
    table = together.pop("attacks")
    assert together == alone
    assert set(table) == {"exchanged_files"}
    found = table["exchanged_files"]
    assert (found["ends_well"]["count"], found["ends_well"]["of"]) == (1, 2)
    assert found["said"] == {"tilt": 1, "ambiguous: tilt, surcharge": 1}
    assert found["held_out_ratio"] == pytest.approx(math.log(0.9) / math.log(0.8))
    assert [one["world"] for one in found["each"]] == ["world_8009", "world_8019"]


def test_the_page_shows_what_fooled_it():
    scores = score([Scored(attacked(), result("effect", ("tilt", None, 0.9)))])
    kinds, each = attack_tables(scores, Data())
    assert kinds.rows[0][0] == ATTACKS["exchanged_files"].words
    assert kinds.rows[0][5].striptags() == "tilt (1)"
    assert "static_1 and static_4" in each.rows[0][3]
    assert each.rows[0][-1].text == "fooled"
    assert attack_tables(score([]), Data()) == []
