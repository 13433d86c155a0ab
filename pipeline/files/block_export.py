"""The block model of an experiment as CSV: centroids, sizes and attributes, one row a block."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.files.atomic import write_text
from pipeline.files.results import Results, clock_of
from pipeline.files.units import with_unit
from pipeline.lattice.block_model import STATE_OUTSIDE, corner_of

NEEDED = ("block_model", "fields")
GEOMETRY = ("centroid_x", "centroid_y", "centroid_z", "dim_x", "dim_y", "dim_z", "volume")
"""The seven leading columns, as Vulcan orders and names them; m and m³."""

_OF_READINGS = ("vertical_stress_mean", "vertical_stress_std", "movement_zone_probability")


def write_block_model(results: Results, path: str | Path, vulcan: bool = False) -> None:
    """Write the ground's blocks as CSV, whole, x fastest and z slowest.

    The columns of `GEOMETRY` come first, in mine coordinates where the experiment says where it
    stands; then `bulk_density_kg_m3`, the region's name and grades where there are regions, and
    stresses and the movement zone at the first and the last reading, the mass drawn or the fill
    height in their names. Values that do not exist are empty. With `vulcan`, lines 2 to 4 hold
    the variables' descriptions, types and defaults, names are lower case without points, and −99
    stands for what does not exist.
    """
    ground = results["block_model"]["state"].values != STATE_OUTSIDE
    attributes = list(_attributes(results))
    side = results.experiment.geometry.cell_size
    z, y, x = np.nonzero(ground)
    corner = corner_of(results.experiment)
    centers = [
        origin + results["block_model"][axis].values[index]
        for origin, axis, index in zip(corner, "xyz", (x, y, z), strict=True)
    ]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name, _, _ in attributes]
    if vulcan:
        blank = [""] * (len(GEOMETRY) - 1)
        writer.writerow([*GEOMETRY, *(re.sub(r"[^a-z0-9_]", "_", name.lower()) for name in names)])
        descriptions = [description.replace(",", ";") for _, description, _ in attributes]
        writer.writerow(["variable descriptions", *blank, *descriptions])
        kinds = [values.dtype.kind for _, _, values in attributes]
        types = ["name" if kind == "U" else "double" for kind in kinds]
        writer.writerow(["variable types", *blank, *types])
        defaults = ["none" if kind == "U" else "-99" for kind in kinds]
        writer.writerow(["variable defaults", *blank, *defaults])
    else:
        writer.writerow([*GEOMETRY, *names])
    sizes = [f"{side:.10g}"] * 3 + [f"{side**3:.10g}"]
    missing = "-99" if vulcan else ""
    columns = [values[ground] for _, _, values in attributes]
    for place in zip(*centers, *columns, strict=True):
        row = [f"{value:.12g}" for value in place[:3]] + sizes
        row += [_cell(value, missing) for value in place[3:]]
        writer.writerow(row)
    write_text(path, text.getvalue())


def _cell(value: str | float, missing: str) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.7g}" if np.isfinite(value) else missing


def _attributes(results: Results) -> Iterator[tuple[str, str, np.ndarray]]:
    """(column, description, values on (z, y, x)) of each attribute."""
    density, fields = results["block_model"]["bulk_density"], results["fields"]
    units = density.attrs["units"]
    yield (
        with_unit("bulk_density", units),
        f"{density.attrs['long_name']}, unit {units}",
        density.values,
    )
    model = results["block_model"]
    if "region" in model:
        names = np.array(model["region"].attrs["flag_meanings"].split())
        index = np.nan_to_num(model["region"].values, nan=0.0).astype(int)
        yield "region", model["region"].attrs["long_name"], names[index]
    for name in results.experiment.grade_units:
        grade = model[f"grade_{name}"]
        unit = grade.attrs["units"]
        column = with_unit(f"grade_{name}", unit)
        yield column, f"{grade.attrs['long_name']}, unit {unit}", grade.values
    clock, times = clock_of(fields)
    unit = fields[clock].attrs["units"]
    for t in sorted({0, len(times) - 1}):
        for name in _OF_READINGS:
            field = fields[name]
            when = f"{times[t]:g}{unit}"
            yield (
                f"{with_unit(name, field.attrs['units'])}_at_{when}",
                f"{field.attrs['long_name']}, unit {field.attrs['units']}, "
                f"at {clock} {times[t]:g} {unit}",
                field.values[t],
            )
