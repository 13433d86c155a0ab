"""What is known of an experiment's parameters and effects: a posterior, and what it stands for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from pipeline.calibrate.calibration import SCALES, Z90, at_end
from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.effects import Active, declared_effects
from pipeline.parameters import Parameters, declared_parameters

TRIES = 10_000  # of a sample within the bounds
UNTOLD = 0.5  # of its prior's sd: from there on the readings tell next to nothing of an unknown
PARAMETER, AMPLITUDE = "parameter", "effect"

KEY = ("quantity", "load_cell", "fill_height", "mass_drawn")  # of a row among targets

Point = tuple[Parameters, tuple[Active, ...]]


@dataclass(frozen=True)
class Unknown:
    """A calibrated parameter or an effect's amplitude.

    `best`, `low`, `high` and the sd of its weak `prior` are in the coordinate that it is drawn in,
    `value` leads back to its `unit`. `at_bound`: the fit ended at the end of its range.
    """

    label: str
    kind: str
    unit: str
    best: float
    low: float
    high: float
    value: Callable[[float], float]
    prior: float
    at_bound: bool

    @classmethod
    def parameter(cls, name: str, label: str, u: float, prior: float | None = None) -> Unknown:
        """A parameter that was fitted at `u`; without the sd of a prior, one as wide as its range.

        E is drawn as it is: where it is near 1 readings are straight in E, and next to flat in
        log(1 − E), in which the fit has it. Others are drawn in the coordinate of the fit.
        """
        scale = SCALES[name]
        low, high = scale.bounds
        at_bound, value = at_end(u, low, high), scale.backward
        if name == "E":
            u, low, high, value, prior = scale.backward(u), scale.low, scale.high, float, None
        prior = prior or high - low
        return cls(label, PARAMETER, scale.unit, u, low, high, value, prior, at_bound)

    @classmethod
    def amplitude(
        cls, label: str, unit: str, best: float, low: float, high: float, prior: float
    ) -> Unknown:
        """An effect's amplitude, drawn as it is."""
        at_bound = at_end(best, low, high)
        return cls(label, AMPLITUDE, unit, best, low, high, float, prior, at_bound)


@dataclass(frozen=True)
class Knowledge:
    """Parameters and effects of an experiment with what is not known of them.

    The unknowns are normal in the coordinates that they are drawn in (the sd of s and the flow
    parameters as logarithms, others as they are), cut off at their bounds: no sample leaves its
    range.

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
        """The fitted values, as drawn (unknown)."""
        return np.array([one.best for one in self.unknowns])

    @property
    def untold(self) -> tuple[Unknown, ...]:
        """Unknowns of which the data tell next to nothing, alone or apart from the others."""
        sd = np.sqrt(np.diag(self.covariance))
        return tuple(
            u for u, spread in zip(self.unknowns, sd, strict=True) if spread > UNTOLD * u.prior
        )

    @property
    def open(self) -> tuple[Unknown, ...]:
        """The others that the data do not bound: their 90 % intervals leave their ranges."""
        half = Z90 * np.sqrt(np.diag(self.covariance))
        return tuple(
            one
            for one, reach in zip(self.unknowns, half, strict=True)
            if (one.best - reach < one.low or one.best + reach > one.high)
            and one not in self.untold
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


def drawn_slope(name: str, u: float) -> float:
    """How a parameter moves in the coordinate that it is drawn in, by that of the fit, at `u`."""
    return -math.exp(u) if name == "E" else 1.0


def within(covariance: np.ndarray, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Covariance (unknown, unknown) of a fit without priors, together with the unknowns' own.

    So a fit that ended where readings are flat has samples within its bounds.
    """
    prior = np.diag([one.prior**2 for one in unknowns])
    return covariance @ np.linalg.solve(covariance + prior, prior)


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
    fitted = [
        (name, u, name if one is chain[0] else f"{name} ({one.name})")
        for one, posterior in zip(oldest_first, posteriors, strict=True)
        for name, u in zip(posterior["parameters"], posterior["coordinates"], strict=True)
    ]
    unknowns = tuple(Unknown.parameter(name, label, u) for name, u, label in fitted)
    slopes = np.array([drawn_slope(name, u) for name, u, _ in fitted])
    blocks = [np.reshape(p["covariance"], (len(p["parameters"]),) * 2) for p in posteriors]
    covariance = within(block_diag(*blocks) * np.outer(slopes, slopes), unknowns)
    effects = declared_effects(chain[0])

    def at(coordinates: np.ndarray) -> Point:
        moved = iter(zip(coordinates, unknowns, strict=True))
        parameters = None
        for one, posterior in zip(oldest_first, posteriors, strict=True):
            used = Parameters.from_document(calibrations[one.name]["parameters_used"])
            values = {name: used.value(name) for name in posterior["parameters"]}
            for name in posterior["parameters"]:
                drawn, unknown = next(moved)
                if drawn != unknown.best:
                    values[name] = unknown.value(drawn)
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
