"""Small experiments that are predicted, and what calibration would say of them."""

import numpy as np
import pytest

from pipeline.config.measured import MeasuredRow
from pipeline.parameters import declared_parameters

CELLS = [
    {"name": "C1", "x": 0.1, "y": 0.1, "width": 0.1, "length": 0.1},
    {"name": "C2", "x": 0.3, "y": 0.2, "width": 0.2, "length": 0.2},
]


@pytest.fixture(scope="session")
def predicted(column):
    """predicted(name=..., **changes): a small column with two load cells and a prediction."""

    def make(name="predicted", **changes):
        given = {"load_cells": CELLS, "prediction": {"samples": 60}} | changes
        return column(name, **given)

    return make


@pytest.fixture(scope="session")
def posterior():
    """posterior(experiment, {name: (coordinate, sd)}): `calibration.json` that says so."""

    def make(experiment, unknowns, parameters=None):
        parameters = parameters or declared_parameters(experiment)
        sd = np.array([one[1] for one in unknowns.values()])
        return {
            "experiment": experiment.name,
            "parameters_used": parameters.to_document(),
            "posterior": {
                "parameters": list(unknowns),
                "coordinates": [one[0] for one in unknowns.values()],
                "covariance": np.diag(sd**2).tolist(),
            },
            "targets": [],
        }

    return make


@pytest.fixture(scope="session")
def reading():
    """reading(value, std, load_cell, **changes): a measured stress at the full height."""

    def make(value, std, load_cell=None, **changes):
        given = {"fill_height": None, "mass_drawn": None, "quantity": "vertical_stress"}
        given |= {"std_shared": 0.0, "count": 1, "line": 1} | changes
        return MeasuredRow(load_cell=load_cell, value=value, std=std, **given)

    return make
