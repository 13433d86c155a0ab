"""write the figures of a report page as SVG files of their own

A figure of several panels gives a file for each. Colors are those of the light page; the numbers
behind them are in the table beside the page, report_data.csv.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("page", type=Path, metavar="PAGE", help="a report's .html")
    parser.add_argument(
        "--only", action="append", metavar="FIGURE", help="one figure by name; may be repeated"
    )
    parser.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="folder to write to (default: figures beside the page)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files; say where each is."""
    from pipeline.report.figure_files import write_figures

    into = arguments.into or arguments.page.parent / "figures"
    for path in write_figures(arguments.page, into, arguments.only):
        print(f"wrote {path}")
    return 0
