"""write an experiment's results as files that other tools open: VTK, CSV, block model"""

import argparse
from pathlib import Path

FORMATS = ("vtk", "csv", "block_model", "vulcan")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "experiment", metavar="NAME|FOLDER", help="experiment, or its folder of results"
    )
    parser.add_argument(
        "--to",
        required=True,
        action="append",
        choices=FORMATS,
        help="vtk: .vti for each reading and a .pvd series; csv: base stress by load cell, "
        "drawpoint and period; block_model, vulcan: blocks with their stress; may be repeated",
    )
    parser.add_argument(
        "--results", default="results", metavar="DIR", help="folder of results (default: results)"
    )
    parser.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="folder to write to (default: export beside the experiment's results)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files; say where each is."""
    from pipeline.files.export import FORMATS, export

    folder = Path(arguments.experiment)
    if not folder.is_dir():
        folder = Path(arguments.results) / "experiments" / arguments.experiment
    for to in arguments.to:
        target = None
        if arguments.into is not None:
            target = arguments.into / Path(FORMATS[to].target).name
        print(export(folder, to, target))
    return 0
