"""An independent simulator of the laboratory, to test the loop on data that its own model did not
make.

It shares no code with the package's model, imports nothing of it, and differs where the model's
choices are arbitrary: cells of two thirds the size, 9, 13 or 25 receivers with Gaussian weights,
lognormal or uniform scatter of their width, voids that walk in continuous steps and are used up as
they loosen the ground, zones without parked voids, and, in some laboratories, static columns that
are a continuum (Janssen's differential slice with lateral diffusion). What a laboratory would have
calibrated is matched: attenuation for each meter, lateral spread for each meter, width of the
movement zone for each height. Effects are written anew from their definitions.

Lengths m, masses kg, loads N, stresses kPa. Arrays are (z, y, x), level 0 at the base.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy import ndimage

GRAVITY = 9.81
FINENESS = 2 / 3  # side of our cells over the declared ones
SPREAD_SCATTER = 0.95  # coefficient of variation of a cell's lateral spread where s.std is 1.5
ZONE_SCATTER = 0.14  # sd of the log width of a drawpoint's movement zone
STRAY = 8  # fewer loosened places than this in a level are no part of a zone's height
SPREAD_MATCH = 1.2  # mean lateral variance of load paths over that of a cell whose s is the mean
LUMP = 1.0  # mean size of what comes out at a time, in cells as high as a declared one

Effects = Sequence[Mapping[str, Any]]  # each with name, scope_key (None: all) and parameters
Theta = Mapping[str, Any]  # E by material, s (std), R, E_min (shift of log(1 − E_min))


@dataclass(frozen=True)
class Physics:
    """How one laboratory's ground works.

    `receivers` of a cell's load in the level below; `law` of the scatter of their spread;
    `continuum`: static columns are no lattice. `spread` and `anisotropy` (x over y) are factors
    on the lateral variance of load paths, `zone` on the width of movement zones. The rest is what
    a lattice of this file may have too, as amplitudes: `shell` (ground at rest within 6 cm of a
    zone sheds more), `crust` (so does the uppermost quarter meter), `side_density` (density leans
    along x).
    """

    receivers: int = 13
    law: str = "lognormal"
    continuum: bool = False
    spread: float = 1.0
    anisotropy: float = 1.0
    zone: float = 1.0
    shell: float = 0.0
    crust: float = 0.0
    side_density: float = 0.0


@dataclass(frozen=True)
class Change:
    """A change of the physics that is in no catalogue of effects, by an amplitude (0: none).

    `words` says what it is; `channel` and `place` are what a local rule that describes it would
    change (None: any) and where; `low` to `high` is the range of the amplitude.
    """

    words: str
    channel: str | None
    place: tuple[str, ...]
    low: float
    high: float
    change: Callable[[Physics, float], Physics]


CHANGES = {
    "neighbor_spread": Change(
        "load spreads wider or less wide than calibration of s alone can follow",
        None,
        ("weights", "spread"),
        -1.5,
        1.0,
        lambda p, a: replace(p, spread=p.spread * math.exp(a)),
    ),
    "anisotropic_spread": Change(
        "load spreads more along one side of the box than along the other",
        None,
        ("weights", "spread", "lateral"),
        -1.5,
        1.5,
        lambda p, a: replace(p, anisotropy=p.anisotropy * math.exp(a)),
    ),
    "zone_width": Change(
        "movement zones are wider or narrower for their height than flow was calibrated to",
        None,
        ("movement zone", "zone", "shell", "boundary", "edge of"),
        -0.30,
        0.30,
        lambda p, a: replace(p, zone=p.zone * math.exp(a)),
    ),
    "sheared_shell": Change(
        "ground at rest within 6 cm of a movement zone has been sheared and sheds more",
        "E",
        ("shell", "around the movement zone", "near the movement zone", "distance to"),
        0.0,
        8.0,
        lambda p, a: replace(p, shell=a),
    ),
    "crust": Change(
        "the uppermost quarter meter of the bed is crusted and sheds more",
        "E",
        ("surface", "top", "depth"),
        0.0,
        20.0,
        lambda p, a: replace(p, crust=a),
    ),
    "side_density": Change(
        "the bed was filled from one end and is denser there, its mass as declared",
        "weight",
        ("lateral", "side", "position", "wall"),
        -0.4,
        0.4,
        lambda p, a: replace(p, side_density=a),
    ),
}
"""Changes by name."""


def ground_stress(
    experiment: Mapping[str, Any],
    theta: Theta,
    effects: Effects,
    physics: Physics,
    packing: np.random.Generator,
    flow: np.random.Generator,
) -> np.ndarray:
    """Stress (time, load_cell) in kPa under the load cells, one packing.

    `experiment` is the content of its file. Times are fill levels of a static experiment, and the
    reading before draw and those of the schedule of a drawn one.
    """
    acting = {
        one["name"]: one["parameters"]
        for one in effects
        if one["scope_key"] in (None, experiment["name"], experiment["material"]["name"])
    }
    if "draw" not in experiment and physics.continuum:
        return _continuum(experiment, theta, acting, physics, packing)
    box = _Box(experiment, acting)
    ground = _Ground(box, theta, acting, physics, packing)
    if "draw" not in experiment:
        levels = [level * box.height_factor for level in experiment["filling"]["levels"]]
        return np.array([_at_rest(ground, level) for level in levels])
    return _drawn(ground, flow)


def as_read(experiment: Mapping[str, Any], stress: np.ndarray, effects: Effects) -> np.ndarray:
    """What the load cells say of the stresses (time, load_cell) in kPa, their faults included."""
    names = [cell["name"] for cell in experiment["load_cells"]]
    drawn = experiment["readings"]["at_mass_drawn"] if "draw" in experiment else ()
    masses = np.array([0.0, *drawn])  # one for each time, or 0 for all of them
    read = stress.copy()
    for name in ("sensor_gain", "sensor_drift", "sensor_offset"):
        for one in effects:
            if one["name"] != name or one["scope_key"] not in names:
                continue
            column = read[:, names.index(one["scope_key"])]
            if name == "sensor_gain":
                column *= one["parameters"]["gain"]
            elif name == "sensor_drift":
                column *= 1.0 + one["parameters"]["rate"] * masses
            else:
                column += one["parameters"]["offset"]
    return read


def _overlap(edges: np.ndarray, center: float, extent: float) -> np.ndarray:
    """Length of each interval between `edges` inside the one of this center and extent."""
    high = np.minimum(center + extent / 2, edges[1:])
    return np.clip(high - np.maximum(center - extent / 2, edges[:-1]), 0.0, None)


class _Box:
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
            shares.append(_overlap(edges, center, extent))
        covered = shares[0][:, None] * shares[1][None, :]
        return covered / covered.sum()

    def read(self, base: np.ndarray) -> np.ndarray:
        """kPa under each load cell from the loads (y, x) on the base, N."""
        return np.tensordot(self.footprints, base, axes=2) / self.cell**2 * 1e-3


# ---------------------------------------------------------------------------------------------
# load paths


def _lattice_variance(exponent: float) -> float:
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


class _Ground:
    """One packing: how wide each cell spreads its load, and how a reading follows from a state."""

    def __init__(self, box, theta, acting, physics, packing):
        self.box, self.theta, self.acting, self.physics = box, theta, acting, physics
        self.packing = packing
        declared = _lattice_variance(box.experiment["stress"]["s"]["mean"])
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


def _at_rest(ground, height):
    box = ground.box
    filled = max(1, math.ceil(height / box.cell - 1e-9))
    weight = np.empty((filled, box.ny, box.nx))
    weight[:] = box.weights(height, ground.index)[:filled, None, None]
    weight[-1] += ground.surcharge
    zone = np.full(weight.shape, -1, dtype=np.int16)
    shed = np.full(weight.shape, ground.own)
    spreading = ground.side[:filled], ground.across[:filled]
    return ground.read(weight, shed, zone, zone < 0, *spreading, np.zeros(weight.shape))


LEAST_RELAXATION = 1e-12  # R = 0 still lets ground amid a zone hand its load on


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


# ---------------------------------------------------------------------------------------------
# draw


class _Zones(NamedTuple):
    """What draw has left in the ground.

    `label` (z, y, x) is the drawpoint whose void came first, −1 where none has been, and `root`
    (drawpoint) the lowest label of the zones that touch. `places` (drawpoint, z) counts those of a
    label in each level; `dilation` (z, y, x) and `sunk` (y, x) are the volumes in cells that voids
    left in each place, and that are gone at the surface.
    """

    label: np.ndarray
    root: np.ndarray
    places: np.ndarray
    dilation: np.ndarray
    sunk: np.ndarray


def _drawn(ground, flow):
    box = ground.box
    experiment, shape = box.experiment, (box.nz, box.ny, box.nx)
    opening = [
        np.array([p["y"], p["x"]]) + np.array([[-0.5], [0.5]]) * [p["length"], p["width"]]
        for p in experiment["drawpoints"]
    ]
    count = len(opening)
    zones = _Zones(
        np.full(shape, -1, dtype=np.int16),
        np.arange(count),
        np.zeros((count, box.nz), dtype=np.int64),
        np.zeros(shape),
        np.zeros(shape[1:]),
    )
    variance = _lattice_variance(experiment["flow"]["exponent"]) / FINENESS
    jitter = np.exp(ZONE_SCATTER * flow.standard_normal(count))
    masses = experiment["readings"]["at_mass_drawn"]
    drawpoints, volumes, taken_at = _lumps(box, flow)
    rows, done = [_during_draw(ground, zones)], 0
    for until in np.searchsorted(taken_at, masses, side="right"):
        _release(
            zones,
            drawpoints[done:until],
            volumes[done:until],
            np.array(opening) / box.cell,
            ground.physics.zone * math.sqrt(3.0 * variance) * jitter,
            experiment["flow"]["bulking"],
            box.height / box.cell,
            flow,
        )
        done = until
        rows.append(_during_draw(ground, zones))
    return np.array(rows)


def _lumps(box, flow):
    """What comes out, in order: drawpoints, volumes in cells, kg drawn when half of it is out.

    Sizes are exponential, so that a void loosens over as long a way as one that may stop anywhere.
    """
    experiment = box.experiment
    names = [point["name"] for point in experiment["drawpoints"]]
    ends = np.cumsum([line["mass"] for line in experiment["draw"]])
    cell_mass = box.density * box.cell**3
    mean = LUMP / FINENESS
    likely = ends[-1] / (mean * cell_mass)
    volumes = mean * flow.standard_exponential(int(likely + 10 * math.sqrt(likely) + 10))
    middles = (np.cumsum(volumes) - 0.5 * volumes) * cell_mass
    kept = middles <= ends[-1]
    of_line = np.searchsorted(ends, middles[kept])
    drawpoints = np.empty(np.count_nonzero(kept), dtype=np.int64)
    for n, line in enumerate(experiment["draw"]):
        into = middles[kept][of_line == n] - (ends[n] - line["mass"])
        turn = (into / line["increment"]).astype(int) % len(line["drawpoints"])
        drawpoints[of_line == n] = np.array([names.index(p) for p in line["drawpoints"]])[turn]
    return drawpoints, volumes[kept], middles[kept]


@njit(nogil=True, cache=True)
def _release(zones, drawpoints, volumes, opening, steps, bulking, top, rng):
    """Lumps leave, and the void of each walks up, used up by the ground that it loosens.

    `opening` (drawpoint, 2, 2) are the low and high corners (y, x) of each, in cells; `steps`
    (drawpoint) the farthest that a void goes aside in one level.
    """
    label, dilation, sunk = zones.label, zones.dilation, zones.sunk
    nz, ny, nx = label.shape
    for n in range(len(drawpoints)):
        drawpoint, volume = drawpoints[n], volumes[n]
        low, high = opening[drawpoint]
        y = low[0] + rng.random() * (high[0] - low[0])
        x = low[1] + rng.random() * (high[1] - low[1])
        step = steps[drawpoint]
        for k in range(nz):
            j, i = int(y), int(x)
            if k >= top - sunk[j, i]:
                break
            if label[k, j, i] < 0:
                label[k, j, i] = drawpoint
                zones.places[drawpoint, k] += 1
                _unite(label, zones.root, k, j, i)
            taken = min(bulking - dilation[k, j, i], volume)
            if taken > 0.0:
                dilation[k, j, i] += taken
                volume -= taken
                if volume <= 1e-12:
                    break
            y = _reflected(y + step * (2.0 * rng.random() - 1.0), ny)
            x = _reflected(x + step * (2.0 * rng.random() - 1.0), nx)
        if volume > 1e-12:
            sunk[int(y), int(x)] += volume


@njit(nogil=True, cache=True)
def _unite(label, root, k, j, i):
    """One root for the zones that meet at a place."""
    nz, ny, nx = label.shape
    own = label[k, j, i]
    for kk in range(max(k - 1, 0), min(k + 2, nz)):
        for jj in range(max(j - 1, 0), min(j + 2, ny)):
            for ii in range(max(i - 1, 0), min(i + 2, nx)):
                other = label[kk, jj, ii]
                if other >= 0 and root[other] != root[own]:
                    low, high = min(root[other], root[own]), max(root[other], root[own])
                    root[root == high] = low


@njit(nogil=True, cache=True)
def _reflected(position, extent):
    position = abs(position)
    if position > extent:
        position = 2.0 * extent - position
    return min(max(position, 0.0), extent - 1e-9)


def _during_draw(ground, zones):
    """One reading: what the zones weigh and shed, from their state."""
    box, sunk, dilation = ground.box, zones.sunk, zones.dilation
    zone = np.where(zones.label >= 0, zones.root[zones.label], -1).astype(np.int16)
    levels = np.arange(box.nz)[:, None, None]
    filled_part = np.clip(box.height / box.cell - sunk[None] - levels, 0.0, 1.0)
    before = np.clip(box.height / box.cell - levels, 1e-9, 1.0)
    weight = box.weights(box.height, ground.index)[:, None, None] / before
    weight = weight * filled_part * (1.0 - dilation)
    if "loosening_density" in ground.acting:
        material = box.experiment["material"]
        solid = material["bulk_density"] / material["particle_density"]
        lost = ground.acting["loosening_density"]["porosity_increase"] / solid
        weight = np.where(zone >= 0, weight * max(1.0 - lost, 0.0), weight)
    filled = filled_part > 0.0
    filled[0] = True
    if ground.surcharge:
        highest = box.nz - 1 - np.argmax(filled[::-1], axis=0)
        y, x = np.indices(highest.shape)
        weight[highest, y, x] += ground.surcharge
    shed = np.full(weight.shape, ground.own)
    side, across = ground.side, ground.across
    if (zone >= 0).any():
        in_zone = box.per_cell(_shed_in_zone(box, ground.theta, _heights(zones) * box.cell))
        shed = np.where(zone >= 0, in_zone[zone], shed)
        side, across = side.copy(), across.copy()  # what moves spreads its load anew
        side[zone >= 0], across[zone >= 0] = ground.spreading(np.count_nonzero(zone >= 0))
    pillars = np.zeros(zone.shape)
    if "pillar_relaxation" in ground.acting:
        x = np.array([point["x"] for point in box.experiment["drawpoints"]])
        places = np.unique(x, return_inverse=True)[1]
        _find_pillars(np.where(zones.label >= 0, places[zones.label], -1), pillars)
    return ground.read(weight, shed, zone, filled, side, across, pillars)


@njit(nogil=True, cache=True)
def _find_pillars(place, pillars):
    """One over the width in cells of the narrowest pillar near each moving place (z, y, x).

    A pillar is ground at rest along x between ground that voids of two drawpoints moved, `place`
    the number of the drawpoint's row and −1 at rest. It counts for what moved within a sixth of
    the box of it.
    """
    nz, ny, nx = place.shape
    for k in range(nz):
        for j in range(ny):
            last = -1
            for i in range(nx):
                if place[k, j, i] < 0:
                    continue
                gap = i - last - 1
                if last >= 0 and gap > 0 and place[k, j, i] != place[k, j, last]:
                    for x in range(max(last - nx // 6, 0), min(i + nx // 6, nx)):
                        if place[k, j, x] >= 0:
                            pillars[k, j, x] = max(pillars[k, j, x], 1.0 / gap)
                last = i


def _heights(zones) -> np.ndarray:
    """Height in levels of the zone of each root (drawpoint): to the last one worth the name."""
    places = np.array(
        [zones.places[zones.root == root].sum(axis=0) for root in range(len(zones.root))]
    )
    levels = np.arange(1, places.shape[1] + 1)
    return np.where(places >= STRAY, levels, 0).max(axis=1)


def _shed_in_zone(box, theta, height):
    """1 − E_min of declared cells in zones of these heights, m."""
    law = box.experiment["stress"]["E_min"]
    shed = math.exp(theta["E_min"]) * (1.0 - law["value"])
    shed = shed * (np.maximum(height, box.declared_cell) / law["at_height"]) ** -law["exponent"]
    return np.clip(shed, 1.0 - theta["E"][box.experiment["material"]["name"]], 1.0)


# ---------------------------------------------------------------------------------------------
# static columns as a continuum

SLICE = 0.005  # m
STRIPS = 24
PACKING_SCATTER = 0.035  # sd of log stress under a load cell, from packing to packing


def _continuum(experiment, theta, acting, physics, packing):
    """Janssen's slices with lateral diffusion and drift along x, walls that let nothing through.

    dσ/dz = ρ g − σ/ℓ (σ/σ_ref)^slope − σ K tan φ / R_h − ∂/∂x (tan θ σ − D ∂σ/∂x)
    """
    box = _Box(experiment, acting)
    rate = -math.log(theta["E"][experiment["material"]["name"]]) / box.declared_cell
    wall = 0.0
    if "wall_friction" in acting:
        angle = math.radians(experiment["walls"]["friction_angle"])
        wall = acting["wall_friction"]["K"] * math.tan(angle) / box.area_over_perimeter
    width = experiment["geometry"]["width"]
    edges = np.linspace(0.0, width, STRIPS + 1)
    under = np.array([_overlap(edges, c["x"], c["width"]) for c in experiment["load_cells"]])
    under /= under.sum(axis=1, keepdims=True)
    diffusion = 0.5 * _lattice_variance(experiment["stress"]["s"]["mean"]) * box.declared_cell
    drift = math.tan(math.radians(acting.get("tilt", {"angle_x": 0.0})["angle_x"]))
    scatter = PACKING_SCATTER * theta["s"] / 1.5 * packing.standard_normal(len(under))
    rows = []
    for level in experiment["filling"]["levels"]:
        height = level * box.height_factor
        depth = (np.arange(round(height / SLICE)) + 0.5) * SLICE
        density = depth ** acting.get("compaction", {"index": 0.0})["index"]
        density *= box.density * height / (density.sum() * SLICE)
        stress = np.full(STRIPS, 1e3 * acting.get("surcharge", {"stress": 0.0})["stress"])
        _descend(
            stress,
            GRAVITY * density,
            rate,
            wall,
            acting.get("stress_dependent_transmission", {"slope": 0.0})["slope"],
            box.half_overburden,
            drift * STRIPS / width,
            physics.spread * diffusion * (STRIPS / width) ** 2,
        )
        rows.append(under @ stress * 1e-3 * np.exp(scatter))
    return np.array(rows)


@njit(nogil=True, cache=True, error_model="numpy")
def _descend(stress, gained, rate, wall, slope, reference, drift, diffusion):
    """Take the stress (strip) in Pa down the column, slice by slice.

    `gained` (slice) in N m⁻³; `drift` and `diffusion` for each meter down, in strips.
    """
    flux = np.zeros(len(stress) + 1)
    for own in gained:
        for i in range(1, len(stress)):
            middle = 0.5 * (stress[i] + stress[i - 1])
            flux[i] = drift * middle - diffusion * (stress[i] - stress[i - 1])
        for i in range(len(stress)):
            by_stress = (max(stress[i], 1.0) / reference) ** slope
            lost = (rate * by_stress + wall) * stress[i] + flux[i + 1] - flux[i]
            stress[i] += SLICE * (own - lost)
