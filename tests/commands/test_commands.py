"""A command is a module of `pipeline/commands`, found by being there."""

from pathlib import Path

from pipeline import commands as package
from pipeline.commands import commands

MODULE = '''"""count letters

Of a word.
"""


def add_arguments(parser):
    parser.add_argument("word")


def run(arguments):
    print(len(arguments.word))
    return 3
'''


def test_an_added_file_is_a_command(tmp_path, monkeypatch, call):
    (tmp_path / "global_.py").write_text(MODULE, "utf-8")
    (tmp_path / "_helpers.py").write_text("1 / 0", "utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    answer = call("global", "gravel")
    assert (answer.status, answer.out) == (3, "6\n")
    assert "count letters" in call("--help").out
    assert "Of a word." in call("global", "--help").out


def test_every_command_says_what_it_does_in_a_line(call):
    listed = " ".join(call("--help").out.split())
    folder = Path(package.__file__).parent
    files = [path.stem for path in folder.glob("*.py") if path.stem[0] != "_"]
    assert commands().keys() == {stem.rstrip("_") for stem in files}
    for module in commands().values():
        assert module.__doc__.splitlines()[0] in listed
