"""Grade and dilution of what was drawn, by drawpoint and mass drawn, from the extraction record."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.montecarlo.statistics import PERCENTILES
from pipeline.simulate.setup import visits

ALL = "all drawpoints"  # has a blank, which the name of a drawpoint cannot have
BINS = 20


@dataclass(frozen=True)
class Drawn:
    """What each drawpoint gave in bins of the mass drawn there; the last place is all together.

    Attributes
    ----------
    edges : (place, bin + 1) kg, bins as scheduled
    mass : (replicate, place, bin) kg; the last bin also holds what is beyond the schedule
    content : by name of a quantity, (replicate, place, bin) kg times the quantity's unit
    """

    edges: np.ndarray
    mass: np.ndarray
    content: dict[str, np.ndarray]


def drawn_in_bins(
    replicates: xr.Dataset, scheduled: np.ndarray, cells: Mapping[str, np.ndarray], bins: int = BINS
) -> Drawn:
    """Share out the extraction record over bins of the mass drawn from each drawpoint.

    A cell that spans the edge of a bin is divided there.

    Parameters
    ----------
    replicates : with `drawn_cell`, `drawn_drawpoint` and `drawn_mass` (replicate, extraction)
    scheduled : (drawpoint) kg that the schedule draws from each; it sets the bins
    cells : by name, the quantity of each initial cell by its identity, flat
    """
    after, point, cell = (
        np.nan_to_num(replicates[f"drawn_{name}"].values.astype(np.float64), nan=-1.0)
        for name in ("mass", "drawpoint", "cell")
    )
    scheduled = np.append(scheduled, scheduled.sum())
    edges = scheduled[:, None] * np.linspace(0.0, 1.0, bins + 1)
    shape = (len(after), len(scheduled), bins)
    mass = np.zeros(shape)
    content = {name: np.zeros(shape) for name in cells}
    for replicate in range(len(after)):
        given = point[replicate] >= 0
        each = np.diff(after[replicate, given], prepend=0.0)
        came = cell[replicate, given].astype(np.int64)
        for place in range(len(scheduled)):
            here = point[replicate, given] == place
            here |= place == len(scheduled) - 1
            until = np.cumsum(np.append(0.0, each[here]))
            ends = np.append(edges[place, :-1], max(edges[place, -1], until[-1]))
            mass[replicate, place] = np.diff(np.interp(ends, until, until))
            for name, values in cells.items():
                held = np.cumsum(np.append(0.0, each[here] * values[came[here]]))
                content[name][replicate, place] = np.diff(np.interp(ends, until, held))
    return Drawn(edges, mass, content)


def grade_curves(
    experiment: Experiment, block_model: xr.Dataset, replicates: xr.Dataset
) -> xr.Dataset:
    """Content of `grade.nc`: statistics of grade and dilution on (drawpoint, mass_bin).

    The last drawpoint is `ALL` of them. For each grade NAME there are `drawn_grade_NAME`, in the
    bin, and `cumulative_grade_NAME`, from the first kilogram to the bin's end, in the unit of the
    grade; `drawn_dilution` and `cumulative_dilution` are shares of waste by mass. Each has the
    suffixes `_mean`, `_p10`, `_p50` and `_p90`, over the replicates in which something was drawn
    (`replicates_in_bin`); NaN where there is none.
    """
    drawn = drawn_in_bins(replicates, scheduled_masses(experiment), _cells(experiment, block_model))
    units = {f"grade_{name}": unit for name, unit in experiment.grade_units.items()}
    dims = ("drawpoint", "mass_bin")
    names = [*(point.name for point in experiment.drawpoints), ALL]
    data = {
        "drawpoint_name": ("drawpoint", np.array(names, dtype="S")),
        "mass_from": (dims, drawn.edges[:, :-1]),
        "mass_to": (dims, drawn.edges[:, 1:]),
        "replicates_in_bin": (dims, (drawn.mass > 0).sum(axis=0).astype(np.int32)),
        "replicate_count": ((), np.int32(len(drawn.mass))),
    }
    data |= _statistics("bin_mass", drawn.mass)
    until = np.cumsum(drawn.mass, axis=-1)
    for name, content in drawn.content.items():
        values = {
            f"drawn_{name}": _share(content, drawn.mass),
            f"cumulative_{name}": _share(np.cumsum(content, axis=-1), until),
        }
        for kind, shares in values.items():
            data |= _statistics(kind, shares, {"units": units[name]} if name in units else {})
    return xr.Dataset(data)


def scheduled_masses(experiment: Experiment) -> np.ndarray:
    """Mass (drawpoint) in kg that the schedule draws from each drawpoint."""
    scheduled, done = np.zeros(len(experiment.drawpoints)), 0.0
    for point, end in visits(experiment):
        scheduled[point] += end - done
        done = end
    return scheduled


def _cells(experiment: Experiment, block_model: xr.Dataset) -> dict[str, np.ndarray]:
    """Grades and whether it is waste (0 or 1) of each cell by identity."""
    names = [f"grade_{name}" for name in experiment.grade_units]
    cells = {name: block_model[name].values.ravel() for name in names}
    waste = [place for place, one in enumerate(experiment.regions, start=1) if one.waste]
    return cells | {"dilution": np.isin(block_model["region"].values, waste).ravel().astype(float)}


def _share(content: np.ndarray, mass: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(mass > 0, content / mass, np.nan)


def _statistics(name: str, values: np.ndarray, attributes: Mapping[str, str] = {}) -> dict:
    """Mean and percentiles over replicates (first axis) where there are values, as variables."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bins that no replicate has reached
        found = {"mean": np.nanmean(values, axis=0)}
        shares = np.nanpercentile(values, PERCENTILES, axis=0)
    found |= {f"p{percent}": share for percent, share in zip(PERCENTILES, shares, strict=True)}
    return {
        f"{name}_{suffix}": (("drawpoint", "mass_bin"), value, dict(attributes))
        for suffix, value in found.items()
    }
