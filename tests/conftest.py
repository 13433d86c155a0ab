"""Shared by all tests: the hypothesis profile and experiments made from a few words."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from pipeline.config.experiment import Experiment
from pipeline.config.load import load_experiment

REPOSITORY = Path(__file__).parents[1]

settings.register_profile(
    "suite",
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.register_profile("ci", settings.get_profile("suite"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "suite")

COLUMN = {
    "title": "A small column",
    "geometry": {"width": 0.5, "length": 0.4, "height": 1.0, "cell_size": 0.1},
    "material": {"name": "gravel", "bulk_density": 1600, "particle_density": 2700},
    "stress": {"E": 0.9, "s": {"mean": 4, "std": 3}},
    "replicates": 8,
    "seed": 2022,
}
DRAWN = {
    "geometry": {"width": 0.6, "length": 0.5, "height": 0.8, "cell_size": 0.05},
    "stress": {
        "R": 0.3,
        "E_min": {"type": "power", "at_height": 0.4, "value": 0.5},
    },
    "flow": {"exponent": 2, "bulking": 0.2},
    "drawpoints": [{"name": "west", "x": 0.3, "y": 0.25, "width": 0.1, "length": 0.1}],
    "draw": [{"drawpoints": ["west"], "mass": 12.0, "increment": 1.0}],
    "readings": {"every": 4.0},
    "load_cells": [
        {"name": "beside", "x": 0.1, "y": 0.25, "width": 0.1, "length": 0.1},
        {"name": "above", "x": 0.3, "y": 0.1, "width": 0.13, "length": 0.1},
    ],
}


def merged(base: dict, changes: dict) -> dict:
    """`base` with `changes`, mapping by mapping; None takes a key away."""
    result = dict(base)
    for key, value in changes.items():
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(result.get(key), dict):
            result[key] = merged(result[key], value)
        else:
            result[key] = value
    return result


@pytest.fixture(scope="session")
def column():
    """column(name=..., path=..., **changes): a small static experiment, changed key by key."""

    def make(name: str = "column", path: Path = Path(), **changes) -> Experiment:
        return Experiment.model_validate(merged(COLUMN, changes)).at(path / f"{name}.yaml")

    return make


@pytest.fixture(scope="session")
def drawn(column):
    """drawn(name=..., **changes): a small draw experiment, changed key by key."""

    def make(name: str = "drawn", path: Path = Path(), **changes) -> Experiment:
        return column(name, path, **merged(DRAWN, changes))

    return make


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def published():
    """published(name, **changes): an experiment of the repository, changed key by key."""
    folder = REPOSITORY / "workflow_configs" / "experiments"

    def load(name: str, **changes) -> Experiment:
        experiment = load_experiment(folder / f"{name}.yaml")
        declared = experiment.model_dump(mode="json", by_alias=True)
        declared["stress"] = {k: v for k, v in declared["stress"].items() if v is not None}
        return Experiment.model_validate(merged(declared, changes)).at(experiment.path)

    return load
