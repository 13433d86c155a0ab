"""From YAML files to checked experiments, studies and comparisons; all problems at once."""

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any, ClassVar

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.config.comparison import Comparison, comparison_problems
from pipeline.config.experiment import DRAW_PARAMETERS, Experiment
from pipeline.config.imports import ImportSettings
from pipeline.config.measured import MeasuredError, MeasuredRow, read_measured, rows_by_name
from pipeline.config.messages import (
    NAME_PATTERN,
    ConfigError,
    did_you_mean,
    dotted,
    problems,
    shown_path,
)
from pipeline.config.study import HeldOutLoadCells, HeldOutTail, Study


class _Loader(yaml.SafeLoader):
    """SafeLoader with the scalars of YAML 1.2 (1e-3 is a number, yes is text), no key twice."""

    yaml_implicit_resolvers: ClassVar[dict] = {}

    def construct_mapping(self, node, deep=False):
        first: dict[str, int] = {}
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in first:
                raise yaml.constructor.ConstructorError(
                    problem=f"key {key.value} is given twice, first in line {first[key.value]}",
                    problem_mark=key.start_mark,
                )
            first[key.value] = key.start_mark.line + 1
        return super().construct_mapping(node, deep=deep)

    def construct_scalar(self, node):
        """Text with the two halves of a JSON escape (\\ud83d\\ude00) joined to one character."""
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16")


_DECIMAL = r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", rf"{_DECIMAL}|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", "-+.0123456789"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("merge", r"<<", "<"),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), list(_first)
    )


def _read_mapping(path: Path) -> dict:
    """The mapping that a YAML file holds; ConfigError when it holds none."""

    def stop(text: str):
        raise ConfigError([(path, text)]) from None

    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        others = [other.name for other in _yaml_files(path.parent)] if path.parent.is_dir() else []
        stop("no such file" + did_you_mean(path.name, others, "beside it are"))
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        stop(f"line {line}: not UTF-8 text; save the file with UTF-8 encoding")
    except OSError as error:
        stop(f"cannot be read: {error.strerror}")
    try:
        content = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        stop(f"{where}not readable as YAML: {_what_yaml_says(error)}")
    except yaml.reader.ReaderError as error:
        line = text[: error.position].count("\n") + 1
        stop(f"line {line}: not readable as YAML: a control character; remove it")
    except (RecursionError, ValueError, OverflowError):
        stop("not readable as YAML: nested too deeply, or a number or character out of range")
    if content is None:
        stop("the file is empty; expected keys and values")
    if not isinstance(content, dict):
        stop(f"expected keys and values (key: value), found a {_kind(content)}")
    return content


def _what_yaml_says(error: yaml.MarkedYAMLError) -> str:
    text = error.problem or error.context
    if "another document" in text:
        return "a second document starts here; keep one in a file, without ---"
    if "constructor for the tag" in text:
        return "a tag (!...) is not allowed here; write the plain value"
    if "unhashable" in text:
        return "a key has to be plain text"
    return text + ("; indent with spaces, not tabs" if r"'\t'" in text else "")


def _kind(content: Any) -> str:
    return "list" if isinstance(content, list) else "single value"


def _yaml_files(folder: Path) -> list[Path]:
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in (".yaml", ".yml") and path.is_file()
    )


def _load(model: type[BaseModel], path: Path) -> Any:
    return validated(model, _read_mapping(Path(path)), path)


def validated(model: type[BaseModel], raw: dict, path: Path) -> Any:
    """The experiment or study that the content of the file ``path`` is.

    Raises ConfigError with every problem of it; other files are not looked at.
    """
    path = Path(path)
    found = []
    if not re.fullmatch(NAME_PATTERN.strip("^$"), path.stem):
        text = "the file's name names the results; expected letters, digits, _ and -"
        found.append(f"{path.name}: {text}")
    try:
        loaded = model.model_validate(raw).at(path)
    except ValidationError as error:
        found += problems(model, error, raw)
    if found:
        raise ConfigError((path, text) for text in found)
    return loaded


def load_experiment(path: Path) -> Experiment:
    """The experiment in the YAML file ``path``, checked together with the files it names.

    Raises ConfigError with every problem of the file, and of its measured table.
    """
    experiment = _load(Experiment, path)
    found = []
    for location, file in experiment.files.items():
        if not file.is_file():
            given = reduce(getitem, location, resolved(experiment))
            where = f"{dotted(location)} = {given}"
            found.append((experiment.path, _no_such_file(where, file)))
    try:
        check_measured(experiment)
    except ConfigError as error:
        found += error.problems
    if found:
        raise ConfigError(found)
    return experiment


def load_import_settings(path: Path) -> ImportSettings:
    """The settings of an import in the YAML file ``path``; ConfigError with every problem."""
    raw = _read_mapping(Path(path))
    try:
        return ImportSettings.model_validate(raw)
    except ValidationError as error:
        found = problems(ImportSettings, error, raw)
        raise ConfigError((path, text) for text in found) from None


def load_study(path: Path) -> Study:
    """The study in the YAML file ``path``; ConfigError with every problem of the file."""
    study = _load(Study, path)
    if study.data_path is not None and not study.data_path.is_file():
        where = f"data.file = {study.data.file}"
        raise ConfigError([(study.path, _no_such_file(where, study.data_path))])
    return study


def load_with_sources(path: Path) -> Experiment:
    """As ``load_experiment``; checked too are the files beside it that its stress comes from."""
    path = Path(path)
    chain, following = {}, path
    while following is not None and following.stem not in chain:
        experiment = load_experiment(following)
        chain[experiment.name] = experiment
        beside = {other.stem: other for other in _yaml_files(path.parent)}
        following = beside.get(experiment.stress.from_)
    if found := list(_broken_references(chain, beside)):
        raise ConfigError(found)
    return chain[path.stem]


def check_prediction(experiment: Experiment, studies: Path) -> None:
    """ConfigError where the study that an experiment's `prediction` names does not serve it.

    `studies` is the study's folder; the experiments that it names lie beside this one.
    """
    if experiment.prediction is None or experiment.prediction.study is None:
        return
    files = {file.stem: file for file in _yaml_files(studies)} if studies.is_dir() else {}
    name = experiment.prediction.study
    known = {name: load_study(files[name])} if name in files else dict.fromkeys(files)
    beside = {file.stem: file for file in _yaml_files(experiment.path.parent)}
    named = known[name].experiments if name in files else ()
    experiments = {one: load_experiment(beside[one]) for one in named if one in beside}
    none = f"there are none in {shown_path(studies)}, name their folder with --studies DIR"
    if found := list(prediction_problems(experiment, known, experiments, none)):
        raise ConfigError(found)


def load_experiments(folder: Path) -> dict[str, Experiment]:
    """All experiments (*.yaml, *.yml) of a folder by name, sorted.

    Raises ConfigError with the problems of all files, and where ``stress.from`` leads nowhere.
    """
    paths = _files_of(folder, "experiments")
    experiments, found = _load_each(paths, load_experiment)
    found += _broken_references(experiments, {path.stem for path in paths})
    if found:
        raise ConfigError(found)
    return experiments


KINDS = {
    "experiments": Experiment,
    "studies": Study,
    "comparisons": Comparison,
    "imports": ImportSettings,
}
"""What a YAML file may be, by the usual name of its folder."""


def kind_of(path: Path) -> type[BaseModel]:
    """What a YAML file means to be: judged by its keys, or else by the name of its folder.

    Where neither tells, it is the kind that lacks the fewest keys.
    """
    raw = _read_mapping(Path(path))

    def shared(model: type[BaseModel]) -> int:
        return len(raw.keys() & {f.alias or name for name, f in model.model_fields.items()})

    def lacking(model: type[BaseModel]) -> int:
        return sum(f.is_required() and name not in raw for name, f in model.model_fields.items())

    most = max(map(shared, KINDS.values()))
    nearest = [model for model in KINDS.values() if shared(model) == most]
    by_folder = KINDS.get(Path(path).absolute().parent.name)
    if not most:
        return by_folder or Experiment
    return by_folder if by_folder in nearest else min(nearest, key=lacking)


def load_studies(
    folder: Path, experiments: Mapping[str, Experiment] | None = None
) -> dict[str, Study]:
    """All studies (*.yaml, *.yml) of a folder by name, sorted.

    Given the ``experiments``, what the studies say of them is checked too. Raises ConfigError with
    the problems of all files.
    """
    studies, found = _load_each(_files_of(folder, "studies"), load_study)
    for study in studies.values() if experiments is not None else ():
        found += study_problems(study, experiments)
    if found:
        raise ConfigError(found)
    return studies


def load_comparison(path: Path) -> Comparison:
    """The comparison in the YAML file ``path``; ConfigError with every problem of the file."""
    return _load(Comparison, path)


def load_comparisons(folder: Path, experiments: Mapping[str, Experiment]) -> dict[str, Comparison]:
    """All comparisons (*.yaml, *.yml) of a folder by name, sorted.

    Raises ConfigError with the problems of all files, and where two experiments do not compare.
    """
    comparisons, found = _load_each(_files_of(folder, "comparisons"), load_comparison)
    for one in comparisons.values():
        found += problems_of_comparison(one, experiments)
    if found:
        raise ConfigError(found)
    return comparisons


def problems_of_comparison(
    comparison: Comparison, experiments: Mapping[str, Experiment]
) -> list[tuple[Path, str]]:
    """Why its two experiments do not compare, their measured rows' readings included."""
    named = (experiments[name] for name in comparison.experiments if name in experiments)
    rows = {experiment.name: check_measured(experiment) for experiment in named}
    texts = comparison_problems(comparison, experiments, rows)
    return [(comparison.path, text) for text in texts]


def check_measured(experiment: Experiment) -> tuple[MeasuredRow, ...]:
    """The experiment's measured rows, () when it names no table; ConfigError with all problems."""
    if experiment.measured is None:
        return ()
    if not experiment.measured_path.is_file():
        where = f"measured = {experiment.measured}"
        raise ConfigError([(experiment.path, _no_such_file(where, experiment.measured_path))])
    return _read_rows(experiment.measured_path, experiment)


def study_rows(
    study: Study, experiments: Mapping[str, Experiment]
) -> dict[str, tuple[MeasuredRow, ...]]:
    """Measured rows of each of the study's experiments, from its own table where it has one."""
    return {
        name: check_measured(experiments[name])
        if study.data is None
        else _read_rows(study.data_path, experiments[name])
        for name in study.experiments
    }


def check_table(path: Path, folder: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Check a measured table with the experiments of a folder.

    Returns
    -------
    read, unknown : the number of rows of each experiment in the folder, and of each other name

    Raises
    ------
    ConfigError
        With every problem of the table and of the experiments that it names, or when it names no
        experiment of the folder.
    """
    try:
        counts = rows_by_name(path)
    except MeasuredError as error:
        raise ConfigError((error.path, text) for text in error.problems) from None
    files = {file.stem: file for file in _yaml_files(folder)} if folder.is_dir() else {}
    read = {name: count for name, count in counts.items() if name in files}
    if not read:
        hint = did_you_mean(next(iter(counts)), files, "experiments there:")
        text = f"experiment = {', '.join(counts)}: no such experiment in {shown_path(folder)}{hint}"
        raise ConfigError([(path, text)])
    found = []
    for name in read:
        try:
            _read_rows(path, _load(Experiment, files[name]))
        except ConfigError as error:
            found += error.problems
    if found:
        raise ConfigError(found)
    return read, {name: count for name, count in counts.items() if name not in files}


def resolved(settings: BaseModel) -> dict:
    """An experiment or study as JSON-able data under the keys of its file, defaults filled in."""
    return settings.model_dump(mode="json", by_alias=True)


def digest(settings: BaseModel) -> str:
    """SHA-256 (hex) of ``resolved``: the same for files that say the same."""
    text = json.dumps(resolved(settings), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


# ---------------------------------------------------------------------------------------------
# across files


def _no_such_file(where: str, path: Path) -> str:
    return f"{where}: no such file ({shown_path(path)}); the path is relative to this file"


def _read_rows(path: Path, experiment: Experiment) -> tuple[MeasuredRow, ...]:
    try:
        return read_measured(path, experiment)
    except MeasuredError as error:
        raise ConfigError((error.path, text) for text in error.problems) from None


def _files_of(folder: Path, kind: str) -> list[Path]:
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError([(folder, f"no such folder; expected a folder of {kind} (*.yaml)")])
    if not (paths := _yaml_files(folder)):
        raise ConfigError([(folder, f"holds no {kind} (*.yaml or *.yml)")])
    return paths


def _load_each(
    paths: list[Path], load_one: Callable[[Path], Any]
) -> tuple[dict[str, Any], list[tuple[Path, str]]]:
    """What the sound files hold, by name, and the problems of the others."""
    loaded, found, first = {}, [], {}
    for path in paths:
        if path.stem in first:
            found.append((path, f"{first[path.stem].name} has the same name; rename one"))
            continue
        first[path.stem] = path
        try:
            loaded[path.stem] = load_one(path)
        except ConfigError as error:
            found += error.problems
    return loaded, found


def sources(experiment: Experiment, experiments: Mapping[str, Experiment]) -> list[Experiment]:
    """The experiment and those its stress comes from, nearest first; stops where one recurs."""
    chain = [experiment]
    while chain[-1].stress.from_ in experiments:
        source = experiments[chain[-1].stress.from_]
        chain.append(source)
        if source in chain[:-1]:
            break
    return chain


def _broken_references(
    experiments: Mapping[str, Experiment], names: Collection[str]
) -> Iterator[tuple[Path, str]]:
    for experiment in experiments.values():
        start = experiment.stress.from_
        if start is None:
            continue
        chain = sources(experiment, experiments)
        where = f"stress.from = {start}: "
        if start not in names:
            others = sorted(set(names) - {experiment.name})
            hint = did_you_mean(start, others, "experiments here:")
            yield experiment.path, f"{where}no such experiment in this folder{hint}"
        elif len(chain) > 1 and chain[-1] is experiment:
            circle = " → ".join(source.name for source in chain)
            yield experiment.path, f"{where}leads back to itself ({circle})"
        elif experiment.is_draw and chain[-1].stress.from_ is None:
            for key, given in (
                ("stress.R", any(source.stress.R is not None for source in chain)),
                ("stress.E_min", any(source.stress.E_min is not None for source in chain)),
                ("flow", any(source.flow is not None for source in chain)),
            ):
                if not given:
                    yield experiment.path, f"{key}: missing here and in {start}; draw needs it"


def prediction_problems(
    experiment: Experiment,
    studies: Mapping[str, Study],
    experiments: Mapping[str, Experiment],
    none: str = "this run has none, name their folder with --config studies_dir=DIR",
) -> Iterator[tuple[Path, str]]:
    """What is wrong with the study that an experiment's `prediction` names.

    `none` is the remedy where there are no studies.
    """
    name = experiment.prediction.study
    if name is None:
        return
    where = f"prediction.study = {name}: "
    if name not in studies:
        hint = did_you_mean(name, studies, "known studies:") or f"; {none}"
        yield experiment.path, f"{where}no such study{hint}"
        return
    study = studies[name]
    if experiment.name in study.experiments:
        return
    materials = {experiments[one].material.name for one in study.experiments if one in experiments}
    for shared in study.parameters:
        if shared.shared_by == "experiment":
            yield (
                experiment.path,
                (
                    f"{where}gives each of its experiments a value of {shared.name}, and this is "
                    "none of them; share it by material or by study, or take the calibration"
                ),
            )
        elif shared.shared_by == "material" and experiment.material.name not in materials:
            hint = did_you_mean(experiment.material.name, sorted(materials), "its materials:")
            yield (
                experiment.path,
                f"{where}knows no {shared.name} of material {experiment.material.name}{hint}",
            )


def study_problems(
    study: Study, experiments: Mapping[str, Experiment]
) -> Iterator[tuple[Path, str]]:
    known = {name: experiments[name] for name in study.experiments if name in experiments}
    for place, name in enumerate(study.experiments):
        where = f"experiments[{place}] = {name}: "
        if name not in known:
            hint = did_you_mean(name, experiments, "known experiments:")
            yield study.path, f"{where}no such experiment{hint}"
        elif study.data is None and known[name].measured is None:
            yield (
                study.path,
                (
                    f"{where}has no measured values; name a table with `measured` in its file, "
                    "or with `data` in this one"
                ),
            )
        elif study.data is not None:
            try:
                _read_rows(study.data_path, known[name])
            except ConfigError as error:
                yield from error.problems
    for text in _hold_out_problems(study, known, experiments):
        yield study.path, text
    if len(known) == len(study.experiments):
        for text in _data_problems(study, known):
            yield study.path, text


def _hold_out_problems(
    study: Study, known: Mapping[str, Experiment], experiments: Mapping[str, Experiment]
) -> Iterator[str]:
    held_out = study.experiments if study.hold_out == "leave_one_out" else study.hold_out
    if isinstance(held_out, tuple):
        for name, experiment in known.items():
            chain = [source.name for source in sources(experiment, experiments)]
            if set(chain[1:]) & set(held_out):
                yield (
                    f"hold_out: {name} takes its stress from {chain[1]}, which would carry "
                    "held-out data across; write its E, s, R and E_min out"
                )
    elif isinstance(held_out, HeldOutLoadCells):
        names = sorted({cell.name for one in known.values() for cell in one.load_cells})
        for place, name in enumerate(held_out.load_cells):
            if name not in names and len(known) == len(study.experiments):
                hint = did_you_mean(name, names, "known load cells:")
                yield f"hold_out.load_cells[{place}] = {name}: no such load cell{hint}"
    else:
        most = max((one.mass_scheduled for one in known.values()), default=math.inf)
        if held_out.mass_drawn_above >= most:
            yield (
                f"hold_out.mass_drawn_above = {held_out.mass_drawn_above:g}: holds nothing out; "
                f"the experiments draw up to {most:g} kg"
            )


def _data_problems(study: Study, experiments: Mapping[str, Experiment]) -> Iterator[str]:
    """Whether what is not held out can carry the study's parameters."""
    try:
        rows = study_rows(study, experiments)
    except ConfigError:
        return  # said of the table itself
    kept = {n: [r for r in own if not is_held_out(study, n, r)] for n, own in rows.items()}
    count = sum(map(len, kept.values()))
    if not count:
        yield "hold_out: holds out every reading; leave some to calibrate on"
        return
    if study.hold_out != "leave_one_out" and count == sum(map(len, rows.values())):
        yield "hold_out: holds out no reading; name what the measured tables have"
    free = 0
    for shared in study.parameters:
        members = [one for name, one in experiments.items() if kept[name]]
        if shared.name in DRAW_PARAMETERS:
            members = [one for one in members if one.is_draw]
        key = {"material": lambda e: e.material.name, "experiment": lambda e: e.name}
        free += len({key.get(shared.shared_by, lambda e: None)(one) for one in members})
    if study.parameters and not free:
        listed = ", ".join(shared.name for shared in study.parameters)
        yield (
            f"parameters: no reading that is not held out depends on {listed}; "
            "give parameters that act here, or []"
        )
    elif free > count:
        yield (
            f"parameters: {free} values to calibrate on {count} readings; share them more widely "
            "(shared_by: study), or give more readings"
        )


def is_held_out(study: Study, name: str, row: MeasuredRow) -> bool:
    """Whether a study keeps a row of the experiment `name` from the fit."""
    hold_out = study.hold_out
    if isinstance(hold_out, HeldOutLoadCells):
        return row.load_cell in hold_out.load_cells
    if isinstance(hold_out, HeldOutTail):
        return (row.mass_drawn or 0.0) > hold_out.mass_drawn_above
    return hold_out != "leave_one_out" and name in hold_out
