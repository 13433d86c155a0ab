"""From an experiment's geometry and material to the block model on (z, y, x)."""

from __future__ import annotations

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.messages import ConfigError
from pipeline.lattice.cells import OUTSIDE, STAGNANT
from pipeline.lattice.grid import Lattice, make_lattice

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
    (int32, the flat index of the cell, -1 outside the ground). The attribute `lattice_notes`
    says where a length was rounded.

    Raises
    ------
    ConfigError
        If a mask leaves no ground, or a mask file does not fit the lattice.
    """
    lattice = lattice_of(experiment)
    ground = ground_mask(experiment, lattice)
    if not ground.any():
        raise _mask_error(experiment, "", "it leaves no ground cell")
    bulk_density, size = experiment.material.bulk_density, experiment.material.particle_size
    density = np.where(ground, np.float32(bulk_density), np.float32(0.0))
    density[-1] = np.where(ground[-1], bulk_density * lattice.top_fraction, 0.0)
    d50 = np.nan if size is None else 0.5 * (size[0] + size[1])
    cell_id = np.arange(ground.size, dtype=np.int32).reshape(ground.shape)
    dims = ("z", "y", "x")
    return xr.Dataset(
        {
            "state": (dims, np.where(ground, STATE_GRANULAR, STATE_OUTSIDE)),
            "zone": (dims, np.full(ground.shape, ZONE_STAGNANT, np.int8)),
            "bulk_density": (dims, density),
            "d50": (dims, np.where(ground, np.float32(d50), np.float32(np.nan))),
            "cell_id": (dims, np.where(ground, cell_id, np.int32(-1))),
        },
        coords={axis: (axis, lattice.centers(axis)) for axis in "zyx"},
        attrs={"lattice_notes": "; ".join(lattice.notes)},
    )


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
    return _mask_from_file(experiment, lattice, mask.variable)


def _mask_from_file(experiment: Experiment, lattice: Lattice, variable: str) -> np.ndarray:
    file = experiment.mask_path
    try:
        with xr.open_dataset(file, engine="netcdf4") as dataset:
            found = ", ".join(map(str, dataset.data_vars)) or "no variable"
            values = dataset[variable].load() if variable in dataset else None
    except OSError as error:
        text = f"{file} is not readable as netCDF: {error.strerror}"
        raise _mask_error(experiment, ".path", text) from None
    if values is None:
        raise _mask_error(experiment, f".variable = {variable}", f"{file} has only: {found}")
    if values.dims != ("z", "y", "x") or values.shape != lattice.shape:
        raise _mask_error(
            experiment,
            f".variable = {variable}",
            f"its dims are {dict(values.sizes)}; the lattice is (z, y, x) = {lattice.shape}",
        )
    return np.nan_to_num(values.values) != 0


def _mask_error(experiment: Experiment, key: str, text: str) -> ConfigError:
    return ConfigError([(experiment.path, f"geometry.mask{key}: {text}")])
