"""A load cell's scale drifts while material is drawn."""

import numpy as np

from pipeline.effects import Effect, Parameter, Reading, Values


def drift(reading: Reading, values: Values) -> np.ndarray:
    """The load cell's stresses times a gain that is linear in the mass drawn."""
    stress = reading.stress.copy()
    stress[:, reading.column] *= 1.0 + values["rate"] * reading.mass_drawn
    return stress


EFFECT = Effect(
    description="A load cell's gain changes in proportion to the mass drawn.",
    equation="reading = (1 + rate · mass drawn) · σ",
    source="load-cell practice; Müller et al. 2010, Chem. Phys. 375",
    scope="load_cell",
    parameters=(
        Parameter("rate", "1/kg", 0.0, -1.0, 1.0, 0.01, 0, "change of gain for each kilogram"),
    ),
    moves="raises the load cell's readings the more has been drawn",
    kind="sensor",
    example={"rate": 0.02},
    readings=drift,
)
