"""What the Snakefile knows: settings, experiments, and what a rule's result depends on."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pipeline.config.load import (
    check_measured,
    digest,
    load_comparisons,
    load_experiments,
    load_studies,
    sources,
)
from pipeline.config.messages import ConfigError

PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".pyc", ".smk")
OWN = {
    "experiments_dir": "workflow_configs/experiments",
    "studies_dir": "workflow_configs/studies",
    "comparisons_dir": "workflow_configs/comparisons",
}
SMALL_RUN = 2e7  # cell sweeps that one thread does in a moment


class Catalog:
    """The experiments, studies and comparisons of a workflow run, read and checked once.

    With a folder of one's own the repository's studies and comparisons are left out. With
    experiments from another folder, studies and comparisons are those of folders named with it;
    without, the experiments are those that the studies and comparisons of such folders name.

    Raises
    ------
    ConfigError
        With every problem of every file.
    """

    def __init__(self, config: Mapping[str, object]):
        self.results = str(config["results_dir"]).rstrip("/")
        self._on_cluster = bool(config["dask_scheduler"])
        own = {key: str(config[key]).rstrip("/") == folder for key, folder in OWN.items()}
        self._known = load_experiments(Path(str(config["experiments_dir"])))
        found: list[tuple[Path, str]] = []

        def load(key, load_folder):
            folder = Path(str(config[key]))
            if own[key] and not (all(own.values()) and any(folder.glob("*.y*ml"))):
                return {}
            try:
                return load_folder(folder, self._known)
            except ConfigError as error:
                found.extend(error.problems)
                return {}

        self.studies = load("studies_dir", load_studies)
        self.comparisons = load("comparisons_dir", load_comparisons)
        if found:
            raise ConfigError(found)
        self.experiments = self._known
        if own["experiments_dir"] and not all(own.values()):
            users = [*self.studies.values(), *self.comparisons.values()]
            named = {name for user in users for name in user.experiments}
            named |= {one.name for name in named for one in sources(self._known[name], self._known)}
            self.experiments = {n: e for n, e in self._known.items() if n in named}

    def file(self, name: str) -> str:
        """Path of the experiment's file."""
        return str(self.experiments[name].path)

    def settings(self, name: str) -> str:
        """Digest of what the experiment's own files say, and of the effects that they declare.

        Its files are the YAML, the measured rows, the mask and the regions'.
        """
        experiment = self.experiments[name]
        parts = [digest(experiment), repr([_said(row) for row in check_measured(experiment)])]
        parts.append(self.effects(name))
        masks = [experiment.mask_path] if experiment.mask_path is not None else []
        for file in (*masks, *experiment.region_paths.values()):
            parts.append(hashlib.sha256(file.read_bytes()).hexdigest())
        return _sha256("".join(parts))

    def effects(self, name: str) -> str:
        """Digest of the code of the effects that an experiment declares."""
        modules = [PACKAGE / "effects" / f"{e}.py" for e in self.experiments[name].effects]
        return "".join(_digest_with_imports(module) for module in modules)

    def blind_scores(self) -> list[str]:
        """Path of a blind benchmark's `scores.json` and its digest; nothing where none was run."""
        path = Path(self.results, "blind_benchmark", "scores.json")
        return [str(path), hashlib.sha256(path.read_bytes()).hexdigest()] if path.is_file() else []

    def source_calibration(self, name: str) -> list[str]:
        """`calibration.json` of the experiment that `stress: {from: NAME}` refers to, if any."""
        source = self.experiments[name].stress.from_
        return [f"{self.results}/experiments/{source}/calibration.json"] if source else []

    def grade_file(self, name: str, suffix: str) -> str | list[str]:
        """`grade.nc` or `grade.csv` of an experiment whose drawn ground has grades or waste."""
        has_curves = self.experiments[name].has_grade_curves
        return f"{self.results}/experiments/{name}/grade.{suffix}" if has_curves else []

    def study_file(self, name: str) -> str:
        """Path of the study's file."""
        return str(self.studies[name].path)

    def study_experiments(self, name: str) -> list[str]:
        """Files of its experiments and of those whose stress they take."""
        return [self.file(one) for one in self._chain(name)]

    def study_settings(self, name: str) -> str:
        """Digest of what the study's files say: its own, its table's and its experiments'."""
        study = self.studies[name]
        parts = [digest(study), *(self.settings(one) for one in self._chain(name))]
        if study.data_path is not None:
            parts.append(hashlib.sha256(study.data_path.read_bytes()).hexdigest())
        return _sha256("".join(parts))

    def comparison_file(self, name: str) -> str:
        """Path of the comparison's file."""
        return str(self.comparisons[name].path)

    def compared_files(self, name: str) -> list[str]:
        """Files of the two experiments that are compared."""
        return [self.file(one) for one in self.comparisons[name].experiments]

    def compared_replicates(self, name: str) -> list[str]:
        """Their `replicates.nc`."""
        pair = self.comparisons[name].experiments
        return [f"{self.results}/experiments/{one}/replicates.nc" for one in pair]

    def comparison_settings(self, name: str) -> str:
        """Digest of what the comparison's file and its experiments' files say."""
        comparison = self.comparisons[name]
        parts = [digest(comparison), *(self.settings(one) for one in comparison.experiments)]
        return _sha256("".join(parts))

    def _chain(self, name: str) -> list[str]:
        named = self.studies[name].experiments
        chains = (sources(self.experiments[one], self.experiments) for one in named)
        return list(dict.fromkeys(one.name for chain in chains for one in chain))

    def threads(self, name: str, cores: int | None) -> int:
        """One thread for a small experiment, all cores for a large one.

        On a Dask cluster one for each: its workers compute, and the job waits for them.
        """
        if self._on_cluster:
            return 1
        experiment = self.experiments[name]
        g = experiment.geometry
        cells = g.width * g.length * g.height / g.cell_size**3
        readings = 1
        if experiment.is_draw and experiment.readings.every:
            readings = experiment.mass_scheduled / experiment.readings.every
        return (cores or 1) if cells * readings * experiment.replicates > SMALL_RUN else 1


def _said(row) -> tuple:
    """A measured row without its place in the file."""
    return tuple(value for key, value in vars(row).items() if key != "line")


@cache
def source_digest(script: str) -> str:
    """Digest of the code that a rule's script runs: itself and all of `pipeline` it imports.

    Comments and layout do not count; data files beside a module do.
    """
    return _digest_with_imports(PACKAGE / "workflow" / "scripts" / f"{script}.py")


def blind_seed(config: Mapping[str, object]) -> int:
    """Seed of the blind benchmark's worlds: the one given, or that of the commit under test."""
    if config["blind_seed"] is not None:
        return int(str(config["blind_seed"]))
    from pipeline.blind.worlds import scoring_seed
    from pipeline.files.netcdf import git_revision

    return scoring_seed(git_revision())


def effects_digest() -> str:
    """Digest of all effects: they are found by being in their folder, not by an import."""
    modules = sorted((PACKAGE / "effects").glob("*.py"))
    return _sha256("".join(f"{m.name}{_digest_with_imports(m)}" for m in modules))


@cache
def _digest_with_imports(path: Path) -> str:
    seen: dict[Path, str] = {}
    todo = [path]
    while todo:
        path = todo.pop()
        if path not in seen:
            seen[path], imported = _read_module(path)
            todo += imported
    return _sha256("".join(f"{path.name}{seen[path]}" for path in sorted(seen)))


@cache
def _read_module(path: Path) -> tuple[str, list[Path]]:
    """Digest of a module with the data files beside it, and the modules here that it imports."""
    tree = ast.parse(path.read_text("utf-8"))
    data = sorted(f for f in path.parent.iterdir() if f.is_file() and f.suffix not in CODE)
    digest = _sha256(ast.dump(tree) + "".join(_sha256(f.read_text("utf-8")) for f in data))
    imported = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        imported += [target for name in names if (target := _path_of(name)) is not None]
    return digest, imported


def _path_of(module: str) -> Path | None:
    """Source file of a module of this package; None for anything else."""
    head, *rest = module.split(".")
    if head != PACKAGE.name:
        return None
    path = PACKAGE.joinpath(*rest)
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
