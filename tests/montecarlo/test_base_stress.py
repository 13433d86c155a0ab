"""The table of base stress: percentiles worked out by hand, in both units."""

import csv
from io import StringIO

import numpy as np
import pytest
import xarray as xr

from pipeline.montecarlo.base_stress import COLUMNS, as_csv, base_stress_rows


def table(clock: str) -> list[dict[str, str]]:
    stress = np.arange(1.0, 12.0)[:, None, None] * [[[10.0, 1.0], [20.0, np.nan]]]
    numbers = {"x": [1.0, 3.0], "y": [2.0, 2.0], "width": [0.5, 0.5], "length": [1.0, 1.0]}
    data = {f"load_cell_{key}": ("load_cell", values) for key, values in numbers.items()}
    data["load_cell_name"] = ("load_cell", np.array(["P1", "P2"], dtype="S"))
    data["vertical_stress"] = (("replicate", "time", "load_cell"), stress)
    data[clock] = ("time", [0.0, 5e8])
    return list(csv.DictReader(StringIO(as_csv(COLUMNS, base_stress_rows(xr.Dataset(data))))))


@pytest.mark.parametrize("clock", ["mass_drawn", "fill_height"])
def test_mean_and_percentiles_of_each_load_cell_and_reading(clock):
    rows = table(clock)
    assert [(row["load_cell"], row["reading"]) for row in rows] == [
        *(("P1", "0"), ("P1", "1")),
        *(("P2", "0"), ("P2", "1")),
    ]
    row = rows[1]
    # eleven replicates: 20, 40, ... 220 kPa; the second, sixth and tenth are the percentiles
    assert [float(row[f"{name}_kpa"]) for name in ("mean", "p10", "p50", "p90")] == [
        *(120.0, 40.0, 120.0, 200.0)
    ]
    assert float(row["p90_mpa"]) == 0.2
    assert (row["x_m"], row["replicates"]) == ("1", "11")
    unit, other = {"mass_drawn": ("mass_drawn_kg", "fill_height_m")}.get(
        clock, ("fill_height_m", "mass_drawn_kg")
    )
    assert (row[unit], row[other]) == ("500000000", "")
    assert rows[3]["mean_kpa"] == ""
