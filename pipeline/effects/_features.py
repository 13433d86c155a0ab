"""Features of places in the ground, for rules that hold in a part of it.

Each takes a `State` and returns φ (z, y, x): 0 where the rule does not act, 1 (or −1) where it acts
in full; it is the same for every replicate as long as nothing is drawn. The first line of its
docstring says in words where that is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.effects import State
from pipeline.effects.pillar_relaxation import nearest, value_at
from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT

SHELL = 2.5  # cells: how far the surroundings of a movement zone or of an opening reach
NEAR = 4.0  # cells over which what decays with distance falls by e

Feature = Callable[[State], np.ndarray]


def _height(state: State) -> np.ndarray:
    """Relative height of each level, 0 at the base and 1 at the declared top, (z, 1, 1)."""
    nz = state.code.shape[0]
    relative = (np.arange(nz) + 0.5) * state.lattice.cell_size / state.experiment.geometry.height
    return np.minimum(relative, 1.0)[:, None, None]


def _across(state: State, axis: int) -> np.ndarray:
    """−1 at the low end of a horizontal axis and 1 at its high end, as it broadcasts."""
    count = state.code.shape[axis]
    place = (2.0 * np.arange(count) + 1.0) / count - 1.0
    return place.reshape([-1 if i == axis else 1 for i in range(3)])


def _beside_rock(state: State, axis: int, step: int) -> np.ndarray:
    """Places whose neighbor along an axis is outside the ground."""
    rock = np.pad(state.code == OUTSIDE, 1, constant_values=True)
    return np.roll(rock, -step, axis)[1:-1, 1:-1, 1:-1].astype(float)


def _zone(state: State) -> np.ndarray:
    return state.code == MOVEMENT


def _distance(found: np.ndarray) -> np.ndarray:
    """Distance to the nearest place found, cells; infinite where there is none."""
    if not found.any():
        return np.full(found.shape, np.inf)
    from scipy.ndimage import distance_transform_edt

    return distance_transform_edt(~found)


def _to_zone(state: State) -> np.ndarray:
    return _distance(state.zone >= 0)


def beside_zones(state: State) -> np.ndarray:
    """in stagnant ground while there is a movement zone"""
    return (state.code == STAGNANT) * float((state.zone >= 0).any())


def walls(state: State) -> np.ndarray:
    """at all walls"""
    faces = [_beside_rock(state, axis, step) for axis in (1, 2) for step in (-1, 1)]
    return np.maximum.reduce(faces)


def west_wall(state: State) -> np.ndarray:
    """at the wall where x = 0"""
    return _beside_rock(state, 2, -1)


def east_wall(state: State) -> np.ndarray:
    """at the wall opposite to x = 0"""
    return _beside_rock(state, 2, 1)


def south_wall(state: State) -> np.ndarray:
    """at the wall where y = 0"""
    return _beside_rock(state, 1, -1)


def north_wall(state: State) -> np.ndarray:
    """at the wall opposite to y = 0"""
    return _beside_rock(state, 1, 1)


def height(state: State) -> np.ndarray:
    """in proportion to height, from −1 at the base to 1 at the top"""
    return 2.0 * _height(state) - 1.0


def floor(state: State) -> np.ndarray:
    """in the lowest tenth"""
    return 1.0 * (_height(state) < 0.1)


def lower_third(state: State) -> np.ndarray:
    """in the lower third"""
    return 1.0 * (_height(state) < 1 / 3)


def middle_third(state: State) -> np.ndarray:
    """in the middle third"""
    return 1.0 * (np.abs(_height(state) - 0.5) < 1 / 6)


def upper_third(state: State) -> np.ndarray:
    """in the upper third"""
    return 1.0 * (_height(state) > 2 / 3)


def surface(state: State) -> np.ndarray:
    """within a tenth of the height below the surface"""
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    above = np.cumsum(granular[::-1], axis=0)[::-1] - 0.5
    depth = above * state.lattice.cell_size / state.experiment.geometry.height
    return 1.0 * (granular & (depth < 0.1))


def along_x(state: State) -> np.ndarray:
    """in proportion to x, from −1 at one side to 1 at the other"""
    return _across(state, 2)


def along_y(state: State) -> np.ndarray:
    """in proportion to y, from −1 at one side to 1 at the other"""
    return _across(state, 1)


def middle(state: State) -> np.ndarray:
    """in the middle half along x"""
    return 1.0 * (np.abs(_across(state, 2)) < 0.5)


def zone(state: State) -> np.ndarray:
    """in the movement zone"""
    return 1.0 * _zone(state)


def zone_floor(state: State) -> np.ndarray:
    """in the movement zone, near the base"""
    return _zone(state) * (_height(state) < 0.15)


def zone_top(state: State) -> np.ndarray:
    """in the upper third of the movement zone"""
    heights = np.append(state.zone_height, np.inf)[state.zone]  # zone −1: the entry appended
    z = _height(state) * state.experiment.geometry.height
    return _zone(state) * (z > 2 / 3 * heights)


def zone_edge(state: State) -> np.ndarray:
    """in the movement zone, beside stagnant ground"""
    return _zone(state) * (_distance(state.code == STAGNANT) < 1.5)


def resting_zone(state: State) -> np.ndarray:
    """in the movement zone, where nothing has moved of late"""
    rest = state.steps_at_rest / max(float(state.steps_at_rest.max()), 1.0)
    return _zone(state) * np.broadcast_to(rest, state.code.shape)


def shell(state: State) -> np.ndarray:
    """in the stagnant shell around the movement zone"""
    return (state.code == STAGNANT) * (_to_zone(state) < SHELL)


def near_zone(state: State) -> np.ndarray:
    """in stagnant ground, the more the nearer the movement zone"""
    return (state.code == STAGNANT) * np.exp(-_to_zone(state) / NEAR)


def above_zone(state: State) -> np.ndarray:
    """in stagnant ground straight above the movement zone"""
    below = np.cumsum(state.zone >= 0, axis=0) > 0
    return 1.0 * ((state.code == STAGNANT) & below)


def pillar(state: State) -> np.ndarray:
    """in stagnant ground between the movement zones of two drawpoints"""
    found = np.zeros(state.code.shape, dtype=bool)
    for axis in (1, 2):
        zone = np.moveaxis(state.zone, axis, -1)
        left, right = (value_at(zone, place, -1) for place in nearest(zone >= 0))
        found |= np.moveaxis((left >= 0) & (right >= 0) & (left != right), -1, axis)
    return 1.0 * (found & (state.code == STAGNANT))


def brow(state: State) -> np.ndarray:
    """around the drawpoints"""
    lattice, openings = state.lattice, np.ones(state.code.shape, dtype=bool)
    if not state.experiment.is_draw:
        return np.zeros(state.code.shape)
    areas = (lattice.covered_area(p.x, p.y, p.width, p.length) for p in state.experiment.drawpoints)
    openings[0] = sum(areas) < 0.5 * lattice.cell_area
    return 1.0 * (_distance(~openings) < SHELL)


def growth(state: State) -> np.ndarray:
    """everywhere, in proportion to the share of the ground that has moved"""
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    return granular * float((state.zone >= 0).mean())


FEATURES: dict[str, Feature] = {
    feature.__name__: feature
    for feature in (
        walls,
        west_wall,
        east_wall,
        south_wall,
        north_wall,
        height,
        floor,
        lower_third,
        middle_third,
        upper_third,
        surface,
        along_x,
        along_y,
        middle,
        zone,
        zone_floor,
        zone_top,
        zone_edge,
        resting_zone,
        shell,
        near_zone,
        above_zone,
        pillar,
        brow,
        growth,
        beside_zones,
    )
}
