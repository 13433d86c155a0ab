"""Cells of the lattice, how they spread their load, and a column at rest."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from scipy import ndimage

GRAVITY = 9.81
FINENESS = 2 / 3  # side of our cells over the declared ones
SPREAD_SCATTER = 0.95  # coefficient of variation of a cell's lateral spread where s.std is 1.5
SPREAD_MATCH = 1.2  # mean lateral variance of load paths over that of a cell whose s is the mean
LEAST_RELAXATION = 1e-12  # R = 0 still lets ground amid a zone hand its load on


def overlap(edges: np.ndarray, center: float, extent: float) -> np.ndarray:
    """Length of each interval between `edges` inside the one of this center and extent."""
    high = np.minimum(center + extent / 2, edges[1:])
    return np.clip(high - np.maximum(center - extent / 2, edges[:-1]), 0.0, None)


class Box:
    """Geometry and declared values of an experiment on our lattice, inputs as they truly are."""

    def __init__(self, experiment, acting):
        g, material = experiment["geometry"], experiment["material"]
        self.experiment, self.declared_cell = experiment, g["cell_size"]
        self.cell = FINENESS * g["cell_size"]
        self.nx, self.ny = round(g["width"] / self.cell), round(g["length"] / self.cell)
        self.area_over_perimeter = g["width"] * g["length"] / (2 * (g["width"] + g["length"]))
        self.height_factor = acting.get("fill_height_misdeclared", {"factor": 1.0})["factor"]
        self.height = g["height"] * self.height_factor
        self.density = (
            material["bulk_density"] * acting.get("density_misdeclared", {"factor": 1.0})["factor"]
        )
        self.half_overburden = 0.5 * GRAVITY * material["bulk_density"] * g["height"]  # Pa
        self.nz = math.ceil(self.height / self.cell - 1e-9)
        self.footprints = np.array([self.covered(cell) for cell in experiment["load_cells"]])

    def per_cell(self, shed: Any) -> Any:
        """A shed fraction of the declared cells, on ours."""
        return 1.0 - (1.0 - shed) ** (self.cell / self.declared_cell)

    def weights(self, height: float, index: float) -> np.ndarray:
        """Weight of each level's cells, N: filled up to `height`, denser below by `index`."""
        filled = np.clip(height / self.cell - np.arange(self.nz), 0.0, 1.0)
        weight = self.density * GRAVITY * self.cell**3 * filled
        if index:
            depth = np.maximum(height - (np.arange(self.nz) + 0.5 * filled) * self.cell, 1e-9)
            factor = np.where(filled > 0.0, depth, 1.0) ** index
            weight = weight * factor * weight.sum() / (weight * factor).sum()
        return weight

    def covered(self, area) -> np.ndarray:
        """Share (y, x) of each base cell in a rectangle of the base."""
        shares = []
        for center, extent, count in (
            (area["y"], area["length"], self.ny),
            (area["x"], area["width"], self.nx),
        ):
            edges = np.arange(count + 1) * self.cell
            shares.append(overlap(edges, center, extent))
        covered = shares[0][:, None] * shares[1][None, :]
        return covered / covered.sum()

    def read(self, base: np.ndarray) -> np.ndarray:
        """kPa under each load cell from the loads (y, x) on the base, N."""
        return np.tensordot(self.footprints, base, axes=2) / self.cell**2 * 1e-3


def lattice_variance(exponent: float) -> float:
    """Variance along x, in cells², of one step to nine neighbors with weights distance^−n."""
    edge, corner = 2.0 ** (-0.5 * exponent), 3.0 ** (-0.5 * exponent)
    return (2 * edge + 4 * corner) / (1 + 4 * edge + 4 * corner)


def _stencil(receivers: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets along y and along x of the receivers of a cell's load."""
    offsets = [(y, x) for y in range(-2, 3) for x in range(-2, 3)]
    within = {
        9: lambda y, x: max(abs(y), abs(x)) <= 1,
        13: lambda y, x: abs(y) + abs(x) <= 2,
        25: lambda y, x: True,
    }[receivers]
    kept = np.array([(y, x) for y, x in offsets if within(y, x)])
    return kept[:, 0], kept[:, 1]


def _ratio_of_variance(receivers: int, variance: np.ndarray) -> np.ndarray:
    """q of weights q^(d²) whose variance along x is the one wanted, cells²; at most 0.99."""
    step, table = _ratios(receivers)
    place = np.minimum(variance / step + 0.5, len(table) - 1)
    return table[place.astype(np.int32)]


@cache
def _ratios(receivers: int) -> tuple[float, np.ndarray]:
    """Step of the variance from 0, and the q of each."""
    y, x = _stencil(receivers)
    q = np.linspace(0.0, 0.99, 500)
    weights = q[:, None] ** (x**2 + y**2)
    reached = (weights * x**2).sum(axis=1) / weights.sum(axis=1)
    even = np.linspace(0.0, reached[-1], 2000)
    return even[1], np.interp(even, reached, q).astype(np.float32)


class Ground:
    """One packing: how wide each cell spreads its load, and how a reading follows from a state."""

    def __init__(self, box, theta, acting, physics, packing):
        self.box, self.theta, self.acting, self.physics = box, theta, acting, physics
        self.packing = packing
        declared = lattice_variance(box.experiment["stress"]["s"]["mean"])
        self.mean = SPREAD_MATCH * declared / FINENESS * physics.spread  # cells²
        self.side, self.across = self.spreading((box.nz, box.ny, box.nx))
        self.own = box.per_cell(1.0 - theta["E"][box.experiment["material"]["name"]])
        self.index = acting.get("compaction", {"index": 0.0})["index"]
        surcharge = acting.get("surcharge", {"stress": 0.0})["stress"]
        self.surcharge = 1e3 * surcharge * box.cell**2  # N on a cell

    def spreading(self, shape) -> tuple[np.ndarray, np.ndarray]:
        """Weights of a receiver one cell off along x, and along y, over that below; drawn anew."""
        scatter = SPREAD_SCATTER * self.theta["s"] / 1.5
        if self.physics.law == "lognormal":
            sigma = math.sqrt(math.log1p(scatter**2))
            factor = self.packing.standard_normal(shape, dtype=np.float32)
            factor = np.exp(sigma * factor - sigma**2 / 2)
        else:
            half = min(math.sqrt(3.0) * scatter, 0.95)
            factor = 1.0 + half * (2.0 * self.packing.random(shape, dtype=np.float32) - 1.0)
        q = _ratio_of_variance(self.physics.receivers, self.mean * factor)
        stretch = math.sqrt(self.physics.anisotropy)
        return q ** (1.0 / stretch), q**stretch

    def read(self, weight, shed, zone, filled, side, across, pillars):
        """Carry the weights (z, y, x) down and read the load cells, kPa."""
        box, acting = self.box, self.acting
        weight, shed = self._uncatalogued(weight, shed, zone, filled)
        dy, dx = _stencil(self.physics.receivers)
        lean = 0.0
        if "tilt" in acting:
            lean = math.tan(math.radians(acting["tilt"]["angle_x"])) / self.mean
        own = np.full(weight.shape, self.own)
        if "wall_friction" in acting:
            angle = math.radians(box.experiment["walls"]["friction_angle"])
            friction = acting["wall_friction"]["K"] * math.tan(angle)
            share = -math.expm1(-friction * box.cell / box.area_over_perimeter)
            shed, own = shed + share * (1.0 - shed), own + share * (1.0 - own)
        base = np.zeros((box.ny, box.nx))
        _sweep(
            weight,
            shed,
            own,
            side,
            across,
            zone,
            filled,
            self._relaxation(pillars),
            self._beside(zone),
            dy,
            dx,
            lean,
            acting.get("stress_dependent_transmission", {"slope": 0.0})["slope"],
            box.half_overburden * box.cell**2,
            acting.get("arching", {"transfer": 0.0})["transfer"],
            base,
        )
        return box.read(base)

    def _uncatalogued(self, weight, shed, zone, filled):
        """Weights and shed fractions as the amplitudes of the physics leave them."""
        physics, cell = self.physics, self.box.cell
        if not (physics.shell or physics.crust or physics.side_density):
            return weight, np.minimum(shed, 1.0)
        factor = np.ones(shed.shape)
        if physics.shell and (zone >= 0).any():
            distance = ndimage.distance_transform_edt(zone < 0, sampling=cell)
            factor[(zone < 0) & (distance <= 0.06)] += physics.shell
        if physics.crust:
            above = np.cumsum(filled[::-1], axis=0)[::-1] * cell
            factor[above <= 0.25] += physics.crust
        if physics.side_density:
            along = (np.arange(weight.shape[2]) + 0.5) / weight.shape[2]
            weight = weight * (1.0 + physics.side_density * (2.0 * along - 1.0))
        return weight, np.minimum(shed * factor, 1.0)

    def _relaxation(self, pillars):
        """R of each place (z, y, x), R / (1 + width / W) near a pillar of width W."""
        field = np.full(pillars.shape, self.theta["R"])
        if "pillar_relaxation" in self.acting:
            field /= 1.0 + self.acting["pillar_relaxation"]["width"] / self.box.cell * pillars
        return field

    def _beside(self, zone):
        """Label of the zone that a place at rest lies within 3 cm of, sideways; −1 elsewhere."""
        if "arching" not in self.acting or not (zone >= 0).any():
            return zone
        reach = max(1, round(0.03 / self.box.cell))
        size = (1, 2 * reach + 1, 2 * reach + 1)
        widened = ndimage.maximum_filter(zone, size=size, mode="constant", cval=-1)
        return np.where(zone < 0, widened, np.int16(-1))


def at_rest(ground, height):
    """Reading (load_cell) in kPa of a column filled up to `height`."""
    box = ground.box
    filled = max(1, math.ceil(height / box.cell - 1e-9))
    weight = np.empty((filled, box.ny, box.nx))
    weight[:] = box.weights(height, ground.index)[:filled, None, None]
    weight[-1] += ground.surcharge
    zone = np.full(weight.shape, -1, dtype=np.int16)
    shed = np.full(weight.shape, ground.own)
    spreading = ground.side[:filled], ground.across[:filled]
    return ground.read(weight, shed, zone, zone < 0, *spreading, np.zeros(weight.shape))


@njit(nogil=True, cache=True, error_model="numpy")
def _sweep(
    weight,
    shed,
    own,
    side,
    across,
    zone,
    filled,
    relaxation,
    beside,
    dy,
    dx,
    lean,
    slope,
    reference,
    transfer,
    base,
):
    """Top-down: each cell keeps its weight and what it receives, sheds a share, gives the rest on.

    The weight of a receiver is side^(dx²) · across^(dy²) · exp(lean dx), times R in a movement
    zone (where all of a cell's receivers are in one that cancels). `transfer` of what a zone sheds
    beyond `own` goes to the places `beside` it one level below.
    """
    nz, ny, nx = weight.shape
    carried = np.zeros((ny, nx))
    received = np.zeros((ny + 4, nx + 4))
    factor = np.zeros((ny + 4, nx + 4))  # of each receiver: 1 at rest, R in motion, 0 if none
    power = np.zeros((3, 3, nx))  # side^(dx²) · across^(dy²) by |dy| and |dx|
    total = np.zeros(nx)
    given = np.zeros(nx)
    labels = max(zone.max() + 1, 1)
    excess = np.zeros(labels)
    touching = np.zeros(labels)
    tilted = np.exp(lean * dx)
    for k in range(nz - 1, -1, -1):
        for j in range(ny):
            for i in range(nx):
                of_others = factor[j + 2, i + 2] * received[j + 2, i + 2]
                carried[j, i] = weight[k, j, i] + of_others
        if transfer > 0.0 and excess.sum() > 0.0:
            touching[:] = 0.0
            for j in range(ny):
                for i in range(nx):
                    if beside[k, j, i] >= 0:
                        touching[beside[k, j, i]] += 1.0
            for j in range(ny):
                for i in range(nx):
                    label = beside[k, j, i]
                    if label >= 0:
                        carried[j, i] += excess[label] / touching[label]
            excess[:] = 0.0
        if k == 0:
            base[:, :] = carried
            return
        received[:, :] = 0.0
        for j in range(ny):
            for i in range(nx):
                moves = zone[k - 1, j, i] >= 0
                share = max(relaxation[k - 1, j, i], LEAST_RELAXATION) if moves else 1.0
                factor[j + 2, i + 2] = share if filled[k - 1, j, i] else 0.0
        for j in range(ny):
            for i in range(nx):
                load = carried[j, i]
                by_stress = 1.0
                if slope != 0.0 and load > 0.0:
                    by_stress = (load / reference) ** slope
                fraction = min(shed[k, j, i] * by_stress, 1.0)
                given[i] = load * (1.0 - fraction)
                if transfer > 0.0 and zone[k, j, i] >= 0:
                    beyond = fraction - min(own[k, j, i] * by_stress, 1.0)
                    excess[zone[k, j, i]] += transfer * max(beyond, 0.0) * load
            _powers(side[k, j], across[k, j], power)
            total[:] = 0.0
            for m in range(len(dy)):
                row, first = j + 2 + dy[m], 2 + dx[m]
                _add_products(
                    total,
                    tilted[m],
                    power[abs(dy[m]), abs(dx[m])],
                    factor[row, first : first + nx],
                )
            for i in range(nx):
                given[i] /= max(total[i], 1e-300)
            for m in range(len(dy)):
                row, first = j + 2 + dy[m], 2 + dx[m]
                _add_products(
                    received[row, first : first + nx],
                    tilted[m],
                    power[abs(dy[m]), abs(dx[m])],
                    given,
                )


@njit(nogil=True, cache=True, inline="always")
def _add_products(total, scale, left, right):
    for i in range(len(total)):
        total[i] += scale * left[i] * right[i]


@njit(nogil=True, cache=True)
def _powers(side, across, power):
    for i in range(len(side)):
        a, b = np.float64(side[i]), np.float64(across[i])
        a4, b4 = a * a * a * a, b * b * b * b
        power[0, 0, i], power[0, 1, i], power[0, 2, i] = 1.0, a, a4
        power[1, 0, i], power[1, 1, i], power[1, 2, i] = b, b * a, b * a4
        power[2, 0, i], power[2, 1, i], power[2, 2, i] = b4, b4 * a, b4 * a4
