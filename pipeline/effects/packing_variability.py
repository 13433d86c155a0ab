"""No two packings shed alike."""

import math
from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Packing, Parameter, Values


def vary(cells: Packing, values: Values) -> Packing:
    """One lognormal factor of mean 1 on 1 − E of all cells of the replicate."""
    std = math.sqrt(math.log1p(values["cv"] ** 2))
    factor = math.exp(std * cells.stream("packing_variability").standard_normal() - std**2 / 2)
    return replace(cells, shed_fraction=np.minimum(cells.shed_fraction * factor, 1.0))


EFFECT = Effect(
    description="Each packing has its own 1 − E: the calibrated one times one lognormal factor of "
    "mean 1 and coefficient of variation cv for the whole replicate.",
    equation="1 − E_r = (1 − E) · exp(ζ N_r − ζ²/2), N_r ~ N(0, 1), ζ² = ln(1 + cv²)",
    source="Gómez & Castro 2022, Table 4: repeats of Seditest; Løvoll et al. 1999, Phys. Rev. E 60",
    scope="material",
    parameters=(Parameter("cv", "1", 0.0, 0.0, 2.0, 0.1, 1, "coefficient of variation of 1 − E"),),
    moves="raises the scatter of readings from replicate to replicate",
    example={"cv": 0.3},
    moves_mean=False,
    packing=vary,
)
