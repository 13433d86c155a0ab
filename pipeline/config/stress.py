"""The laws of the model: how cells hand their load down, and how voids climb."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pipeline.config.fields import (
    FileStem,
    Fraction,
    Height,
    Length,
    Strict,
    Transmission,
    increasing,
)
from pipeline.config.messages import Found, quantity, read_number


class Scatter(Strict):
    """A normal distribution."""

    mean: quantity("a number from -1000 to 1000", ge=-1000, le=1000)
    """Mean, dimensionless."""
    std: quantity("a number from 0 to 1000", ge=0, le=1000) = 0.0
    """Standard deviation from cell to cell, dimensionless."""


def _scatter(value: Any) -> Any:
    if isinstance(value, dict | Scatter):
        return value
    return {"mean": read_number(value, "a number, or {mean, std}")}


def _table_fits(height, value) -> Iterator[Found]:
    yield from increasing("height", height)
    if len(height) != len(value):
        text = f"expected as many values as heights ({len(height)}), these are {len(value)}"
        yield ("value",), text


class EMinTable(Strict):
    """E_min by linear interpolation over height, constant beyond the ends."""

    type: Literal["table"]
    """Form of E_min."""
    height: Annotated[tuple[Height, ...], Field(min_length=1)]
    """Heights above the base, increasing, m."""
    value: Annotated[tuple[Fraction, ...], Field(min_length=1)]
    """E_min at these heights, fraction of load passed on."""

    checks = (_table_fits,)


class EMinPower(Strict):
    """1 - E_min(h) = (1 - value) (h / at_height)^(-exponent), kept within [0, E]."""

    type: Literal["power"]
    """Form of E_min."""
    at_height: Length
    """Height above the base at which E_min is ``value``, m."""
    value: Fraction
    """E_min at that height, fraction of load passed on."""
    exponent: quantity("a number from 0 to 10", ge=0, le=10) = 0.5
    """How fast 1 - E_min falls with height; 0: not at all."""


EMin = Annotated[EMinTable | EMinPower, Field(discriminator="type")]


def _one_source_of_E(E, attenuation_length, from_) -> Iterator[Found]:
    given = [
        key
        for key, value in (("E", E), ("attenuation_length", attenuation_length), ("from", from_))
        if value is not None
    ]
    if len(given) != 1:
        text = "expected exactly one of E, attenuation_length, from; " + (
            f"these are {' and '.join(given)}" if given else "none is given"
        )
        yield (), text


def _s_is_given(s, from_) -> Iterator[Found]:
    if s is None and from_ is None:
        yield ("s",), "missing; expected a number or {mean, std}"


def _E_min_below_E(E, E_min) -> Iterator[Found]:
    if E is None or E_min is None:
        return
    table = isinstance(E_min, EMinTable)
    for place, value in enumerate(E_min.value if table else (E_min.value,)):
        if value > E:
            text = (
                f"expected at most E ({E:g}): flowing ground passes on no more than ground at rest"
            )
            yield ("E_min", "value", *([place] if table else [])), text


class Stress(Strict):
    """How cells hand their load down; starting values where something is calibrated."""

    E: Transmission | None = None
    """Fraction of its load that a cell at rest passes on, for this cell size, in (0, 1]."""
    attenuation_length: Length | None = None
    """In place of E: the length c / (1 - E) over which load is shed, m."""
    from_: FileStem | None = Field(None, alias="from")
    """In place of E: the experiment whose calibrated parameters are taken."""
    s: (
        Annotated[Scatter, BeforeValidator(_scatter, json_schema_input_type=float | Scatter)] | None
    ) = None
    """Exponent of distance in the weights (1/d)^s: a number, or mean and std over the cells."""
    R: Fraction | None = None
    """Relaxation: factor in [0, 1] on weights onto movement-zone cells beside stagnant ones."""
    E_min: EMin | None = None
    """Fraction of its load that a cell in the movement zone passes on, by height."""
    rule: Literal["inverse_distance", "multinomial"] = "inverse_distance"
    """How weights follow from distances: eq. 4 alone, or eq. 3 of Gómez & Castro (2022)."""

    checks = (_one_source_of_E, _s_is_given, _E_min_below_E)


class Flow(Strict):
    """How voids climb from the drawpoints."""

    exponent: quantity("a number from 0 to 1000", ge=0, le=1000)
    """Exponent n of distance in the probabilities (1/d)^n of a void's climb, dimensionless."""
    bulking: Fraction
    """Probability in [0, 1] that a void stays where it loosens stagnant ground."""
