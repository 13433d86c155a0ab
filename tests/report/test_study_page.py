"""Pages of studies, whatever the loop found."""

import re
from html import unescape

import numpy as np
import pytest
from pages import shown_numbers
from studies import (
    EXPERIMENTS,
    WORDS,
    added,
    case,
    closed_loop,
    error,
    make_study,
    residuals,
)

from pipeline.effects import effects
from pipeline.files.atomic import read_json
from pipeline.report.index import write_index
from pipeline.report.study_words import VERDICTS, label_of, listed

SAYS = {
    "no_effect_detectable": "nothing that the model lacks",
    "effect": "The model lacks <strong>wall_friction (sand, ore)</strong>",
    "ambiguous": "cannot tell which of these it is: surcharge, density_misdeclared",
    "unknown_effect": f"no effect of the catalogue stands for: <strong>{WORDS}</strong>",
    "unexplained": "No candidate and no local rule explains it",
}


@pytest.fixture(scope="module", params=list(VERDICTS))
def made(request, tmp_path_factory):
    return make_study(tmp_path_factory.mktemp(request.param), closed_loop(request.param))


def words(html):
    """Text of a page without its tags and style."""
    return unescape(re.sub(r"<style>.*?</style>|<[^>]*>", " ", html, flags=re.DOTALL))


def figures(made):
    return set(re.findall(r'<figure id="figure-(\w+)"', made.html))


def panels(made, figure):
    found = re.search(rf'<figure id="figure-{figure}".*?</figure>', made.html, re.DOTALL)
    return re.findall(r'<p class="panel-title">([^<]*)</p>', found.group())


def test_the_verdict_is_a_sentence_with_its_evidence(made):
    head = re.search(r'<section class="verdict".*?</section>', made.html, re.DOTALL).group()
    assert SAYS[made.found["verdict"]] in head
    assert "p = <data" in head
    assert "α = <data" in head
    assert "before, <data" in head
    assert str(VERDICTS[made.found["verdict"]].text) in made.html


def test_every_shown_number_is_in_the_data(made):
    known = {row[key] for row in made.rows for key in ("x", "y", "y_low", "y_high")}
    numbers = shown_numbers(made.html)
    assert len(numbers) > 50
    assert not set(numbers) - known
    assert not {"nan", "None", "null"} & set(words(made.html).split())


def test_no_candidate_is_dropped(made):
    tables = "".join(re.findall(r'<table id="table-(?:un)?testable".*?</table>', made.html, re.S))
    rows = re.findall(r'<tr><th scope="row">(.*?)</th>', tables, re.DOTALL)
    for entry in made.found["candidates"]:
        name = entry["name"] if entry["scope_key"] is None else entry["scope_key"]
        assert any(entry["name"] in row and name in row for row in rows), entry
        assert entry["why"] in tables
    outcomes = re.search(r'<table id="table-outcomes".*?</table>', made.html, re.DOTALL).group()
    for entry in made.found["candidates"]:
        assert f'<th scope="row">{entry["name"]}</th>' in outcomes
    for table in (one for one in made.found["evidence"] if one):
        assert all(name in outcomes for name in table["by_name"])


def test_figures_have_alternative_text_and_ids_are_unique(made):
    expected = {"one_to_one", "standardized", "misfit", "held_out", "folds"}
    asked = [n for n, one in enumerate(made.found["evidence"], start=1) if one]
    assert figures(made) == expected | {f"posterior_{n}" for n in asked}
    shown = re.findall(r'<svg class="panel"[^>]*>', made.html)
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', panel) for panel in shown)
    ids = re.findall(r' id="([^"]+)"', made.html)
    assert len(ids) == len(set(ids))


def test_links_are_relative_and_nothing_is_loaded(made):
    links = set(re.findall(r'(?:src|href)="([^"#][^"]*)"', made.html))
    names = {entry["name"] for entry in made.found["effects_added"]}
    assert links == {
        "../../index.html",
        "report_data.csv",
        "residual.nc",
        *(f"{name}.json" for name in ("attribution", "closed_loop", "predictions", "improved")),
        *(f"../../experiments/{name}/report.html" for name in EXPERIMENTS),
        *(f"improved/{name}.yaml" for name in EXPERIMENTS),
        *(f"../../effects/index.html#{name}" for name in names),
    }
    assert "<script" not in made.html


def test_what_was_added_has_its_equation_and_interval(tmp_path):
    made = make_study(tmp_path, closed_loop())
    effect = effects()["wall_friction"]
    text = words(made.html)
    assert effect.equation in text
    assert "Janssen" in text
    values = {row["y"] for row in made.rows if row["figure"] == "added_1"}
    assert values == {"0.5", "0.4", "0.6"}
    assert "wall_friction: one value for the study" in text


def test_an_amplitude_at_the_end_of_its_range_is_called_no_fit(tmp_path):
    found = closed_loop("unknown_effect")
    assert "not a fit" not in words(make_study(tmp_path / "within", found).html)
    found["effects_added"][0]["parameters"]["amplitude"]["at_bound"] = True
    found["local_rules"][0]["at_bound"] = True
    text = words(make_study(tmp_path / "at_bound", found).html)
    assert text.count("at the end of its range: not a fit") == 3  # head and two tables


@pytest.mark.parametrize(
    ("ratio", "says"), [(None, False), (0.4, False), (1.005, False), (1.3, True)]
)
def test_a_model_that_predicts_worse_is_called_so_in_the_head(tmp_path, ratio, says):
    found = closed_loop()
    found["error"]["held_out"]["ratio"] = ratio
    text = words(make_study(tmp_path, found).html)
    assert ("predicts them worse" in text) == says
    assert ("1.30  times the error" in text) == says


def test_a_second_round_that_ends_at_the_limit_says_so(tmp_path):
    found = closed_loop() | {"candidate_set": ["surcharge"]}
    found["settings"]["max_effects"] = 1
    found["gate"] = [found["gate"][0], found["gate"][0] | {"round": 2}]
    found["evidence"] = [found["evidence"][0]] * 2
    text = words(make_study(tmp_path, found).html)
    assert "still missing" in text
    assert "It is most likely surcharge. The study allows no more effects." in text


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("density_misdeclared", "input", "An input is not as declared"),
        ("sensor_gain", "sensor", "corrects the data and never the ground"),
    ],
)
def test_inputs_and_sensors_are_not_called_physics(tmp_path, name, kind, says):
    found = closed_loop() | {"effects_added": [added(name, 1, "west", kind=kind)]}
    made = make_study(tmp_path, found)
    assert says in made.html
    assert "The model lacks" not in made.html


def test_only_what_varies_has_a_panel(tmp_path):
    made = make_study(tmp_path, closed_loop())
    assert panels(made, "standardized") == ["By experiment"]
    varied = residuals(
        load_cell=["west", "east", ""],
        material=["sand", "sand", "ore"],
        mass_drawn=np.array([0.0, 4.0, 8.0]),
        fill_height=np.array([0.4, 0.5, 0.5]),
        wall_friction_angle=np.array([20.0, 25.0, np.nan]),
    )
    made = make_study(tmp_path / "varied", closed_loop(), varied)
    assert panels(made, "standardized") == [
        "By experiment",
        "By load cell",
        "By material",
        "Against mass drawn",
        "Against fill height",
        "Against wall friction angle",
    ]
    shown = [row for row in made.rows if row["panel"] == "Against wall friction angle"]
    assert [row["x"] for row in shown if row["series"] in EXPERIMENTS] == ["20", "25"]


def test_shares_of_the_misfit_add_up_to_the_whole(tmp_path):
    made = make_study(tmp_path, closed_loop())
    shares = [float(r["y"]) for r in made.rows if r["series"] == "share"]
    assert len(shares) == len(EXPERIMENTS)
    assert sum(shares) == pytest.approx(100)


def test_far_residuals_of_several_quantities_have_their_panels(tmp_path):
    residual = residuals(
        quantity=["vertical_stress", "vertical_stress", "movement_zone_height"],
        simulated=np.array([0.5, 50.0, 0.3]),
        standardized_residual=np.array([-400.0, 3.0, 0.1]),
    )
    made = make_study(tmp_path, closed_loop(), residual)
    assert panels(made, "one_to_one") == ["Vertical stress", "Movement zone height"]


def test_without_held_out_readings_it_says_so(tmp_path):
    found = closed_loop()
    nothing = error(None, 0)
    found["error"]["held_out"] = {
        "before": nothing,
        "after": nothing,
        "ratio": None,
        "ratio_interval_90": None,
    }
    for name in ("recalibrated_only", "gaussian_process"):
        found["error"][name]["held_out"] = nothing
    found["folds"] = [
        fold | {"error": None, "not_predictable": [fold["name"]]} for fold in found["folds"]
    ]
    found |= {"sharing": [], "next_measurement": [], "parameters": {"before": {}, "after": {}}}
    made = make_study(tmp_path, found, rows=[], is_run=False)
    assert "No held-out value could be predicted: nothing tests it." in made.html
    assert not {"held_out", "folds"} & figures(made)
    assert "every parameter stays as its experiment declares it" in made.html
    assert 'href="improved' not in made.html


def test_geometry_alone_has_errors_in_logarithms(tmp_path):
    found = closed_loop()
    for when in ("before", "after"):
        found["error"]["held_out"][when] |= {"rms_kpa": None, "mean_absolute_kpa": None}
    head = words(make_study(tmp_path, found).html)
    assert "Error (rms of logarithms) on what was held out" in head


def test_the_data_label_stands_with_the_data(tmp_path):
    found = closed_loop() | {"data_labels": ["published simulation"]}
    made = make_study(tmp_path, found)
    assert "data: published simulation" in made.html
    assert "published simulation (kPa)" in made.html


def test_what_a_user_writes_is_text(tmp_path):
    evil = "<script>alert(1)</script> {{ 1 + 1 }}"
    found = closed_loop("unknown_effect") | {"candidate_set": [evil]}
    found["next_measurement"] = [{"what": evil, "where": evil, "expected_gain": 0.1}]
    found["candidates"][0] |= {"scope_key": evil, "alike": [evil] * 5, "nearest_mimic": evil}
    found["local_rules"][0]["words"] = evil
    made = make_study(tmp_path, found, title=evil, source=evil)
    assert "<script" not in made.html
    assert made.html.count("&lt;script&gt;alert(1)&lt;/script&gt; {{ 1 + 1 }}") >= 8


def test_the_same_documents_give_the_same_bytes(tmp_path):
    one, other = (make_study(tmp_path / name, closed_loop()) for name in "ab")
    assert one.html == other.html
    assert one.rows == other.rows


def test_labels_of_one_name_stand_together():
    labels = ["tilt [a]", "local_rule E floor", "arching", "tilt [b]", "local_rule E walls"]
    assert listed(labels) == "tilt [a, b]; local_rule E [floor, walls]; arching"
    entry = {"name": "tilt", "scope": "material", "scope_key": None}
    assert label_of(entry) == "tilt of each material"
    assert label_of(entry | {"label": "tilt angle_x"}) == "tilt angle_x of each material"


def test_the_index_marks_a_study_whose_model_predicts_worse(tmp_path):
    worse = closed_loop()
    worse["error"]["held_out"]["ratio"] = 1.3
    made = {n: make_study(tmp_path / n, found) for n, found in (("a", worse), ("b", closed_loop()))}
    studies = {name: one.folder / "closed_loop.json" for name, one in made.items()}
    page = tmp_path / "index.html"
    write_index([], [], [], [], tmp_path / "law.svg", page, tmp_path / "index.json", studies)
    assert page.read_text("utf-8").count('<span class="badge bad">predicts worse</span>') == 1


def test_the_index_lists_studies(tmp_path):
    made = {v: make_study(tmp_path / "studies" / v, closed_loop(v)) for v in VERDICTS}
    page, numbers = tmp_path / "index.html", tmp_path / "index.json"
    studies = {v: one.folder / "closed_loop.json" for v, one in made.items()}
    law = tmp_path / "flow_law" / "flow_law.svg"
    write_index([], [], [], [], law, page, numbers, studies)
    html, document = page.read_text("utf-8"), read_json(numbers)
    known = {value for row in document["data"] for value in row.values()}
    assert {float(value) for value in shown_numbers(html)} <= known
    for verdict, entry in zip(VERDICTS, document["studies"], strict=True):
        assert entry["verdict"] == verdict
        assert (tmp_path / entry["report"]).samefile(made[verdict].folder / "report.html")
        assert f'href="{entry["report"]}"' in html
        names = [one["name"] for one in case(verdict).get("effects_added", [])]
        assert entry["effects_added"] == list(dict.fromkeys(names))
