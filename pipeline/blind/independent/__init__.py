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
from typing import Any

import numpy as np

from pipeline.blind.independent.continuum import as_continuum
from pipeline.blind.independent.draw import drawn
from pipeline.blind.independent.ground import Box, Ground, at_rest

Effects = Sequence[Mapping[str, Any]]  # each with name, scope_key (None: all) and parameters
Theta = Mapping[str, Any]  # E by material, s (std), R, E_min (shift of log(1 − E_min))


@dataclass(frozen=True)
class Physics:
    """How one laboratory's ground works.

    `receivers` of a cell's load in the level below; `law` of the scatter of their spread;
    `continuum`: static columns are no lattice. `spread` and `anisotropy` (x over y) are factors
    on the lateral variance of load paths, `zone` on the width of movement zones. The rest is what
    a lattice may have here too, as amplitudes: `shell` (ground at rest within 6 cm of a
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
        return as_continuum(experiment, theta, acting, physics, packing)
    box = Box(experiment, acting)
    ground = Ground(box, theta, acting, physics, packing)
    if "draw" not in experiment:
        levels = [level * box.height_factor for level in experiment["filling"]["levels"]]
        return np.array([at_rest(ground, level) for level in levels])
    return drawn(ground, flow)


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
