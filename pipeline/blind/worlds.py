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
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from pipeline.blind import independent, laboratory
from pipeline.blind.attacks import ATTACKED, ATTACKS, Plan, attack_of
from pipeline.blind.injection import (
    INDEPENDENT_PHYSICS,
    INPUTS,
    OWN,
    PHYSICS,
    SHARED,
    World,
    effect_near,
)
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
    true_parameters,
)
from pipeline.files.atomic import read_json, write_json, write_text

FORMAT_VERSION = 2
UNDERSTATED = 1.5  # true over declared noise of the nulls whose noise is understated
HARD_NULLS = 5000  # index from which worlds are hard nulls, of the two kinds in turn
ATTACK = "attack_"  # begins the kinds of worlds written to fool the loop
PACKINGS = 3  # spawn key of the packings' streams
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


def make_worlds(
    root: Path | str,
    sealed_root: Path | str,
    count: int,
    seed: int,
    hard_nulls: int = 0,
    attacks: int = 0,
    workers: int = 1,
) -> list[str]:
    """Write `count` worlds of the mix, and as many of each hard null and attack as asked for.

    Worlds that are there already and match their truth are kept. Returns their names in order,
    after `hashes.json` is written under `root`; `workers` processes change no number.
    """
    indices = [
        *range(count),
        *range(HARD_NULLS, HARD_NULLS + 2 * hard_nulls),
        *range(ATTACKED, ATTACKED + len(ATTACKS) * attacks),
    ]
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


def index_of(name: str) -> int:
    """Index of the world of this name."""
    return int(name.removeprefix("world_"))


def digest_of(content: bytes) -> str:
    """SHA-256 (hex)."""
    return hashlib.sha256(content).hexdigest()


def kind_of(seed: int, index: int) -> tuple[str, str]:
    """What kind of truth a world has, and which generator makes its data."""
    if index >= ATTACKED:
        return f"{ATTACK}{attack_of(index)}", "lattice"
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
    begun = begin_world(seed, index, kind, generator)
    plan, choice = begun.plan, begun.choice
    world = World(begun.source, begun.source.experiments, begun.theta, (seed, PACKINGS, index))
    attack = kind.startswith(ATTACK)
    if attack:
        added = plan.effects(world, choice)
    else:
        added = _effects(world, kind, generator, choice, delta_range)
    effects, rows = world.truth_of(added)
    plan.misread(rows)
    measure(kind, rows, choice, {}, plan.noise)
    plan.misfile(rows)
    title = f"Blind benchmark, {world_name(index)}"
    files = files_of(world_name(index), laboratory.study(title), begun.declared, rows)
    truth = {
        "format_version": FORMAT_VERSION,
        "world": world_name(index),
        "seed": seed,
        "index": index,
        "kind": kind,
        "generator": generator,
        "physics": asdict(begun.source.physics) if generator == "independent" else None,
        "effects": effects,
        "parameters": true_parameters(begun.theta),
        "noise": {
            "shared": SHARED,
            "own": OWN,
            "true_over_declared": UNDERSTATED if kind == "null_understated_noise" else 1.0,
            "law": "student_t_3" if kind == "null_heavy_tails" else "normal",
        },
        "files": {path: digest_of(text.encode()) for path, text in files.items()},
        "rows": rows,
    }
    if attack:
        truth["attack"] = _attack(world, plan, added)
    return files, truth


def _attack(world: World, plan: Plan, added: Sequence[Added]) -> dict[str, Any]:
    """What is wrong apart from the effects, what all of them move, and the answers accepted."""
    joint = world.joint_delta(added)
    return {
        "details": dict(plan.details),
        "joint_delta": joint,
        "held_out_rms_log": world.moved_held_out(added),
        "right": asdict(plan.right(added, joint)),
    }


class Begun(NamedTuple):
    """A world before its effects: experiments as declared, what an attack does (else nothing), the
    generator, the true parameters, and the stream of all that is drawn next."""

    declared: Mapping[str, Any]
    plan: Plan
    source: Generator
    theta: np.ndarray
    choice: np.random.Generator


def begin_world(seed: int, index: int, kind: str, generator: str) -> Begun:
    """What a world of a seed starts from."""
    choice = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2, index)))
    declared = laboratory.documents(int(choice.integers(2**31)))
    theta = np.array(THETA_STD) * choice.standard_normal(len(THETA))
    attack = ATTACKS.get(kind.removeprefix(ATTACK))
    plan = attack.plan(declared, choice) if attack else Plan()
    source = LatticeGenerator(plan.documents(declared))
    if generator == "independent":
        source = IndependentGenerator(source.experiments, _physics(kind, choice))
    return Begun(declared, plan, source, theta, choice)


def _physics(kind: str, choice: np.random.Generator) -> independent.Physics:
    """The physics of an independent world; what is outside the catalogue acts on lattices alone."""
    return independent.Physics(
        receivers=int(choice.choice([9, 13, 25])),
        law=str(choice.choice(["lognormal", "uniform"])),
        continuum=bool(choice.random() < 0.15) and kind != "outside",
        spread=float(np.exp(0.1 * choice.standard_normal())),
    )


def _effects(world: World, kind: str, generator: str, choice, delta_range) -> tuple[Added, ...]:
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
        added.append(effect_near(world, names, choice, choice.uniform(*np.log([low, high]))))
    return tuple(added)


# ---------------------------------------------------------------------------------------------
# data and files


def measure(
    kind: str,
    rows: Sequence[dict[str, Any]],
    choice: np.random.Generator,
    known: Mapping[tuple[str, str], float],
    times: Callable[[Mapping[str, Any]], tuple[float, float]] = Plan.noise,
) -> None:
    """Give each row what was `measured`, and the `shared_error` that is in its logarithm.

    `known` are shared errors of load cells in experiments, (experiment, load cell), that have been
    read before. The two parts of the noise are so many `times` as declared.
    """

    def draw() -> float:
        if kind == "null_heavy_tails":
            return choice.standard_t(3) / math.sqrt(3.0)
        return choice.standard_normal() * (UNDERSTATED if kind == "null_understated_noise" else 1.0)

    shared = dict(known)
    for row in rows:
        key = row["experiment"], row["load_cell"]
        of_shared, of_own = times(row)
        if key not in shared:
            shared[key] = SHARED * of_shared * draw()
        row["shared_error"] = shared[key]
        error = shared[key] + OWN * of_own * draw()
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
