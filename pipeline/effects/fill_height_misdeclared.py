"""The bed is higher, or lower, than declared."""

from pipeline.effects import Effect, Parameter, Values


def rise(height: float, values: Values) -> float:
    """The true height, m."""
    return height * values["factor"]


EFFECT = Effect(
    description="Every true fill height is the declared one times a factor.",
    equation="H = factor · H_declared",
    source="Gómez & Castro 2022, Table 5: inputs that cannot be as declared",
    scope="experiment",
    parameters=(
        Parameter("factor", "1", 1.0, 0.5, 2.0, 0.05, 0, "true over declared fill height"),
    ),
    moves="raises every reading, the less the more of the column friction carries",
    kind="input",
    example={"factor": 1.2},
    geometry=rise,
)
