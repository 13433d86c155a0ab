"""A load cell reads in another scale."""

import numpy as np

from pipeline.effects import Effect, Parameter, Reading, Values


def scale(reading: Reading, values: Values) -> np.ndarray:
    """The load cell's stresses times the gain."""
    stress = reading.stress.copy()
    stress[:, reading.column] *= values["gain"]
    return stress


EFFECT = Effect(
    description="A load cell reads the stress times a gain.",
    equation="reading = gain · σ",
    source="load-cell practice; Müller et al. 2010, Chem. Phys. 375",
    scope="load_cell",
    parameters=(Parameter("gain", "1", 1.0, 0.01, 100.0, 0.1, 0, "reading over stress"),),
    moves="raises the load cell's readings in proportion",
    kind="sensor",
    example={"gain": 1.2},
    readings=scale,
)
