"""Friction sheds another share under high stress than under low."""

from dataclasses import replace

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.grid import GRAVITY


def depend(state: State, values: Values) -> State:
    """Let the sweep take 1 − E by each cell's load."""
    experiment = state.experiment
    overburden = experiment.material.bulk_density * GRAVITY * experiment.geometry.height
    reference = 0.5 * overburden * state.lattice.cell_area
    coupling = state.coupling._replace(slope=values["slope"], reference=reference)
    return replace(state, coupling=coupling)


EFFECT = Effect(
    description="1 − E of a cell goes with a power of its stress; at the reference, half the "
    "overburden of the declared full bed, it is the calibrated one. The load at the base is then "
    "no longer linear in the weights.",
    equation="ln(1 − E(σ)) = ln(1 − E) + slope · ln(σ / σ_ref), σ_ref = ρ g H / 2, 1 − E(σ) ≤ 1",
    source="Castro et al. 2014: dilatancy and nonlinear friction at low stress",
    scope="material",
    parameters=(
        Parameter("slope", "1", 0.0, -2.0, 2.0, 0.3, 0, "slope of ln(1 − E) in ln stress"),
    ),
    moves="lowers readings above the reference stress and raises those below it",
    example={"slope": 0.5},
    state=depend,
)
