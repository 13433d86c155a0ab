"""What the Snakefile knows: settings, experiments, and what a rule's result depends on."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pipeline.config.load import check_measured, digest, load_experiments, load_studies, sources

PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".pyc", ".smk")
OWN = {"experiments_dir": "workflow_configs/experiments", "studies_dir": "workflow_configs/studies"}
SMALL_RUN = 2e7  # cell sweeps that one thread does in a moment


class Catalog:
    """The experiments and studies of a workflow run, read and checked once.

    With experiments from another folder there are no studies but those of a folder named with it.
    With studies from another folder alone, the experiments are those that the studies name.

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
        self.experiments, self.studies = self._known, {}
        folder = Path(str(config["studies_dir"]))
        if own["studies_dir"] and not (own["experiments_dir"] and any(folder.glob("*.y*ml"))):
            return
        self.studies = load_studies(folder, self._known)
        if not own["studies_dir"] and own["experiments_dir"]:
            named = {name for study in self.studies.values() for name in study.experiments}
            named |= {one.name for name in named for one in sources(self._known[name], self._known)}
            self.experiments = {n: e for n, e in self._known.items() if n in named}

    def file(self, name: str) -> str:
        """Path of the experiment's file."""
        return str(self.experiments[name].path)

    def settings(self, name: str) -> str:
        """Digest of what the experiment's own files say, and of the effects that they declare.

        Its files are the YAML, the measured rows and the mask.
        """
        experiment = self.experiments[name]
        parts = [digest(experiment), repr([_said(row) for row in check_measured(experiment)])]
        parts.append(self.effects(name))
        if experiment.mask_path is not None:
            parts.append(hashlib.sha256(experiment.mask_path.read_bytes()).hexdigest())
        return _sha256("".join(parts))

    def effects(self, name: str) -> str:
        """Digest of the code of the effects that an experiment declares."""
        modules = [PACKAGE / "effects" / f"{e}.py" for e in self.experiments[name].effects]
        return "".join(_digest_with_imports(module) for module in modules)

    def source_calibration(self, name: str) -> list[str]:
        """`calibration.json` of the experiment that `stress: {from: NAME}` refers to, if any."""
        source = self.experiments[name].stress.from_
        return [f"{self.results}/experiments/{source}/calibration.json"] if source else []

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
