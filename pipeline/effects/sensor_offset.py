"""A load cell reads from another zero."""

import numpy as np

from pipeline.effects import Effect, Parameter, Reading, Values


def shift(reading: Reading, values: Values) -> np.ndarray:
    """The load cell's stresses plus the offset, after gain and drift."""
    stress = reading.stress.copy()
    stress[:, reading.column] += values["offset"]
    return stress


EFFECT = Effect(
    description="A load cell reads the stress plus an offset.",
    equation="reading = σ + offset",
    source="load-cell practice; Müller et al. 2010, Chem. Phys. 375",
    scope="load_cell",
    parameters=(Parameter("offset", "kPa", 0.0, -1e3, 1e3, 0.2, 0, "reading at no stress"),),
    moves="raises the load cell's readings by the same amount",
    kind="sensor",
    example={"offset": 0.5},
    order=10,
    readings=shift,
)
