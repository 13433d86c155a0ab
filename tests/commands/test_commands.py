"""A command is a module of `pipeline/commands`, found by being there."""

import argparse
import re
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


def _parsers(parser):
    """The parser and those of its subcommands, with the help line of each."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action._choices_actions:
                yield choice.help, action.choices[choice.dest]
                yield from _parsers(action.choices[choice.dest])


def test_help_is_written_alike_everywhere():
    """Lower case, no full stop, each argument explained, defaults as (default: ...)."""
    parser = argparse.ArgumentParser()
    choices = parser.add_subparsers()
    for name, module in commands().items():
        command = choices.add_parser(name, help=module.__doc__.partition("\n")[0])
        module.add_arguments(command)
    checked = 0
    for line, command in _parsers(parser):
        own = [action.help for action in command._actions if action.metavar not in ("KIND",)]
        for text in (line, *own):
            assert text, command.prog
            assert text[0].islower() or text.split()[0] in ("MassFlow's",), text
            assert not text.endswith("."), text
            assert "default" not in text or re.search(r"\(default(: [^()]+)?\)", text), text
            checked += 1
    assert checked > 30
