"""Movement zones: what draw leaves in the ground, and the loads around it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.blind.independent.ground import FINENESS, lattice_variance

ZONE_SCATTER = 0.14  # sd of the log width of a drawpoint's movement zone
STRAY = 8  # fewer loosened places than this in a level are no part of a zone's height
LUMP = 1.0  # mean size of what comes out at a time, in cells as high as a declared one


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


def drawn(ground, flow):
    """Readings (time, load_cell) in kPa: before draw, and at each mass drawn."""
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
    variance = lattice_variance(experiment["flow"]["exponent"]) / FINENESS
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
