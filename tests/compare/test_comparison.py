"""The numbers of a comparison, against values worked out by hand."""

import csv
from io import StringIO

import numpy as np
import pytest
import xarray as xr

from pipeline.compare.comparison import (
    LOAD_CELL_COLUMNS,
    READING_COLUMNS,
    compare,
    load_cell_rows,
    reading_rows,
    share_of_time_above,
)
from pipeline.config.comparison import Comparison
from pipeline.files.tables import as_csv

MASS = [0.0, 10.0, 40.0]  # kg: the second interval is three quarters of the time


def replicates(stress) -> xr.Dataset:
    """`replicates.nc` of stresses (replicate, time, load_cell) in kPa; their mean is the base's."""
    stress = np.array(stress, dtype=float)
    return xr.Dataset(
        {
            "vertical_stress": (("replicate", "time", "load_cell"), stress),
            "base_vertical_stress": (("replicate", "time"), stress.mean(axis=2)),
            "mass_drawn": ("time", MASS),
        }
    )


@pytest.fixture
def document(drawn):
    """Two replicates of each; load cells `beside` and `above`."""
    first = replicates([[[400, 300], [500, 100], [100, 100]], [[600, 300], [500, 100], [300, 100]]])
    second = replicates(
        [[[500, 300], [300, 200], [200, 100]], [[500, 300], [300, 200], [200, 100]]]
    )
    comparison = Comparison(experiments=("one", "two"), threshold_mpa=0.4)
    return compare(comparison, [drawn("one"), drawn("two", assumed=["flow"])], [first, second])


def test_share_of_time_counts_the_part_of_each_interval_above():
    mass = np.array(MASS)
    stress = np.array([[2.0, 0.0, 2.0, 1.0, 3.0], [0.0, 2.0, 2.0, 1.0, 2.0], [0.0, 0.0, 2.0, 1, 0]])
    # down through 1 in the middle of the first quarter; up and down; always; never above; 1/4 + 3/8
    expected = [0.125, 0.125 + 0.375, 1.0, 0.0, 0.25 + 0.375]
    np.testing.assert_allclose(share_of_time_above(stress, mass, 1.0), expected)


def test_share_of_time_of_a_stress_that_is_not_known_is_not_known():
    stress = np.array([[np.nan, 2.0], [1.0, 2.0], [1.0, 2.0]])
    found = share_of_time_above(stress, np.array(MASS), 1.0)
    assert np.isnan(found[0])
    assert found[1] == 1.0


def test_means_percentiles_peaks_and_when(document):
    beside, above = document["load_cells"]
    assert (beside["load_cell"], beside["x_m"], beside["width_m"]) == ("beside", 0.1, 0.1)
    first = beside["first"]
    np.testing.assert_allclose(first["mean_mpa"], [0.5, 0.5, 0.2])
    np.testing.assert_allclose(first["p10_mpa"], [0.42, 0.5, 0.12])  # a tenth of the way up
    np.testing.assert_allclose(first["p50_mpa"], first["mean_mpa"])
    np.testing.assert_allclose(first["p90_mpa"], [0.58, 0.5, 0.28])
    assert first["peak_mpa"] == pytest.approx(0.5)
    assert first["peak_at_mass_drawn_kg"] == 0.0  # the first of two that are the same
    assert (first["peak_p10_mpa"], first["peak_p90_mpa"]) == pytest.approx((0.42, 0.58))
    assert above["second"]["peak_mpa"] == pytest.approx(0.3)


def test_shares_of_time_are_means_over_replicates(document):
    first = document["load_cells"][0]["first"]
    # replicate 1: all of the first quarter, then 100 of 400 kPa; replicate 2: then 100 of 200
    shares = [0.25 * 1.0 + 0.75 * 0.25, 0.25 + 0.75 * 0.5]
    assert first["share_above"] == pytest.approx(np.mean(shares))
    assert first["share_above_p10"] == pytest.approx(shares[0] + 0.1 * (shares[1] - shares[0]))
    assert document["load_cells"][1]["first"]["share_above"] == 0.0


def test_differences_are_second_less_first_with_the_standard_error_of_both(document):
    beside = document["load_cells"][0]
    np.testing.assert_allclose(beside["difference_mpa"], [0.0, -0.2, 0.0], atol=1e-15)
    # sd of 400 and 600 is 141.4 kPa, over the root of 2 replicates; the second has no scatter
    np.testing.assert_allclose(beside["difference_se_mpa"], [0.1, 0.0, 0.1], atol=1e-12)
    assert beside["largest_difference_mpa"] == pytest.approx(-0.2)
    assert beside["largest_difference_at_mass_drawn_kg"] == 10.0
    base = document["base"]
    np.testing.assert_allclose(base["first"]["mean_mpa"], [0.4, 0.3, 0.15])


def test_what_is_said_of_the_experiments(document):
    one, two = document["experiments"]
    assert (one["experiment"], one["label"], one["replicates"]) == ("one", "simulated", 2)
    assert two["assumed"] == ["flow"]
    assert one["has_data"] is False
    assert one["drawpoints"][0]["name"] == "west"


def test_the_tables_hold_the_same_numbers(document):
    readings = list(csv.DictReader(StringIO(as_csv(READING_COLUMNS, reading_rows(document)))))
    assert len(readings) == 3 * 3
    row = readings[3 + 1]
    assert (row["load_cell"], row["mass_drawn_kg"], row["second_experiment"]) == (
        "beside",
        "10",
        "two",
    )
    assert float(row["first_mean_mpa"]) == 0.5
    assert float(row["difference_mpa"]) == pytest.approx(-0.2)
    assert float(row["difference_kpa"]) == pytest.approx(-200.0)
    cells = list(csv.DictReader(StringIO(as_csv(LOAD_CELL_COLUMNS, load_cell_rows(document)))))
    assert [row["load_cell"] for row in cells] == ["", "beside", "above"]
    assert float(cells[1]["share_above_difference"]) == pytest.approx(
        document["load_cells"][0]["second"]["share_above"]
        - document["load_cells"][0]["first"]["share_above"]
    )


def test_a_load_cell_without_ground_is_left_empty(drawn):
    stress = [[[np.nan, 300], [np.nan, 100], [np.nan, 100]]] * 2
    comparison = Comparison(experiments=("one", "two"), threshold_mpa=0.2)
    found = compare(comparison, [drawn("one"), drawn("two")], [replicates(stress)] * 2)
    row = list(load_cell_rows(found))[1]
    text = as_csv(LOAD_CELL_COLUMNS, [row])
    assert dict(next(csv.DictReader(StringIO(text))))["first_peak_mpa"] == ""
