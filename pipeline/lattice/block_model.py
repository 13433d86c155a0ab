"""From an experiment's geometry and material to the block model on (z, y, x)."""

from __future__ import annotations

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.regions import NO_REGION
from pipeline.lattice.cells import OUTSIDE, STAGNANT
from pipeline.lattice.grid import Lattice, make_lattice
from pipeline.lattice.on_lattice import lattice_error, read_on_lattice
from pipeline.lattice.regions import Regions, regions_on

# CF flags of `state` and `zone` in files, apart from the kernels' cell codes
STATE_VOID, STATE_GRANULAR, STATE_OUTSIDE = np.int8(0), np.int8(1), np.int8(2)
ZONE_STAGNANT, ZONE_MOVEMENT = np.int8(0), np.int8(1)


def lattice_of(experiment: Experiment) -> Lattice:
    """The lattice of an experiment's declared geometry."""
    g = experiment.geometry
    return make_lattice(g.width, g.length, g.height, g.cell_size)


def corner_of(experiment: Experiment) -> tuple[float, float, float]:
    """Where the model's corner stands, (x, y, z) in m: in the mine where declared, or zero."""
    origin = experiment.geometry.origin
    return (
        (0.0, 0.0, 0.0) if origin is None else (origin.easting, origin.northing, origin.elevation)
    )


def build_block_model(experiment: Experiment) -> xr.Dataset:
    """Block model before draw.

    Returns
    -------
    Dataset on (z, y, x) with `state` and `zone` (int8 flags), `bulk_density` (kg m-3; the top
    level scaled to its filled fraction, 0 outside the ground), `d50` (m, the middle of the
    declared particle sizes, NaN where none is declared or outside the ground) and `cell_id`
    (int32, the flat index of the cell, -1 outside the ground). With regions also `region` (int8
    flags, -1 outside the ground) and `grade_NAME` of each grade, in its unit (NaN outside the
    ground). The attribute `lattice_notes` says where a length was rounded.

    Raises
    ------
    ConfigError
        If a mask leaves no ground, a mask file does not fit the lattice, or regions do not fit,
        see `regions.regions_on`.
    """
    lattice = lattice_of(experiment)
    ground = ground_mask(experiment, lattice)
    if not ground.any():
        raise lattice_error(experiment, "geometry.mask", "it leaves no ground cell")
    regions = regions_on(experiment, lattice, ground)
    density = np.where(ground, regions.bulk_density.astype(np.float32), np.float32(0.0))
    density[-1] = np.where(ground[-1], regions.bulk_density[-1] * lattice.top_fraction, 0.0)
    cell_id = np.arange(ground.size, dtype=np.int32).reshape(ground.shape)
    dims = ("z", "y", "x")
    return xr.Dataset(
        {
            "state": (dims, np.where(ground, STATE_GRANULAR, STATE_OUTSIDE)),
            "zone": (dims, np.full(ground.shape, ZONE_STAGNANT, np.int8)),
            "bulk_density": (dims, density),
            "d50": (dims, np.where(ground, regions.d50.astype(np.float32), np.nan)),
            "cell_id": (dims, np.where(ground, cell_id, np.int32(-1))),
            **_of_regions(experiment, regions),
        },
        coords={axis: (axis, lattice.centers(axis)) for axis in "zyx"},
        attrs={"lattice_notes": "; ".join(lattice.notes)},
    )


def _of_regions(experiment: Experiment, regions: Regions) -> dict[str, tuple]:
    """Variables that only an experiment with regions has."""
    if not experiment.regions:
        return {}
    names = " ".join([NO_REGION, *(region.name for region in experiment.regions)])
    found = {"region": (tuple("zyx"), regions.index, {"flag_meanings": names})}
    for name, unit in experiment.grade_units.items():
        found[f"grade_{name}"] = (tuple("zyx"), regions.grades[name], {"units": unit})
    return found


def cell_codes(block_model: xr.Dataset) -> np.ndarray:
    """Kernel cell codes (z, y, x) int8 of a block model before draw."""
    outside = block_model["state"].values == STATE_OUTSIDE
    return np.where(outside, OUTSIDE, STAGNANT)


def ground_mask(experiment: Experiment, lattice: Lattice) -> np.ndarray:
    """True where a cell is ground, (z, y, x); a cell belongs to it by its center.

    Masks: a vertical cylinder about the middle of the base; drawbells, the ground below a
    height cut away except for funnels that open upwards from the drawpoints at the wall angle
    (degrees from horizontal); a netCDF variable on (z, y, x), nonzero where there is ground.
    """
    mask = experiment.geometry.mask
    ground = np.ones(lattice.shape, dtype=bool)
    if mask is None:
        return ground
    x, y, z = (lattice.centers(axis) for axis in "xyz")
    if mask.type == "cylinder":
        radius = experiment.geometry.diameter / 2
        off_x, off_y = x - experiment.geometry.width / 2, y - experiment.geometry.length / 2
        inside = off_x[None, :] ** 2 + off_y[:, None] ** 2 <= radius**2 * (1 + 1e-9)
        return ground & inside[None]
    if mask.type == "drawbells":
        below = z < mask.height
        in_funnel = np.zeros(lattice.shape, dtype=bool)
        opening = z / np.tan(np.radians(mask.wall_angle))
        for point in experiment.drawpoints:
            near_x = np.abs(x - point.x)[None, :] <= (point.width / 2 + opening)[:, None] + 1e-9
            near_y = np.abs(y - point.y)[None, :] <= (point.length / 2 + opening)[:, None] + 1e-9
            in_funnel |= near_y[:, :, None] & near_x[:, None, :]
        return ~below[:, None, None] | in_funnel
    file = experiment.files["geometry", "mask", "path"]
    where = "geometry.mask", file, mask.variable, "variable"
    return np.nan_to_num(read_on_lattice(experiment, lattice, *where).values) != 0
