"""Shared by all tests: the hypothesis profile and experiments made from a few words."""

import os
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from specs import COLUMN, DRAWN, merged

from pipeline.config.experiment import Experiment
from pipeline.config.load import load_experiment

REPOSITORY = Path(__file__).parents[1]
JARGON = re.compile(
    r"pydantic|Input should|Field required|Extra inputs|type=|input_value|https?://|validation "
    r"error|Value error|\bNone\b|\bdict\b|\btuple\b|\bfloat\b|Traceback|yaml\.|<class"
)

settings.register_profile(
    "suite",
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.register_profile("ci", settings.get_profile("suite"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "suite")


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


@pytest.fixture(scope="session")
def assert_in_house_style():
    """Asserts a path line, then indented problems, without the words of the libraries below."""

    def check(text: str) -> None:
        first, *problems = text.split("\n")
        assert not first.startswith(" ")
        assert problems
        assert not JARGON.search(text), text
        assert all(len(line) < 400 for line in text.split("\n"))

    return check
