"""Force chains in ground at rest relax while its neighbor is drawn."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.lattice.cells import STAGNANT


def relax(state: State, values: Values) -> State:
    """Lower the straight share of stagnant cells by their steps at rest."""
    kept = np.exp(-values["rate"] * state.steps_at_rest)
    aside = 4.0 * (state.edge.astype(np.float64) + state.corner)  # over the weight straight down
    decayed = (state.code == STAGNANT) & (kept < 1.0)
    whole = np.where(decayed, 1.0 + aside - kept, 1.0)
    factor = np.where(decayed, kept * aside / whole, 1.0).astype(np.float32)
    return replace(state, coupling=state.coupling._replace(straight=factor))


EFFECT = Effect(
    description="The share of its load that a stagnant cell passes straight down decays with the "
    "increments drawn since it last moved; the rest goes to its other receivers in proportion.",
    equation="β_down ← β_down exp(−rate · steps), the other β scaled so that all add up to 1",
    source="Løvoll et al. 1999, Phys. Rev. E 60; McNulty 1965 (WES TR 1-674)",
    scope="study",
    parameters=(Parameter("rate", "1", 0.0, 0.0, 10.0, 0.01, 1, "decay for each increment drawn"),),
    moves="spreads the load of stagnant ground: raises readings where neighbors carry more",
    example={"rate": 0.05},
    state=relax,
)
