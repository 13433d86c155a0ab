"""Effects: what the model may lack, one file each, found by being in this folder.

A module `NAME.py` here with an `EFFECT = Effect(...)` is the effect NAME. It acts at the stages
whose functions it gives; each takes what a kernel will get and the effect's values, and returns a
changed copy. With every parameter neutral an effect is not called at all, so it changes no bit.

Stages, in this order; within one, by `order` and then by name, whatever the order in a config:

1. `geometry` (height m) → height m: the filling as it truly was.
2. `packing` (`Packing`) → `Packing`: cells before draw, for each replicate.
3. `state` (`State`) → `State`: the lattice at a reading, as the sweep will take it.
4. `readings` (`Reading`) → stresses (time, load_cell) kPa: the sensors.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Literal

import numpy as np

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    `scale` is the prior's, in `unit`: amplitudes beyond a few of it would surprise. `sign` is +1
    or −1 where physics fixes the side of `neutral` on which it can lie, else 0.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    scale: float
    sign: int
    words: str


@dataclass(frozen=True)
class Effect:
    """Description and action of an effect; see the module's docstring for the stages.

    `scope` says what shares one value: study, material, experiment or load_cell. `moves` says in
    words what a larger value does to readings. `options` are choices by name, the first one the
    default. `example` has non-neutral values that show what the effect does. `needs` gives the
    keys that an experiment must declare for it (`walls.friction_angle`), from the effect's values.
    `kind` says what it would mean to find it: physics that the model lacks, an input that was
    declared wrong, a sensor at fault, or a rule that no other effect stands for. `moves_mean` is
    False for an effect on the scatter alone, of which no mean reading tells.
    """

    description: str
    equation: str
    source: str
    scope: str
    parameters: tuple[Parameter, ...]
    moves: str
    example: Values
    options: Mapping[str, tuple] = field(default_factory=dict)
    needs: Callable[[Values], tuple[str, ...]] = lambda values: ()
    kind: Literal["physics", "input", "sensor", "rule"] = "physics"
    moves_mean: bool = True
    order: int = 0
    geometry: Callable[[float, Values], float] | None = None
    packing: Callable[[Packing, Values], Packing] | None = None
    state: Callable[[State, Values], State] | None = None
    readings: Callable[[Reading, Values], np.ndarray] | None = None

    @property
    def neutral(self) -> dict[str, Any]:
        """Values with which the effect is off."""
        values = {parameter.name: parameter.neutral for parameter in self.parameters}
        return values | {name: choices[0] for name, choices in self.options.items()}


@dataclass(frozen=True)
class Active:
    """An effect switched on with `values`; `load_cell` where it belongs to one."""

    name: str
    values: Values
    load_cell: str | None = None

    @property
    def effect(self) -> Effect:
        """Its description and action."""
        return effects()[self.name]

    @property
    def is_neutral(self) -> bool:
        """Whether it changes nothing."""
        return all(self.values[p.name] == p.neutral for p in self.effect.parameters)


@dataclass(frozen=True)
class Packing:
    """Cells of one replicate before draw, by cell identity (flat, the index into (z, y, x)).

    `code` (z, y, x) are the cell codes. `weight` (N) and `shed_fraction` (1 − E; one number where
    all cells shed alike) belong to the cell and travel with it, as does the
    shift `s_shift` of its spreading exponent. `persistence` is the share of a place's weights β
    that stays when another cell moves in. `random` is the root of the effects' streams.
    """

    experiment: Any
    lattice: Any
    code: np.ndarray
    weight: np.ndarray
    shed_fraction: np.ndarray | np.floating
    s_shift: np.ndarray | float
    persistence: float
    random: np.random.Generator

    def stream(self, name: str) -> np.random.Generator:
        """The stream of the effect `name`, the same whichever other effects are on."""
        seed = self.random.bit_generator.seed_seq
        key = (*seed.spawn_key, zlib.crc32(name.encode()))
        return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))


@dataclass(frozen=True)
class State:
    """The lattice at one reading; arrays (z, y, x) over the filled levels.

    `zone` is the drawpoint whose void loosened a place, `zone_root` the label of the connected
    movement zone that it belongs to (−1: none) and `zone_height` (label) its height in m;
    `own_shed` is 1 − E of the cell as in stagnant ground; `steps_at_rest` counts the increments
    drawn since a cell was last seen to come to the place. `weight`, `shed_fraction`, `edge`,
    `corner` and `coupling` are what the sweep takes.
    """

    experiment: Any
    lattice: Any
    code: np.ndarray
    zone: np.ndarray
    zone_root: np.ndarray
    zone_height: np.ndarray
    own_shed: np.ndarray
    steps_at_rest: np.ndarray
    relaxation: float
    weight: np.ndarray
    shed_fraction: np.ndarray
    edge: np.ndarray
    corner: np.ndarray
    coupling: Any


@dataclass(frozen=True)
class Reading:
    """Stresses of the load cells (time, load_cell) in kPa, as the ground has them.

    `column` is the load cell that the effect belongs to; `mass_drawn` (time) in kg, zeros in a
    static experiment.
    """

    stress: np.ndarray
    column: int
    mass_drawn: np.ndarray


@cache
def effects() -> dict[str, Effect]:
    """All effects by name, sorted."""
    names = sorted(m.name for m in iter_modules(__path__) if not m.name.startswith("_"))
    return {name: import_module(f"{__name__}.{name}").EFFECT for name in names}


def lacking(effect: Effect, experiment: Any, values: Values) -> tuple[str, ...]:
    """Keys that the effect needs and the experiment does not declare; () where it can act."""
    missing = []
    for key in effect.needs(values):
        found = experiment
        for part in key.split("."):
            found = getattr(found, part, None)
        if found is None:
            missing.append(key)
    return tuple(missing)


def declared_effects(experiment: Any) -> tuple[Active, ...]:
    """Effects of an experiment's `effects:` block, in the order in which they act."""
    active = []
    for name, given in experiment.effects.items():
        effect = effects()[name]
        if effect.scope == "load_cell":
            active += [
                Active(name, effect.neutral | dict(values), cell) for cell, values in given.items()
            ]
        else:
            active.append(Active(name, effect.neutral | dict(given)))
    return ordered(active)


def ordered(active: list[Active] | tuple[Active, ...]) -> tuple[Active, ...]:
    """Effects in the order in which they act, whatever the order given."""
    return tuple(sorted(active, key=lambda a: (a.effect.order, a.name, a.load_cell or "")))


def apply(active: tuple[Active, ...], stage: str, subject: Any) -> Any:
    """Send `subject` through the stage of every effect that is not neutral."""
    for one in active:
        action = getattr(one.effect, stage)
        if action is not None and not one.is_neutral:
            subject = action(subject, one.values)
    return subject


def as_filled(experiment: Any, active: tuple[Active, ...] | None = None) -> Any:
    """The experiment with the height to which it truly was filled, where effects say so.

    The boxes of its regions are stretched with it. `active` replace the effects that the
    experiment declares.
    """
    active = declared_effects(experiment) if active is None else active
    declared = experiment.geometry.height
    height = float(apply(active, "geometry", declared))
    if height == declared:
        return experiment
    geometry = experiment.geometry.model_copy(update={"height": height})
    regions = tuple(region.stretched(height / declared) for region in experiment.regions)
    return experiment.model_copy(update={"geometry": geometry, "regions": regions})
