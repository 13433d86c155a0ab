"""Readings of the laboratory as a generator has them, and how far an injected effect moves them.

A generator turns true parameters and injected effects into the stress under the load cells, packing
by packing: `LatticeGenerator` with the package's own model, `IndependentGenerator` without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from pipeline.blind import independent, laboratory
from pipeline.blind.outside import OUTSIDE, Injected
from pipeline.config.experiment import Experiment
from pipeline.effects import Active, Reading, effects
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import Setup, load_cells, make_setup

SHRINKAGE = 0.2  # of the replicate covariance to its diagonal
SENSORS = ("sensor_gain", "sensor_offset", "sensor_drift")
THETA = (*(f"E:{material}" for material in laboratory.MATERIALS), "s", "R", "E_min")
THETA_STD = (*(0.15 for _ in laboratory.MATERIALS), 0.25, 0.4, 0.15)


@dataclass(frozen=True)
class Added:
    """An effect in a world: its values, and the material, experiment or load cell that has it.

    `scope_key` is None where all experiments have it.
    """

    name: str
    scope_key: str | None
    parameters: Mapping[str, Any]

    def document(self) -> dict[str, Any]:
        """As JSON-able data."""
        return {
            "name": self.name,
            "scope_key": self.scope_key,
            "parameters": dict(self.parameters),
        }


class Generator(Protocol):
    """What `readings` needs of a generator; `experiments` are documents by name."""

    experiments: Mapping[str, Mapping[str, Any]]

    def stress(
        self, name: str, theta: np.ndarray, added: Sequence[Added], seed: Sequence[int]
    ) -> np.ndarray:
        """Ground stress (time, load_cell) in kPa of one packing of an experiment."""

    def as_read(self, name: str, stress: np.ndarray, added: Sequence[Added]) -> np.ndarray:
        """The same as the load cells say, faults included."""


def true_parameters(theta: np.ndarray) -> dict[str, Any]:
    """Values of the parameters from their shifts `THETA` (declared: zeros).

    Shifts are of log(1 − E) of each material, log s, logit R and log(1 − E_min).
    """
    *of_E, s, R, E_min = theta
    odds = laboratory.RELAXATION / (1 - laboratory.RELAXATION) * math.exp(R)
    return {
        "E": {
            material: 1.0 - (1.0 - E) * math.exp(shift)
            for (material, E), shift in zip(laboratory.TRANSMISSION.items(), of_E, strict=True)
        },
        "s": laboratory.SPREADING["std"] * math.exp(s),
        "R": odds / (1 + odds),
        "E_min": float(E_min),
    }


def _streams(seed: Sequence[int], name: str) -> tuple[np.random.Generator, np.random.Generator]:
    """Streams of packing and flow of one packing of an experiment."""
    place = [*laboratory.STATIC, *laboratory.DRAWS].index(name)
    root = np.random.SeedSequence(seed[0], spawn_key=(*seed[1:], place))
    return tuple(np.random.default_rng(child) for child in root.spawn(2))


@dataclass
class LatticeGenerator:
    """The package's own model. Effects outside its catalogue are those of `outside`."""

    experiments: Mapping[str, Mapping[str, Any]]
    _loaded: dict[str, Experiment] = field(default_factory=dict)
    _setups: dict[tuple, Setup] = field(default_factory=dict)

    def stress(self, name, theta, added, seed):
        experiment = self._experiment(name)
        active = tuple(
            _switched_on(one)
            for one in added
            if one.name not in SENSORS and one.scope_key in (None, name, experiment.material.name)
        )
        parameters = self._parameters(experiment, theta)
        for one in active:
            if isinstance(one, Injected):
                parameters = one.kind.parameters(parameters, one.values)
        key = (name, *((one.name, *sorted(one.values.items())) for one in active))
        if key not in self._setups:
            self._setups[key] = make_setup(experiment, effects=active)
        packing, flow = _streams(seed, name)
        return simulate(self._setups[key], parameters, packing, flow).vertical_stress

    def as_read(self, name, stress, added):
        experiment = self._experiment(name)
        names = [cell.name for cell in load_cells(experiment)]
        masses = np.zeros(len(stress))
        if experiment.is_draw:
            masses = np.array([0.0, *experiment.readings.at_mass_drawn])
        for one in added:
            if one.name in SENSORS and one.scope_key in names:
                reading = Reading(stress, names.index(one.scope_key), masses)
                stress = effects()[one.name].readings(reading, one.parameters)
        return stress

    def _experiment(self, name: str) -> Experiment:
        if name not in self._loaded:
            experiment = Experiment.model_validate(self.experiments[name])
            self._loaded[name] = experiment.at(f"{name}.yaml")
        return self._loaded[name]

    @staticmethod
    def _parameters(experiment: Experiment, theta: np.ndarray) -> Parameters:
        values = true_parameters(theta)
        declared = replace(declared_parameters(experiment), E=values["E"][experiment.material.name])
        if not experiment.is_draw:
            return declared.with_values({"s": values["s"]})
        return declared.with_values({name: values[name] for name in ("s", "R", "E_min")})


def _switched_on(one: Added) -> Active | Injected:
    if one.name in OUTSIDE:
        return Injected(one.name, one.parameters)
    return Active(one.name, effects()[one.name].neutral | dict(one.parameters))


@dataclass
class IndependentGenerator:
    """The independent simulator; an effect outside the catalogue is a change of its physics."""

    experiments: Mapping[str, Mapping[str, Any]]
    physics: independent.Physics

    def stress(self, name, theta, added, seed):
        physics = self.physics
        for one in added:
            if one.name in independent.CHANGES:
                change = independent.CHANGES[one.name].change
                physics = change(physics, one.parameters["amplitude"])
        return independent.ground_stress(
            {**self.experiments[name], "name": name},
            true_parameters(theta),
            [one.document() for one in added],
            physics,
            *_streams(seed, name),
        )

    def as_read(self, name, stress, added):
        return independent.as_read(
            {**self.experiments[name], "name": name}, stress, [one.document() for one in added]
        )


# ---------------------------------------------------------------------------------------------
# rows


@dataclass(frozen=True)
class Row:
    """A reading: which load cell of which experiment, at which fill height (m) or mass (kg)."""

    experiment: str
    load_cell: str
    fill_height: float | None
    mass_drawn: float | None

    @property
    def held_out(self) -> bool:
        """Whether the study may not calibrate on it."""
        return self.experiment in laboratory.HELD_OUT


def rows_of(name: str, document: Mapping[str, Any]) -> list[Row]:
    """Rows of an experiment in the order of a flattened (time, load_cell) array."""
    cells = [cell["name"] for cell in document["load_cells"]]
    if "draw" in document:
        masses = [0.0, *document["readings"]["at_mass_drawn"]]
        return [Row(name, cell, None, mass) for mass in masses for cell in cells]
    return [Row(name, cell, z, None) for z in document["filling"]["levels"] for cell in cells]


def replicates(
    generator: Generator,
    names: Sequence[str],
    theta: np.ndarray,
    added: Sequence[Added],
    seed: Sequence[int],
    count: int,
) -> dict[str, np.ndarray]:
    """Ground stress (replicate, time, load_cell) in kPa of each experiment."""
    return {
        name: np.array([generator.stress(name, theta, added, (*seed, i)) for i in range(count)])
        for name in names
    }


def read_logs(
    generator: Generator, stress: Mapping[str, np.ndarray], added: Sequence[Added]
) -> dict[str, np.ndarray]:
    """Log of what the load cells say, (replicate, row), of each experiment; NaN if not positive."""
    logs = {}
    for name, values in stress.items():
        read = np.array([generator.as_read(name, one, added) for one in values])
        with np.errstate(invalid="ignore", divide="ignore"):
            logs[name] = np.log(read).reshape(len(read), -1)
    return logs


# ---------------------------------------------------------------------------------------------
# how far an effect moves the readings


class Metric:
    """Length of a shift of log readings, whitened, beyond what calibration can follow.

    Parameters
    ----------
    logs : log readings (replicate, row) of each experiment, for the packings' covariance, which is
        shrunk a little to its diagonal
    rows : rows of each experiment
    noise : sd's of what all readings of one load cell in one experiment share, and of what each
        has of its own
    jacobian : for each parameter, derivatives (1, row) by experiment; one that is missing is 0
    """

    def __init__(
        self,
        logs: Mapping[str, np.ndarray],
        rows: Mapping[str, Sequence[Row]],
        noise: tuple[float, float],
        jacobian: Sequence[Mapping[str, np.ndarray]],
    ):
        self._factors = {name: _whitener(logs[name], rows[name], noise) for name in logs}
        self._jacobian = np.column_stack([self._whitened(one)[0] for one in jacobian])

    def norm(
        self, shift: Mapping[str, np.ndarray], beside: Sequence[Mapping[str, np.ndarray]] = ()
    ) -> float:
        """Norm of the mean of a shift (replicate, row), free of the replicates' scatter.

        Products of different replicates alone are summed, so that scatter adds nothing. What
        lies along the mean shifts `beside` is left out too. 0 of a shift of no experiment.
        """
        if not shift:
            return 0.0
        values = self._projected(shift, beside)
        count, total = len(values), values.sum(axis=0)
        pairs = total @ total - np.einsum("ij,ij->", values, values)
        return math.sqrt(max(pairs / (count * (count - 1)), 0.0))

    def step(self, shift: Mapping[str, np.ndarray]) -> np.ndarray:
        """Change of the parameters that follows the mean of a shift (replicate, row) best."""
        mean = self._whitened(shift).mean(axis=0)
        return np.linalg.lstsq(self._jacobian, mean, rcond=None)[0]

    def cosine(self, one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> float:
        """Of the angle between the means of two shifts (replicate, row)."""
        means = [self._projected(shift).mean(axis=0) for shift in (one, other)]
        return float(means[0] @ means[1] / np.prod([np.linalg.norm(mean) for mean in means]))

    def _projected(self, shift: Mapping[str, np.ndarray], beside=()) -> np.ndarray:
        """Whitened values (replicate, row), without what calibration or `beside` explain."""
        others = [self._whitened(one).mean(axis=0) for one in beside]
        basis, _ = np.linalg.qr(np.column_stack([self._jacobian, *others]))
        values = self._whitened(shift)
        return values - values @ basis @ basis.T

    def _whitened(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """All experiments' whitened values (replicate, row), 0 of one that is missing."""
        count = len(next(iter(values.values())))
        parts = [
            values[name] @ factor.T if name in values else np.zeros((count, len(factor)))
            for name, factor in self._factors.items()
        ]
        return np.concatenate(parts, axis=1)


def _whitener(logs: np.ndarray, rows: Sequence[Row], noise: tuple[float, float]) -> np.ndarray:
    """Inverse of the Cholesky factor (row, row) of an experiment's covariance."""
    covariance = np.cov(logs, rowvar=False)
    covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance))
    cells = np.array([row.load_cell for row in rows])
    shared, own = noise
    covariance += shared**2 * (cells[:, None] == cells) + own**2 * np.eye(len(cells))
    return np.linalg.inv(np.linalg.cholesky(covariance))
