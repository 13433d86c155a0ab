"""The bed is denser, or lighter, than declared."""

from dataclasses import replace

from pipeline.effects import Effect, Packing, Parameter, Values


def weigh(cells: Packing, values: Values) -> Packing:
    """Every cell's weight times the factor."""
    return replace(cells, weight=cells.weight * values["factor"])


EFFECT = Effect(
    description="The true bulk density is the declared one times a factor. Mass drawn is weighed, "
    "so that a denser bed gives up fewer cells for a kilogram.",
    equation="ρ = factor · ρ_declared",
    source="Gómez & Castro 2022, Table 5, whose values fit other densities than those declared",
    scope="material",
    parameters=(
        Parameter("factor", "1", 1.0, 0.2, 5.0, 0.1, 0, "true over declared bulk density"),
    ),
    moves="raises every static reading in proportion",
    kind="input",
    example={"factor": 1.2},
    packing=weigh,
)
