"""Moving ground sticks to the ground beside it."""

from dataclasses import replace

from pipeline.effects import Effect, Parameter, State, Values


def stick(state: State, values: Values) -> State:
    """Let the sweep hand load aside over the faces of the movement zone."""
    force = 1e3 * values["stress"] * state.lattice.cell_area
    return replace(state, coupling=state.coupling._replace(cohesion=force))


EFFECT = Effect(
    description="A movement-zone cell hands up to τ c² over each face that it shares with a "
    "stagnant cell of its level to that cell, and never more than it carries.",
    equation="ΔP = min(P / m, τ c²) for each of the m stagnant faces of a movement-zone cell",
    source="Sánchez et al. 2019, IJRMMS 114: above 6 % moisture fine ore does not flow",
    scope="material",
    parameters=(
        Parameter("stress", "kPa", 0.0, 0.0, 1e3, 0.1, 1, "cohesion τ on the zone's faces"),
    ),
    moves="raises readings in stagnant ground beside movement zones",
    example={"stress": 0.1},
    state=stick,
)
