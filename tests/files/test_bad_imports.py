"""Every malformed import gives one error with file, place and remedy, and leaves nothing behind.

Each folder of `bad_imports` is a case: the command line, what its message has to say, and files.
"""

import shlex
from pathlib import Path

import pytest

from pipeline.__main__ import main

HERE = Path(__file__).parent
CASES = sorted(path for path in (HERE / "bad_imports").iterdir() if path.is_dir())


def command_of(case: Path, into: Path) -> list[str]:
    """The case's command, writing into a folder of its own."""
    text = (case / "command.txt").read_text(encoding="utf-8")
    arguments = shlex.split(text.format(here=case, good=HERE / "mine_files"))
    if arguments[0] == "measured":
        return ["import", *arguments, "--out", str(into / "measured.csv")]
    name = [] if "--name" in arguments else ["--name", "imported"]
    return ["import", *arguments, *name, "--into", str(into)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bad_import_is_named_with_place_and_remedy(case, tmp_path, capsys):
    before = {path: path.stat().st_mtime_ns for path in HERE.rglob("*.csv")}
    into = tmp_path / "into"
    assert main(command_of(case, into)) == 1
    said = capsys.readouterr()
    assert said.out == ""
    expected = (case / "expect.txt").read_text(encoding="utf-8").splitlines()
    assert expected
    for part in expected:
        assert part in said.err
    assert not said.err.startswith(" ")
    assert sum(not line.startswith(" ") for line in said.err.splitlines()) == 1, "one file's error"
    assert not into.exists() or not list(into.rglob("*"))
    assert {path: path.stat().st_mtime_ns for path in HERE.rglob("*.csv")} == before


def test_the_corpus_is_large_enough():
    assert len(CASES) >= 40
