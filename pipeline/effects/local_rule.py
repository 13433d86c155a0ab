"""A rule that holds in a part of the ground."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Parameter, State, Values
from pipeline.effects._features import FEATURES
from pipeline.lattice.cells import MOVEMENT

WEIGHT_PART = 0.2  # of an amplitude for ln γ: ground differs less in weight than in what it sheds
CHANNELS = {
    "E": "the share of load that is shed, 1 − E,",
    "weight": "the weight of the ground",
    "R": "the relaxation R of movement-zone receivers",
}


def follow(state: State, values: Values) -> State:
    """Multiply the channel by exp(amplitude · φ), the weight by a part of that."""
    change = values["amplitude"] * FEATURES[values["feature"]](state)
    if values["channel"] == "weight":
        return replace(state, weight=state.weight * np.exp(WEIGHT_PART * change))
    factor = np.exp(change)
    if values["channel"] == "R":
        field = state.coupling.relaxation
        field = field if field.size else np.full(state.code.shape, state.relaxation)
        field = np.where(state.code == MOVEMENT, field * factor, field).astype(np.float32)
        return replace(state, coupling=state.coupling._replace(relaxation=field))

    def more(shed: np.ndarray) -> np.ndarray:
        return np.minimum(shed * factor, 1.0).astype(shed.dtype)

    return replace(state, shed_fraction=more(state.shed_fraction), own_shed=more(state.own_shed))


def in_words(channel: str, feature: str, amplitude: float) -> str:
    """What a rule says, as a sentence's beginning."""
    where = (FEATURES[feature].__doc__ or feature).strip().splitlines()[0].rstrip(".")
    change = "rises" if amplitude > 0 else "falls"
    return f"{CHANNELS[channel]} {change} {where}"


EFFECT = Effect(
    description="A correction that no effect of the catalogue stands for: in a part of the ground, "
    "or in proportion to a feature of it, more or less load is shed, the ground is heavier or "
    "lighter, or the movement zone takes more or less load.",
    equation="1 − E or R ← itself · exp(amplitude · φ), γ ← γ · exp(0.2 amplitude · φ), "
    "φ the feature of the place",
    source="found in data by the closed loop, from the adjoint of the stress sweep",
    scope="study",
    parameters=(
        Parameter(
            "amplitude",
            "1",
            0.0,
            -5.0,
            5.0,
            0.3,
            0,
            "change of ln(1 − E), of ln R, or of 5 ln γ",
        ),
    ),
    moves="depends on the rule",
    example={"amplitude": 0.4, "channel": "E", "feature": "walls"},
    options={"channel": tuple(CHANNELS), "feature": tuple(FEATURES)},
    kind="rule",
    order=20,
    state=follow,
)
