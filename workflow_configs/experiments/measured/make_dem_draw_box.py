"""Add the movement zone of the DEM draw box to its load-cell rows.

    python make_dem_draw_box.py LOAD_CELLS.csv RAW_FOLDER > dem_draw_box.csv

LOAD_CELLS.csv has the stresses as the DEM laboratory delivers them; RAW_FOLDER has its
dem_box_*_s1.nc. The movement zone is where particles have settled by more than half a diameter
(`moving_cumulative`), on a 2 cm x-z grid: its height is that of its highest place, its width the
largest x extent of one level; one cell is the standard deviation of both. A place that has moved
stays in the zone, as in the model.
"""

import sys
from pathlib import Path

import numpy as np
import xarray as xr

RUNS = {
    "dem_box_isolated": "dem_box_iso_s1.nc",
    "dem_box_panel": "dem_box_panel_s1.nc",
    "dem_box_block_wide": "dem_box_block36_s1.nc",
}
CELL = 0.02


def zone_rows(experiment: str, path: Path):
    """CSV rows of one run."""
    with xr.open_dataset(path) as run:
        masses = run["mass_drawn"].sum("drawpoint").values
        moving = np.maximum.accumulate(run["moving_cumulative"].values == 1)
    for mass, zone in zip(masses[1:], moving[1:], strict=True):
        levels = [np.flatnonzero(level) for level in zone]
        extents = [level[-1] - level[0] + 1 if len(level) else 0 for level in levels]
        height = max(k + 1 for k, level in enumerate(levels) if len(level))
        for quantity, cells in (
            ("movement_zone_height", height),
            ("movement_zone_width", max(extents)),
        ):
            yield f"{experiment},,,{mass:.4f},{quantity},{cells * CELL:.2f},{CELL:g},,1"


def main(load_cells: str, raw: str) -> None:
    """Write the joined table to standard output."""
    print("# Simulated (DEM). Stresses as delivered; movement zone: make_dem_draw_box.py beside.")
    print(Path(load_cells).read_text().strip())
    for experiment, file in RUNS.items():
        for row in zone_rows(experiment, Path(raw) / file):
            print(row)


if __name__ == "__main__":
    main(*sys.argv[1:])
