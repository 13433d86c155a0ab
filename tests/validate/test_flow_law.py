"""Growth of isolated movement zones: a small ensemble, its errors, and the files made of it."""

import csv
import io
import json
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest

from pipeline.files.atomic import read_json, write_json
from pipeline.validate.flow_law import (
    WIDTHS,
    flow_law_figure,
    flow_law_table,
    jackknife,
    measure_flow_law,
)


@cache
def ensemble():
    """Four replicates at bulkings below and above 0.3: the entries by bulking, and the whole."""
    law = measure_flow_law(bulkings=(0.05, 0.3, 0.6), replicates=4, seed=7)
    return {entry["bulking"]: entry for entry in law["bulkings"]}, law


@cache
def small_law():
    return measure_flow_law(bulkings=(0.3, 1.0), replicates=2, shape=(90, 41, 41))


@pytest.mark.parametrize("bulking", [0.3, 0.6])
@pytest.mark.parametrize("width", WIDTHS)
def test_width_grows_with_about_the_square_root_of_the_height(bulking, width):
    """Exponent within 0.45 to 0.60, allowing two of its standard errors; seed fixed."""
    entry = ensemble()[0][bulking]
    exponent = entry["fitted"]["exponents"][width]
    assert entry["fitted"]["height"][0] < 75
    assert entry["fitted"]["height"][1] > 150
    assert 0 < exponent["standard_error"] < 0.05, exponent
    assert exponent["within_0.45_0.60_by_two_standard_errors"], exponent


@pytest.mark.parametrize("bulking", [0.3, 0.6])
def test_drawn_volume_is_bulking_times_loosened_volume(bulking):
    """Within 3 % before breakthrough; parked voids alone, without hang-ups, within two errors."""
    fitted = ensemble()[0][bulking]["fitted"]
    ratio, parked = (fitted[f"{what}_over_loosened_over_bulking"] for what in ("drawn", "parked"))
    assert ratio["within_3_percent"], ratio
    assert abs(ratio["value"] - 1) < 0.03
    assert ratio["value"] - parked["value"] == pytest.approx(
        fitted["hang_ups_per_drawn_cell"] * ratio["value"], abs=1e-12
    )


def test_low_bulking_makes_filaments_rather_than_a_zone():
    low, *zones = (ensemble()[0][bulking]["fitted"] for bulking in (0.05, 0.3, 0.6))
    assert low["filaments"]
    assert not any(zone["filaments"] for zone in zones)
    exponents = [fit["exponents"]["diameter"]["value"] for fit in (low, *zones)]
    assert exponents[0] > 1.0 > max(exponents[1:])


def test_readings_end_before_the_zone_reaches_the_top_or_a_side():
    entries, law = ensemble()
    for entry in entries.values():
        assert entry["ended_by"] == "top"
        assert set(entry["readings"]) == set(law["quantities"])
        assert max(entry["readings"]["height"]) < law["ensemble"]["lattice_cells"]["z"]
        assert (np.diff(entry["readings"]["height"]) >= 0).all()
        assert (np.diff(entry["readings"]["drawn"]) > 0).all()
    narrow = measure_flow_law(bulkings=(0.3,), replicates=2, shape=(90, 41, 15))["bulkings"][0]
    assert narrow["ended_by"] == "side"
    assert max(narrow["readings"]["extent"]) < 15


def test_a_bulking_that_empties_the_drawpoint_has_no_exponent():
    entry = small_law()["bulkings"][1]
    assert entry["ended_by"] == "empty drawpoint"
    assert entry["fitted"] is None


def test_the_same_seed_gives_the_same_files():
    again = measure_flow_law(bulkings=(0.3, 1.0), replicates=2, shape=(90, 41, 41))
    assert again == small_law()
    assert flow_law_figure(again) == flow_law_figure(small_law())
    assert flow_law_table(again) == flow_law_table(small_law())


def test_another_bulking_changes_no_numbers():
    alone = measure_flow_law(bulkings=(1.0,), replicates=2, shape=(90, 41, 41))
    assert alone["bulkings"] == small_law()["bulkings"][1:]


def test_the_law_is_json_and_names_its_ensemble(tmp_path):
    _, law = ensemble()
    write_json(tmp_path / "flow_law.json", law)
    read = read_json(tmp_path / "flow_law.json")
    assert read == json.loads(json.dumps(law))
    assert read["ensemble"] == {
        "flow_exponent": 3.0,
        "replicates": 4,
        "seed": 7,
        "lattice_cells": {"z": 200, "y": 81, "x": 81},
        "opening_cells": {"y": 3, "x": 3},
    }
    for entry in read["bulkings"]:
        assert len({len(values) for values in entry["readings"].values()}) == 1
        for exponent in entry["fitted"]["exponents"].values():
            assert exponent["within_0.45_0.60"] is (0.45 <= exponent["value"] <= 0.60)


def test_the_table_has_every_number_of_the_figure():
    entries, law = ensemble()
    rows = list(csv.DictReader(io.StringIO(flow_law_table(law))))
    exponents = {
        (row["series"], float(row["x"])): float(row["y"])
        for row in rows
        if row["panel"].startswith("Exponent")
    }
    for bulking, entry in entries.items():
        for width, name in WIDTHS.items():
            value = entry["fitted"]["exponents"][width]["value"]
            assert exponents[name, bulking] == pytest.approx(value, rel=1e-9)
            growth = [
                float(row["y"])
                for row in rows
                if name in row["panel"] and row["series"] == f"bulking {bulking:g}"
            ]
            np.testing.assert_allclose(growth, entry["readings"][width], rtol=1e-9)


def test_the_figure_names_its_axes_its_band_and_its_ensemble():
    svg = ElementTree.fromstring(flow_law_figure(ensemble()[1]))
    text = " ".join(svg.itertext())
    for words in (
        "4 replicates",
        "n = 3",
        "200 × 81 × 81 cells",
        "zone height (cells)",
        "largest x extent (cells)",
        "equal-area diameter (cells)",
        "0.45 to 0.60",
        "1 ± 3 %",
        "no zone",
    ):
        assert words in text


def test_jackknife_of_a_mean_is_its_standard_error():
    samples = np.array([1.0, 2.0, 4.0, 9.0])
    estimate = jackknife(float, samples)
    assert estimate["value"] == 4.0
    assert estimate["standard_error"] == pytest.approx(samples.std(ddof=1) / 2)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"replicates": 1}, "standard error"),
        ({"bulkings": (0.0,)}, "above 0"),
        ({"bulkings": (0.3, 1.2)}, "at most 1"),
    ],
)
def test_what_cannot_be_measured_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        measure_flow_law(**wrong)
