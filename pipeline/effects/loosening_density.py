"""Flowing ground is looser than its parked voids say."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import MOVEMENT


def loosen(state: State, values: Values) -> State:
    """Lighter cells in the movement zone."""
    material = state.experiment.material
    solid = material.bulk_density / material.particle_density
    factor = max(1.0 - values["porosity_increase"] / solid, 0.0)
    return replace(
        state, weight=np.where(state.code == MOVEMENT, state.weight * factor, state.weight)
    )


EFFECT = Effect(
    description="The porosity n of movement-zone cells exceeds the declared bed's, beyond the "
    "voids that bulking parks there. The mass that they lose would stand above the bed and is not "
    "in the lattice.",
    equation="ρ_zone = ρ · (1 − n − porosity_increase) / (1 − n), n = 1 − ρ / ρ_particle",
    source="Gómez & Castro 2022, §2.2 and its references 71–73; MassFlow's maximum porosity",
    scope="study",
    parameters=(
        Parameter("porosity_increase", "1", 0.0, 0.0, 0.3, 0.05, 1, "added to n in moving ground"),
    ),
    moves="lowers readings under the movement zone",
    example={"porosity_increase": 0.1},
    state=loosen,
)
