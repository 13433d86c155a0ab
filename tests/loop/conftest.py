"""Tiny studies, each made once; their problems are made anew where a test simulates."""

import pytest
from worlds import World, drawn_world, mixed_world, walled_world

TRUTH = {"wall_friction": {"K": 0.5}}


@pytest.fixture(scope="session")
def walls(tmp_path_factory) -> World:
    """Columns between walls whose friction nobody declares; E in truth is not as declared."""
    return walled_world(tmp_path_factory.mktemp("walls") / "w", truth=TRUTH, true_E=0.97)


@pytest.fixture(scope="session")
def nothing(tmp_path_factory) -> World:
    """The same columns with nothing undeclared but E."""
    return walled_world(tmp_path_factory.mktemp("nothing") / "w", true_E=0.97)


@pytest.fixture(scope="session")
def mixed(tmp_path_factory) -> World:
    """A static column and a draw of one material, all quantities among their readings."""
    return mixed_world(tmp_path_factory.mktemp("mixed") / "w")


@pytest.fixture(scope="session")
def tail(tmp_path_factory) -> World:
    """A draw whose end is held out."""
    return drawn_world(tmp_path_factory.mktemp("tail") / "w")
