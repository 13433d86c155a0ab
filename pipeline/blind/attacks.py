"""Worlds written to fool the loop.

Each kind of attack is a plan for one world: what is injected, what is wrong with sensors, noise and
files, and which answers a user would accept. The answers are sealed with the truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from pipeline.blind import laboratory
from pipeline.blind.injection import AMPLITUDES, PHYSICS, World, effect_near, nearest, path_of
from pipeline.blind.truth import Added

ATTACKED = 8000  # index from which worlds are attacks, of all kinds in turn
NOTHING, UNEXPLAINED = "no_effect_detectable", "unexplained"
LOCAL_RULE = ("local_rule", None)
STRONG = 5.0  # joint shift, in sd, from which nothing detectable is no good answer
DELTA_RANGE = (8.0, 15.0)  # of physics beside which something is broken or wrongly declared
MIMIC_DELTA_RANGE = (4.0, 7.0)  # of each; farther, two that are alike drive each other
MIMICS = (  # beyond calibration, cosines of their shifts reach 0.5 to 0.9, either way
    "density_misdeclared",
    "stress_dependent_transmission",
    "surcharge",
    "wall_friction",
)
PATHS = 3  # of each, by its side and the material that has it, that may be the mimic

Claim = tuple[str, str | None]  # name of an effect (`*` for any ending), and what it belongs to
Rows = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Right:
    """Answers that a user would accept.

    One of `verdicts` (None: any), with all of `must_name` added and nothing beyond these and
    `may_name`.
    """

    verdicts: tuple[str, ...] | None = None
    must_name: tuple[Claim, ...] = ()
    may_name: tuple[Claim, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What is done to one world.

    Attributes
    ----------
    details : what is wrong apart from the injected effects, as JSON-able data
    right : from the injected effects, and how far all of them together move the readings
    documents : experiments as they truly are, where that is not what is declared
    effects : what is injected
    misread : change the `reading` of rows in place, as a load cell with a fault beyond the
        catalogue does
    noise : of a row: true over declared noise, of what a load cell's readings share, and of each
    misfile : change the `measured` of rows in place, as a wrong file does
    """

    right: Callable[[Sequence[Added], float], Right] = lambda added, joint: Right()
    details: Mapping[str, Any] = field(default_factory=dict)
    documents: Callable[[dict], dict] = lambda declared: declared
    effects: Callable[[World, np.random.Generator], tuple[Added, ...]] = lambda world, choice: ()
    misread: Callable[[Rows], None] = lambda rows: None
    noise: Callable[[Mapping[str, Any]], tuple[float, float]] = lambda row: (1.0, 1.0)
    misfile: Callable[[Rows], None] = lambda rows: None


@dataclass(frozen=True)
class Attack:
    """A kind of attack: `words` what it does, `wanted` the answers that a user would accept."""

    words: str
    wanted: str
    plan: Callable[[Mapping[str, Any], np.random.Generator], Plan]


def attack_of(index: int) -> str:
    """Name of the attack of a world."""
    return list(ATTACKS)[(index - ATTACKED) % len(ATTACKS)]


# ---------------------------------------------------------------------------------------------
# noise that is not as declared


def _noise_everywhere(documents, choice) -> Plan:
    times = float(choice.uniform(2.0, 3.0))
    return Plan(
        right=lambda added, joint: Right((NOTHING, UNEXPLAINED)),
        details={"true_over_declared": times},
        noise=lambda row: (times, times),
    )


def _noise_shared(documents, choice) -> Plan:
    times = float(choice.uniform(2.0, 3.0))
    return Plan(
        right=lambda added, joint: Right((NOTHING, UNEXPLAINED)),
        details={"true_over_declared": times},
        noise=lambda row: (times, 1.0),
    )


def _noise_of_one_cell(documents, choice) -> Plan:
    times, broken = float(choice.uniform(2.0, 3.0)), _load_cell(documents, choice)
    return Plan(
        right=lambda added, joint: Right(may_name=(("sensor_*", broken),)),
        details={"true_over_declared": times, "load_cell": broken},
        noise=lambda row: (times, times) if row["load_cell"] == broken else (1.0, 1.0),
    )


# ---------------------------------------------------------------------------------------------
# effects that hide


def _alike(documents, choice) -> Plan:
    return Plan(right=_nothing_wrong, effects=lambda world, choice: _mimics(world, choice, 1.0))


def _cancelling(documents, choice) -> Plan:
    return Plan(right=_nothing_wrong, effects=lambda world, choice: _mimics(world, choice, -1.0))


def _mimics(world: World, choice, side: float) -> tuple[Added, Added]:
    """Two effects of the catalogue, moved as far, of which the second is the most like the first.

    `side` is 1 for a shift like that of the first, and −1 for one like its opposite.
    """
    log_delta = choice.uniform(*np.log(MIMIC_DELTA_RANGE))
    first = effect_near(world, MIMICS, choice, log_delta)
    names = [name for name in MIMICS if name != first.name]
    paths = [path_of(world, name, choice) for name in names for _ in range(PATHS)]
    reached = [max(world.delta(path(1.0)), 0.05) for path in paths]
    enough = min(0.5 * math.exp(log_delta), max(reached))
    strong = [(p, delta) for p, delta in zip(paths, reached, strict=True) if delta >= enough]
    about = [path(min(math.exp(log_delta) / delta, 1.0)) for path, delta in strong]
    path, delta = strong[int(np.argmax(side * np.array(world.likeness(first, about))))]
    return first, nearest(world, path, delta, log_delta)


def _nothing_wrong(added: Sequence[Added], joint: float) -> Right:
    verdicts = ("effect", "ambiguous", "unknown_effect", UNEXPLAINED)
    if joint < STRONG:
        verdicts = (*verdicts, NOTHING)
    return Right(verdicts, may_name=(*_claims(added), LOCAL_RULE))


def _held_out_only(documents, choice) -> Plan:
    where = str(choice.choice(laboratory.HELD_OUT))
    drawn = "draw" in documents[where]
    names = ("arching", "pillar_relaxation") if drawn else ("surcharge", "wall_friction")
    name, part = str(choice.choice(names)), float(choice.uniform(0.8, 1.0))
    parameter, _, high = AMPLITUDES[name]
    return Plan(
        right=lambda added, joint: Right((NOTHING,)),
        effects=lambda world, choice: (Added(name, where, {parameter: part * high}),),
    )


# ---------------------------------------------------------------------------------------------
# physics beside something broken


def _physics(world: World, choice) -> Added:
    return effect_near(world, PHYSICS, choice, choice.uniform(*np.log(DELTA_RANGE)))


def _gain_beside(documents, choice) -> Plan:
    fault = Added("sensor_gain", _load_cell(documents, choice), {"gain": 0.5})
    return Plan(
        right=lambda added, joint: Right(must_name=_claims(added)),
        effects=lambda world, choice: (_physics(world, choice), fault),
    )


def _stuck_beside(documents, choice) -> Plan:
    broken = _load_cell(documents, choice)

    def misread(rows: Rows) -> None:
        first: dict[str, float] = {}
        for row in rows:
            if row["load_cell"] == broken:
                row["reading"] = first.setdefault(row["experiment"], row["reading"])

    return Plan(
        right=lambda added, joint: Right(must_name=(*_claims(added), ("sensor_*", broken))),
        details={"load_cell": broken},
        effects=lambda world, choice: (_physics(world, choice),),
        misread=misread,
    )


# ---------------------------------------------------------------------------------------------
# files that say what is not so


def _wrong_angle(documents, choice) -> Plan:
    material = str(choice.choice(list(laboratory.MATERIALS)))
    angle = float(choice.uniform(12.0, 16.0))

    def truly(declared: dict) -> dict:
        """The material is no rougher with the wall than with itself."""
        documents = deepcopy(declared)
        for document in documents.values():
            if document["material"]["name"] == material:
                document["material"]["internal_friction_angle"] = angle
                document["walls"]["friction_angle"] = min(
                    angle, document["walls"]["friction_angle"]
                )
        return documents

    def effects(world: World, choice) -> tuple[Added]:
        def path(part: float) -> Added:
            return Added("wall_friction", material, {"K": AMPLITUDES["wall_friction"][2] * part})

        log_delta = choice.uniform(*np.log(DELTA_RANGE))
        return (nearest(world, path, max(world.delta(path(1.0)), 0.05), log_delta),)

    return Plan(
        right=_nothing_wrong,
        details={"material": material, "true_internal_friction_angle": angle},
        documents=truly,
        effects=effects,
    )


def _exchanged(documents, choice) -> Plan:
    fitted = [name for name in documents if name not in laboratory.HELD_OUT]
    pairs = [
        (one, other)
        for one, other in combinations(fitted, 2)
        if all(documents[one].get(k) == documents[other].get(k) for k in ("load_cells", "filling"))
        and "draw" not in documents[one]
        and "draw" not in documents[other]
    ]
    pair = pairs[int(choice.integers(len(pairs)))]

    def misfile(rows: Rows) -> None:
        parts = [[row for row in rows if row["experiment"] == name] for name in pair]
        for one, other in zip(*parts, strict=True):
            one["measured"], other["measured"] = other["measured"], one["measured"]

    return Plan(
        right=lambda added, joint: Right(may_name=(LOCAL_RULE,)),
        details={"experiments": list(pair)},
        misfile=misfile,
    )


def _claims(added: Sequence[Added]) -> tuple[Claim, ...]:
    return tuple((one.name, one.scope_key) for one in added)


def _load_cell(documents, choice) -> str:
    cells = {cell["name"] for document in documents.values() for cell in document["load_cells"]}
    return str(choice.choice(sorted(cells)))


ATTACKS = {
    "noise_everywhere": Attack(
        "Nothing is missing; all noise is 2 to 3 times what is declared.",
        "nothing detectable, or unexplained",
        _noise_everywhere,
    ),
    "noise_shared": Attack(
        "Nothing is missing; what the readings of one load cell share is 2 to 3 times what is "
        "declared, the rest as declared.",
        "nothing detectable, or unexplained",
        _noise_shared,
    ),
    "noise_of_one_cell": Attack(
        "Nothing is missing; the noise of one load cell, in all experiments, is 2 to 3 times what "
        "is declared.",
        "no effect named but a fault of that very load cell, and no rule",
        _noise_of_one_cell,
    ),
    "mimics_alike": Attack(
        "Two effects as strong as each other whose shifts of the readings are as alike as the "
        "catalogue has them.",
        "none named that is not there; not nothing where the two move the readings by 5 sd",
        _alike,
    ),
    "mimics_cancelling": Attack(
        "Two effects as strong as each other of which one undoes what it can of the other.",
        "none named that is not there; not nothing where the two move the readings by 5 sd",
        _cancelling,
    ),
    "held_out_only": Attack(
        "An effect that acts in one experiment alone, and that one is held out.",
        "nothing detectable",
        _held_out_only,
    ),
    "gain_beside_physics": Attack(
        "A real effect, and one load cell that reads half of what is there.",
        "both named, nothing else",
        _gain_beside,
    ),
    "stuck_beside_physics": Attack(
        "A real effect, and one load cell that stays at the first reading of each experiment: no "
        "fault of the catalogue.",
        "the effect named, and some fault of that load cell, nothing else",
        _stuck_beside,
    ),
    "wrong_angle": Attack(
        "Wall friction of a material that slides on itself at 12° to 16°, and so on any wall; its "
        "angles are declared twice as large.",
        "none named but wall friction of that material; not nothing where it moves the readings by "
        "5 sd",
        _wrong_angle,
    ),
    "exchanged_files": Attack(
        "Nothing is missing; the readings of two columns with the same load cells and levels, of "
        "the two materials, are filed under each other's name.",
        "no effect of the catalogue named",
        _exchanged,
    ),
}
"""Attacks by name; new ones go last, as their place is that of their worlds."""
