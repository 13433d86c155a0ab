"""What is known of an experiment's parameters and effects: a posterior, and what it stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.calibrate.calibration import SCALES, Z90
from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.effects import Active, declared_effects
from pipeline.parameters import Parameters, declared_parameters

TRIES = 10_000  # of a sample within the bounds
PARAMETER, AMPLITUDE = "parameter", "effect"

KEY = ("quantity", "load_cell", "fill_height", "mass_drawn")  # of a row among targets

Point = tuple[Parameters, tuple[Active, ...]]


@dataclass(frozen=True)
class Unknown:
    """A calibrated parameter or an effect's amplitude.

    `best`, `low` and `high` are in the coordinate that it was fitted in, `value` leads back to its
    `unit`. `at_bound`: the fit ended at the end of its range.
    """

    label: str
    kind: str
    unit: str
    best: float
    low: float
    high: float
    value: Callable[[float], float]

    @property
    def at_bound(self) -> bool:
        """Whether the fit ended at the end of its range, where it is no fit."""
        return min(self.best - self.low, self.high - self.best) < 1e-3 * (self.high - self.low)


@dataclass(frozen=True)
class Knowledge:
    """Parameters and effects of an experiment with what is not known of them.

    The unknowns are normal in the coordinates that they were fitted in (E as log(1 − E), the sd
    of s and the flow parameters as logarithms), cut off at their bounds: so the fit itself has
    them, and no sample leaves its range.

    Attributes
    ----------
    source : where it comes from, in words
    unknowns : parameters first, then effects' amplitudes
    covariance : (unknown, unknown) of their coordinates, before they are cut off
    at : parameters and effects at coordinates (unknown); at the best ones those of a plain run,
        to the bit
    remarks : what a reader must know
    """

    source: str
    unknowns: tuple[Unknown, ...]
    covariance: np.ndarray
    at: Callable[[np.ndarray], Point]
    remarks: tuple[str, ...] = ()

    @property
    def best(self) -> np.ndarray:
        """The fitted coordinates (unknown)."""
        return np.array([one.best for one in self.unknowns])

    @property
    def open(self) -> tuple[Unknown, ...]:
        """Unknowns that the data do not bound: their 90 % intervals leave their ranges."""
        half = Z90 * np.sqrt(np.diag(self.covariance))
        return tuple(
            one
            for one, reach in zip(self.unknowns, half, strict=True)
            if one.best - reach < one.low or one.best + reach > one.high
        )

    @property
    def parameters(self) -> int:
        """Number of unknown parameters; the others are amplitudes."""
        return sum(one.kind == PARAMETER for one in self.unknowns)

    @property
    def document(self) -> dict[str, Any]:
        """All that decides a sample, as JSON-able data."""
        parameters, active = self.at(self.best)
        return {
            "labels": [one.label for one in self.unknowns],
            "bounds": [[one.low, one.best, one.high] for one in self.unknowns],
            "covariance": self.covariance.tolist(),
            "parameters": parameters.to_document(),
            "effects": [[one.name, one.load_cell, dict(one.values)] for one in active],
        }

    def relevant(self) -> Knowledge:
        """Without the unknowns that this experiment's parameters and effects do not hang on."""
        here = self.at(self.best)
        kept = []
        for place, one in enumerate(self.unknowns):
            moved = self.best
            moved[place] = (one.low + one.high) / 2
            if moved[place] == one.best:
                moved[place] = one.low
            if self.at(moved) != here:
                kept.append(place)
        best, whole = self.best, self.at

        def at(coordinates: np.ndarray) -> Point:
            every = best.copy()
            every[kept] = coordinates
            return whole(every)

        covariance = self.covariance[np.ix_(kept, kept)]
        unknowns = tuple(self.unknowns[place] for place in kept)
        return replace(self, unknowns=unknowns, covariance=covariance, at=at)

    def sample(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """One sample of all coordinates, and the same with amplitudes as its parameters imply.

        The second has each amplitude at its mean given the parameters: from there to the first is
        what is not known of the effects once the parameters are.

        Raises
        ------
        ValueError
            If no sample lies within the bounds, however often it is tried.
        """
        best, root = self.best, _root(self.covariance)
        low = np.minimum([one.low for one in self.unknowns], best)
        high = np.maximum([one.high for one in self.unknowns], best)
        for _ in range(TRIES):
            drawn = best + root @ random.standard_normal(len(best))
            if np.all((low <= drawn) & (drawn <= high)):
                return drawn, np.clip(self._implied(drawn), low, high)
        labels = ", ".join(one.label for one in self.unknowns)
        raise ValueError(f"{self.source}: no sample of {labels} within their bounds")

    def _implied(self, drawn: np.ndarray) -> np.ndarray:
        n, best = self.parameters, self.best
        of_parameters, across = self.covariance[:n, :n], self.covariance[n:, :n]
        moved = across @ np.linalg.pinv(of_parameters) @ (drawn[:n] - best[:n])
        return np.concatenate([drawn[:n], best[n:] + moved])


def _root(covariance: np.ndarray) -> np.ndarray:
    """Symmetric root of a covariance that may be singular."""
    size, directions = np.linalg.eigh(covariance)
    return directions * np.sqrt(np.maximum(size, 0.0)) @ directions.T


def from_calibration(
    chain: Sequence[Experiment], calibrations: Mapping[str, Mapping[str, Any]]
) -> Knowledge:
    """What calibration says of an experiment, through what `stress: {from: NAME}` refers to.

    Parameters
    ----------
    chain : the experiment, then those its stress comes from, nearest first
    calibrations : content of each one's `calibration.json`, by name

    Each calibration is taken to be independent of the others: that of an experiment holds what it
    took from another one as it was.
    """
    oldest_first = tuple(reversed(chain))
    posteriors = [calibrations[one.name]["posterior"] for one in oldest_first]
    unknowns = tuple(
        _unknown(name, u, one.name if one is not chain[0] else "")
        for one, posterior in zip(oldest_first, posteriors, strict=True)
        for name, u in zip(posterior["parameters"], posterior["coordinates"], strict=True)
    )
    covariance = np.zeros((len(unknowns), len(unknowns)))
    done = 0
    for posterior in posteriors:
        size = len(posterior["parameters"])
        if size:
            block = slice(done, done + size)
            covariance[block, block] = posterior["covariance"]
        done += size
    best = [one.best for one in unknowns]
    effects = declared_effects(chain[0])

    def at(coordinates: np.ndarray) -> Point:
        moved = iter(zip(coordinates, best, strict=True))
        parameters = None
        for one, posterior in zip(oldest_first, posteriors, strict=True):
            used = Parameters.from_document(calibrations[one.name]["parameters_used"])
            values = {name: used.value(name) for name in posterior["parameters"]}
            for name in posterior["parameters"]:
                u, fitted = next(moved)
                if u != fitted:
                    values[name] = SCALES[name].backward(u)
            sources = None if parameters is None else {one.stress.from_: parameters}
            parameters = declared_parameters(one, sources).with_values(values)
        return parameters, effects

    fitted_in = [
        one.name
        for one, posterior in zip(oldest_first, posteriors, strict=True)
        if posterior["parameters"]
    ]
    source = f"calibration of {' and '.join(fitted_in)}" if fitted_in else "nothing calibrated"
    return Knowledge(source, unknowns, covariance, at).relevant()


def was_calibrated(calibration: Mapping[str, Any], row: MeasuredRow) -> bool:
    """Whether the experiment's own calibration was fitted to a measured row."""
    return any(
        all(target[key] == getattr(row, key) for key in KEY) for target in calibration["targets"]
    )


def _unknown(name: str, u: float, where: str) -> Unknown:
    scale = SCALES[name]
    label = f"{name} ({where})" if where else name
    return Unknown(label, PARAMETER, scale.unit, u, *scale.bounds, scale.backward)
