"""Experiments on which every effect can act, and runs of them."""

from collections.abc import Iterable

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.effects import Active, effects
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.parameters import declared_parameters
from pipeline.simulate.readings import Readings
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import load_cells, make_setup

GROUND = {
    "material": {
        "name": "gravel",
        "bulk_density": 1600,
        "particle_density": 2700,
        "particle_size": [0.002, 0.02],
        "internal_friction_angle": 35,
    },
    "walls": {"friction_angle": 25},
    "filling": {"levels": [0.35, 0.7]},
    "load_cells": [
        {"name": "west", "x": 0.1, "y": 0.2, "width": 0.2, "length": 0.4},
        {"name": "east", "x": 0.4, "y": 0.2, "width": 0.2, "length": 0.4},
    ],
}
PILLAR = {
    "geometry": {"width": 1.0, "length": 0.2, "height": 0.8, "cell_size": 0.04},
    "stress": {
        "E": 0.97,
        "R": 0.3,
        "E_min": {"type": "power", "at_height": 0.4, "value": 0.8},
    },
    "flow": {"exponent": 4, "bulking": 0.3},
    "filling": None,
    "drawpoints": [
        {"name": "left", "x": 0.3, "y": 0.1, "width": 0.12, "length": 0.2},
        {"name": "right", "x": 0.7, "y": 0.1, "width": 0.12, "length": 0.2},
    ],
    "draw": [{"drawpoints": ["left", "right"], "mass": 20.0, "increment": 0.5}],
    "readings": {"every": 5.0},
    "load_cells": [
        {"name": "pillar", "x": 0.5, "y": 0.1, "width": 0.12, "length": 0.2},
        {"name": "zone", "x": 0.3, "y": 0.1, "width": 0.12, "length": 0.2},
        {"name": "outer", "x": 0.06, "y": 0.1, "width": 0.12, "length": 0.2},
    ],
}


def example(name: str, experiment: Experiment) -> Active:
    """An effect with its example values, at the first load cell if it belongs to one."""
    effect = effects()[name]
    cell = load_cells(experiment)[0].name if effect.scope == "load_cell" else None
    return Active(name, effect.neutral | dict(effect.example), cell)


def block(active: Iterable[Active]) -> dict:
    """The `effects:` block that declares them."""
    return {
        one.name: {one.load_cell: dict(one.values)} if one.load_cell else dict(one.values)
        for one in active
    }


def run(
    experiment: Experiment, active: Iterable[Active] = (), replicates=1, dtype=np.float32, **more
) -> list[Readings]:
    """Replicates with these effects."""
    setup = make_setup(experiment, dtype=dtype, effects=tuple(active))
    parameters = declared_parameters(experiment)
    return [
        simulate(
            setup,
            parameters,
            random_stream(1, "effects", PACKING, i),
            random_stream(1, "effects", FLOW, i),
            **more,
        )
        for i in range(replicates)
    ]


def assert_same(a: Readings, b: Readings) -> None:
    """Bit for bit."""
    for name, value in vars(a).items():
        np.testing.assert_array_equal(value, vars(b)[name], err_msg=name)
