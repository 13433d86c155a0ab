"""Coarse and fine cells spread load differently."""

from dataclasses import replace

import numpy as np

from pipeline.effects import Effect, Packing, Parameter, Values


def segregate(cells: Packing, values: Values) -> Packing:
    """Shift s of each cell by its d50, log-uniform in the declared particle sizes."""
    sizes = cells.experiment.material.particle_size
    if sizes is None or sizes[0] == sizes[1]:
        return cells
    half = 0.5 * np.log(sizes[1] / sizes[0])
    log_d50 = cells.stream("segregation").uniform(-half, half, cells.weight.size)
    return replace(cells, s_shift=cells.s_shift + values["slope"] * log_d50)


EFFECT = Effect(
    description="The spreading exponent of a cell shifts with its d50, drawn for each cell from "
    "the declared particle sizes and carried along when the cell moves. The mean d50 is the "
    "geometric one, so that the mean of s stays. Particles of one size: no effect.",
    equation="s ← s + slope · ln(d50 / d50_mean), ln d50 ~ U(ln d_min, ln d_max)",
    source="Kvapil 2008, Gravity Flow in Sublevel and Panel Caving; fines migration in FlowSim",
    scope="material",
    parameters=(
        Parameter("slope", "1", 0.0, -20.0, 20.0, 2.0, 0, "change of s for each e-fold of d50"),
    ),
    moves="raises the scatter over the base, whatever its sign",
    example={"slope": 6.0},
    packing=segregate,
)
