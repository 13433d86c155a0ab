"""Lattices that are measured, and what is done on them again and again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.benchmark.figures import Action
from pipeline.benchmark.yardsticks import triad
from pipeline.config.experiment import Experiment
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import Setup

CELL_SIZE, BULK_DENSITY = 1.0, 1600.0  # m, kg m-3
EXPONENT, BULKING = 3.0, 0.15
APART, OPENING = 15, 4  # drawpoints, cells: their distance and side
CELLS_A_VISIT = 40


def cube(side: int, drawn: bool = False) -> Experiment:
    """A cube of `side` cells of 1 m, at rest or drawn as a mine is.

    Drawn: up to ten by ten drawpoints of 4 × 4 cells, 15 cells apart in the middle of the base,
    each drawn in turn, 40 cells a visit; one round.
    """
    extent = side * CELL_SIZE
    content = {
        "title": "A cube",
        "geometry": {name: extent for name in ("width", "length", "height")},
        "material": {"name": "rock", "bulk_density": BULK_DENSITY, "particle_density": 2700},
        "stress": {"E": 0.99, "s": {"mean": 4, "std": 3}},
        "replicates": 1,
        "seed": 1,
    }
    content["geometry"]["cell_size"] = CELL_SIZE
    if drawn:
        abreast = max(2, min(10, side // APART))
        apart = min(APART, side // abreast)
        opening = min(OPENING, apart)
        first = (side - (abreast - 1) * apart - opening) // 2 + opening / 2
        places = [CELL_SIZE * (first + i * apart) for i in range(abreast)]
        size = {"width": opening * CELL_SIZE, "length": opening * CELL_SIZE}
        points = [
            {"name": f"D{j}_{i}", "x": x, "y": y, **size}
            for j, y in enumerate(places)
            for i, x in enumerate(places)
        ]
        visit = min(CELLS_A_VISIT, side) * BULK_DENSITY * CELL_SIZE**3
        names = [point["name"] for point in points]
        content["stress"] |= {
            "R": 0.3,
            "E_min": {"type": "power", "at_height": extent, "value": 0.9},
        }
        content["flow"] = {"exponent": EXPONENT, "bulking": BULKING}
        content["drawpoints"] = points
        content["draw"] = [{"drawpoints": names, "mass": visit * len(names), "increment": visit}]
        content["readings"] = {"every": visit * len(names)}
    return Experiment.model_validate(content).at(Path("cube.yaml"))


def replicate_on(setup: Setup) -> Action:
    """One replicate after the other, in cells."""
    parameters = declared_parameters(setup.experiment)
    packing, flow = np.random.default_rng(1), np.random.default_rng(2)

    def run(_):
        simulate(setup, parameters, packing, flow)
        return setup.code.size

    return Action(run)


def triad_over(cells: int) -> Action:
    """The STREAM triad over arrays of float32."""
    a, b, c = (np.full(cells, value, np.float32) for value in (0.0, 1.0, 2.0))

    def run(_):
        triad(a, b, c, np.float32(3.0))
        return cells

    return Action(run)
