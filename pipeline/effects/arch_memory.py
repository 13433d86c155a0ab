"""Arches outlive the cells that formed them."""

from dataclasses import replace

from pipeline.effects import Effect, Packing, Parameter, Values


def remember(cells: Packing, values: Values) -> Packing:
    """A share of a place's weights stays when another cell moves in."""
    return replace(cells, persistence=values["persistence"])


EFFECT = Effect(
    description="In the base model a cell that has moved spreads its load anew. With memory the "
    "weights at a place are a mix of those before and of the new cell's.",
    equation="β ← persistence · β_before + (1 − persistence) · β_new",
    source="McNulty 1965, arching in sand (WES TR 1-674); intermittent draw",
    scope="study",
    parameters=(
        Parameter("persistence", "1", 0.0, 0.0, 1.0, 0.5, 1, "share of β that stays at a place"),
    ),
    moves="lowers the change from reading to reading under flowing ground",
    example={"persistence": 0.8},
    packing=remember,
)
