"""write the reference pages: keys of files, variables of netCDF files, effects

They say what the models, the table of variables and the catalogue of effects say.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--dir",
        type=Path,
        metavar="DIR",
        help="folder to write to (default: the repository's docs/reference)",
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit 1 where a page is not up to date"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the pages, or show how they differ from what they should say."""
    from pipeline.report.reference import FOLDER, stale_lines, write_pages

    folder = arguments.dir or FOLDER
    if arguments.check:
        lines = stale_lines(folder)
        print(*lines, sep="\n", end="\n" if lines else "")
        return 1 if lines else 0
    for path in write_pages(folder):
        print(f"wrote {path}")
    return 0
