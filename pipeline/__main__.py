"""`python -m pipeline COMMAND ...`: each module of `pipeline.commands` is a command."""

import argparse
import sys
from importlib import import_module
from pkgutil import iter_modules

from pipeline import commands
from pipeline.config.messages import ConfigError


def main(arguments: list[str] | None = None) -> int:
    """Run a command; its exit status, or 1 with the message when a file of the user is wrong."""
    parser = argparse.ArgumentParser(prog="python -m pipeline")
    chosen = parser.add_subparsers(metavar="COMMAND", required=True)
    for found in sorted(iter_modules(commands.__path__), key=lambda found: found.name):
        module = import_module(f"{commands.__name__}.{found.name}")
        text = module.__doc__.splitlines()[0]
        command = chosen.add_parser(found.name.rstrip("_"), help=text, description=text)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    given = parser.parse_args(arguments)
    try:
        return given.run(given)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
