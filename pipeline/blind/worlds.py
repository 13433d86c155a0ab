"""Blind worlds: a laboratory's experiments as the loop gets them, and the truth apart from them.

A world is a folder `world_NNNN` with `experiments/*.yaml`, `experiments/measured/data.csv` and
`studies/world_NNNN.yaml`. Its truth is `world_NNNN.json` under another root that only the scorer
opens; `hashes.json` beside the worlds holds the SHA-256 of every truth. World `index` of a seed is
always the same, whatever the others.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pipeline.blind import independent, laboratory
from pipeline.blind.outside import OUTSIDE
from pipeline.blind.tasks import each
from pipeline.blind.truth import (
    SENSORS,
    THETA,
    THETA_STD,
    Added,
    Generator,
    IndependentGenerator,
    LatticeGenerator,
    Metric,
    read_logs,
    replicates,
    rows_of,
    true_parameters,
)
from pipeline.files.atomic import read_json, write_json, write_text

FORMAT_VERSION = 2
SHARED, OWN = 0.08, 0.055  # of a CV of 10 %: what a load cell's readings share, and each its own
UNDERSTATED = 1.5  # true over declared noise of the nulls whose noise is understated
HARD_NULLS = 5000  # index from which worlds are hard nulls, of the two kinds in turn
REPLICATES = 64  # of the noise-free means of held-out experiments
SCATTER = 32  # of the others, and of their covariance
COMMON = 16  # on common random numbers, of the shift that an effect makes
PROBES = 6  # on common random numbers, of a derivative
LOOKS = 12  # on common random numbers, of a first look at an amplitude
PACKINGS = 3  # spawn key of the packings' streams
SHARED_PACKINGS, TRUE_PACKING = 0, 1  # streams of all that is averaged, and of the one measured
DELTA_RANGE = (1.0, 20.0)
PAIR_DELTA_RANGE = (3.0, 20.0)

MIX = (  # of every twenty worlds
    *(("null_plain", "lattice"),) * 4,
    *(("null_plain", "independent"),) * 2,
    *(("one", "lattice"),) * 5,
    *(("one", "independent"),) * 2,
    ("two", "lattice"),
    ("two", "independent"),
    *(("outside", "lattice"),) * 2,
    ("outside", "independent"),
    ("sensor_or_input", "lattice"),
    ("sensor_or_input", "independent"),
)

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


def make_worlds(
    root: Path | str,
    sealed_root: Path | str,
    count: int,
    seed: int,
    hard_nulls: int = 0,
    workers: int = 1,
) -> list[str]:
    """Write `count` worlds of the mix, and as many hard nulls of each kind as asked for.

    Worlds that are there already and match their truth are kept. Returns their names in order,
    after `hashes.json` is written under `root`; `workers` processes change no number.
    """
    indices = [*range(count), *range(HARD_NULLS, HARD_NULLS + 2 * hard_nulls)]
    one = partial(make_world, Path(root), Path(sealed_root), seed)
    digests = each("blind worlds, making them", one, indices, workers)
    names = [world_name(index) for index in indices]
    write_json(Path(root) / "hashes.json", dict(zip(names, digests, strict=True)))
    return names


def make_world(root: Path, sealed_root: Path, seed: int, index: int, **replaced: Any) -> str:
    """Write world `index` of a seed, or keep it; the SHA-256 of its sealed truth.

    `replaced` is passed on to `draw_world`.
    """
    name = world_name(index)
    sealed = sealed_root / f"{name}.json"
    if not _is_whole(root / name, sealed, seed, index):
        files, truth = draw_world(seed, index, **replaced)
        for path, text in files.items():
            write_text(root / name / path, text)
        write_json(sealed, truth)
    return digest_of(sealed.read_bytes())


def scoring_seed(commit: str) -> int:
    """The seed with which a commit is scored, so that nobody can tune on its worlds.

    Raises ValueError where the commit is unknown.
    """
    if commit == "unknown":
        raise ValueError("no git checkout, so no commit to score: give the worlds a seed")
    return int.from_bytes(hashlib.sha256(commit.encode()).digest()[:6], "big")


def world_name(index: int) -> str:
    """Name of a world's folder, its study and its truth."""
    return f"world_{index:04d}"


def digest_of(content: bytes) -> str:
    """SHA-256 (hex)."""
    return hashlib.sha256(content).hexdigest()


def kind_of(seed: int, index: int) -> tuple[str, str]:
    """What kind of truth a world has, and which generator makes its data."""
    if index >= HARD_NULLS:
        pair, place = divmod(index - HARD_NULLS, 2)
        kind = ("null_heavy_tails", "null_understated_noise")[place]
        return kind, "independent" if pair % 4 == 3 else "lattice"
    block, place = divmod(index, len(MIX))
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, block)))
    return MIX[order.permutation(len(MIX))[place]]


def draw_world(
    seed: int,
    index: int,
    kind: str | None = None,
    generator: str | None = None,
    delta_range: tuple[float, float] | None = None,
) -> tuple[dict[str, str], dict[str, Any]]:
    """Files of a world by their paths in its folder, and its truth.

    `kind`, `generator` and `delta_range` stand in for those that the mix gives it.
    """
    drawn_kind, drawn_generator = kind_of(seed, index)
    kind, generator = kind or drawn_kind, generator or drawn_generator
    source, theta, choice = begin_world(seed, index, kind, generator)
    documents = source.experiments
    world = _World(source, documents, theta, (seed, PACKINGS, index))
    added = _effects(world, kind, generator, choice, delta_range)
    effects, rows = world.truth_of(added)
    measure(kind, rows, choice, {})
    title = f"Blind benchmark, {world_name(index)}"
    files = files_of(world_name(index), laboratory.study(title), documents, rows)
    return files, {
        "format_version": FORMAT_VERSION,
        "world": world_name(index),
        "seed": seed,
        "index": index,
        "kind": kind,
        "generator": generator,
        "physics": asdict(source.physics) if generator == "independent" else None,
        "effects": effects,
        "parameters": true_parameters(theta),
        "noise": {
            "shared": SHARED,
            "own": OWN,
            "true_over_declared": UNDERSTATED if kind == "null_understated_noise" else 1.0,
            "law": "student_t_3" if kind == "null_heavy_tails" else "normal",
        },
        "files": {path: digest_of(text.encode()) for path, text in files.items()},
        "rows": rows,
    }


def begin_world(
    seed: int, index: int, kind: str, generator: str
) -> tuple[Generator, np.ndarray, np.random.Generator]:
    """The generator of a world, its true parameters, and the stream of all that is drawn next."""
    choice = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2, index)))
    documents = laboratory.documents(int(choice.integers(2**31)))
    theta = np.array(THETA_STD) * choice.standard_normal(len(THETA))
    if generator == "independent":
        return IndependentGenerator(documents, _physics(kind, choice)), theta, choice
    return LatticeGenerator(documents), theta, choice


# ---------------------------------------------------------------------------------------------
# truths


class _World:
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


def _physics(kind: str, choice: np.random.Generator) -> independent.Physics:
    """The physics of an independent world; what is outside the catalogue acts on lattices alone."""
    return independent.Physics(
        receivers=int(choice.choice([9, 13, 25])),
        law=str(choice.choice(["lognormal", "uniform"])),
        continuum=bool(choice.random() < 0.15) and kind != "outside",
        spread=float(np.exp(0.1 * choice.standard_normal())),
    )


def _effects(world: _World, kind: str, generator: str, choice, delta_range) -> tuple[Added, ...]:
    """Effects of a world of this kind, by what they should move the readings."""
    if kind.startswith("null"):
        return ()
    pool = {
        "one": PHYSICS if generator == "lattice" else INDEPENDENT_PHYSICS,
        "two": PHYSICS if generator == "lattice" else INDEPENDENT_PHYSICS,
        "outside": OUTSIDE if generator == "lattice" else independent.CHANGES,
        "sensor_or_input": (*INPUTS, *SENSORS),
    }[kind]
    low, high = delta_range or (PAIR_DELTA_RANGE if kind == "two" else DELTA_RANGE)
    added = []
    for _ in range(2 if kind == "two" else 1):
        names = [name for name in pool if name not in {one.name for one in added}]
        added.append(_effect_near(world, names, choice, choice.uniform(*np.log([low, high]))))
    return tuple(added)


def _effect_near(world: _World, names: Sequence[str], choice, log_delta: float) -> Added:
    """The first of the effects, in random order, that can move the readings so far.

    Where none can, it is the one that moves them most.
    """
    most, farthest = -1.0, None
    for name in choice.permutation(list(names)):
        path = _path(world, str(name), choice)
        reached = world.delta(path(1.0))
        if reached >= math.exp(log_delta):
            return _nearest(world, path, reached, log_delta)
        if reached > most:
            most, farthest = reached, path(1.0)
    return farthest


def _path(world: _World, name: str, choice) -> Callable[[float], Added]:
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


def _nearest(world: _World, path: Callable, reached: float, log_delta: float) -> Added:
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


def _scope_key(world: _World, name: str, choice) -> str | None:
    if name in SENSORS:
        cells = sorted({row.load_cell for row in world.all_rows})
        return str(choice.choice(cells))
    if name in OF_MATERIAL:
        return str(choice.choice(list(laboratory.MATERIALS)))
    if name == "fill_height_misdeclared":
        return str(choice.choice(world.fitted))
    return None


# ---------------------------------------------------------------------------------------------
# data and files


def measure(
    kind: str,
    rows: Sequence[dict[str, Any]],
    choice: np.random.Generator,
    known: Mapping[tuple[str, str], float],
) -> None:
    """Give each row what was `measured`, and the `shared_error` that is in its logarithm.

    `known` are shared errors of load cells in experiments, (experiment, load cell), that have been
    read before.
    """

    def draw() -> float:
        if kind == "null_heavy_tails":
            return choice.standard_t(3) / math.sqrt(3.0)
        return choice.standard_normal() * (UNDERSTATED if kind == "null_understated_noise" else 1.0)

    shared = dict(known)
    for row in rows:
        key = row["experiment"], row["load_cell"]
        if key not in shared:
            shared[key] = SHARED * draw()
        row["shared_error"] = shared[key]
        error = shared[key] + OWN * draw()
        row["measured"] = float(f"{row['reading'] * math.exp(error):.6g}")


def files_of(
    name: str,
    study: Mapping[str, Any],
    documents: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
) -> dict[str, str]:
    """Text of the experiments, of their table of measured rows and of the study, by path."""
    files = {f"experiments/{stem}.yaml": _yaml(document) for stem, document in documents.items()}
    files["experiments/measured/data.csv"] = _table(documents, rows)
    files[f"studies/{name}.yaml"] = _yaml(study)
    return files


def _yaml(document: Mapping[str, Any]) -> str:
    return yaml.safe_dump(document, sort_keys=False, width=100)


def _table(documents: Mapping[str, Any], rows: Sequence[Mapping]) -> str:
    text = io.StringIO()
    columns = "experiment,load_cell,fill_height,mass_drawn,quantity,value,std,std_shared,count"
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns.split(","))
    for row in rows:
        value, height = row["measured"], row["fill_height"]
        full = height == documents[row["experiment"]]["geometry"]["height"]
        table.writerow(
            [
                row["experiment"],
                row["load_cell"],
                "" if height is None or full else f"{height:g}",
                "" if row["mass_drawn"] is None else f"{row['mass_drawn']:g}",
                "vertical_stress",
                f"{value:.6g}",
                f"{OWN * value:.4g}",
                f"{SHARED * value:.4g}",
                1,
            ]
        )
    return text.getvalue()


def _is_whole(folder: Path, sealed: Path, seed: int, index: int) -> bool:
    """Whether a world and its truth are there and belong together."""
    if not sealed.is_file():
        return False
    truth = read_json(sealed)
    if (truth["format_version"], truth["seed"], truth["index"]) != (FORMAT_VERSION, seed, index):
        return False
    files = {path: folder / path for path in truth["files"]}
    return all(
        file.is_file() and digest_of(file.read_bytes()) == truth["files"][path]
        for path, file in files.items()
    )
