"""The index of any set of experiments."""

import re

import pytest
from pages import shown_numbers

from pipeline.files.atomic import read_json, write_json
from pipeline.report.index import write_index


@pytest.fixture
def index(tmp_path):
    """index(made, ...): HTML and JSON of an index of these experiments."""

    def make(*made, comparisons=(), blind_scores=None):
        def files(name):
            return [entry.folder / name for entry in made]

        page, numbers = tmp_path / "index.html", tmp_path / "index.json"
        documents = (files(name) for name in ("calibration.json", "validation.json", "report.html"))
        law = tmp_path / "flow_law" / "flow_law.svg"
        write_index(
            [entry.experiment for entry in made],
            *documents,
            law,
            page,
            numbers,
            comparisons=[entry.folder / "comparison.json" for entry in comparisons],
            blind_scores=blind_scores,
        )
        return page.read_text("utf-8"), read_json(numbers)

    return make


@pytest.fixture(scope="session")
def unmeasured(column, make_page):
    return make_page(column(name="unmeasured"))


@pytest.mark.parametrize(
    "names",
    [("static", "draw", "unmeasured"), ("static",), ("draw",), ("unmeasured",), ()],
    ids=lambda names: "+".join(names) or "none",
)
def test_every_number_is_in_the_json(index, request, names):
    html, numbers = index(*(request.getfixturevalue(name) for name in names))
    known = {value for row in numbers["data"] for value in row.values()}
    assert {float(value) for value in shown_numbers(html)} <= known
    assert [entry["experiment"] for entry in numbers["experiments"]] == [
        request.getfixturevalue(name).experiment.name for name in names
    ]


def test_each_experiment_is_linked_with_its_verdict(index, static, draw, tmp_path):
    html, numbers = index(static, draw)
    for made, entry in zip((static, draw), numbers["experiments"], strict=True):
        assert (tmp_path / entry["report"]).samefile(made.folder / "report.html")
        assert f'href="{entry["report"]}"' in html
        assert entry["agreement"]["as_declared"]["values"] == len(
            read_json(made.inputs["validation"])["readings"]
        )
    assert numbers["experiments"][0]["published_mean_reproduced"] is False
    assert "not reproduced" in html


def test_experiments_stand_at_a_glance_by_whether_they_agree(index, static, draw, unmeasured):
    html, numbers = index(static, draw, unmeasured)
    glance = html.split('<ul class="glance">')[1].split("</ul>")[0]
    groups = {}
    for row in re.findall(r"<li>.*?</li>", glance):
        outcome = re.search(r'class="badge \w+">([^<]*)<', row)[1]
        groups[outcome] = re.findall(r'<a href="([^"]*)"', row)
    for entry in numbers["experiments"]:
        found = entry["agreement"]["calibrated"] or entry["agreement"]["as_declared"]
        if found is None:
            outcome = "no data"
        elif not found["agrees"]:
            outcome = "disagrees"
        else:  # every value of the static experiment is in its calibration, none of the draw's
            outcome = "fitted" if entry["experiment"] == static.experiment.name else "agrees"
        assert entry["report"] in groups[outcome]
    assert sum(map(len, groups.values())) == 3


def test_the_figures_have_alternative_text(index, static, draw):
    html, _ = index(static, draw)
    assert set(re.findall(r'<figure id="figure-(\w+)"', html)) == {
        "transmission",
        "published",
        "errors",
    }
    panels = re.findall(r'<svg class="panel"[^>]*>', html)
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', panel) for panel in panels)


def test_errors_tell_fitted_values_from_others(index, static, draw):
    _, numbers = index(static, draw)
    series = {row["series"] for row in numbers["data"] if row["figure"] == "errors"}
    assert "calibrated, value used in the calibration" in series
    assert "as declared" in series
    declared = [row for row in numbers["data"]
                if row["figure"] == "errors" and row["series"] == "as declared"]  # fmt: skip
    assert len(declared) == 3 + 5


def test_what_a_user_writes_is_text(index, column, make_page):
    evil = "<script>alert(1)</script>"
    made = make_page(column(title=evil, source=evil, material={"name": evil}))
    html, _ = index(made)
    assert "<script" not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html


def test_the_same_results_give_the_same_bytes(index, static, draw):
    assert index(static, draw) == index(static, draw)


def test_a_blind_benchmark_is_linked_with_its_bars(index, static, tmp_path):
    scores = tmp_path / "blind_benchmark" / "scores.json"
    content = {"commit": "0123456789", "date": "2026-11-25", "worlds": 40}
    bars = [{"met": True}, {"met": True}, {"met": False}, {"met": None}]
    write_json(scores, content | {"bars": bars, "seed_is_the_commits": False})
    html, numbers = index(static, blind_scores=scores)
    assert 'href="blind_benchmark/report.html"' in html
    assert "tuning worlds" in html
    blind = numbers["blind_benchmark"]
    assert (blind["worlds"], blind["bars_met"], blind["bars"]) == (40, 2, 3)
    assert index(static)[1]["blind_benchmark"] is None


def test_comparisons_are_linked_with_peak_and_time_above(index, static, comparison, tmp_path):
    html, numbers = index(static, comparisons=[comparison])
    (entry,) = numbers["comparisons"]
    assert (tmp_path / entry["report"]).samefile(comparison.folder / "report.html")
    assert f'href="{entry["report"]}"' in html
    assert entry["experiments"] == ["west_first", "west_second"]
    shown = {row["series"]: row["y"] for row in numbers["data"] if row["figure"] == "comparisons"}
    assert shown["Peak (MPa): first"] == pytest.approx(0.5)
    assert shown["Above (%): second"] == pytest.approx(100 * (200 / 250) / 3, rel=1e-3)
