"""``python -m pipeline COMMAND``: what a user does beside running the workflow."""

import argparse
import sys
from collections.abc import Sequence

from pipeline.commands import commands
from pipeline.config.messages import ConfigError


def command_line() -> argparse.ArgumentParser:
    """The parser of all commands; each sets ``run`` to what does its work."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline",
        description="What a user does beside running the workflow; docs/tutorial.md shows it.",
    )
    choices = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, module in commands().items():
        summary, _, details = module.__doc__.partition("\n")
        command = choices.add_parser(name, help=summary, description=summary, epilog=details)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments
        Words of the command line; by default those of this process.

    Returns
    -------
    int
        Exit status: 0, or 1 after what is wrong with the user's files has been printed.
    """
    chosen = command_line().parse_args(arguments)
    try:
        return chosen.run(chosen)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
