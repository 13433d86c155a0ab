"""Fixtures of the effects' tests."""

import pytest
from runs import GROUND, PILLAR
from specs import merged

from pipeline.config.experiment import Experiment


@pytest.fixture(scope="session")
def filling(column):
    """filling(**changes): a static column on which every effect can act."""
    return lambda **changes: column("filling", **merged(GROUND, changes))


@pytest.fixture(scope="session")
def pillar(column):
    """pillar(**changes): a pillar between two movement zones, likewise."""
    return lambda **changes: column("pillar", **merged(merged(GROUND, PILLAR), changes))


@pytest.fixture(scope="session", params=["filling", "pillar"])
def experiment(request) -> Experiment:
    """Both in turn."""
    return request.getfixturevalue(request.param)()
