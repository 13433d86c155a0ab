"""The lattice's rounding, partial top level and masks."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.messages import ConfigError
from pipeline.lattice.block_model import build_block_model, cell_codes, ground_mask, lattice_of
from pipeline.lattice.cells import OUTSIDE, STAGNANT
from pipeline.lattice.grid import make_lattice
from pipeline.simulate.setup import make_setup


@pytest.mark.parametrize(
    ("extent", "cells"),
    [
        (0.23, 12),
        (0.25, 13),
        (0.35, 18),
        (0.54, 27),
        (0.229, 11),
        (0.231, 12),
        (0.3, 15),
        (0.01, 1),
    ],
)
def test_lengths_are_rounded_half_up_to_whole_cells(extent, cells):
    lattice = make_lattice(extent, extent, 0.1, 0.02)
    assert (lattice.nx, lattice.ny) == (cells, cells)


@given(st.integers(1, 400), st.sampled_from([0.1, 0.02, 0.0025, 0.3, 7.0]))
def test_whole_multiples_of_the_cell_are_not_rounded_and_not_mentioned(cells, cell_size):
    extent = float(f"{cells * cell_size:.12g}")
    lattice = make_lattice(extent, extent, extent, cell_size)
    assert lattice.shape == (cells, cells, cells)
    assert lattice.top_fraction == 1.0
    assert lattice.notes == ()


def test_test_3_has_52_500_cells_and_says_what_was_rounded(published):
    experiment = published("castro_2020")
    model = build_block_model(experiment)
    assert model["state"].size == 52_500
    assert model.attrs["lattice_notes"] == (
        "length 0.23 m is 11.5 cells of 0.02 m: the lattice has 12 (0.24 m); wall areas keep 0.23 m"
    )
    assert experiment.geometry.hydraulic_radius == pytest.approx(0.70 * 0.23 / (2 * 0.93))


def test_height_between_levels_is_noted_and_every_rounded_length_named(column):
    notes = lattice_of(column(geometry={"width": 0.52, "height": 0.97})).notes
    assert len(notes) == 2
    assert notes[0].startswith("width 0.52 m is 5.2 cells of 0.1 m: the lattice has 5 (0.5 m)")
    assert notes[1] == (
        "height 0.97 m is 9.7 cells of 0.1 m: the top level, number 10, carries 0.7 of its density"
    )


@given(height=st.floats(0.1, 2.0))
def test_weight_of_a_partial_top_level_is_exact(column, height):
    experiment = column(geometry={"height": height})
    setup = make_setup(experiment, build_block_model(experiment), dtype=np.float64)
    assert setup.cell_weight.sum() == pytest.approx(1600 * 9.81 * 0.5 * 0.4 * height, rel=2e-7)


def test_block_model_holds_state_density_size_and_identity(column):
    experiment = column(geometry={"height": 0.95}, material={"particle_size": [4e-3, 14e-3]})
    model = build_block_model(experiment)
    assert dict(model.sizes) == {"z": 10, "y": 4, "x": 5}
    assert (model["state"] == 1).all()
    assert (model["zone"] == 0).all()
    assert (model["bulk_density"][:9] == 1600).all()
    assert (model["bulk_density"][9] == 800).all()
    assert (model["d50"] == np.float32(9e-3)).all()
    np.testing.assert_array_equal(model["cell_id"].values.ravel(), np.arange(200))
    np.testing.assert_allclose(model["z"], np.arange(10) * 0.1 + 0.05)
    assert (cell_codes(model) == STAGNANT).all()


def test_cylinder_mask_keeps_cells_whose_center_is_inside(column):
    experiment = column(
        geometry={"width": 0.5, "length": 0.5, "mask": {"type": "cylinder", "diameter": 0.4}}
    )
    mask = ground_mask(experiment, lattice_of(experiment))
    expected = [
        [0, 0, 1, 0, 0],
        [0, 1, 1, 1, 0],
        [1, 1, 1, 1, 1],
        [0, 1, 1, 1, 0],
        [0, 0, 1, 0, 0],
    ]
    np.testing.assert_array_equal(mask, np.broadcast_to(expected, (10, 5, 5)))
    assert experiment.geometry.hydraulic_radius == pytest.approx(0.1)
    model = build_block_model(experiment)
    assert (model["bulk_density"].values[~mask] == 0).all()
    assert (model["cell_id"].values[~mask] == -1).all()
    assert (cell_codes(model)[~mask] == OUTSIDE).all()


def test_cylinder_without_diameter_fills_the_smaller_side(column):
    experiment = column(
        geometry={
            "width": 5.0,
            "length": 4.0,
            "cell_size": 0.05,
            "height": 0.05,
            "mask": {"type": "cylinder"},
        },
    )
    area = ground_mask(experiment, lattice_of(experiment)).sum() * 0.05**2
    assert area == pytest.approx(np.pi * 2.0**2, rel=5e-3)


def test_drawbells_open_upwards_from_the_drawpoint(drawn):
    experiment = drawn(
        geometry={
            "width": 0.5,
            "length": 0.5,
            "height": 0.5,
            "cell_size": 0.1,
            "mask": {"type": "drawbells", "height": 0.2, "wall_angle": 45},
        },
        drawpoints=[{"name": "west", "x": 0.25, "y": 0.25, "width": 0.1, "length": 0.1}],
        load_cells=[],
    )
    mask = ground_mask(experiment, lattice_of(experiment))
    # half widths 0.05 + z at z = 0.05 and 0.15 m reach the centers 0.1 and 0.2 m away
    np.testing.assert_array_equal(mask[0, 2], [0, 1, 1, 1, 0])
    np.testing.assert_array_equal(mask[0, :, 2], [0, 1, 1, 1, 0])
    assert mask[0].sum() == 9
    assert mask[1:].all()


def _write_mask(path, dims, shape, name="ground"):
    values = np.ones(shape, np.int8)
    values[0] = 0
    xr.Dataset({name: (dims, values)}).to_netcdf(path)


def test_mask_file_is_taken_cell_by_cell(column, tmp_path):
    _write_mask(tmp_path / "pit.nc", ("z", "y", "x"), (10, 4, 5))
    experiment = column(path=tmp_path, geometry={"mask": {"type": "file", "path": "pit.nc"}})
    mask = ground_mask(experiment, lattice_of(experiment))
    assert not mask[0].any()
    assert mask[1:].all()


@pytest.mark.parametrize(
    ("dims", "shape", "found"),
    [
        (("x", "y", "z"), (5, 4, 10), "{'x': 5, 'y': 4, 'z': 10}"),
        (("z", "y", "x"), (9, 4, 5), "{'z': 9, 'y': 4, 'x': 5}"),
    ],
)
def test_mask_file_of_other_dims_is_refused_with_both_shapes(column, tmp_path, dims, shape, found):
    _write_mask(tmp_path / "pit.nc", dims, shape)
    experiment = column(path=tmp_path, geometry={"mask": {"type": "file", "path": "pit.nc"}})
    with pytest.raises(ConfigError) as caught:
        build_block_model(experiment)
    text = str(caught.value)
    assert "column.yaml" in text
    assert "geometry.mask.variable = ground" in text
    assert f"its dims are {found}; the lattice is (z, y, x) = (10, 4, 5)" in text


def test_mask_file_without_the_variable_is_refused_with_what_it_has(column, tmp_path):
    _write_mask(tmp_path / "pit.nc", ("z", "y", "x"), (10, 4, 5), name="rock")
    experiment = column(path=tmp_path, geometry={"mask": {"type": "file", "path": "pit.nc"}})
    with pytest.raises(ConfigError, match=r"variable = ground.*has only: rock"):
        build_block_model(experiment)


def test_mask_without_ground_is_refused(column, tmp_path):
    xr.Dataset({"ground": (("z", "y", "x"), np.zeros((10, 4, 5)))}).to_netcdf(tmp_path / "pit.nc")
    experiment = column(path=tmp_path, geometry={"mask": {"type": "file", "path": "pit.nc"}})
    with pytest.raises(ConfigError, match=r"geometry\.mask: it leaves no ground cell"):
        build_block_model(experiment)


def test_a_mask_file_that_is_no_netcdf_is_refused(column, tmp_path):
    (tmp_path / "pit.nc").write_text("not netCDF")
    experiment = column(path=tmp_path, geometry={"mask": {"type": "file", "path": "pit.nc"}})
    expected = r"geometry\.mask\.path: .*pit\.nc is not readable as netCDF"
    with pytest.raises(ConfigError, match=expected):
        build_block_model(experiment)


def test_load_cell_off_the_grid_averages_by_covered_area(column):
    cells = [{"name": "a", "x": 0.13, "y": 0.2, "width": 0.1, "length": 0.2}]
    experiment = column(load_cells=cells)
    footprint = make_setup(experiment, build_block_model(experiment)).footprints[0]
    # 0.08 to 0.18 m covers 0.02 m of the first cell along x and 0.08 m of the second
    expected = np.zeros((4, 5))
    expected[1:3, 0], expected[1:3, 1] = 0.1, 0.4
    np.testing.assert_allclose(footprint, expected, atol=1e-12)
