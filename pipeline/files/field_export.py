"""Fields of an experiment as VTK image data, one file for each reading, and their series."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.files.atomic import whole_folder
from pipeline.files.results import Results, clock_of
from pipeline.files.units import with_unit
from pipeline.files.vtk import HIDDEN_CELL, Grid, write_image_data, write_series
from pipeline.lattice.block_model import STATE_OUTSIDE, corner_of

NEEDED = ("block_model", "fields")


def write_fields(results: Results, folder: str | Path) -> Path:
    """Write the folder `folder` whole: `NAME_0000.vti`, ... and `NAME.pvd`; the latter's path.

    Cell arrays are the variables of `fields.nc` on (time, z, y, x), their units at the end of
    their names, NaN where nothing is; `ground` is 1 inside the mask, and cells outside it are
    hidden. With regions, `region` (its number in the experiment's file, 0 in none) and the grades
    before draw are there too. Coordinates are m, the mine's where the experiment says where it
    stands. The time of the series is the mass drawn in kg, or the fill height in m.
    """
    fields, name = results["fields"], results.experiment.name
    ground = results["block_model"]["state"].values != STATE_OUTSIDE
    side = results.experiment.geometry.cell_size
    grid = Grid(corner_of(results.experiment), (side, side, side))
    constant = {"ground": ground.astype(np.uint8)} | _of_regions(results)
    if not ground.all():
        constant["vtkGhostType"] = np.where(ground, 0, HIDDEN_CELL).astype(np.uint8)
    clock, times = clock_of(fields)
    varying = [
        variable
        for variable in fields.data_vars.values()
        if variable.dims == ("time", "z", "y", "x")
    ]
    with whole_folder(folder) as partial:
        steps = []
        for t, time in enumerate(times.tolist()):
            cells = {with_unit(v.name, v.attrs["units"]): v.values[t] for v in varying}
            facts = {"TimeValue": time, with_unit(clock, fields[clock].attrs["units"]): time}
            file = f"{name}_{t:04d}.vti"
            write_image_data(partial / file, grid, cells | constant, facts)
            steps.append((time, file))
        write_series(partial / f"{name}.pvd", steps)
    return Path(folder) / f"{name}.pvd"


def _of_regions(results: Results) -> dict[str, np.ndarray]:
    """Cell arrays that only an experiment with regions has."""
    model, experiment = results["block_model"], results.experiment
    if not experiment.regions:
        return {}
    region = np.nan_to_num(model["region"].values, nan=-1.0).astype(np.int8)
    grades = [model[f"grade_{name}"] for name in experiment.grade_units]
    named = {with_unit(str(one.name), one.attrs["units"]): one.values for one in grades}
    return {"region": region} | named
