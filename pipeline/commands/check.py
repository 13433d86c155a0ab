"""check experiments, studies, comparisons, import settings and tables; nothing runs

Prints a line for each sound file. Of the others it says, all at once, where, what and what would
be right; the exit status is then 1. A folder stands for the YAML files in its folders experiments,
studies and comparisons, or else for its own, and for the tables that experiments name. A block
model, drawpoints or a schedule are checked by `import`, before it writes anything.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

from pipeline.commands._places import (
    experiments_of_study,
    experiments_of_table,
    studies_of_experiment,
)
from pipeline.config.comparison import Comparison
from pipeline.config.experiment import Experiment
from pipeline.config.imports import ImportSettings
from pipeline.config.load import (
    check_measured,
    check_prediction,
    check_table,
    is_held_out,
    kind_of,
    load_comparison,
    load_experiments,
    load_import_settings,
    load_study,
    load_with_sources,
    problems_of_comparison,
    study_problems,
    study_rows,
)
from pipeline.config.messages import ConfigError, did_you_mean, shown_path
from pipeline.config.study import Study

YAML, TABLE = (".yaml", ".yml"), (".csv", ".nc")
FOLDERS = ("experiments", "studies", "comparisons")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "paths",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="experiments, studies, comparisons and import settings (.yaml), measured tables "
        "(.csv, .nc), or folders of them",
    )
    parser.add_argument(
        "--experiments",
        type=Path,
        metavar="DIR",
        help="folder of the experiments that studies, comparisons and tables name (default: for a "
        "study or a comparison the folder experiments beside its own, or else the repository's; "
        "for a table the folder above measured, or else its own)",
    )
    parser.add_argument(
        "--studies",
        type=Path,
        metavar="DIR",
        help="folder of the studies that predictions name (default: the folder studies beside the "
        "experiment's own)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Check all files; ConfigError with what is wrong in any of them."""
    found: list[tuple[Path, str]] = []
    experiments_in = cache(load_experiments)
    for path in arguments.paths:
        try:
            todo = dict.fromkeys(_files(path), arguments.experiments)
        except ConfigError as error:
            found += error.problems
            continue
        tables: dict[Path, Path] = {}  # that a folder's experiments name, and the folder
        for files in (todo, tables):
            for file, folder in files.items():
                try:
                    said, table = _checked(file, folder, experiments_in, arguments.studies)
                except ConfigError as error:
                    found += error.problems
                    continue
                print(f"{shown_path(file)}: {said}", flush=True)
                if path.is_dir() and table is not None:
                    tables.setdefault(table, file.parent)
    if found:
        raise ConfigError(found)
    return 0


def _files(path: Path) -> Iterator[Path]:
    """The file, or the YAML files of the folder."""
    if not path.is_dir():
        yield path
        return
    folders = [path / name for name in FOLDERS if (path / name).is_dir()] or [path]
    files = [file for one in folders for file in sorted(one.iterdir()) if _is(file, YAML)]
    if not files:
        text = "holds no experiments, studies or comparisons (*.yaml or *.yml)"
        raise ConfigError([(path, text)])
    yield from files


def _is(file: Path, suffixes: tuple[str, ...]) -> bool:
    return file.suffix.lower() in suffixes


def _checked(
    path: Path,
    experiments: Path | None,
    experiments_in: Callable[[Path], dict[str, Experiment]],
    studies: Path | None,
) -> tuple[str, Path | None]:
    """What a sound file holds, in a line, and the measured table that an experiment names."""
    if not path.is_file():
        others = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
        names = [one.name for one in others if _is(one, YAML + TABLE)]
        hint = did_you_mean(path.name, names, "beside it are")
        raise ConfigError([(path, f"no such file{hint}")])
    if _is(path, TABLE):
        return _table(path, experiments or experiments_of_table(path)), None
    if not _is(path, YAML):
        text = (
            "expected an experiment, a study, a comparison or import settings (.yaml), or a "
            "measured table (.csv or .nc)"
        )
        raise ConfigError([(path, text)])
    kind = kind_of(path)
    if kind is ImportSettings:
        return _import_settings(load_import_settings(path)), None
    if kind in (Study, Comparison):
        loaded = load_study(path) if kind is Study else load_comparison(path)
        known = experiments_in(experiments or experiments_of_study(path))
        return (_study if kind is Study else _comparison)(loaded, known), None
    experiment = load_with_sources(path)
    check_prediction(experiment, studies or studies_of_experiment(path))
    return _experiment(experiment), experiment.measured_path


def _experiment(experiment: Experiment) -> str:
    box = experiment.geometry
    sides = (box.width, box.length, box.height)
    cells = math.prod(math.floor(side / box.cell_size + 0.5) for side in sides)
    if experiment.regions:  # whether they, and their files, fit the lattice
        from pipeline.lattice.block_model import build_block_model

        build_block_model(experiment)
    kind = "draw" if experiment.is_draw else "static"
    values = _count(len(check_measured(experiment)), "measured value")
    return (
        f"{kind} experiment, {cells} cells, {values}, {_count(experiment.replicates, 'replicate')}"
    )


def _study(study: Study, experiments: Mapping[str, Experiment]) -> str:
    if found := list(study_problems(study, experiments)):
        raise ConfigError(found)
    rows = study_rows(study, experiments)
    values = _count(sum(map(len, rows.values())), "measured value")
    if study.hold_out == "leave_one_out":
        held_out = "each experiment"
    else:
        held_out = sum(is_held_out(study, name, row) for name, own in rows.items() for row in own)
    return f"study of {_count(len(rows), 'experiment')}, {values}, {held_out} held out"


def _comparison(comparison: Comparison, experiments: Mapping[str, Experiment]) -> str:
    if found := problems_of_comparison(comparison, experiments):
        raise ConfigError(found)
    cells = len(experiments[comparison.experiments[0]].load_cells)
    return (
        f"comparison of {' and '.join(comparison.experiments)}, {_count(cells, 'load cell')}, "
        f"threshold {comparison.threshold_mpa:g} MPa"
    )


def _import_settings(settings: ImportSettings) -> str:
    given = [key for key in ImportSettings.model_fields if key in settings.model_fields_set]
    return f"import settings: {', '.join(given) or 'nothing given'}"


def _table(path: Path, folder: Path) -> str:
    read, unknown = check_table(path, folder)
    said = ", ".join(f"{_count(count, 'value')} of {name}" for name, count in read.items())
    for name, count in unknown.items():
        hint = did_you_mean(name, read, "")
        said += f"; not read, as there is no experiment {name}: {_count(count, 'row')}"
        said += hint if hint.endswith("?") else ""
    return said


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
