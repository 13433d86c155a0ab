"""Errors against measured rows, by hand."""

import numpy as np
import pytest
import xarray as xr

from pipeline.config.measured import MeasuredRow
from pipeline.validate.validation import validate

# four replicates of a column read at 0.5 m and full: mean of the base, and its spatial sd
BASE = [[4.0, 8.0], [4.0, 8.0], [5.0, 10.0], [5.0, 10.0]]
SPATIAL = [[1.0, 2.0], [1.0, 2.0], [1.0, 4.0], [1.0, 4.0]]
PUBLISHED = {"vertical_stress_mean": 13.5, "vertical_stress_std": 4.0, "test": 3}


def measured(quantity, value, std, **changes):
    given = dict.fromkeys(("load_cell", "fill_height", "mass_drawn", "count"))
    given |= {"std_shared": 0.0, "line": 1} | changes
    return MeasuredRow(quantity=quantity, value=value, std=std, **given)


ROWS = (
    measured("vertical_stress", 5.0, 0.5, fill_height=0.5),  # simulated 4.5: -0.5, -1 sd
    measured("vertical_stress", 8.0, 0.3, std_shared=0.4),  # simulated 9: +1, +2 sd
    measured("vertical_stress_spatial_std", 2.5, 0.25),  # simulated 3: +0.5, +2 sd
)


def replicates(**as_declared):
    dims = ("replicate", "time")
    data = {
        "base_vertical_stress": (dims, BASE),
        "base_vertical_stress_std": (dims, SPATIAL),
        "vertical_stress": ((*dims, "load_cell"), np.array(BASE)[..., None]),
        "negative_s_share": ("replicate", [0.25] * 4),
        "fill_height": ("time", [0.5, 1.0]),
    }
    data |= {f"{name}_as_declared": (dims, values) for name, values in as_declared.items()}
    return xr.Dataset(data)


def calibration(targets=(), messages=()):
    return {
        "targets": list(targets),
        "messages": list(messages),
        "parameters_used": {"E": 0.9},
        "declared": {"E": 0.8},
    }


def test_errors_of_each_reading_by_hand(column):
    document = validate(column(), replicates(), calibration(), ROWS)
    first, second, spread = document["readings"]
    assert first["calibrated"]["mean"] == 4.5
    assert first["calibrated"]["std"] == pytest.approx(np.sqrt(1 / 3))
    assert first["calibrated"]["standard_error"] == pytest.approx(np.sqrt(1 / 3) / 2)
    assert first["calibrated"]["error"] == -0.5
    assert first["calibrated"]["error_in_sd"] == -1.0
    assert second["measured_sd"] == pytest.approx(0.5)
    assert second["calibrated"]["error"] == 1.0
    assert second["calibrated"]["error_in_sd"] == pytest.approx(2.0)
    assert spread["calibrated"]["error"] == 0.5
    assert (first["unit"], spread["unit"]) == ("kPa", "kPa")


def test_bias_mean_absolute_error_and_rmse_by_hand(column):
    overall = validate(column(), replicates(), calibration(), ROWS)["overall"]["calibrated"]
    stress = overall["vertical_stress"]
    assert stress["n"] == 2
    assert stress["bias"] == pytest.approx(0.25)  # of -0.5 and 1
    assert stress["mean_absolute_error"] == pytest.approx(0.75)
    assert stress["rmse"] == pytest.approx(np.sqrt(1.25 / 2))
    assert stress["bias_in_sd"] == pytest.approx(0.5)  # of -1 and 2
    assert stress["mean_absolute_error_in_sd"] == pytest.approx(1.5)
    assert stress["rmse_in_sd"] == pytest.approx(np.sqrt(2.5))
    assert overall["vertical_stress_spatial_std"]["bias"] == pytest.approx(0.5)


def test_a_row_with_a_count_has_the_replicates_scatter_over_n_in_its_sd(column):
    rows = (measured("vertical_stress", 8.0, 0.5, count=4),)
    (reading,) = validate(column(), replicates(), calibration(), rows)["readings"]
    total = np.sqrt(0.5**2 + (4 / 3) / 4)  # replicates 8, 8, 10, 10: variance 4/3
    assert reading["measured_sd"] == pytest.approx(total)
    assert reading["calibrated"]["error_in_sd"] == pytest.approx(1.0 / total)


def test_as_declared_stands_beside_calibrated(column):
    declared = {"base_vertical_stress": np.array(BASE) + 2, "base_vertical_stress_std": SPATIAL}
    document = validate(column(), replicates(**declared), calibration(), ROWS)
    assert document["runs"] == {"calibrated": {"E": 0.9}, "as_declared": {"E": 0.8}}
    for reading in document["readings"][:2]:
        assert reading["as_declared"]["error"] == reading["calibrated"]["error"] + 2
    overall = document["overall"]
    assert overall["as_declared"]["vertical_stress"]["bias"] == pytest.approx(2.25)
    alone = validate(column(), replicates(), calibration(), ROWS)
    assert set(alone["overall"]) == {"calibrated"}


def test_rows_that_the_calibration_saw_are_marked(column):
    target = {
        "quantity": "vertical_stress",
        "load_cell": None,
        "fill_height": None,
        "mass_drawn": None,
    }
    document = validate(column(), replicates(), calibration([target]), ROWS)
    assert [r["used_in_calibration"] for r in document["readings"]] == [False, True, False]


def test_published_mean_is_compared_with_ours_as_declared(column):
    declared = {"base_vertical_stress": np.array(BASE) * 2, "base_vertical_stress_std": SPATIAL}
    document = validate(column(published=PUBLISHED), replicates(**declared), calibration(), ROWS)
    published = document["published"]
    assert published["ours_mean"] == 18.0  # full, as declared
    assert published["ours_std"] == 3.0
    assert published["mean_ratio"] == pytest.approx(18 / 13.5)
    assert published["mean_reproduced"] is False
    # loads are proportional to density
    assert published["density_that_gives_published_mean"] == pytest.approx(1600 * 0.75)
    assert published["ours_std_at_that_density"] == pytest.approx(3.0 * 0.75)
    (text,) = [s for s in document["statements"] if "published parameters" in s]
    assert "is not reproduced: 18 kPa, published 13.5 kPa" in text
    assert "A bulk density of 1200 kg/m³ would reproduce it" in text


def test_published_mean_within_one_percent_counts_as_reproduced(column):
    for value, reproduced in ((9.08, True), (9.12, False)):
        experiment = column(published=PUBLISHED | {"vertical_stress_mean": value})
        document = validate(experiment, replicates(), calibration(), ROWS)
        assert document["published"]["mean_reproduced"] is reproduced


def test_statements_carry_the_calibrations_messages_and_negative_s(column):
    document = validate(column(), replicates(), calibration(messages=["out of reach"]), ROWS)
    assert document["statements"] == [
        "out of reach",
        "25.0% of the cells have a negative s and spread outwards.",
    ]


def test_nothing_measured_is_said(column):
    document = validate(column(), replicates(), calibration(), ())
    assert document["readings"] == []
    assert document["overall"] == {"calibrated": {}}
    assert document["statements"][-1].endswith("nothing is calibrated or validated.")
