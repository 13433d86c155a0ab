"""The scorer on made-up results whose scores are known."""

import hashlib
import json
import math

import pytest
from scipy.stats import binomtest

from pipeline.blind.scored import Scored, SealBrokenError, open_world
from pipeline.blind.scores import append_log, rate, score
from pipeline.effects import effects


def truth(kind, *effects, generator="lattice", world="world_0000"):
    """A sealed truth with one static and one drawn held-out reading."""
    rows = [
        {"experiment": "static_7", "load_cell": "C1", "fill_height": 0.8, "mass_drawn": None},
        {"experiment": "static_7", "load_cell": "C1", "fill_height": 1.6, "mass_drawn": None},
        {"experiment": "block_narrow", "load_cell": "C1", "fill_height": None, "mass_drawn": 0.0},
        {"experiment": "block_narrow", "load_cell": "C1", "fill_height": None, "mass_drawn": 6.0},
    ]
    values = {"held_out": True, "stress": 10.0, "measured": 11.0}
    return {
        "world": world,
        "kind": kind,
        "generator": generator,
        "effects": list(effects),
        "rows": [row | values for row in rows],
    }


def effect(name, delta=10.0, key=None, **more):
    return {"name": name, "scope_key": key, "parameters": {}, "delta": delta} | more


def result(verdict="no_effect_detectable", *added, candidates=(), rules=()):
    """A `closed_loop.json`; `added` are (name, scope_key, probability)."""
    return {
        "verdict": verdict,
        "effects_added": [
            {"name": name, "scope_key": key, "probability": p} for name, key, p in added
        ],
        "candidate_set": list(candidates),
        "gate": [{"round": 1, "rejected": verdict != "no_effect_detectable"}],
        "local_rules": list(rules),
        "candidates": [],
    }


def predictions(before, after):
    places = [
        ("static_7", 0.8, None),
        ("static_7", None, None),
        ("block_narrow", None, None),
        ("block_narrow", None, 6.0),
    ]
    return [
        {
            "experiment": name,
            "load_cell": "C1",
            "fill_height": height,
            "mass_drawn": mass,
            "quantity": "vertical_stress",
            "before": before,
            "after": after,
            "recalibrated_only": before,
            "gaussian_process": 1.1 * before,
        }
        for name, height, mass in places
    ]


def bar(scores, words):
    (found,) = [one for one in scores["bars"] if words in one["quantity"]]
    return found


@pytest.mark.parametrize(("count", "of"), [(0, 10), (3, 76), (10, 10), (53, 53)])
def test_bounds_are_clopper_pearson(count, of):
    found = rate(count, of)
    exact = binomtest(count, of).proportion_ci(0.95, "exact")
    assert (found["low"], found["high"]) == pytest.approx((exact.low, exact.high))
    one_sided = binomtest(count, of, alternative="greater").proportion_ci(0.95, "exact")
    assert found["lower_95"] == pytest.approx(one_sided.low)


def test_a_rate_of_nothing_is_none():
    assert rate(0, 0)["rate"] is None


def test_false_alarms_by_kind_of_null():
    plain = [Scored(truth("null_plain"), result()) for _ in range(18)]
    plain += [Scored(truth("null_plain"), result("effect", ("tilt", None, 0.95)))]
    plain += [Scored(truth("null_plain"), result("unknown_effect"))]
    hard = [Scored(truth("null_heavy_tails"), result("unexplained"))]
    alarms = (scores := score(plain + hard))["false_alarms"]
    assert alarms["null_plain"]["any_claim"]["count"] == 2
    assert alarms["null_plain"]["named_effect"]["count"] == 1
    assert alarms["null_heavy_tails"]["any_claim"]["rate"] == 1.0
    assert alarms["null_understated_noise"]["any_claim"]["rate"] is None
    any_claim = bar(scores, "any false claim")
    assert any_claim["figure"] == pytest.approx(0.1)
    assert any_claim["met"]  # two of twenty do not break 5 % with 95 % certainty
    assert any_claim["rate"]["lower_95"] < 0.05


def test_a_false_alarm_bar_is_broken_by_the_lower_bound():
    bad = [Scored(truth("null_plain"), result("unexplained"))] * 10
    good = [Scored(truth("null_plain"), result())] * 50
    assert not bar(score(bad + good), "any false claim")["met"]


def test_right_needs_the_name_and_the_place():
    wall = truth("one", effect("wall_friction", 6.0, "sand"))
    worlds = [
        Scored(wall, result("effect", ("wall_friction", "sand", 0.99))),
        Scored(wall, result("effect", ("wall_friction", "gravel", 0.92))),
        Scored(wall, result("effect", ("tilt", None, 0.5))),
        Scored(wall, result("ambiguous", candidates=["wall_friction", "surcharge"])),
        Scored(wall, result()),
    ]
    scores = score(worlds)
    assert bar(scores, "named first")["rate"]["count"] == 1
    assert bar(scores, "named first")["rate"]["of"] == 3
    assert bar(scores, "found and right")["figure"] == pytest.approx(0.2)
    assert bar(scores, "probability")["figure"] == pytest.approx(0.5)
    assert scores["confusion"]["wall_friction"] == {
        "ambiguous": 1,
        "no_effect_detectable": 1,
        "tilt": 1,
        "wall_friction": 1,
        "wall_friction, elsewhere": 1,
    }
    assert scores["confusion_by_delta"]["5-8"] == scores["confusion"]
    assert scores["confusion_by_delta"][">8"] == {}
    assert scores["sets"]["coverage"]["count"] == 3
    assert scores["sets"]["mean_size"] == pytest.approx(1.25)


def test_what_strong_worlds_were_missed_for_is_listed():
    answer = result("ambiguous", candidates=["wall_friction", "cohesion"])
    parts = {"name": "wall_friction", "scope_key": "sand", "nearest_mimic": "cohesion [sand]"}
    answer["candidates"] = [
        parts | {"probability": 0.6, "mimic_distance": 2.0},
        parts | {"probability": 0.1, "mimic_distance": 9.0},
    ]
    wall = effect("wall_friction", 6.0, "sand") | {"parameters": {"K": 0.45}}
    scale = effects()["wall_friction"].parameters[0].scale
    pair = truth("two", effect("tilt", 7.0), effect("surcharge", 8.0), world="world_0001")
    worlds = [
        Scored(truth("one", wall), answer),
        Scored(truth("one", wall), result("effect", ("wall_friction", "sand", 0.99))),
        Scored(truth("one", effect("tilt", 4.9)), result()),
        Scored(pair, result("effect", ("tilt", None, 0.99))),
        Scored(truth("null_plain"), result("effect", ("tilt", None, 0.99))),
    ]
    first, second = score(worlds)["missed"]
    (found,) = first["effects"]
    assert first["said"] == "ambiguous: wall_friction, cohesion"
    assert found["probability"] == 0.6
    assert found["mimic_distance"] == pytest.approx(2.0 * 0.45 / scale)
    assert second["world"] == "world_0001"
    assert [one["probability"] for one in second["effects"]] == [None, None]


def test_weak_worlds_do_not_count_as_missed():
    weak = Scored(truth("one", effect("tilt", 1.5)), result())
    scores = score([weak])
    assert bar(scores, "found and right")["met"] is None
    assert scores["named_first_by_delta"]["<2"]["found_and_right"]["rate"] == 0.0


def test_held_out_ratios_against_the_truth_and_the_readings():
    named = result("effect", ("tilt", None, 0.99))
    better = Scored(truth("one", effect("tilt")), named, predictions(12.0, 10.5))
    worse = Scored(truth("one", effect("tilt")), named, predictions(10.2, 10.5))
    scores = score([better, worse])
    table = scores["held_out"]["one_effect_at_least_5"]
    ratios = [math.log(1.05) / math.log(1.2), math.log(1.05) / math.log(1.02)]
    assert table["after_rms_log"]["median_ratio"] == pytest.approx(sum(ratios) / 2)
    assert table["after_rms_log"]["made_worse"]["count"] == 1
    assert bar(scores, "made worse")["figure"] == 0.5
    each = scores["each"][0]["held_out"]
    assert each["after"]["rms_kpa"] == pytest.approx(0.5)
    assert each["after"]["rms_log_readings"] == pytest.approx(math.log(11 / 10.5))
    assert each["gaussian_process"]["rms_kpa"] == pytest.approx(3.2)


def test_two_effects_need_the_exact_set():
    pair = truth("two", effect("tilt", 9.0), effect("wall_friction", 6.0, "sand"))
    both = result("effect", ("wall_friction", "sand", 0.9), ("tilt", None, 0.9))
    one = result("effect", ("tilt", None, 0.9))
    more = result("effect", ("tilt", None, 0.9), ("surcharge", None, 0.9))
    weak = truth("two", effect("tilt", 9.0), effect("wall_friction", 4.0, "sand"))
    scores = score([Scored(pair, both), Scored(pair, one), Scored(pair, more), Scored(weak, one)])
    strong = scores["two"]["both_at_least_5"]
    assert (strong["exact_set"]["count"], strong["exact_set"]["of"]) == (1, 3)
    assert strong["one_right_none_wrong"]["count"] == 1
    assert strong["wrong_term"]["count"] == 1
    assert scores["two"]["all"]["exact_set"]["of"] == 4


def test_outside_the_catalogue():
    shell = effect("loosened_shell", 9.0, channel="E", place=["shell", "near the movement zone"])
    outside = truth("outside", shell)

    def rule(channel, words, probability=0.9):
        return {"channel": channel, "feature": "f", "words": words, "probability": probability}

    right = [rule("weight", "depth", 0.1), rule("E", "ground Near the movement zone")]
    worlds = [
        Scored(outside, result("unknown_effect", ("local_rule", None, 0.9), rules=right)),
        Scored(outside, result("unknown_effect", rules=[rule("weight", "in the shell")])),
        Scored(outside, result("effect", ("tilt", None, 0.9), rules=right)),
        Scored(outside, result()),
    ]
    table = score(worlds)["outside"]["at_least_5"]
    assert table["not_named_as_catalogue"]["count"] == 3
    assert table["unknown_effect"]["count"] == 2
    assert table["right_rule"]["count"] == 1


def test_reliability_of_probabilities():
    tilt = truth("one", effect("tilt"))
    worlds = [
        Scored(tilt, result("effect", ("tilt", None, 0.95))),
        Scored(tilt, result("effect", ("tilt", None, 0.91))),
        Scored(tilt, result("effect", ("surcharge", None, 0.92))),
        Scored(tilt, result("effect", ("tilt", None, 1.0))),
    ]
    table = {row["probability"]: row for row in score(worlds)["reliability"]}
    assert table["0.9-0.97"]["right"]["count"] == 2
    assert table["0.9-0.97"]["mean_probability"] == pytest.approx(0.92666667)
    assert table["0.97-1"]["right"]["of"] == 1


def test_peers_answer_the_same_questions():
    tilt = truth("one", effect("tilt"))
    worlds = [
        Scored(tilt, result(), peers={"bic": [("tilt", None)]}),
        Scored(tilt, result(), peers={"bic": [["surcharge", None], ["tilt", None]]}),
        Scored(truth("null_plain"), result(), peers={"bic": [("tilt", None)]}),
        Scored(truth("null_plain"), result(), peers={"bic": []}),
    ]
    table = score(worlds)["peers"]["bic"]
    assert table["claims_on_plain_nulls"]["rate"] == 0.5
    assert table["right_of_named"]["rate"] == 0.5
    assert table["found_and_right_at_least_5"]["count"] == 1


def test_a_truth_must_be_the_one_that_was_published(tmp_path):
    sealed, loop = tmp_path / "sealed.json", tmp_path / "closed_loop.json"
    sealed.write_text(json.dumps(truth("null_plain")))
    loop.write_text(json.dumps(result()))
    digest = hashlib.sha256(sealed.read_bytes()).hexdigest()
    assert not open_world(sealed, digest, loop, seconds=2.0).claims
    sealed.write_text(json.dumps(truth("one", effect("tilt"))))
    with pytest.raises(SealBrokenError, match="published"):
        open_world(sealed, digest, loop)


def test_the_log_keeps_every_run(tmp_path):
    scores = score([Scored(truth("null_plain"), result(), seconds=3.0)])
    log = tmp_path / "log.jsonl"
    for commit in ("abc", "def"):
        append_log(log, scores, commit, {"scoring": 7}, "2026-01-02")
    first, second = map(json.loads, log.read_text().splitlines())
    assert (first["commit"], second["commit"]) == ("abc", "def")
    assert first["seeds"] == {"scoring": 7}
    assert len(first["bars"]) == len(scores["bars"])
    assert bar(scores, "seconds")["met_stretch"]


def test_scores_of_nothing_are_empty_not_an_error():
    scores = score([])
    assert json.dumps(scores, allow_nan=False)
    assert all(one["met"] is None for one in scores["bars"])
