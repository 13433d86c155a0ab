"""Grade and dilution curves: mass balances, grade is linear, dilution is a share."""

import csv

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.files.grade_table import write_grade_table
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.grade import ALL, BINS, drawn_in_bins, grade_curves, scheduled_masses
from pipeline.montecarlo.replicates import run_experiment
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

CELLS, POINTS = 40, 3
POINT = [
    {"name": "west", "x": 0.2, "y": 0.25, "width": 0.1, "length": 0.1},
    {"name": "east", "x": 0.45, "y": 0.25, "width": 0.1, "length": 0.1},
]
REGIONS = [
    {"name": "low", "box": {"z": [0, 0.3]}, "grade": {"Cu": {"value": 0.7, "unit": "%"},
                                                     "Au": {"value": 0.2, "unit": "g/t"}}},
    {"name": "high", "box": {"z": [0.3, 0.6]}, "bulk_density": 2000,
     "grade": {"Cu": {"value": 1.4, "unit": "%"}, "Au": {"value": 0.1, "unit": "g/t"}}},
    {"name": "cap", "box": {"z": [0.6, 0.8]}, "bulk_density": 1300, "waste": True},
]  # fmt: skip


# ---------------------------------------------------------------------------------------------
# of any record


@st.composite
def records(draw):
    """Any extraction record of three replicates, padded, and a schedule that it may miss."""
    lengths = draw(st.lists(st.integers(0, CELLS), min_size=3, max_size=3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width = max(max(lengths), 1)
    after, point, cell = np.full((3, width), -1.0), np.full((3, width), -1), np.full((3, width), -1)
    for row, length in enumerate(lengths):
        after[row, :length] = np.cumsum(rng.uniform(0.1, 5.0, length))
        point[row, :length] = rng.integers(0, POINTS, length)
        cell[row, :length] = rng.permutation(CELLS)[:length]
    dims = ("replicate", "extraction")
    record = {"drawn_mass": after, "drawn_drawpoint": point, "drawn_cell": cell}
    scheduled = rng.uniform(0.0, 60.0, POINTS) * draw(st.sampled_from([0.0, 0.1, 1.0]))
    return xr.Dataset({k: (dims, v) for k, v in record.items()}), scheduled


grades = hnp.arrays(np.float64, CELLS, elements=st.floats(0, 100))


def mass_of_each(record):
    after = record["drawn_mass"].values
    return np.where(after >= 0, np.diff(after, axis=1, prepend=0.0), 0.0)


@given(records(), grades)
def test_drawpoints_together_give_the_content_of_the_drawn_cells(given_record, grade):
    record, scheduled = given_record
    drawn = drawn_in_bins(record, scheduled, {"a": grade})
    cell, mass = record["drawn_cell"].values, mass_of_each(record)
    content = np.where(cell >= 0, mass * grade[cell], 0.0).sum(axis=1)
    for places in (drawn.content["a"][:, :-1], drawn.content["a"][:, -1:]):
        np.testing.assert_allclose(places.sum(axis=(1, 2)), content, rtol=1e-12, atol=1e-12)
    for places in (drawn.mass[:, :-1], drawn.mass[:, -1:]):
        np.testing.assert_allclose(places.sum(axis=(1, 2)), mass.sum(axis=1), rtol=1e-12)


@given(records(), st.floats(0.01, 100))
def test_one_grade_everywhere_gives_a_flat_curve(given_record, grade):
    drawn = drawn_in_bins(*given_record, {"a": np.full(CELLS, grade)})
    np.testing.assert_allclose(drawn.content["a"], grade * drawn.mass, rtol=1e-9, atol=1e-10)


@given(records(), grades, grades, st.floats(-3, 3))
def test_content_is_linear_in_the_cells_grades(given_record, first, second, factor):
    together = first + factor * second
    drawn = drawn_in_bins(*given_record, {"a": first, "b": second, "c": together})
    expected = drawn.content["a"] + factor * drawn.content["b"]
    np.testing.assert_allclose(drawn.content["c"], expected, rtol=1e-9, atol=1e-8)


@given(records(), hnp.arrays(np.bool_, CELLS))
def test_waste_is_a_share_of_what_is_drawn(given_record, waste):
    cells = {"some": waste * 1.0, "all": np.ones(CELLS), "none": np.zeros(CELLS)}
    drawn = drawn_in_bins(*given_record, cells)
    assert (drawn.content["some"] >= -1e-12).all()
    assert (drawn.content["some"] <= drawn.mass + 1e-12).all()
    np.testing.assert_array_equal(drawn.content["all"], drawn.mass)
    assert (drawn.content["none"] == 0).all()


def test_a_cell_across_the_end_of_a_bin_is_divided_there():
    """Cells of 1, 3 and 4 kg in bins of 2 kg, by hand."""
    dims = ("replicate", "extraction")
    record = xr.Dataset(
        {
            "drawn_mass": (dims, [[1.0, 4.0, 8.0]]),
            "drawn_drawpoint": (dims, [[0, 0, 0]]),
            "drawn_cell": (dims, [[2, 0, 1]]),
        }
    )
    drawn = drawn_in_bins(record, np.array([6.0]), {"a": np.array([10.0, 20.0, 30.0])}, bins=3)
    np.testing.assert_allclose(drawn.mass[0, 0], [2, 2, 4])  # 2 kg beyond the schedule
    np.testing.assert_allclose(drawn.content["a"][0, 0], [30 + 10, 20, 80])
    np.testing.assert_array_equal(drawn.content["a"][0, 0], drawn.content["a"][0, 1])


# ---------------------------------------------------------------------------------------------
# of a run


@pytest.fixture(scope="module")
def run(drawn, tmp_path_factory):
    """An experiment of three regions: itself, block model, replicates and curves, from files."""
    experiment = drawn(
        regions=REGIONS,
        drawpoints=POINT,
        draw=[
            {"drawpoints": ["west", "east"], "mass": 100.0, "increment": 1.0},
            {"drawpoints": ["east"], "mass": 60.0, "increment": 1.0},
        ],
        load_cells=[],
        readings={"every": 40.0},
        replicates=4,
    )
    model = build_block_model(experiment)
    replicates, _ = run_experiment(make_setup(experiment, model), declared_parameters(experiment),
                                   declared_parameters(experiment))  # fmt: skip
    folder = tmp_path_factory.mktemp("run")
    for name, dataset in (("block_model", model), ("replicates", replicates)):
        write_dataset(folder / f"{name}.nc", dataset, experiment, name, name)
    model, replicates = (
        read_dataset(folder / f"{name}.nc") for name in ("block_model", "replicates")
    )
    curves = grade_curves(experiment, model, replicates)
    write_dataset(folder / "grade.nc", curves, experiment, "grade", "Grade", statistics=True)
    return experiment, model, replicates, read_dataset(folder / "grade.nc"), folder


def test_mass_drawn_weighs_each_cell_by_its_regions_density(run):
    experiment, model, replicates, _, _ = run
    cell = replicates["drawn_cell"].values
    mass = np.diff(replicates["drawn_mass"].values, axis=1, prepend=0.0)
    density = model["bulk_density"].values.ravel()
    known = np.isfinite(cell)
    expected = density[cell[known].astype(int)] * experiment.geometry.cell_size**3
    np.testing.assert_allclose(mass[known], expected, rtol=1e-6)
    assert len(np.unique(expected.round(6))) == 3


def test_each_drawpoints_mean_grade_is_that_of_its_cells(run):
    _, model, replicates, curves, _ = run
    cell, point = (replicates[f"drawn_{n}"].values for n in ("cell", "drawpoint"))
    mass = np.diff(replicates["drawn_mass"].values, axis=1, prepend=0.0)
    grade = model["grade_Cu"].values.ravel()
    waste = (model["region"].values == 3).ravel()
    for place in range(3):
        cu, dilution = [], []
        for row in range(4):
            here = np.isfinite(cell[row]) & ((point[row] == place) | (place == 2))
            came, weight = cell[row, here].astype(int), mass[row, here]
            cu.append((weight * grade[came]).sum() / weight.sum())
            dilution.append((weight * waste[came]).sum() / weight.sum())
        last = {"drawpoint": place, "mass_bin": -1}
        for name, values in (("grade_Cu", cu), ("dilution", dilution)):
            expected = [np.mean(values), *np.percentile(values, [10, 50, 90])]
            found = [
                float(curves[f"cumulative_{name}_{s}"][last]) for s in ("mean", "p10", "p50", "p90")
            ]
            np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_bins_are_labelled_with_drawpoint_and_scheduled_mass(run):
    experiment, _, _, curves, _ = run
    names = [name.decode() for name in curves["drawpoint_name"].values]
    assert names == ["west", "east", ALL]
    np.testing.assert_allclose(scheduled_masses(experiment), [50, 110])
    np.testing.assert_allclose(curves["mass_to"][:, -1], [50, 110, 160])
    np.testing.assert_array_equal(curves["mass_from"][:, 1:], curves["mass_to"][:, :-1])
    assert curves.sizes["mass_bin"] == BINS
    assert curves["drawn_grade_Au_p90"].attrs["units"] == "g/t"
    assert curves["drawn_dilution_mean"].attrs["units"] == "1"
    long_name = (
        "grade Cu of what was drawn until the end of the bin: 10th percentile over replicates"
    )
    assert curves["cumulative_grade_Cu_p10"].attrs["long_name"] == long_name


def test_the_ore_comes_first_and_the_waste_of_the_cap_last(run):
    curves = run[3]
    dilution = curves["drawn_dilution_mean"].values[-1]
    assert dilution[0] == 0.0
    assert dilution[-1] > 0.3
    assert curves["drawn_grade_Cu_mean"].values[-1, 0] == pytest.approx(0.7, rel=1e-12)


def test_the_table_has_a_row_for_each_drawpoint_bin_and_quantity(run):
    experiment, _, _, curves, folder = run
    write_grade_table(curves, experiment.name, folder / "grade.csv")
    with open(folder / "grade.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * BINS * 3
    assert [row["quantity"] for row in rows[:3]] == ["Cu", "Au", "dilution"]
    assert [row["unit"] for row in rows[:3]] == ["%", "g/t", "1"]
    last = rows[-1]
    assert (last["drawpoint"], last["bin"], last["replicates"]) == (ALL, "20", "4")
    expected = float(curves["cumulative_dilution_p90"][-1, -1])
    assert float(last["cumulative_p90"]) == pytest.approx(expected, rel=1e-9)
    assert float(last["mass_to_t"]) == pytest.approx(0.16)


def test_what_no_replicate_has_drawn_is_empty(drawn):
    """A drawpoint that runs empty: its last bins have no grade, and nothing warns of it."""
    experiment = drawn(
        geometry={"width": 0.2, "length": 0.2, "height": 0.2, "cell_size": 0.1},
        regions=[{"name": "all", "box": {"z": [0, 0.2]}, "grade": REGIONS[0]["grade"]}],
        drawpoints=[
            {"name": "west", "x": 0.05, "y": 0.05, "width": 0.1, "length": 0.1},
            {"name": "east", "x": 0.15, "y": 0.15, "width": 0.1, "length": 0.1},
        ],
        draw=[{"drawpoints": ["west"], "mass": 12.0, "increment": 1.0}],
        load_cells=[],
    )
    model = build_block_model(experiment)
    declared = declared_parameters(experiment)
    replicates, _ = run_experiment(make_setup(experiment, model), declared, declared)
    curves = grade_curves(experiment, model, replicates)
    assert (curves["replicates_in_bin"].values[1] == 0).all()
    assert np.isnan(curves["drawn_grade_Cu_mean"].values[1]).all()
    west = curves["drawn_grade_Cu_mean"].values[0]
    np.testing.assert_allclose(west[np.isfinite(west)], 0.7)
