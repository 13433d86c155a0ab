"""make an experiment of a mine's files, or a measured table of its stress readings

docs/mine_files.md has the formats, their sources, and what is refused.
"""

import argparse
from datetime import datetime
from pathlib import Path

from pipeline.commands._places import next_steps

OWN = Path("workflow_configs/experiments")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments, kind of files by kind."""
    kinds = parser.add_subparsers(metavar="KIND", required=True)
    blocks = _add_kind(kinds, "blocks", "a CSV block model (plain, Vulcan's, Leapfrog's)")
    blocks.add_argument("blocks", type=Path, metavar="FILE", help="the block model")
    _add_experiment(blocks)
    blocks.set_defaults(kind=_blocks)
    massflow = _add_kind(kinds, "massflow", "MassFlow's mine blocks, drawpoints and schedule")
    massflow.add_argument("--blocks", type=Path, required=True, metavar="FILE", help="mine blocks")
    massflow.add_argument("--drawpoints", type=Path, metavar="FILE", help="drawpoints")
    massflow.add_argument("--schedule", type=Path, metavar="FILE", help="draw schedule, t")
    _add_experiment(massflow)
    massflow.set_defaults(kind=_massflow)
    measured = _add_kind(kinds, "measured", "stress measured in a mine, by date")
    measured.add_argument("measured", type=Path, metavar="FILE", help="the readings")
    measured.add_argument(
        "--experiment", type=Path, required=True, metavar="YAML", help="the experiment's file"
    )
    measured.add_argument("--schedule", type=Path, metavar="FILE", help="MassFlow's draw schedule")
    measured.add_argument("--start", metavar="DATE", help="first day of the schedule, YYYY-MM-DD")
    measured.add_argument(
        "--drawn", type=Path, metavar="FILE", help="instead: a CSV of date, mass_drawn_t"
    )
    measured.add_argument(
        "--out",
        type=Path,
        metavar="CSV",
        help="table to write (default: measured/NAME.csv beside the experiment)",
    )
    measured.add_argument("--overwrite", action="store_true", help="replace the table if there")
    measured.set_defaults(kind=_measured)


def _add_kind(kinds, name: str, words: str) -> argparse.ArgumentParser:
    return kinds.add_parser(name, help=words, description=words)


def _add_experiment(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--name", required=True, help="name of the experiment")
    parser.add_argument(
        "--settings", type=Path, metavar="YAML", help="columns, units, and what the files leave out"
    )
    parser.add_argument(
        "--gaps", choices=("refuse", "outside"), help="what a missing block is (default: refuse)"
    )
    parser.add_argument("--base", type=float, metavar="M", help="elevation of the base, m")
    parser.add_argument(
        "--into", type=Path, default=OWN, metavar="DIR", help=f"folder to write to (default: {OWN})"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files that are there")


def run(arguments: argparse.Namespace) -> int:
    """Import, and print what was understood and what was written."""
    return arguments.kind(arguments)


def _settings(arguments: argparse.Namespace):
    from pipeline.config.imports import ImportSettings
    from pipeline.config.load import load_import_settings

    settings = ImportSettings()
    if arguments.settings is not None:
        settings = load_import_settings(arguments.settings)
    given = {key: getattr(arguments, key) for key in ("gaps", "base")}
    given = {key: value for key, value in given.items() if value is not None}
    return settings.model_copy(update=given)


def _blocks(arguments: argparse.Namespace) -> int:
    from pipeline.files.mine.block_table import read_block_table

    settings = _settings(arguments)
    table = read_block_table(arguments.blocks, settings)
    return _write(arguments, settings, table, f"block model {arguments.blocks.name}")


def _massflow(arguments: argparse.Namespace) -> int:
    from pipeline.files.mine.massflow import read_drawpoints, read_mine_blocks, read_schedule

    settings = _settings(arguments)
    table = read_mine_blocks(arguments.blocks, settings)
    drawpoints = schedule = None
    if arguments.drawpoints is not None:
        drawpoints = read_drawpoints(arguments.drawpoints, settings)
    if arguments.schedule is not None:
        schedule = read_schedule(arguments.schedule)
    title = f"MassFlow mine blocks {arguments.blocks.name}"
    return _write(arguments, settings, table, title, drawpoints, schedule)


def _write(arguments, settings, table, title, drawpoints=None, schedule=None) -> int:
    from pipeline.files.mine.block_grid import regular_grid
    from pipeline.files.mine.experiment import describe_experiment, write_experiment

    grid = regular_grid(table, settings.gaps, settings.base)
    content, datasets, notes = describe_experiment(table, grid, settings, drawpoints, schedule)
    content |= {"title": f"{arguments.name}, imported", "source": title}
    written = write_experiment(
        arguments.name, content, datasets, notes, arguments.into, arguments.overwrite
    )
    print(*(f"- {note}" for note in notes), *written, sep="\n")
    print(next_steps(arguments.into / f"{arguments.name}.yaml"))
    return 0


def _measured(arguments: argparse.Namespace) -> int:
    from pipeline.config.load import load_experiment
    from pipeline.files.mine.measured import convert, write_measured

    experiment = load_experiment(arguments.experiment)
    rows = convert(arguments.measured, experiment, _calendar(arguments, experiment))
    out = arguments.out
    if out is None:
        out = experiment.path.parent / "measured" / f"{experiment.name}.csv"
    write_measured(rows, experiment, out, arguments.overwrite)
    print(f"- {len(rows)} readings", out, sep="\n")
    if experiment.measured is None:
        print(f"name it in {experiment.path}:  measured: measured/{out.name}")
    return 0


def _calendar(arguments: argparse.Namespace, experiment):
    from pipeline.config.messages import ConfigError
    from pipeline.files.mine.massflow import read_schedule
    from pipeline.files.mine.measured import calendar_of, read_calendar

    if not experiment.is_draw:
        return None
    if arguments.drawn is not None:
        return read_calendar(arguments.drawn)
    if arguments.schedule is None or arguments.start is None:
        text = "readings by date need --schedule FILE with --start DATE, or --drawn FILE"
        raise ConfigError([(arguments.measured, text)])
    try:
        start = datetime.fromisoformat(arguments.start)
    except ValueError:
        text = f"--start = {arguments.start}: expected a date as 2025-12-31"
        raise ConfigError([(arguments.measured, text)]) from None
    return calendar_of(read_schedule(arguments.schedule), start)
