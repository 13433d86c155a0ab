"""The page that compares two experiments."""

import csv
import re
from io import StringIO

import pytest
from comparisons import make_comparison
from pages import shown_numbers

from pipeline.files.atomic import read_json


def test_every_number_on_the_page_is_in_the_file_beside_it(comparison):
    known = {row["y"] for row in csv.DictReader(StringIO(comparison.data))}
    assert set(shown_numbers(comparison.html)) <= known


def test_curves_are_those_of_the_json(comparison):
    content = read_json(comparison.folder / "comparison.json")
    rows = [
        row
        for row in csv.DictReader(StringIO(comparison.data))
        if (row["figure"], row["panel"], row["series"])
        == ("series", "Load cell above", "west_first, simulated mean")
    ]
    entry = content["load_cells"][1]["first"]
    for key, column in (("mean_mpa", "y"), ("p10_mpa", "y_low"), ("p90_mpa", "y_high")):
        assert [float(row[column]) for row in rows] == pytest.approx(entry[key])


def test_figures_have_alternative_text_and_a_map_for_each_reading(comparison):
    html = comparison.html
    assert re.findall(r'<figure id="figure-(\w+)"', html) == [
        *("series", "difference_maps", "stress_maps_first", "stress_maps_second"),
        *("peak_maps", "share_maps"),
    ]
    panels = re.findall(r'<svg class="panel"[^>]*>', html)
    assert len(panels) == 3 + 3 + 3 + 3 + 4 + 3
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', panel) for panel in panels)


def test_it_says_what_is_simulated_and_what_is_assumed(comparison):
    assert ">simulated<" in comparison.html
    assert "no measured data: nothing is calibrated or validated there" in comparison.html
    assert "Assumed in west_first" in comparison.html
    assert 'href="../../experiments/west_first/report.html"' in comparison.html


def test_the_answer_names_peak_time_above_and_largest_difference(comparison):
    words = re.sub(r"<[^>]*>", "", comparison.html.split("Verdict")[1])
    assert "west_first: the highest mean stress is 0.550 MPa, on above before draw" in words
    assert "They differ most on above: −0.165 MPa (west_second less west_first) after 4 kg" in words


def test_user_s_words_are_escaped(drawn, tmp_path):
    evil = "<script>alert(1)</script>"
    first = drawn("west_first", title=evil, assumed=["flow"])
    html = make_comparison(first, drawn("west_second"), tmp_path, title=evil).html
    assert evil not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html


def test_the_same_numbers_give_the_same_bytes(comparison, drawn, tmp_path):
    pair = drawn("west_first", assumed=["flow", "draw"]), drawn("west_second")
    assert make_comparison(*pair, tmp_path, title="Two strategies").html == comparison.html
