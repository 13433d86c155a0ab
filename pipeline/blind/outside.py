"""What may be missing and no catalogue holds: effects that only the blind benchmark knows.

They act on the package's lattice through the stages of an effect, see `pipeline.effects`, or on the
parameters of a run, and are no files of the catalogue. Each has one amplitude, 0 where it is off.
Lengths m; places are those of the laboratory's boxes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT, STAGNANT
from pipeline.parameters import Parameters


def _as_they_are(parameters: Parameters, values: Values) -> Parameters:
    return parameters


@dataclass(frozen=True)
class Kind:
    """An effect outside the catalogue.

    `words` says what it is; `channel` is what a local rule that describes it would change (E,
    weight or R; None: any) and `place` where, in words of which it should use one; `low` to `high`
    is the range of its amplitude.
    """

    words: str
    channel: str | None
    place: tuple[str, ...]
    low: float
    high: float
    state: Callable[[State, Values], State] | None = None
    parameters: Callable[[Parameters, Values], Parameters] = _as_they_are

    @property
    def effect(self) -> Effect:
        """The same with the interface of the catalogue's effects."""
        amplitude = Parameter(
            "amplitude", "1", 0.0, self.low, self.high, self.high, 0, "how strong"
        )
        return Effect(
            description=self.words,
            equation="",
            source="blind benchmark",
            scope="study",
            parameters=(amplitude,),
            moves="",
            example={"amplitude": self.high},
            order=20,
            state=self.state,
        )


@dataclass(frozen=True)
class Injected:
    """A kind of `OUTSIDE` switched on: in place of `pipeline.effects.Active` in a setup."""

    name: str
    values: Mapping[str, float]
    load_cell: None = None

    @property
    def kind(self) -> Kind:
        """What it is."""
        return OUTSIDE[self.name]

    @property
    def effect(self) -> Effect:
        """Its action."""
        return self.kind.effect

    @property
    def is_neutral(self) -> bool:
        """Whether it changes nothing."""
        return self.values["amplitude"] == 0.0


# ---------------------------------------------------------------------------------------------
# places


def _x(state: State) -> np.ndarray:
    return ((np.arange(state.code.shape[2]) + 0.5) * state.lattice.cell_size)[None, None, :]


def _y(state: State) -> np.ndarray:
    return ((np.arange(state.code.shape[1]) + 0.5) * state.lattice.cell_size)[None, :, None]


def _z(state: State) -> np.ndarray:
    return ((np.arange(state.code.shape[0]) + 0.5) * state.lattice.cell_size)[:, None, None]


def _near_zone(state: State, reach: float) -> np.ndarray:
    """Ground at rest within `reach` of a movement zone."""
    moving = state.zone >= 0
    if not moving.any():
        return moving
    distance = ndimage.distance_transform_edt(~moving, sampling=state.lattice.cell_size)
    return (state.code == STAGNANT) & (distance <= reach)


def _shed_more(state: State, factor: np.ndarray) -> State:
    """1 − E times a factor (z, y, x), never above 1."""
    shed = np.minimum(state.shed_fraction * np.broadcast_to(factor, state.code.shape), 1.0)
    return replace(state, shed_fraction=shed)


def _drawn_openings(state: State) -> list[tuple[float, float]]:
    """Centers (x, y) of the drawpoints that anything came out of."""
    labels = set(np.unique(state.zone)) - {-1}
    return [(p.x, p.y) for i, p in enumerate(state.experiment.drawpoints) if i in labels]


# ---------------------------------------------------------------------------------------------
# what they do


def _widen(parameters: Parameters, values: Values) -> Parameters:
    """The flow exponent whose voids spread (1 + amplitude) times as wide."""
    if parameters.exponent is None:
        return parameters

    def variance(exponent):
        edge, corner = 2.0 ** (-0.5 * exponent), 3.0 ** (-0.5 * exponent)
        return (2 * edge + 4 * corner) / (1 + 4 * edge + 4 * corner)

    wanted = variance(parameters.exponent) * (1.0 + values["amplitude"]) ** 2
    exponents = np.linspace(20.0, -8.0, 2000)
    return replace(parameters, exponent=float(np.interp(wanted, variance(exponents), exponents)))


def _shell(state: State, values: Values) -> State:
    return _shed_more(state, 1.0 + values["amplitude"] * _near_zone(state, 0.065))


def _brow(state: State, values: Values) -> State:
    near = np.zeros(state.code.shape, dtype=bool)
    for x, y in _drawn_openings(state):
        near |= (_x(state) - x) ** 2 + (_y(state) - y) ** 2 + _z(state) ** 2 <= 0.13**2
    return _shed_more(state, 1.0 + values["amplitude"] * near)


def _crater(state: State, values: Values) -> State:
    weight = state.weight.copy()
    height = state.experiment.geometry.height
    for x, y in _drawn_openings(state):
        away = np.sqrt((_x(state) - x) ** 2 + (_y(state) - y) ** 2)
        weight *= 1.0 - values["amplitude"] * (_z(state) > height - 0.45 + away)
    return replace(state, weight=weight)


def _inclusion(state: State, values: Values) -> State:
    g = state.experiment.geometry
    off_x, off_z = (_x(state) - 0.35 * g.width) / 0.09, (_z(state) - 0.45) / 0.12
    inside = (off_x**2 + off_z**2 + 0.0 * _y(state)) <= 1.0
    spread = 1.0 - 0.95 * inside
    state = _shed_more(state, 1.0 + values["amplitude"] * inside)
    return replace(state, edge=state.edge * spread, corner=state.corner * spread)


def _rough_wall(state: State, values: Values) -> State:
    return _shed_more(state, 1.0 + values["amplitude"] * (_x(state) < 0.07))


def _weak_band(state: State, values: Values) -> State:
    return _shed_more(state, 1.0 + values["amplitude"] * (np.abs(_z(state) - 0.60) < 0.12))


def _soft_floor(state: State, values: Values) -> State:
    width = state.experiment.geometry.width
    patch = (_z(state) < 0.10) & (np.abs(_x(state) - 0.75 * width) < 0.12 * width)
    return _shed_more(state, 1.0 + values["amplitude"] * patch)


def _creep(state: State, values: Values) -> State:
    """Ground that has stood still since draw began sheds more the longer draw goes on."""
    if not state.experiment.is_draw:
        return state
    steps = state.steps_at_rest * (state.code == STAGNANT)
    return _shed_more(state, 1.0 + values["amplitude"] * steps / 60.0)


def _neighbor(state: State, values: Values) -> State:
    """A drawpoint that nobody reports, behind the wall at the far end of x."""
    g = state.experiment.geometry
    near = np.exp(-(g.width - _x(state)) / 0.10) * ((_z(state) > 0.15) & (_z(state) < 1.2))
    return _shed_more(state, 1.0 + values["amplitude"] * near)


def _heap(state: State, values: Values) -> State:
    """A heap on the low end of x: kPa on the surface, falling to nothing in the middle."""
    granular = (state.code == STAGNANT) | (state.code == MOVEMENT)
    top = state.code.shape[0] - 1 - np.argmax(granular[::-1], axis=0)
    y, x = np.nonzero(granular.any(axis=0))
    width = state.experiment.geometry.width
    stress = values["amplitude"] * np.maximum(1.0 - _x(state)[0, 0] / (0.5 * width), 0.0)
    weight = state.weight.copy()
    weight[top[y, x], y, x] += 1e3 * stress[x] * state.lattice.cell_area
    return replace(state, weight=weight)


def _bridge(state: State, values: Values) -> State:
    """A stable arch in the moving ground: it sheds more in one band of heights."""
    inside = (state.code == MOVEMENT) & (np.abs(_z(state) - 0.54) < 0.10)
    return _shed_more(state, 1.0 + values["amplitude"] * inside)


def _weights(state: State, values: Values) -> State:
    """Other neighbor weights: those of the edges grow and those of the corners fall, or back."""
    factor = math.exp(values["amplitude"])
    return replace(state, edge=state.edge * factor, corner=state.corner / factor)


def _wet_top(state: State, values: Values) -> State:
    """Water in the top of the bed: heavier, and the same at every fill level."""
    height = state.code.shape[0] * state.lattice.cell_size
    factor = 1.0 + values["amplitude"] * (_z(state) > height - 0.30)
    return replace(state, weight=state.weight * factor)


OUTSIDE = {
    "wide_zone": Kind(
        "movement zones are wider or narrower for their height than flow was calibrated to",
        None,
        ("movement zone", "zone", "shell", "boundary", "edge of"),
        -0.30,
        0.30,
        parameters=_widen,
    ),
    "loosened_shell": Kind(
        "ground at rest within 6.5 cm of a movement zone is loosened and sheds more",
        "E",
        ("shell", "around the movement zone", "near the movement zone", "distance to"),
        0.0,
        12.0,
        state=_shell,
    ),
    "brow_shedding": Kind(
        "the brows of working drawpoints take load from the ground above",
        "E",
        ("brow", "drawpoint", "floor", "shell"),
        0.0,
        40.0,
        state=_brow,
    ),
    "surface_crater": Kind(
        "a loose crater at the surface above each working drawpoint",
        "weight",
        ("crater", "surface", "top"),
        0.0,
        0.9,
        state=_crater,
    ),
    "stiff_inclusion": Kind(
        "a body in the bed that passes its load straight down, and some of it aside to the frame",
        "E",
        ("inclusion", "lateral", "block", "position", "band"),
        0.0,
        30.0,
        state=_inclusion,
    ),
    "one_rough_wall": Kind(
        "the wall at the low end of x is rougher than the others",
        "E",
        ("wall",),
        0.0,
        20.0,
        state=_rough_wall,
    ),
    "weak_depth_band": Kind(
        "a band between 0.48 m and 0.72 m above the base sheds more",
        "E",
        ("band", "depth", "height"),
        -0.9,
        6.0,
        state=_weak_band,
    ),
    "soft_floor": Kind(
        "a soft patch of floor at three quarters of the width",
        "E",
        ("floor", "lateral", "position"),
        0.0,
        30.0,
        state=_soft_floor,
    ),
    "creep": Kind(
        "ground at rest sheds more the longer draw goes on",
        "E",
        ("time", "drawn", "rest"),
        -0.9,
        4.0,
        state=_creep,
    ),
    "hidden_neighbor": Kind(
        "the stress shadow of a drawpoint behind the wall at the high end of x",
        "E",
        ("wall", "lateral", "position"),
        0.0,
        10.0,
        state=_neighbor,
    ),
    "heap": Kind(
        "a heap of ground on one end of the surface",
        "weight",
        ("surface", "top", "lateral", "wall", "position"),
        0.0,
        6.0,
        state=_heap,
    ),
    "bridge": Kind(
        "a stable arch in moving ground, 0.44 m to 0.64 m above the base",
        "E",
        ("band", "movement zone", "height"),
        -0.9,
        10.0,
        state=_bridge,
    ),
    "other_weights": Kind(
        "load spreads by other neighbor weights",
        None,
        ("weights", "spread"),
        -1.5,
        1.5,
        state=_weights,
    ),
    "wet_top": Kind(
        "the uppermost 0.3 m of the bed are wet and heavier, at every fill level",
        "weight",
        ("surface", "top", "depth"),
        0.0,
        0.8,
        state=_wet_top,
    ),
}
"""Kinds by name."""
