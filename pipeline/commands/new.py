"""write an experiment or a study to start from: commented, and sound as it is

Beside an experiment goes a table of made-up readings. Nothing is ever overwritten. The first line
of a YAML file names the JSON schema by which editors complete keys.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from string import Template

import yaml
from pydantic import BaseModel

from pipeline.commands._places import (
    OWN,
    REPOSITORY,
    experiments_of_study,
    next_steps,
)
from pipeline.config.commented import commented
from pipeline.config.experiment import Experiment
from pipeline.config.load import check_measured, load_experiments, study_problems, validated
from pipeline.config.measured import COLUMNS, QUANTITIES
from pipeline.config.messages import (
    NAME_PATTERN,
    ConfigError,
    did_you_mean,
    shown,
    shown_path,
)
from pipeline.config.schema import FOLDER, schema_text
from pipeline.config.study import Study
from pipeline.files.atomic import write_text

STARTERS = Path(__file__).with_name("starters")
EXPERIMENT_HEAD = """\
# $name: $kind experiment. Written by `python -m pipeline new`; it runs as it is. The file's name is
# the experiment's name. Put in your own values: those here, and the readings in
# measured/$name.csv, are made up, as `data_label: synthetic` says wherever they are shown.
# Lengths m, densities kg m-3, angles degrees, masses kg, stresses kPa. x and y run from a corner
# of the base, z is the height above it. A line that starts with #key is a key that is left out.
"""
STUDY_HEAD = """\
# $name: a study. Written by `python -m pipeline new`; it runs as it is. The file's name is the
# study's name. A line that starts with #key is a key that is left out.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("name", metavar="NAME", help="its name: letters, digits, _ and -")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--kind",
        choices=("static", "draw"),
        default="static",
        help="an experiment at rest (default), or one that is drawn",
    )
    what.add_argument(
        "--study",
        nargs="+",
        metavar="EXPERIMENT",
        help="a study of these experiments, in place of an experiment",
    )
    parser.add_argument(
        "--dir",
        type=Path,
        metavar="DIR",
        help="folder to write to, made where it is missing (default: the repository's own, "
        f"{OWN}/experiments or {OWN}/studies)",
    )
    parser.add_argument(
        "--experiments",
        type=Path,
        metavar="DIR",
        help="folder of a study's experiments (default: the folder experiments beside DIR, or the "
        "repository's own)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files; say which, and how to go on."""
    kind = "studies" if arguments.study else "experiments"
    folder = REPOSITORY / OWN / kind if arguments.dir is None else arguments.dir
    path = folder / f"{arguments.name}.yaml"
    _check_name(path, arguments.name)
    _check_experiments(arguments)
    experiments = None
    if arguments.study:
        experiments = arguments.experiments or experiments_of_study(path)
        files = {path: _study(path, arguments.study, experiments)}
    else:
        table = folder / "measured" / f"{arguments.name}.csv"
        _check_free(table)
        files = {
            table: _table(arguments.name, arguments.kind),
            path: _experiment(path, arguments.kind),
        }
    _write_all(_schema_beside(folder, kind) | files)
    for written in files:
        print(f"wrote {shown_path(written)}")
    print(next_steps(path, experiments))
    return 0


# ---------------------------------------------------------------------------------------------
# texts


def _experiment(path: Path, kind: str) -> str:
    names = {"name": path.stem, "kind": "a static" if kind == "static" else "a draw"}
    return _file(path, EXPERIMENT_HEAD, f"{kind}.yaml", Experiment, names)


def _table(name: str, kind: str) -> str:
    """Made-up readings. No comment has a comma, which would let spreadsheets split or quote it."""
    quantities = "; ".join(
        f"{quantity} ({'a ratio' if unit == '1' else unit})"
        for quantity, unit in QUANTITIES.items()
    )
    head = [
        f"Readings of {name}. They are made up: put in your own. Lines like this one are comments.",
        *(f"{column}: {text}" for column, text in COLUMNS.items()),
        f"quantities: {quantities}",
    ]
    rows = Template((STARTERS / f"{kind}.csv").read_text("utf-8")).substitute(name=name)
    return "".join(f"# {line}\n" for line in head) + ",".join(COLUMNS) + "\n" + rows


def _study(path: Path, names: list[str], folder: Path) -> str:
    """A study that is sound; ConfigError when these experiments can make none."""
    experiments = load_experiments(folder)
    if found := list(_unfit(names, experiments, folder)):
        raise ConfigError((path, text) for text in found)
    values = {
        "name": path.stem,
        "experiments": ", ".join(names),
        "hold_out": _hold_out(path, names, experiments),
    }
    text = _file(path, STUDY_HEAD, "study.yaml", Study, values)
    study = validated(Study, yaml.safe_load(text), path)
    if found := list(study_problems(study, experiments)):
        raise ConfigError(found)
    return text


def _unfit(names: list[str], experiments: Mapping[str, Experiment], folder: Path) -> Iterator[str]:
    for name in names:
        if name not in experiments:
            hint = did_you_mean(Path(name).stem, experiments, "experiments there:")
            yield f"--study {name}: no such experiment in {shown_path(folder)}{hint}"
        elif experiments[name].measured is None:
            yield f"--study {name}: has no measured values; name a table in its key `measured`"


def _hold_out(path: Path, names: list[str], experiments: Mapping[str, Experiment]) -> str:
    """What a study keeps from the fit: each experiment in turn, or a part of the only one."""
    if len(names) > 1:
        return "leave_one_out"
    rows = check_measured(experiments[names[0]])
    cells = sorted({row.load_cell for row in rows if row.load_cell})
    masses = sorted({row.mass_drawn for row in rows if row.mass_drawn is not None})
    if len(cells) > 1:
        return f"{{load_cells: [{cells[-1]}]}}"
    if len(masses) > 1:
        return f"{{mass_drawn_above: {masses[-2]:g}}}"
    text = (
        f"--study {names[0]}: nothing to hold out, as its readings are of fewer than two load "
        "cells and at fewer than two masses drawn; name another experiment too"
    )
    raise ConfigError([(path, text)])


def _file(path: Path, head: str, starter: str, model: type[BaseModel], values: dict) -> str:
    body = Template((STARTERS / starter).read_text("utf-8")).substitute(values)
    modeline = f"# yaml-language-server: $schema={_schema_path(path.parent, model)}\n"
    return modeline + Template(head).substitute(values) + "\n" + commented(body, model)


# ---------------------------------------------------------------------------------------------
# files


def _check_name(path: Path, name: str) -> None:
    if not re.fullmatch(NAME_PATTERN.strip("^$"), name):
        stem = re.sub(r"\.ya?ml$", "", name)
        near = stem != name and re.fullmatch(NAME_PATTERN.strip("^$"), stem)
        hint = f"; did you mean {stem}?" if near else ""
        text = "the name names the results; expected letters, digits, _ and -"
        raise ConfigError([(path.parent, f"NAME = {shown(name)}: {text}{hint}")])
    for taken in (path, path.with_suffix(".yml")):
        _check_free(taken)


def _check_experiments(arguments: argparse.Namespace) -> None:
    if arguments.experiments is None:
        return
    if not arguments.study:
        text = "--experiments says where a study's experiments are; name them after --study"
        raise ConfigError([(arguments.experiments, text)])
    if arguments.dir is None:
        text = "the repository's studies are of its own experiments; give --dir too"
        raise ConfigError([(arguments.experiments, text)])


def _check_free(path: Path) -> None:
    try:
        taken = path.exists()
    except OSError as error:  # such as a name that is too long
        raise ConfigError([(path, _not_written(path, error))]) from None
    if taken:
        raise ConfigError([(path, "exists already; choose another name, or remove it")])


def _not_written(path: Path, error: OSError) -> str:
    blocking = [one for one in path.parents if one.exists() and not one.is_dir()]
    reason = f"{shown_path(blocking[0])} is no folder" if blocking else error.strerror
    return f"cannot be written: {reason}"


def _is_in_repository(folder: Path) -> bool:
    return folder.resolve().is_relative_to(REPOSITORY)


def _schema_path(folder: Path, model: type[BaseModel]) -> str:
    """The schema as seen from a folder: the repository's, or outside of it a copy beside."""
    name = f"{model.__name__.lower()}.schema.json"
    if _is_in_repository(folder):
        return Path(os.path.relpath(FOLDER.resolve() / name, folder.resolve())).as_posix()
    return f"schema/{name}"


def _schema_beside(folder: Path, kind: str) -> dict[Path, str]:
    """The schema's copy for a folder outside the repository, where it is missing or old."""
    name = "study.schema.json" if kind == "studies" else "experiment.schema.json"
    path, text = folder / "schema" / name, schema_text(name)
    if _is_in_repository(folder) or (path.is_file() and path.read_text("utf-8") == text):
        return {}
    return {path: text}


def _write_all(files: Mapping[Path, str]) -> None:
    """Write all files, or none: on an error what was made is taken away again."""
    made: list[Path] = []
    for path, text in files.items():
        made += [one for one in (*reversed(path.parents), path) if not one.exists()]
        try:
            write_text(path, text)
        except OSError as error:
            for one in reversed(made):
                with suppress(OSError):
                    one.rmdir() if one.is_dir() else one.unlink()
            raise ConfigError([(path, _not_written(path, error))]) from None
