"""A user's folder with a sound experiment and study, and calls of the command line in it."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.__main__ import main


@dataclass(frozen=True)
class Answer:
    """What a command said, and its exit status."""

    status: int
    out: str
    err: str


@pytest.fixture
def call(capsys):
    """call(*words): the command's answer; an exit by argparse is an answer like any other."""

    def run(*words) -> Answer:
        capsys.readouterr()
        try:
            status = main([str(word) for word in words])
        except SystemExit as stop:
            status = stop.code
        return Answer(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def written_once(tmp_path_factory) -> Path:
    """The experiment `box` and the study `loop` of it, as the command writes them."""
    folder = tmp_path_factory.mktemp("written")
    assert main(["new", "box", "--dir", f"{folder}/experiments"]) == 0
    assert main(["new", "loop", "--study", "box", "--dir", f"{folder}/studies"]) == 0
    return folder


@pytest.fixture
def mine(written_once, tmp_path, monkeypatch) -> Path:
    """A user's folder `mine` with an experiment and a study, in the working directory."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(written_once, tmp_path / "mine")
