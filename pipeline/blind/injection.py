"""What is put into blind worlds: effects, by how far they move a laboratory's readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.blind import independent, laboratory
from pipeline.blind.outside import OUTSIDE
from pipeline.blind.truth import (
    SENSORS,
    THETA,
    THETA_STD,
    Added,
    Generator,
    Metric,
    read_logs,
    replicates,
    rows_of,
)

SHARED, OWN = 0.08, 0.055  # of a CV of 10 %: what a load cell's readings share, and each its own
REPLICATES = 64  # of the noise-free means of held-out experiments
SCATTER = 32  # of the others, and of their covariance
COMMON = 16  # on common random numbers, of the shift that an effect makes
PROBES = 4  # on common random numbers, of a derivative
LOOKS = 8  # on common random numbers, of a first look at an amplitude
FOLLOWED, STRIDE = 7, 0.4  # steps of a calibration after a shift, and the longest of a parameter
SHARED_PACKINGS, TRUE_PACKING = 0, 1  # streams of all that is averaged, and of the one measured

# Parameter, and the range of it that a laboratory might meet. Cohesion, segregation, memory of
# arches and a looser movement zone move no reading of this laboratory by one standard deviation
# whatever their amplitude; packing variability moves no mean at all.
AMPLITUDES = {
    "arching": ("transfer", 0.0, 1.0),
    "compaction": ("index", 0.0, 0.3),
    "pillar_relaxation": ("width", 0.0, 2.0),
    "relaxation_in_time": ("rate", 0.0, 0.5),
    "stress_dependent_transmission": ("slope", -0.8, 0.8),
    "surcharge": ("stress", 0.0, 6.0),
    "tilt": ("angle_x", -15.0, 15.0),
    "wall_friction": ("K", 0.0, 1.0),
    "density_misdeclared": ("factor", 0.6, 1.6),
    "fill_height_misdeclared": ("factor", 0.7, 1.3),
    "sensor_gain": ("gain", 0.4, 2.5),
    "sensor_offset": ("offset", -2.5, 8.0),
    "sensor_drift": ("rate", -0.025, 0.05),
}
INPUTS = ("density_misdeclared", "fill_height_misdeclared")
FACTORS = (*INPUTS, "sensor_gain")  # neutral at 1
PHYSICS = tuple(name for name in AMPLITUDES if name not in (*INPUTS, *SENSORS))
OF_MATERIAL = (
    "compaction",
    "density_misdeclared",
    "stress_dependent_transmission",
    "wall_friction",
)
INDEPENDENT_PHYSICS = (  # written for the independent generator too
    "arching",
    "compaction",
    "pillar_relaxation",
    "stress_dependent_transmission",
    "surcharge",
    "tilt",
    "wall_friction",
)


class World:
    """One laboratory: its generator, its true parameters, and what was simulated of it so far."""

    def __init__(self, generator: Generator, documents, theta: np.ndarray, seed: Sequence[int]):
        self.generator, self.documents, self.theta, self.seed = generator, documents, theta, seed
        self.fitted = [name for name in documents if name not in laboratory.HELD_OUT]
        self.rows = {name: rows_of(name, documents[name]) for name in documents}
        self.all_rows = [row for rows in self.rows.values() for row in rows]

    def simulate(self, names, added, count, theta=None, packings=SHARED_PACKINGS):
        """Ground stress (replicate, time, load_cell) in kPa by experiment."""
        theta = self.theta if theta is None else theta
        return replicates(self.generator, names, theta, added, (*self.seed, packings), count)

    @cached_property
    def base(self) -> dict[str, np.ndarray]:
        """Ground stress without any effect."""
        return self.simulate(self.fitted, (), COMMON)

    @cached_property
    def jacobian(self) -> list[dict[str, np.ndarray]]:
        """Derivative of the mean log readings, (1, row) by experiment, for each of `THETA`."""
        derivatives = []
        for place, std in enumerate(THETA_STD):
            names = [name for name in self.fitted if self._depends(name, THETA[place])]
            logs = []
            for step in (0.5 * std, -0.5 * std):
                theta = self.theta.copy()
                theta[place] += step
                stress = self.simulate(names, (), PROBES, theta)
                logs.append(read_logs(self.generator, stress, ()))
            up, down = logs
            derivatives.append({n: (up[n] - down[n]).mean(axis=0)[None] / std for n in names})
        return derivatives

    def _depends(self, name: str, parameter: str) -> bool:
        document = self.documents[name]
        if parameter.startswith("E:"):
            return parameter == f"E:{document['material']['name']}"
        return parameter == "s" or "draw" in document

    @cached_property
    def first_metric(self) -> Metric:
        """How far readings move beyond what calibration reaches, by the scatter without effects."""
        return self.metric(read_logs(self.generator, self.base, ()))

    def metric(self, logs: Mapping[str, np.ndarray]) -> Metric:
        """The same by the scatter of these logs (replicate, row)."""
        return Metric(logs, self.rows, (SHARED, OWN), self.jacobian)

    def shift(self, added: Sequence[Added], count: int, after=None) -> dict[str, np.ndarray]:
        """Change of log readings (replicate, row) by these effects, on common random numbers.

        `after` is the ground stress with them where it is known.
        """
        names = [n for n in self.fitted if any(self._reaches(one, n) for one in added)]
        before = {name: self.base[name][:count] for name in names}
        if after is None:
            in_ground = any(one.name not in SENSORS for one in added)
            after = self.simulate(names, added, count) if in_ground else before
        before = read_logs(self.generator, before, ())
        after = read_logs(self.generator, {name: after[name][:count] for name in names}, added)
        return {name: after[name] - before[name] for name in names}

    def _reaches(self, one: Added, name: str) -> bool:
        cells = {row.load_cell for row in self.rows[name]} if one.name in SENSORS else set()
        material = self.documents[name]["material"]["name"]
        return one.scope_key in {None, name, material, *cells}

    def delta(self, one: Added) -> float:
        """How far an effect moves the readings, by a first look; 0 if one is no longer positive."""
        shift = self.shift((one,), LOOKS)
        if not all(np.isfinite(values).all() for values in shift.values()):
            return 0.0
        return self.first_metric.norm(shift)

    def joint_delta(self, added: Sequence[Added]) -> float:
        """How far effects together move the readings from a calibration that follows them.

        A large shift may be one that other parameters make as well, though not in proportion to
        their derivatives here: calibration goes after it in steps.
        """
        if not any(self._reaches(one, name) for one in added for name in self.fitted):
            return 0.0
        moved = read_logs(self.generator, self.simulate(self.fitted, added, LOOKS), added)
        theta, deltas = self.theta.copy(), []
        for _ in range(FOLLOWED):
            followed = read_logs(self.generator, self.simulate(self.fitted, (), LOOKS, theta), ())
            shift = {name: moved[name] - followed[name] for name in self.fitted}
            deltas.append(self.first_metric.norm(shift))
            theta = theta + np.clip(0.6 * self.first_metric.step(shift), -STRIDE, STRIDE)
        return min(deltas)

    def likeness(self, one: Added, others: Sequence[Added]) -> list[float]:
        """Cosines of an effect's shift and others', by a first look.

        Of what is beyond calibration alone.
        """
        shift, *of_others = (self.shift((of,), LOOKS) for of in (one, *others))
        return [self.first_metric.cosine(shift, other) for other in of_others]

    def moved_held_out(self, added: Sequence[Added]) -> float:
        """Rms change of the log mean ground stress in what is held out, by a first look."""
        ratios = []
        without, moved = (self.simulate(laboratory.HELD_OUT, a, LOOKS) for a in ((), added))
        for name in laboratory.HELD_OUT:
            means = (of[name].mean(axis=0).ravel() for of in (moved, without))
            ratios.append(np.divide(*means))
        return float(np.sqrt(np.mean(np.log(np.concatenate(ratios)) ** 2)))

    def truth_of(self, added: Sequence[Added]) -> tuple[list[dict], list[dict]]:
        """Documents of the effects, with how far each moves the readings, and of the rows."""
        stress = self.simulate(self.fitted, added, SCATTER)
        stress |= self.simulate(laboratory.HELD_OUT, added, REPLICATES)
        packing = self.simulate(self.documents, added, 1, packings=TRUE_PACKING)
        effects = [self._effect(one, added, stress) for one in added]
        rows = []
        for name, of_name in self.rows.items():
            of_ground = np.log(stress[name]).reshape(len(stress[name]), -1)
            (true,) = packing[name]
            columns = {
                "stress": np.exp(of_ground.mean(axis=0)),
                "log_std": of_ground.std(axis=0, ddof=1),
                "packing": true.ravel(),
                "reading": self.generator.as_read(name, true, added).ravel(),
            }
            for place, row in enumerate(of_name):
                values = {key: float(column[place]) for key, column in columns.items()}
                rows.append(asdict(row) | {"held_out": row.held_out} | values)
        return effects, rows

    def _effect(self, one: Added, added: Sequence[Added], stress) -> dict[str, Any]:
        logs = read_logs(self.generator, {name: stress[name] for name in self.fitted}, added)
        metric = self.metric(logs)
        others = [self.shift((other,), COMMON) for other in added if other != one]
        shift = self.shift((one,), COMMON, None if others else stress)
        document = one.document() | {"delta": metric.norm(shift)}
        if others:
            document["delta_beside_others"] = metric.norm(shift, beside=others)
        kind = OUTSIDE.get(one.name) or independent.CHANGES.get(one.name)
        if kind is not None:
            document |= {"words": kind.words, "channel": kind.channel, "place": list(kind.place)}
        return document


def effect_near(world: World, names: Sequence[str], choice, log_delta: float) -> Added:
    """The first of the effects, in random order, that can move the readings so far.

    Where none can, it is the one that moves them most.
    """
    most, farthest = -1.0, None
    for name in choice.permutation(list(names)):
        path = path_of(world, str(name), choice)
        reached = world.delta(path(1.0))
        if reached >= math.exp(log_delta):
            return nearest(world, path, reached, log_delta)
        if reached > most:
            most, farthest = reached, path(1.0)
    return farthest


def path_of(world: World, name: str, choice) -> Callable[[float], Added]:
    """An effect on one of its sides, from neutral (0) to the end of its range (1)."""
    if name in AMPLITUDES:
        parameter, low, high = AMPLITUDES[name]
    else:
        kind = OUTSIDE.get(name) or independent.CHANGES[name]
        parameter, low, high = "amplitude", kind.low, kind.high
    key = _scope_key(world, name, choice)
    neutral = 1.0 if name in FACTORS else 0.0
    end = choice.choice([end for end in (low, high) if end != neutral])
    return lambda part: Added(name, key, {parameter: float(neutral + part * (end - neutral))})


def nearest(world: World, path: Callable, reached: float, log_delta: float) -> Added:
    """The effect on its path that moves the readings by about so much, `reached` at its end.

    How far it moves them is taken for a power of the way along the path.
    """
    part, power = 1.0, 1.0
    for _ in range(3):
        ahead = log_delta - math.log(reached)
        if abs(ahead) < 0.1:
            break
        nearer = min(part * math.exp(ahead / power), 1.0)
        then = max(world.delta(path(nearer)), 0.05)
        if nearer != part and then != reached:
            power = max(math.log(then / reached) / math.log(nearer / part), 0.2)
        part, reached = nearer, then
    return path(part)


def _scope_key(world: World, name: str, choice) -> str | None:
    if name in SENSORS:
        cells = sorted({row.load_cell for row in world.all_rows})
        return str(choice.choice(cells))
    if name in OF_MATERIAL:
        return str(choice.choice(list(laboratory.MATERIALS)))
    if name == "fill_height_misdeclared":
        return str(choice.choice(world.fitted))
    return None
