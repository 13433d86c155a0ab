"""Regions: what each cell is, which region wins, and what is refused."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.messages import ConfigError
from pipeline.effects import as_filled
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.streams import PACKING, random_stream
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

CU, NONE = {"Cu": {"value": 0.9, "unit": "%"}}, {"Cu": {"value": 0, "unit": "%"}}
WHOLE = {"z": [0, 1.0]}


def test_without_regions_no_variable_and_no_bit_changes(column):
    """The formulas of an experiment of one material, as they stood before there were regions."""
    experiment = column(geometry={"height": 0.95}, material={"particle_size": [4e-3, 14e-3]})
    model = build_block_model(experiment)
    assert list(model.data_vars) == ["state", "zone", "bulk_density", "d50", "cell_id"]
    expected = np.full((10, 4, 5), np.float32(1600))
    expected[-1] = 1600 * experiment_top(experiment)
    assert model["bulk_density"].dtype == model["d50"].dtype == np.float32
    np.testing.assert_array_equal(model["bulk_density"], expected)
    np.testing.assert_array_equal(model["d50"], np.float32(0.5 * (4e-3 + 14e-3)))
    assert "regions" not in experiment.model_dump(mode="json", by_alias=True)


def experiment_top(experiment):
    from pipeline.lattice.block_model import lattice_of

    return lattice_of(experiment).top_fraction


def test_a_region_of_the_same_material_changes_no_bit_of_a_run(drawn):
    plain = drawn()
    region = {"name": "all", "box": {"x": [0, 0.6]}, "bulk_density": 1600}
    runs = []
    for experiment in (plain, drawn(regions=[region])):
        setup = make_setup(experiment, build_block_model(experiment))
        streams = (random_stream(1, "a", purpose, 0) for purpose in (PACKING, 1))
        runs.append(simulate(setup, declared_parameters(experiment), *streams))
    for name, value in vars(runs[0]).items():
        np.testing.assert_array_equal(value, getattr(runs[1], name), err_msg=name)


def test_later_regions_override_earlier_ones_and_the_rest_keeps_the_material(column):
    model = build_block_model(
        column(
            material={"particle_size": [0.01, 0.03]},
            regions=[
                {"name": "low", "box": {"z": [0, 0.5]}, "bulk_density": 2000},
                {
                    "name": "core",
                    "box": {"x": [0.1, 0.3], "z": [0.4, 0.6]},
                    "particle_size": [0.02, 0.06],
                },
            ],
        )
    )
    region = model["region"].values
    assert model["region"].attrs["flag_meanings"] == "no_region low core"
    expected = np.zeros((10, 4, 5), np.int8)
    expected[:5] = 1
    expected[4:6, :, 1:3] = 2
    np.testing.assert_array_equal(region, expected)
    # what a region does not say is the material's, not that of a region below it
    np.testing.assert_array_equal(model["bulk_density"], np.where(region == 1, 2000, 1600))
    np.testing.assert_allclose(model["d50"], np.where(region == 2, 0.04, 0.02))


@given(cut=st.floats(0.06, 0.44), shift=st.sampled_from([0.0, 0.05, 0.1]))
def test_two_boxes_that_meet_share_out_every_cell(column, cut, shift):
    """Wherever they meet, on a cell's center too."""
    width = 0.5 + shift  # 0.55 m becomes six cells: the last center lies at the width's end
    cut = round(cut, 2)
    experiment = column(
        geometry={"width": width},
        regions=[
            {"name": "west", "box": {"x": [0, cut]}, "grade": CU},
            {"name": "east", "box": {"x": [cut, width]}, "grade": NONE},
        ],
    )
    region = build_block_model(experiment)["region"]
    assert set(np.unique(region)) == {1, 2}
    west = (region == 1).isel(y=0, z=0).values
    np.testing.assert_array_equal(west, region["x"].values < cut - 1e-10)


def test_weight_and_stress_follow_the_density(column):
    heavy = column(regions=[{"name": "top", "box": {"z": [0.5, 1.0]}, "bulk_density": 2400}])
    loads = []
    for experiment in (column(), heavy):
        setup = make_setup(experiment, build_block_model(experiment), dtype=np.float64)
        parameters = declared_parameters(experiment).with_values({"E": 1.0})
        stream = random_stream(1, "a", PACKING, 0)
        loads.append(simulate(setup, parameters, stream).base_vertical_stress[-1])
    assert loads[0] == pytest.approx(1600 * 9.81 * 1.0 / 1e3, rel=1e-6)
    assert loads[1] == pytest.approx(2000 * 9.81 * 1.0 / 1e3, rel=1e-6)


def test_regions_end_where_the_ground_does(column):
    model = build_block_model(
        column(
            geometry={"mask": {"type": "cylinder"}},
            regions=[{"name": "all", "box": {"z": [0, 1.0]}, "grade": CU}],
        )
    )
    outside = model["state"].values == 2
    assert outside.any()
    assert (model["region"].values == np.where(outside, -1, 1)).all()
    assert (np.isnan(model["grade_Cu"].values) == outside).all()
    assert (model["bulk_density"].values[outside] == 0).all()


def test_the_file_names_regions_units_and_what_is_missing(column, tmp_path):
    experiment = column(
        regions=[
            {"name": "ore", "box": WHOLE, "grade": {"Au": {"value": 1.5, "unit": "g/t"}}},
            {"name": "cap", "box": {"z": [0.8, 1.0]}, "waste": True},
        ]
    )
    model = build_block_model(experiment)
    write_dataset(tmp_path / "a.nc", model, experiment, "block_model", "Block model")
    found = read_dataset(tmp_path / "a.nc")
    assert found["grade_Au"].attrs["units"] == "g/t"
    assert found["grade_Au"].attrs["long_name"] == "grade Au of the cell"
    assert found["region"].attrs["flag_meanings"] == "no_region ore cap"
    np.testing.assert_array_equal(found["region"].attrs["flag_values"], [0, 1, 2])
    grade = found["grade_Au"].values
    assert (grade[:8] == 1.5).all()
    assert (grade[8:] == 0.0).all()  # waste that says nothing of its grade


def test_a_bed_filled_higher_than_declared_stretches_its_boxes(column):
    experiment = column(
        effects={"fill_height_misdeclared": {"factor": 1.2}},
        regions=[
            {"name": "low", "box": {"z": [0, 0.5]}, "grade": CU},
            {"name": "high", "box": {"z": [0.5, 1.0]}, "grade": NONE},
        ],
    )
    region = build_block_model(as_filled(experiment))["region"].values
    assert region.shape == (12, 4, 5)
    np.testing.assert_array_equal(region[:, 0, 0], [1] * 6 + [2] * 6)
    assert experiment.regions[0].box.z == (0, 0.5)


# ---------------------------------------------------------------------------------------------
# files

NAMES = {"flag_values": np.array([0, 1, 2], np.int8), "flag_meanings": "sediment ore_zone breccia"}


@pytest.fixture
def blocks(tmp_path):
    """Columns of an imported block model: rock by level, its number, and a grade."""
    rock = np.repeat(np.array([1, 2, 1, 2, 1, 0, 0, 0, 0, 0], np.int8), 20).reshape(10, 4, 5)
    grade = np.where(rock > 0, 0.1 * np.arange(200).reshape(10, 4, 5) / 200, np.nan)
    xr.Dataset(
        {
            "rock": (("z", "y", "x"), rock, NAMES),
            "code": (("z", "y", "x"), rock * 10.0),
            "CU": (("z", "y", "x"), grade),
        }
    ).to_netcdf(tmp_path / "blocks.nc")
    return tmp_path, rock, grade


def by_column(name="rock", values=("ore zone",), **more):
    return {"name": "ore", "column": {"path": "blocks.nc", "name": name, "values": values}} | more


@pytest.mark.parametrize(
    ("name", "values", "codes"),
    [
        ("rock", ["ore zone"], [1]),
        ("rock", ["ore_zone", "breccia"], [1, 2]),
        ("code", [10, 20.0], [1, 2]),
    ],
)
def test_a_region_is_where_a_column_has_its_values(column, blocks, name, values, codes):
    path, rock, _ = blocks
    region = build_block_model(column(path=path, regions=[by_column(name, values)]))["region"]
    np.testing.assert_array_equal(region == 1, np.isin(rock, codes))


def test_a_grade_can_be_a_column_too(column, blocks):
    path, rock, grade = blocks
    ore = by_column(values=["ore zone", "breccia"], grade={"Cu": {"column": "CU", "unit": "%"}})
    rest = {"name": "rest", "box": WHOLE, "waste": True}
    found = build_block_model(column(path=path, regions=[rest, ore]))["grade_Cu"].values
    np.testing.assert_array_equal(found, np.where(rock > 0, grade, 0.0))


def test_a_mask_is_taken_cell_by_cell_by_the_regions_name(column, blocks):
    path, rock, _ = blocks
    region = {"name": "rock", "mask": "blocks.nc"}
    named = {"name": "ore", "mask": {"path": "blocks.nc", "variable": "rock"}}
    for one in (region, named):
        found = build_block_model(column(path=path, regions=[one]))["region"].values
        np.testing.assert_array_equal(found == 1, rock != 0)


REFUSED = {
    "mask_variable_unknown": (
        [{"name": "ore", "mask": "blocks.nc"}],
        r"regions\[0\]\.mask\.variable = ore: .*blocks\.nc has only: rock, code, CU",
    ),
    "column_unknown": ([by_column("rok")], r"column\.name = rok: .*; did you mean rock\?"),
    "value_unknown": (
        [by_column(values=["oxide"])],
        r"regions\[0\]\.column\.values: column rock has no value oxide; its values are sediment",
    ),
    "value_is_no_number": (
        [by_column("code", ["oxide"])],
        r"column code has no value oxide; its values are 0, 10, 20",
    ),
    "grade_column_unknown": (
        [by_column(grade={"Cu": {"column": "CUT", "unit": "%"}})],
        r"regions\[0\]\.grade\.Cu\.column = CUT: .*has only",
    ),
    "grade_column_is_text": (
        [by_column(grade={"Cu": {"column": "rock", "unit": "%"}})],
        r"grade\.Cu\.column = rock: expected a column of numbers, 0 or more",
    ),
    "grade_with_gaps": (
        [by_column(values=["sediment"], grade={"Cu": {"column": "CU", "unit": "%"}})],
        r"regions\[0\]\.grade\.Cu: 100 of its cells have no value in column CU",
    ),
    "ground_without_grade": (
        [{"name": "ore", "box": {"z": [0, 0.5]}, "grade": CU}],
        r"regions: 100 ground cells lie in no region, so that their grade Cu is not known; begin",
    ),
    "no_cell": (
        [{"name": "thin", "box": {"z": [0.31, 0.34]}}],
        r"regions\[0\]: thin holds no cell",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_the_lattice_is_refused(column, blocks, assert_in_house_style, case):
    regions, expected = REFUSED[case]
    with pytest.raises(ConfigError, match=expected) as caught:
        build_block_model(column(path=blocks[0], regions=regions))
    assert len(caught.value.problems) == 1
    assert_in_house_style(str(caught.value))


def test_a_mask_of_another_shape_is_refused_with_both(column, tmp_path):
    xr.Dataset({"ore": (("z", "y", "x"), np.ones((9, 4, 5)))}).to_netcdf(tmp_path / "ore.nc")
    with pytest.raises(ConfigError) as caught:
        build_block_model(column(path=tmp_path, regions=[{"name": "ore", "mask": "ore.nc"}]))
    expected = "regions[0].mask.variable = ore: its dims are {'z': 9, 'y': 4, 'x': 5}; the lattice"
    assert expected in str(caught.value)
