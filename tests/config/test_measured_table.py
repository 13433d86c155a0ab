"""The measured table: what is read, what joins the readings, and CSV and netCDF alike."""

import contextlib
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.config.experiment import Experiment
from pipeline.config.measured import (
    COLUMNS,
    MeasuredError,
    MeasuredRow,
    fill_levels,
    read_measured,
    reading_masses,
)

COLUMN = Experiment.model_validate(
    {
        "geometry": {"width": 0.1, "length": 0.08, "height": 0.5, "cell_size": 0.02},
        "material": {"name": "gravel", "bulk_density": 970, "particle_density": 2670},
        "stress": {"E": 0.54, "s": 2},
        "filling": {"levels": [0.2, 0.35]},
    }
).at(Path("column.yaml"))
BOX = Experiment.model_validate(
    {
        "geometry": {"width": 0.3, "length": 0.1, "height": 0.4, "cell_size": 0.02},
        "material": {"name": "ore", "bulk_density": 1420, "particle_density": 2600},
        "stress": {
            "E": 0.98,
            "s": 4,
            "R": 0.3,
            "E_min": {"type": "power", "at_height": 0.4, "value": 0.9},
        },
        "flow": {"exponent": 3.0, "bulking": 0.15},
        "drawpoints": [{"name": "D1", "x": 0.1, "y": 0.05, "width": 0.06, "length": 0.1}],
        "draw": [{"drawpoints": ["D1"], "mass": 2.0, "increment": 0.2}],
        "readings": {"every": 0.8},
        "load_cells": [{"name": "C1", "x": 0.05, "y": 0.05, "width": 0.04, "length": 0.1}],
    }
).at(Path("box.yaml"))
HEADER = ",".join(COLUMNS) + "\n"


def table(tmp_path, text: str, header: str = HEADER) -> Path:
    path = tmp_path / "table.csv"
    path.write_text(header + text, encoding="utf-8")
    return path


def test_rows_are_read_with_their_defaults(tmp_path):
    path = table(
        tmp_path,
        "# a comment\n\ncolumn,,0.2,,vertical_stress,0.44,0.03,,\n"
        "other,,,,vertical_stress,1,1,,\n"
        "column,,,, vertical_stress ,0.48,0.04,0.02,3\n",
    )
    assert read_measured(path, COLUMN) == (
        MeasuredRow(None, 0.2, None, "vertical_stress", 0.44, 0.03, 0.0, None, 4),
        MeasuredRow(None, None, None, "vertical_stress", 0.48, 0.04, 0.02, 3, 6),
    )


def test_optional_columns_may_be_left_out_and_reordered(tmp_path):
    path = table(tmp_path, "0.04,0.48,vertical_stress,column\n", "std,value,quantity,experiment\n")
    (row,) = read_measured(path, COLUMN)
    assert (row.value, row.std, row.std_shared, row.load_cell) == (0.48, 0.04, 0.0, None)


def test_a_byte_order_mark_and_windows_line_ends_are_tolerated(tmp_path):
    path = tmp_path / "table.csv"
    text = HEADER + "column,,,,vertical_stress,0.48,0.04,,\n"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert len(read_measured(path, COLUMN)) == 1


def test_an_empty_mass_is_the_reading_before_draw(tmp_path):
    path = table(
        tmp_path,
        "box,C1,,,vertical_stress,5,0.5,,\nbox,C1,,1.1,vertical_stress,4,0.5,,\n"
        "box,,,1.1,movement_zone_width,0,0.01,,\n",
    )
    assert [row.mass_drawn for row in read_measured(path, BOX)] == [0.0, 1.1, 1.1]


def test_every_problem_of_a_table_is_reported(tmp_path):
    path = table(tmp_path, "column,,0.9,,vertical_stress,-1,0,,\ncolumn,,,,stress,x,,-1,0\n")
    with pytest.raises(MeasuredError) as caught:
        read_measured(path, COLUMN)
    assert len(caught.value.problems) == 8
    assert caught.value.path == path


def test_measured_levels_join_the_fill_levels(tmp_path):
    path = table(
        tmp_path,
        "column,,0.28,,vertical_stress,0.4,0.1,,\n"
        "column,,0.35000000000000003,,vertical_stress,0.4,0.1,,\n",
    )
    assert fill_levels(COLUMN) == (0.2, 0.35, 0.5)
    assert fill_levels(COLUMN, read_measured(path, COLUMN)) == (0.2, 0.28, 0.35, 0.5)
    assert fill_levels(BOX) == (0.4,)


def test_measured_masses_join_the_readings(tmp_path):
    path = table(
        tmp_path,
        "box,C1,,1.1,vertical_stress,4,0.5,,\nbox,C1,,1.6000000000000001,vertical_stress,4,0.5,,\n",
    )
    assert reading_masses(BOX) == (0.0, 0.8, 1.6, 2.0)
    assert reading_masses(BOX, read_measured(path, BOX)) == (0.0, 0.8, 1.1, 1.6, 2.0)
    assert reading_masses(COLUMN) == ()


def test_declared_masses_stay_as_declared():
    listed = BOX.model_copy(
        update={
            "readings": BOX.readings.model_copy(update={"every": None, "at_mass_drawn": (0.3, 1.0)})
        }
    )
    assert reading_masses(listed) == (0.0, 0.3, 1.0)


def test_the_last_multiple_is_the_scheduled_mass():
    tenths = BOX.model_copy(update={"readings": BOX.readings.model_copy(update={"every": 0.1})})
    assert reading_masses(tenths) == tuple(round(0.1 * n, 1) for n in range(21))


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_broken_table_gives_problems_and_no_other_error(tmp_path, data):
    text = HEADER + "box,C1,,1.1,vertical_stress,4,0.5,0.1,3\nbox,C1,,,vertical_stress,4,0.5,,\n"
    splices = st.sampled_from([",", ";", '"', "\n", "#", "\x00", "nan", "1e400", "box", "é", "-"])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text)))
        text = text[:place] + data.draw(splices) + text[place + data.draw(st.integers(0, 3)) :]
    with contextlib.suppress(MeasuredError):
        assert read_measured(table(tmp_path, text, ""), BOX)


@pytest.mark.parametrize("characters", [False, True])
def test_netcdf_reads_as_the_csv(tmp_path, characters):
    csv_path = table(
        tmp_path,
        "box,C1,,,vertical_stress,5,0.5,0.25,3\n"
        "box,C1,,1.5,vertical_stress,4,0.5,,\n"
        "other,,,,vertical_stress,4,0.5,,\n",
    )
    path = tmp_path / "table.nc"
    texts = {
        "experiment": ["box", "box", "other"],
        "load_cell": ["C1", "C1", ""],
        "quantity": ["vertical_stress"] * 3,
    }
    with netCDF4.Dataset(path, "w") as dataset:
        dataset.createDimension("row", 3)
        for name, values in texts.items():
            if characters:
                dataset.createDimension(f"{name}_length", 16)
                variable = dataset.createVariable(name, "S1", ("row", f"{name}_length"))
                variable[:] = netCDF4.stringtochar(np.array(values, "S16"))
            else:
                variable = dataset.createVariable(name, str, ("row",))
                variable[:] = np.array(values, object)
        for name, values in {
            "mass_drawn": [np.nan, 1.5, np.nan],
            "value": [5, 4, 4],
            "std": [0.5] * 3,
            "std_shared": [0.25, np.nan, np.nan],
        }.items():
            dataset.createVariable(name, "f8", ("row",))[:] = values
        dataset.createVariable("count", "i4", ("row",), fill_value=-1)[:] = [3, -1, -1]

    def without_line(rows):
        return [
            (row.load_cell, row.mass_drawn, row.value, row.std, row.std_shared, row.count)
            for row in rows
        ]

    assert without_line(read_measured(path, BOX)) == without_line(read_measured(csv_path, BOX))


def test_a_broken_netcdf_is_named(tmp_path):
    path = tmp_path / "table.nc"
    path.write_bytes(b"not netCDF")
    with pytest.raises(MeasuredError, match="not readable as netCDF"):
        read_measured(path, BOX)


def test_a_netcdf_without_a_needed_variable_is_named(tmp_path):
    path = tmp_path / "table.nc"
    with netCDF4.Dataset(path, "w") as dataset:
        dataset.createDimension("row", 1)
        dataset.createVariable("value", "f8", ("row",))[:] = 1
    with pytest.raises(MeasuredError, match="column experiment is missing"):
        read_measured(path, BOX)


def test_reading_configuration_imports_nothing_heavy():
    code = (
        "import sys, pipeline.config.load; "
        "print(*{'numpy', 'xarray', 'dask', 'numba', 'netCDF4', 'matplotlib'} & set(sys.modules))"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""
