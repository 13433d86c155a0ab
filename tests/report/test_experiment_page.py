"""Pages of a static and of a draw experiment, and of experiments that lack things."""

import csv
import re

import numpy as np
import pytest
import xarray as xr
from pages import row, shown_numbers

from pipeline.files.atomic import read_json
from pipeline.parameters import Parameters
from pipeline.report.experiment import write_report
from pipeline.report.experiment_tables import is_assumed
from pipeline.report.results import Agreement

STATIC = {"sections", "profile", "filling", "spreading", "lattice", "convergence"}
DRAW = STATIC - {"filling"} | {
    "draw_views",
    "load_cells",
    "stress_sections",
    "zone_sections",
    "movement_zone",
    "E_min",
    "extraction_zone",
}


REGIONS = {"regions", "drawn_Cu", "drawn_Au", "drawn_dilution"}


@pytest.fixture(params=["static", "draw", "regions"])
def made(request):
    return request.getfixturevalue(request.param)


def replicates(made):
    with xr.open_dataset(made.inputs["replicates"], decode_times=False) as dataset:
        return dataset.load()


def test_every_shown_number_is_in_the_data(made):
    numbers = shown_numbers(made.html)
    known = {row[key] for row in made.rows for key in ("x", "y", "y_low", "y_high")}
    assert len(numbers) > 50
    assert not set(numbers) - known


def test_number_cells_hold_recorded_numbers(made):
    cells = re.findall(r'<td class="number">(.*?)</td>', made.html, re.DOTALL)
    assert cells
    assert all("<data value=" in cell or cell.strip() == "–" for cell in cells)


def test_every_figure_is_there_with_alternative_text(made):
    figures = set(re.findall(r'<figure id="figure-(\w+)"', made.html))
    expected = DRAW if made.experiment.is_draw else STATIC
    assert figures == expected | (REGIONS if made.experiment.regions else set())
    panels = re.findall(r'<svg class="panel"[^>]*>', made.html)
    assert len(panels) >= len(figures)
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', panel) for panel in panels)
    assert made.html.count("<figcaption>") == len(figures)


def test_tables_have_captions_and_headers(made):
    tables = re.findall(r"<table.*?</table>", made.html, re.DOTALL)
    assert len(tables) >= 3
    for table in tables:
        assert "<caption>" in table
        assert 'scope="col"' in table
        assert 'scope="row"' in table


def test_the_page_stands_alone(made):
    links = re.findall(r'(?:src|href)="([^"#][^"]*)"', made.html)
    outside = [link for link in links if not link.startswith("data:image/png;base64,")]
    assert set(outside) == {
        "../../index.html",
        "report_data.csv",
        *(path.name for path in made.inputs.values()),
    }
    assert made.html.count("<script") == (1 if made.experiment.is_draw else 0)
    assert "@import" not in made.html
    assert len(made.html) < 1_500_000


def test_ids_are_unique_and_references_resolve(made):
    ids = re.findall(r' id="([^"]+)"', made.html)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|href="#)([^")]+)', made.html)) <= set(ids)


def test_the_same_results_give_the_same_bytes(made, tmp_path):
    write_report(made.experiment, made.inputs, tmp_path / "report.html",
                 tmp_path / "report_data.csv")  # fmt: skip
    assert (tmp_path / "report.html").read_text("utf-8") == made.html
    assert (tmp_path / "report_data.csv").read_bytes() == (
        made.folder / "report_data.csv"
    ).read_bytes()


def test_the_data_label_stands_with_the_data(made):
    label = made.experiment.data_label
    assert f"data: {label}" in made.html
    assert f"Data, {label}" in made.html
    used = "used" if made.experiment.calibrate else "not used"
    assert f"{label} data, {used} in calibration" in made.html


def test_what_is_assumed_is_flagged(made):
    for key in made.experiment.assumed:
        assert f"<code>{key}</code>" in made.html
    assert '<span class="badge warn">assumed</span>' in made.html


def test_a_static_page_says_what_does_not_reproduce(static):
    validation = read_json(static.inputs["validation"])
    assert not validation["published"]["mean_reproduced"]
    assert "<strong>not reproduced</strong>" in static.html
    assert validation["statements"][0].split(":")[0] in static.html


def test_a_target_out_of_reach_is_flagged(column, make_page):
    experiment = column(calibrate=["s"], measured="table.csv")
    made = make_page(experiment, (row("vertical_stress_spatial_std", 50.0, 1.0),))
    assert "its target is out of reach" in made.html


def test_the_nine_shares_add_up_to_the_whole(static):
    shares = [
        np.array(static.series("spreading", name))[:, 1]
        for name in (
            "straight below, d = 1",
            "beside, d = √2 (each of four)",
            "corner, d = √3 (each of four)",
        )
    ]
    np.testing.assert_allclose(shares[0] + 4 * shares[1] + 4 * shares[2], 1.0, rtol=1e-8)


def test_the_lattice_figure_holds_both_forms_of_eq_5(static):
    E = read_json(static.inputs["calibration"])["parameters_used"]["E"]
    n, exact = np.array(static.series("lattice", "sum of eqs 1 and 2")).T
    np.testing.assert_allclose(exact, (1 - E**n) / (n * (1 - E)), rtol=1e-8)
    printed = np.array(static.series("lattice", "eq 5 as printed (once more × E)"))[:, 1]
    np.testing.assert_allclose(printed, E * exact, rtol=1e-8)


def test_the_profile_ends_at_the_base_stress(static):
    base = replicates(static)["base_vertical_stress"].values[:, -1].mean()
    depth, stress = static.series("profile", "model, mean over the level")[0]
    assert depth == pytest.approx(1.0)
    assert stress == pytest.approx(base, rel=1e-5)


def test_the_running_mean_ends_at_the_mean(static):
    values = replicates(static)["base_vertical_stress_std"].values[:, -1]
    n, mean = static.series("convergence", "running mean", "Sd from place to place on the base")[-1]
    assert n == len(values)
    assert mean == pytest.approx(values.mean())


def test_load_cells_show_the_ratio_to_the_stress_before_draw(draw):
    stress = replicates(draw)["vertical_stress"].values
    ratio = (stress / stress[:, :1]).mean(axis=0)
    shown = np.array(draw.series("load_cells", "model, mean", "Load cell above"))
    np.testing.assert_allclose(shown[:, 1], ratio[:, 1], rtol=1e-8)
    label = "simulated (DEM) data, not used in calibration (± 1 sd)"
    beside = draw.series("load_cells", label, "Load cell beside")
    assert beside == [(0, 1), (4, pytest.approx(9.4 / 9)), (8, pytest.approx(9.8 / 9))]
    assert draw.series("load_cells", label, "Load cell above") == [(8, 0.6)]


def test_the_ratio_has_the_independent_errors_of_both_readings(draw):
    later = next(r for r in draw.rows if r["figure"] == "load_cells" and r["x"] == "4"
                 and r["series"].startswith("simulated"))  # fmt: skip
    error = np.hypot(0.4, 0.4 * 9.4 / 9) / 9
    assert float(later["y_high"]) - float(later["y"]) == pytest.approx(error)


def test_e_min_is_the_law_that_was_used(draw):
    used = Parameters.from_document(read_json(draw.inputs["calibration"])["parameters_used"])
    height, value = np.array(draw.series("E_min", "E_min, movement zone")).T
    np.testing.assert_allclose(value, 1 - used.shed_in_zone(height), rtol=1e-8)


def test_drawpoints_gave_the_mass_that_was_drawn(draw):
    drawn = replicates(draw)["replicate_mass_drawn"].values[:, -1].mean()
    given = [float(r["y"]) for r in draw.rows
             if r["figure"] == "drawpoints" and r["series"] == "Drawn (kg)"]  # fmt: skip
    assert sum(given) == pytest.approx(drawn)


def test_published_errors_are_quoted(draw):
    assert "as published (a paper)" in draw.html
    assert '<data value="1.53">1.53</data>' in draw.html


@pytest.mark.parametrize(
    "changes",
    [
        {"replicates": 1},
        {"geometry": {"mask": {"type": "cylinder"}}},
        {"geometry": {"height": 0.95}, "stress": {"E": 1.0, "s": 2.0}},
        {"stress": {"rule": "multinomial"}, "keep_fields": True},
    ],
    ids=["one replicate", "cylinder", "nothing shed", "fields kept"],
)
def test_an_experiment_without_data_has_a_page(column, make_page, changes):
    made = make_page(column(**changes))
    assert "data: none" in made.html
    assert "No data to compare with" in made.html
    assert "nan" not in re.sub(r"<[^>]*>", "", made.html).lower().split()


@pytest.mark.parametrize(
    "changes",
    [
        {"replicates": 1, "load_cells": None},
        {"geometry": {"mask": {"type": "drawbells", "height": 0.2, "wall_angle": 60}}},
    ],
    ids=["one replicate, no load cell", "drawbells"],
)
def test_a_draw_without_data_has_a_page(drawn, make_page, changes):
    made = make_page(drawn(**changes))
    assert "No load cell was measured" in made.html
    assert "It was not measured here" in made.html


def test_what_a_user_writes_is_text(column, make_page):
    evil = "<script>alert(1)</script> {{ 1 + 1 }} \" '"
    made = make_page(column(title=evil, source=evil, material={"name": evil}))
    assert "<script" not in made.html
    assert made.html.count("&lt;script&gt;alert(1)&lt;/script&gt; {{ 1 + 1 }}") >= 3


def test_what_a_user_writes_is_text_beside_the_script_of_a_draw(drawn, make_page):
    evil = "</script><script>alert(1)</script> {{ 1 + 1 }} \" '"
    made = make_page(drawn("evil", title=evil, source=evil, material={"name": evil}))
    assert made.html.count("<script") == made.html.count("</script") == 1
    assert made.html.count("&lt;script&gt;alert(1)&lt;/script&gt; {{ 1 + 1 }}") >= 3


@pytest.mark.parametrize(
    ("assumed", "key", "flagged"),
    [
        ("drawpoints", "drawpoints", True),
        ("stress", "stress.E", True),
        ("measured.std", "measured", True),
        ("stress.E_min", "stress.E", False),
    ],
)
def test_assumed_keys_match_by_whole_parts(column, assumed, key, flagged):
    assert is_assumed(column(assumed=[assumed]), key) is flagged


@pytest.mark.parametrize(
    ("count", "within", "agrees"), [(1, 1, True), (1, 0, False), (20, 19, True), (19, 18, False)]
)
def test_the_verdict_allows_one_value_in_twenty(count, within, agrees):
    assert Agreement(count, within, 3.0).agrees is agrees


def test_many_load_cells_get_a_map_and_a_table_by_period(pillars):
    html = pillars.html
    assert 'id="figure-base_map"' in html
    table = html.split('id="table-base_stress"')[1].split("</table>")[0]
    assert table.count("<tr>") == 2 + 18 * 4
    with open(pillars.inputs["base_stress"], encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["place"] == "load_cell"]
    stored = [float(row["p90_kpa"]) for row in rows]
    shown = [
        float(row["y"])
        for row in pillars.rows
        if (row["figure"], row["series"]) == ("base_stress", "Stress (kPa): P90")
    ]
    assert shown == stored
    panels = {
        row["panel"] for row in pillars.rows if row["figure"] == "load_cells" and row["panel"]
    }
    assert len(panels) == 7
    assert "Shown are 7 of the 18 load cells" in html


def test_few_load_cells_keep_a_panel_each(draw):
    assert "base_map" not in draw.html
    assert "Shown are" not in draw.html


def test_what_was_drawn_has_the_grades_of_the_files(regions):
    with xr.open_dataset(regions.inputs["grade"]) as curves:
        curves = curves.load()
    for name, figure in (("grade_Cu", "drawn_Cu"), ("dilution", "drawn_dilution")):
        shown = np.array(regions.series(figure, "in each bin, mean", "west"))
        np.testing.assert_allclose(shown[:, 1], curves[f"drawn_{name}_mean"].values[0], rtol=1e-9)
        until = np.array(regions.series(figure, "from the start, mean", "All drawpoints"))
        np.testing.assert_allclose(until[:, 0], curves["mass_to"].values[-1])
        expected = curves[f"cumulative_{name}_mean"].values[-1]
        np.testing.assert_allclose(until[:, 1], expected, rtol=1e-9)
    (total,) = [
        row["y"]
        for row in regions.rows
        if (row["figure"], row["panel"], row["series"]) == ("grade", "west", "dilution (–): P90")
    ]
    assert float(total) == pytest.approx(float(curves["cumulative_dilution_p90"][0, -1]), rel=1e-9)


def test_regions_stand_in_a_table_with_place_density_grades_and_waste(regions):
    (table,) = re.findall(r'<table id="table-regions">.*?</table>', regions.html, re.DOTALL)
    rows = re.findall(r'<th scope="row">(\d: \w+)</th>(.*?)</tr>', table, re.DOTALL)
    assert [name for name, _ in rows] == ["1: ore", "2: cap"]
    assert "z 0 to 0.8 m" in rows[0][1]
    assert shown_numbers(rows[0][1]) == ["1600", "0.7", "0.2"]
    assert shown_numbers(rows[1][1]) == ["1300", "0", "0"]
    assert ["waste" in cells for _, cells in rows] == [False, True]
    assert "tuff &lt;b&gt;" in table
    assert "tuff <b>" not in regions.html


def test_the_overburden_is_that_of_the_regions(regions):
    depth = dict(regions.series("profile", "overburden ρ g z"))
    assert min(depth.values()) == pytest.approx(1300 * 9.81 * 0.05 / 1e3, rel=1e-6)
    assert max(depth.values()) == pytest.approx(1450 * 9.81 * 0.8 / 1e3, rel=1e-6)


def test_a_page_without_regions_says_nothing_of_them(draw):
    assert "table-regions" not in draw.html
    assert "dilution" not in draw.html


@pytest.mark.parametrize(
    ("target", "count", "words"), [(1e3, 5, "reached"), (1e-6, 8, "not reached")]
)
def test_a_run_that_may_stop_says_when_it_did(column, make_page, target, count, words):
    cells = [{"name": "C", "x": 0.25, "y": 0.2, "width": 0.1, "length": 0.1}]
    stop_at = {"standard_error": target, "at_least": 5}
    made = make_page(column("stopping", load_cells=cells, stop_at=stop_at))
    setup = re.search(r'<table id="table-setup">.*?</table>', made.html, re.DOTALL)[0]
    assert f">{words}</span>" in setup
    shown = {row["panel"]: float(row["y"]) for row in made.rows if row["figure"] == "setup"}
    assert shown["replicates, at most"] == 8
    assert shown["replicates of this run"] == count
    stress = replicates(made)["vertical_stress"].values
    largest = shown["standard error of a load cell's mean, the largest of this run"]
    assert largest == pytest.approx(stress.std(axis=0, ddof=1).max() / np.sqrt(count), rel=1e-6)
