"""Files that open: numbers of our netCDF read by ncdump, CDO and NCO, and of our .vti by VTK."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from specs import MINE_ORIGIN as ORIGIN

from pipeline.files.export import export
from pipeline.files.netcdf import read_dataset

NUMBER = r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?"


def run(*command):
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    return subprocess.run(map(str, command), capture_output=True, text=True, check=True).stdout


# ---------------------------------------------------------------------------------------------
# netCDF


def test_ncdump_reads_the_fields(folder):
    header = run("ncdump", "-h", folder / "fields.nc")
    assert "float vertical_stress_mean(time, z, y, x) ;" in header
    assert ':Conventions = "CF-1.11"' in header
    text = run("ncdump", "-v", "z", folder / "fields.nc").split("data:")[1]
    first = float(re.search(r"z = ([0-9.eE+-]+)", text)[1])
    assert first == pytest.approx(float(read_dataset(folder / "fields.nc")["z"][0]))


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("block_model", "bulk_density"),
        ("replicates", "base_vertical_stress"),
        ("statistics", "base_vertical_stress_p95"),
    ],
)
def test_ncdump_reads_the_last_number_of_every_kind_of_file(folder, file, name):
    text = run("ncdump", "-p", "9,17", "-v", name, folder / f"{file}.nc").split("data:")[1]
    values = re.findall(NUMBER, text.split(f"{name} =")[1].split(";")[0])
    expected = read_dataset(folder / f"{file}.nc")[name].values
    assert len(values) == expected.size
    assert float(values[-1]) == pytest.approx(float(expected.ravel()[-1]), rel=1e-7)


def test_ncdump_reads_where_the_model_stands_in_the_mine(written):
    header = run("ncdump", "-h", written("mine")[1] / "fields.nc")
    for key, value in ORIGIN.items():
        assert float(re.search(rf":origin_{key} = ({NUMBER})", header)[1]) == value
    assert "origin" not in run("ncdump", "-h", written("draw")[1] / "replicates.nc")


def test_cdo_reads_the_fields_with_their_mean(folder):
    fields = read_dataset(folder / "fields.nc")
    text = run("cdo", "-s", "infon", "-selname,vertical_stress_mean", folder / "fields.nc")
    lines = [line.split() for line in text.splitlines() if "vertical_stress_mean" in line]
    assert len(lines) == fields.sizes["time"] * fields.sizes["z"]
    level = fields["vertical_stress_mean"].isel(time=0, z=0)
    # ... Points Missing : Minimum Mean Maximum : Name
    missing, mean = int(lines[0][6]), float(lines[0][9])
    assert missing == int(level.isnull().sum())
    assert mean == pytest.approx(float(level.mean()), rel=1e-4)


def test_cdo_averages_over_the_readings(folder):
    fields = read_dataset(folder / "fields.nc")["vertical_stress_mean"].isel(z=0)
    text = run(
        "cdo", "-s", "outputf,%.6f,1", "-fldmax", "-timmean", "-sellevidx,1",
        "-selname,vertical_stress_mean", folder / "fields.nc",
    )  # fmt: skip
    assert float(text) == pytest.approx(float(fields.mean("time").max()), abs=2e-5)


def test_nco_averages_a_variable(folder, tmp_path):
    for file, name, dims in (
        ("fields", "vertical_stress_mean", "time,z,y,x"),
        ("replicates", "vertical_stress", "replicate,time,load_cell"),
    ):
        run("ncwa", "-O", "-v", name, "-a", dims, folder / f"{file}.nc", tmp_path / "mean.nc")
        text = run("ncks", "-H", "-C", "-v", name, "-s", "%.9g", tmp_path / "mean.nc")
        mean = np.nanmean(read_dataset(folder / f"{file}.nc")[name].values.astype(float))
        assert float(text) == pytest.approx(mean, rel=1e-5), file


def test_nco_cuts_a_level_out(folder, tmp_path):
    run(
        "ncks", "-O", "-d", "z,0", "-d", "time,0", "-v", "vertical_stress_mean",
        folder / "fields.nc", tmp_path / "level.nc",
    )  # fmt: skip
    np.testing.assert_array_equal(
        read_dataset(tmp_path / "level.nc")["vertical_stress_mean"].values[0, 0],
        read_dataset(folder / "fields.nc")["vertical_stress_mean"].values[0, 0],
    )


# ---------------------------------------------------------------------------------------------
# VTK


@pytest.fixture
def read_image():
    """read_image(file): what VTK's own reader makes of a .vti; fails where it complains."""
    module = pytest.importorskip("vtkmodules.vtkIOXML")
    core = pytest.importorskip("vtkmodules.vtkCommonCore")

    def read(file):
        said = core.vtkStringOutputWindow()
        core.vtkOutputWindow.SetInstance(said)
        reader = module.vtkXMLImageDataReader()
        reader.SetFileName(str(file))
        reader.Update()
        assert said.GetOutput() == ""
        assert reader.GetErrorCode() == 0
        return reader.GetOutput()

    return read


def cell_values(image, name):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    nx, ny, nz = (points - 1 for points in image.GetDimensions())
    return vtk_to_numpy(image.GetCellData().GetArray(name)).reshape(nz, ny, nx)


def test_vtk_reads_every_reading_cell_by_cell(folder, tmp_path, read_image):
    export(folder, "vtk", tmp_path / "vtk")
    fields = read_dataset(folder / "fields.nc")
    files = sorted((tmp_path / "vtk").glob("*.vti"))
    assert len(files) == fields.sizes["time"]
    for t, file in enumerate(files):
        image = read_image(file)
        for name in ("vertical_stress_mean", "vertical_stress_std"):
            np.testing.assert_array_equal(
                cell_values(image, f"{name}_kpa"), fields[name].values[t], err_msg=file.name
            )


def test_vtk_finds_a_place_of_the_mine(written, tmp_path, read_image):
    experiment, folder = written("mine")
    export(folder, "vtk", tmp_path / "vtk")
    image = read_image(tmp_path / "vtk" / "mine_0003.vti")
    fields = read_dataset(folder / "fields.nc")
    z, y, x = 11, 3, 8
    place = [
        ORIGIN[key] + float(fields[axis][i])
        for key, axis, i in (("easting", "x", x), ("northing", "y", y), ("elevation", "z", z))
    ]
    index, weights = [0] * 3, [0.0] * 3
    assert image.ComputeStructuredCoordinates(place, index, weights) == 1
    cell = image.ComputeCellId(index)
    stress = image.GetCellData().GetArray("vertical_stress_mean_kpa").GetValue(cell)
    assert stress == float(fields["vertical_stress_mean"][3, z, y, x])
    assert image.GetFieldData().GetArray("TimeValue").GetValue(0) == experiment.mass_scheduled


def test_vtk_hides_what_is_outside_the_ground(written, tmp_path, read_image):
    folder = written("static")[1]
    export(folder, "vtk", tmp_path / "vtk")
    image = read_image(tmp_path / "vtk" / "column_0000.vti")
    ground = cell_values(image, "ground")
    state = read_dataset(folder / "block_model.nc")["state"].values
    np.testing.assert_array_equal(ground == 1, state == 1)
    seen = [image.IsCellVisible(cell) for cell in range(image.GetNumberOfCells())]
    np.testing.assert_array_equal(np.array(seen, dtype=bool), ground.ravel() == 1)
