"""Walls carry a share of the bed."""

import math
from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import OUTSIDE


def rub(state: State, values: Values) -> State:
    """Shed the walls' share on top of 1 − E, in stagnant and in moving ground."""
    geometry = state.experiment.geometry
    angle = state.experiment.walls.friction_angle
    if values["cap"]:
        angle = min(angle, state.experiment.material.internal_friction_angle)
    friction = values["K"] * math.tan(math.radians(angle))  # of the vertical stress
    faces = state.lattice.cell_size / geometry.hydraulic_radius
    if values["reach"] == "face":
        faces = _wall_faces(state)
    share = -np.expm1(-friction * faces)

    def more(shed: np.ndarray) -> np.ndarray:
        return (shed + share * (1.0 - shed)).astype(shed.dtype)

    return replace(state, shed_fraction=more(state.shed_fraction), own_shed=more(state.own_shed))


def _wall_faces(state: State) -> np.ndarray:
    """Wall faces of each cell (z, y, x), the lattice's scaled to the declared walls.

    Sides of a box or cylinder of whole cells are rounded, and a cylinder's are stairs; there the
    faces add up to the declared perimeter over area. In any other ground each face counts as 1.
    """
    rock = np.pad(state.code == OUTSIDE, ((0, 0), (1, 1), (1, 1)), constant_values=True)
    faces = sum(
        rock[:, 1 + dy : rock.shape[1] - 1 + dy, 1 + dx : rock.shape[2] - 1 + dx].astype(float)
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1))
    )
    ground = state.code != OUTSIDE
    faces[~ground] = 0.0
    geometry = state.experiment.geometry
    if geometry.mask is None or geometry.diameter is not None:
        mean = state.lattice.cell_size / geometry.hydraulic_radius
        faces *= mean * ground.sum() / faces.sum()
    return faces


def needs(values: Values) -> tuple[str, ...]:
    """The wall's angle, and the material's where it caps the wall's."""
    capped = ("material.internal_friction_angle",) if values["cap"] else ()
    return ("walls.friction_angle", *capped)


EFFECT = Effect(
    description="Walls carry part of the bed by friction, K times the vertical stress pressing on "
    "them. reach: level takes it from all cells of a level in proportion (Janssen's assumption), "
    "reach: face from the cells at the wall alone. cap: true lets the wall be no rougher than the "
    "material is with itself.",
    equation="w = 1 − exp(−K tan φ_w c perimeter / area) of a level's load; "
    "face: 1 − exp(−K tan φ_w) for each wall face of a cell; 1 − E ← 1 − E (1 − w)",
    source="Janssen 1895; Marconi et al. 2000 for its reach",
    scope="material",
    parameters=(
        Parameter("K", "1", 0.0, 0.0, 5.0, 0.4, 1, "horizontal over vertical stress at the wall"),
    ),
    moves="lowers every reading, the more the narrower and higher the column",
    example={"K": 0.5},
    options={"reach": ("level", "face"), "cap": (False, True)},
    needs=needs,
    state=rub,
)
