"""What the Snakefile knows: settings, experiments, and what a rule's result depends on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import yaml

from pipeline.config.load import (
    check_measured,
    digest,
    load_comparisons,
    load_experiments,
    load_studies,
    prediction_problems,
    sources,
)
from pipeline.config.messages import ConfigError, did_you_mean
from pipeline.workflow.source import PACKAGE, digest_with_imports, sha256

DEFAULTS = PACKAGE.parent / "workflow_configs" / "default.yaml"
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
        check_settings(config)
        self.results = str(config["results_dir"]).rstrip("/")
        self._on_cluster = bool(config["dask_scheduler"])
        self._settings: dict[str, str] = {}
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
        self.predicted = [n for n, e in self._known.items() if e.prediction is not None]
        if own["experiments_dir"] and not all(own.values()):  # its studies are left out
            self.predicted = [n for n in self.predicted if self._has_study(n)]
        for name in self.predicted:
            found += prediction_problems(self._known[name], self.studies, self._known)
        if found:
            raise ConfigError(found)
        self.experiments = self._known
        if own["experiments_dir"] and not all(own.values()):
            users = [*self.studies.values(), *self.comparisons.values()]
            named = {name for user in users for name in user.experiments}
            named |= {one.name for name in named for one in sources(self._known[name], self._known)}
            self.experiments = {n: e for n, e in self._known.items() if n in named}
            self.predicted = [name for name in self.predicted if name in named]

    def file(self, name: str) -> str:
        """Path of the experiment's file."""
        return str(self.experiments[name].path)

    def settings(self, name: str) -> str:
        """Digest of what the experiment's own files say, and of the effects that they declare.

        Its files are the YAML, the measured rows, the mask and the regions'.
        """
        if name not in self._settings:
            self._settings[name] = self._read_settings(name)
        return self._settings[name]

    def _read_settings(self, name: str) -> str:
        experiment = self.experiments[name]
        parts = [digest(experiment), repr([_said(row) for row in check_measured(experiment)])]
        parts.append(self.effects(name))
        for file in experiment.files.values():
            parts.append(hashlib.sha256(file.read_bytes()).hexdigest())
        return sha256("".join(parts))

    def effects(self, name: str) -> str:
        """Digest of the code of the effects that an experiment declares."""
        modules = [PACKAGE / "effects" / f"{e}.py" for e in self.experiments[name].effects]
        return "".join(digest_with_imports(module) for module in modules)

    def blind_scores(self) -> list[str]:
        """Path of a blind benchmark's `scores.json` and its digest; nothing where none was run."""
        path = Path(self.results, "blind_benchmark", "scores.json")
        return [str(path), hashlib.sha256(path.read_bytes()).hexdigest()] if path.is_file() else []

    def source_calibration(self, name: str) -> list[str]:
        """`calibration.json` of the experiment that `stress: {from: NAME}` refers to, if any."""
        source = self.experiments[name].stress.from_
        return [f"{self.results}/experiments/{source}/calibration.json"] if source else []

    def _has_study(self, name: str) -> bool:
        study = self._known[name].prediction.study
        return study is None or study in self.studies

    def prediction_page(self, name: str) -> dict[str, str]:
        """The page of an experiment's prediction, by its name among the inputs of its report."""
        folder = f"{self.results}/experiments/{name}"
        return {"prediction": f"{folder}/prediction.html"} if name in self.predicted else {}

    def prediction_inputs(self, name: str) -> dict[str, object]:
        """Files of results that a prediction comes from: a study's, or calibrations."""
        study = self.experiments[name].prediction.study
        if study is not None:
            return {"attribution": f"{self.results}/studies/{study}/attribution.json"}
        chain = sources(self.experiments[name], self.experiments)
        folder = f"{self.results}/experiments"
        return {"calibrations": [f"{folder}/{one.name}/calibration.json" for one in chain]}

    def prediction_study(self, name: str) -> str | None:
        """Path of the file of the study that a prediction names; None without one."""
        study = self.experiments[name].prediction.study
        return None if study is None else self.study_file(study)

    def prediction_experiments(self, name: str) -> list[str]:
        """Files of the experiment, those its stress comes from, and those of its study."""
        chain = [one.name for one in sources(self.experiments[name], self.experiments)]
        study = self.experiments[name].prediction.study
        chain += self._chain(study) if study is not None else []
        return [self.file(one) for one in dict.fromkeys(chain)]

    def prediction_threads(self, name: str, cores: int | None) -> int:
        """As `threads`, for a prediction."""
        return self.threads(name, cores, 2 * self.experiments[name].prediction.samples)

    def prediction_settings(self, name: str) -> str:
        """Digest of what the prediction's settings and all these files say."""
        prediction = self.experiments[name].prediction
        parts = [
            digest(prediction),
            *(self.settings(one.name) for one in sources(self.experiments[name], self.experiments)),
        ]
        if prediction.study is not None:
            parts.append(self.study_settings(prediction.study))
        return sha256("".join(parts))

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
        return sha256("".join(parts))

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
        return sha256("".join(parts))

    def _chain(self, name: str) -> list[str]:
        named = self.studies[name].experiments
        chains = (sources(self.experiments[one], self.experiments) for one in named)
        return list(dict.fromkeys(one.name for chain in chains for one in chain))

    def threads(self, name: str, cores: int | None, replicates: int | None = None) -> int:
        """One thread for a small experiment, all cores for a large one.

        `replicates` stand in for its own number of them.
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
        return (
            (cores or 1)
            if cells * readings * (replicates or experiment.replicates) > SMALL_RUN
            else 1
        )


def check_settings(config: Mapping[str, object]) -> None:
    """ConfigError with each key of ``--config`` that the workflow does not know."""
    known = yaml.safe_load(DEFAULTS.read_text("utf-8"))
    found = [
        (Path("--config"), f"{key}: unknown key{did_you_mean(key, known, 'known keys:')}")
        for key in config
        if key not in known
    ]
    if found:
        raise ConfigError(found)


def _said(row) -> tuple:
    """A measured row without its place in the file."""
    return tuple(value for key, value in vars(row).items() if key != "line")


def blind_seed(config: Mapping[str, object]) -> int:
    """Seed of the blind benchmark's worlds: the one given, or that of the commit under test."""
    if config["blind_seed"] is not None:
        return int(str(config["blind_seed"]))
    from pipeline.blind.worlds import scoring_seed
    from pipeline.files.netcdf import git_revision

    return scoring_seed(git_revision())
