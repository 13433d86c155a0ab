"""Fields reduced over replicates with integer sums, so that any order gives the same bits.

Stress enters as its difference from a reference profile, rounded to a grid of 2^-40 of the
overburden (squares: 2^-36 of its square). Sums of such integers are exact: chunk → combine →
finalise cannot depend on how replicates were shared out. In 64 bits there is room for 10^6
replicates with stresses of several times the overburden.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from numba import njit

from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT
from pipeline.lattice.grid import GRAVITY
from pipeline.simulate.readings import KPA
from pipeline.simulate.setup import Setup

STRESS_UNIT, SQUARE_UNIT = 2.0**-40, 2.0**-36  # of the overburden and of its square
DENSITY_UNIT = 2.0**-8  # kg m-3
SLAB = 2**17  # places whose sums become fields at a time; 1 MB in double precision


@dataclass
class FieldSums:
    """Sums over replicates on (time, z, y, x); integers in grid units.

    `stress` and `square` hold Σ(σ − σ_ref) and Σ(σ − σ_ref)², `granular`, `movement` and `void`
    count replicates, `density` sums the bulk density. `first` is the stress of the first
    replicate, kPa, NaN where it has no material; None in sums without that replicate.
    """

    setup: Setup
    count: int
    stress: np.ndarray
    square: np.ndarray
    granular: np.ndarray
    movement: np.ndarray
    void: np.ndarray
    density: np.ndarray
    first: np.ndarray | None = None

    @classmethod
    def empty(cls, setup: Setup) -> FieldSums:
        """Sums over no replicate."""
        shape = (setup.times, *setup.lattice.shape)
        wide, narrow = (np.int64, np.int32)
        kinds = (wide, wide, narrow, narrow, narrow, wide)
        return cls(setup, 0, *(np.zeros(shape, kind) for kind in kinds))

    def observe(self, t: int, code: np.ndarray, cell_id: np.ndarray, load: np.ndarray) -> None:
        """Add one replicate's state at reading `t`; arrays (levels, y, x), `load` in N."""
        levels = code.shape[0]
        reference, unit, square_unit = _scales(self.setup)
        lattice = self.setup.lattice
        _add(
            code,
            cell_id,
            load,
            self.setup.cell_weight,
            reference,
            KPA / lattice.cell_area,
            1.0 / unit,
            1.0 / square_unit,
            1.0 / (GRAVITY * lattice.cell_volume * DENSITY_UNIT),
            self.stress[t, :levels],
            self.square[t, :levels],
            self.granular[t, :levels],
            self.movement[t, :levels],
            self.void[t, :levels],
            self.density[t, :levels],
        )

    def observe_first(
        self, t: int, code: np.ndarray, cell_id: np.ndarray, load: np.ndarray
    ) -> None:
        """As `observe`, for the first replicate, whose own stress is kept too."""
        self.observe(t, code, cell_id, load)
        if self.first is None:
            self.first = np.full(self.stress.shape, np.nan, dtype=np.float32)
        stress = np.where(load > 0.0, load * (KPA / self.setup.lattice.cell_area), np.nan)
        self.first[t, : code.shape[0]] = stress

    def __iadd__(self, other: FieldSums) -> FieldSums:
        self.count += other.count
        self.first = other.first if self.first is None else self.first
        for name in ("stress", "square", "granular", "movement", "void", "density"):
            getattr(self, name).__iadd__(getattr(other, name))
        return self

    def finalise(self) -> xr.Dataset:
        """Content of `fields.nc`: means, standard deviations (n − 1) and probabilities on
        (time, z, y, x), float32, beside `mass_drawn` or `fill_height` (time).

        NaN outside the ground, above the filling, and, for stress, where no replicate (for its
        standard deviation: at most one) has material. Double precision is used for `SLAB` places
        at a time: for all of them it would take more memory than the sums do.
        """
        setup = self.setup
        fields = defaultdict(lambda: np.empty(self.stress.shape, np.float32))
        nz, ny, nx = self.stress.shape[1:]
        step = math.ceil(SLAB / (ny * nx))
        for t, bottom in product(range(setup.times), range(0, nz, step)):
            levels = slice(bottom, bottom + step)
            ground = self._ground(t, levels)
            for name, values in self._at(t, levels).items():
                fields[name][t, levels] = np.where(ground, values, np.nan)
        data = {name: (("time", "z", "y", "x"), values) for name, values in fields.items()}
        clock = "mass_drawn" if setup.masses else "fill_height"
        data[clock] = ("time", np.array(setup.masses or setup.fill_levels))
        data["replicate_count"] = ((), np.int32(self.count))
        coords = {axis: (axis, setup.lattice.centers(axis)) for axis in "zyx"}
        coords["time"] = ("time", np.arange(setup.times, dtype=np.float64))
        coords["realization"] = ((), np.int32(0))
        return xr.Dataset(data, coords=coords)

    def _at(self, t: int, levels: slice) -> dict[str, np.ndarray | float]:
        """Fields (z, y, x) of levels of a time by name, whatever they are outside the ground."""
        reference, unit, square_unit = _scales(self.setup)
        n = self.granular[t, levels].astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            off = self.stress[t, levels] * unit / n
            variance = (self.square[t, levels] * square_unit - n * off**2) / (n - 1.0)
            mean = np.where(n > 0, off + reference[levels, None, None], np.nan)
            std = np.where(n > 1, np.sqrt(np.maximum(variance, 0.0)), np.nan)
        return {
            "vertical_stress_mean": mean,
            "vertical_stress_std": std,
            "vertical_stress_first": np.nan if self.first is None else self.first[t, levels],
            "movement_zone_probability": self.movement[t, levels] / self.count,
            "void_probability": self.void[t, levels] / self.count,
            "bulk_density_mean": self.density[t, levels] * DENSITY_UNIT / self.count,
        }

    def _ground(self, t: int, levels: slice) -> np.ndarray:
        """Places (z, y, x) of some levels of a time that are ground and, while filling, filled."""
        inside = self.setup.code[levels] != OUTSIDE
        return inside if self.setup.masses else inside & (self.granular[t, levels] > 0)


def _scales(setup: Setup) -> tuple[np.ndarray, float, float]:
    """Reference stress of each level (kPa) and the units of the two sums (kPa, kPa²)."""
    lattice = setup.lattice
    density = setup.experiment.material.bulk_density
    level_stress = density * GRAVITY * lattice.cell_size * KPA
    reference = level_stress * np.arange(lattice.nz, 0, -1)
    scale = 2.0 ** math.ceil(math.log2(level_stress * lattice.nz))
    return reference, scale * STRESS_UNIT, scale**2 * SQUARE_UNIT


@njit(nogil=True, cache=True)
def _add(
    code,
    cell_id,
    load,
    cell_weight,
    reference,
    stress_per_load,
    per_unit,
    per_square_unit,
    density_per_weight,
    stress,
    square,
    granular,
    movement,
    void,
    density,
):
    """Add one state (levels, y, x) to the sums of one reading."""
    nz, ny, nx = code.shape
    for k in range(nz):
        for y in range(ny):
            for x in range(nx):
                cell = code[k, y, x]
                if cell in (STAGNANT, MOVEMENT):
                    off = load[k, y, x] * stress_per_load - reference[k]
                    stress[k, y, x] += np.int64(np.rint(off * per_unit))
                    square[k, y, x] += np.int64(np.rint(off * off * per_square_unit))
                    granular[k, y, x] += 1
                    weight = cell_weight[cell_id[k, y, x]]
                    density[k, y, x] += np.int64(np.rint(weight * density_per_weight))
                    if cell == MOVEMENT:
                        movement[k, y, x] += 1
                elif cell != OUTSIDE:
                    void[k, y, x] += 1
                    movement[k, y, x] += 1
