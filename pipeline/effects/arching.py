"""What moving ground sheds rests on the ground beside it."""

from dataclasses import replace

from pipeline.effects import Effect, Parameter, State, Values


def arch(state: State, values: Values) -> State:
    """Let the sweep hand on the excess of each movement zone."""
    coupling = state.coupling._replace(
        zone_root=state.zone_root, own_shed=state.own_shed, transfer=values["transfer"]
    )
    return replace(state, coupling=coupling)


EFFECT = Effect(
    description="The load that a movement zone does not pass on, beyond what its cells would shed "
    "at rest, goes in equal shares to the stagnant cells that touch the zone one level below. "
    "Where none touch it, it stays shed.",
    equation="X_k = transfer · Σ_zone (E − E_min) P of level k; "
    "P_j ← P_j + X_k / m for the m stagnant cells j at the zone in level k − 1",
    source="Terzaghi 1943; Chevalier et al. 2009; Castro et al. 2020: 0.3 to 2.8 σ_v0",
    scope="study",
    parameters=(
        Parameter("transfer", "1", 0.0, 0.0, 1.0, 0.5, 1, "share of the excess that is handed on"),
    ),
    moves="raises readings in stagnant ground beside movement zones",
    example={"transfer": 0.8},
    order=10,
    state=arch,
)
