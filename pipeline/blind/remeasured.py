"""Worlds that the loop left undecided, measured once more: as it recommends, and at random.

In an undecided world's folder, `then_recommended/` and `then_random/` hold the same experiments
and study with one more measurement, and what the loop then finds; `measurement.json` says which.

The addition is made on the same world: what has been read stays as it is, bit for bit, in the same
packing and with the same shared error of each load cell; new readings and new load cells have
errors of their own. A repeat is another packing, without what was wrong with the filling of the
first. A direct measurement of an input or a sensor is taken as a user would take it. Three standard
deviations from what was declared, it `shows` the fault by itself. Else its value is declared in the
`effects:` block, so that the loop runs on cleaned data and no longer tries that effect there; if it
is two off and then nothing is missing any more, it was this that it `corrects`.

The truth is opened here, and nothing here runs while the loop does.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.blind import laboratory
from pipeline.blind.injection import TRUE_PACKING
from pipeline.blind.scored import CHOICES
from pipeline.blind.truth import Added, rows_of
from pipeline.blind.worlds import PACKINGS, begin_world, files_of, measure
from pipeline.effects import effects
from pipeline.files.atomic import read_json, write_json, write_text

CHOOSING, ERRORS = 4, 5  # spawn keys of the random choice, and of all new errors
FIRST, SECOND = 0, 1  # packings of an experiment
# standard deviations off what was declared: shown by itself, or if nothing is missing after it
SHOWN, CORRECTED = 3.0, 2.0


def is_undecided(result: Mapping[str, Any]) -> bool:
    """Whether a `closed_loop.json` names nothing, though something is missing."""
    return result["verdict"] == "ambiguous"


def measure_again(world: Path, sealed: Path, choice: str) -> Path | None:
    """Make an undecided world's next measurement; the folder for the loop, if it is to run again.

    `sealed` is the world's truth, `choice` one of `CHOICES`.
    """
    folder = world / f"then_{choice}"
    asked = _asked(read_json(world / "closed_loop.json"), read_json(sealed), choice)
    for part in ("experiments", "studies"):
        shutil.rmtree(folder / part, ignore_errors=True)
    if asked is None:
        shutil.rmtree(folder, ignore_errors=True)
        return None
    files, says = extended(read_json(sealed), asked, folder.name)
    write_json(folder / "measurement.json", {"measurement": asked} | says)
    for path, text in files.items():
        write_text(folder / path, text)
    return folder if files else None


def outcomes(world: Path) -> dict[str, dict[str, Any]] | None:
    """By choice: the `measurement`, the [effect, key] that it `shows` or `corrects`, if any, and
    the loop's `result` after it, but for one that is shown.

    None for a world that is not undecided; a choice is missing where there was none.
    """
    if not is_undecided(read_json(world / "closed_loop.json")):
        return None
    found = {}
    for choice in CHOICES:
        folder = world / f"then_{choice}"
        if folder.is_dir():
            found[choice] = read_json(folder / "measurement.json")
            if not found[choice]["shows"]:
                found[choice]["result"] = read_json(folder / "closed_loop.json")
    return found


def extended(
    truth: Mapping[str, Any], asked: Mapping[str, Any], name: str
) -> tuple[dict[str, str], dict[str, list | None]]:
    """Files, by path, of a world with one more measurement, and what it `shows` or `corrects`.

    Both of these are an [effect, key] or None; there are no files where a fault is shown. `asked`
    is one of the additions of `possible_measurements`, `name` that of the study.
    """
    begun = begin_world(truth["seed"], truth["index"], truth["kind"], truth["generator"])
    documents = deepcopy(dict(begun.declared))
    random = np.random.default_rng(_stream(truth, ERRORS))
    says: dict[str, list | None] = {"shows": None, "corrects": None}
    new = []
    if asked["kind"] == "direct":
        says |= _declare(documents, truth, asked, random)
        if says["shows"]:
            return {}, says
    else:
        new = _read(documents, begun.source, begun.theta, truth, asked)
        known = {(r["experiment"], r["load_cell"]): r["shared_error"] for r in truth["rows"]}
        measure(truth["kind"], new, random, known)
    study = laboratory.study(f"Blind benchmark, {truth['world']}: {asked['what']}")
    study["experiments"] = list(documents)
    return files_of(name, study, documents, [*truth["rows"], *new]), says


def _stream(truth: Mapping[str, Any], purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(truth["seed"], spawn_key=(purpose, truth["index"]))


def _asked(result, truth, choice: str) -> dict[str, Any] | None:
    """The addition to make; None where there is none."""
    possible = result["possible_measurements"]
    if not is_undecided(result) or not possible:
        return None
    if choice == "recommended":
        return possible[0]
    return possible[np.random.default_rng(_stream(truth, CHOOSING)).integers(len(possible))]


def _read(documents: dict[str, Any], source, theta, truth, asked) -> list[dict[str, Any]]:
    """Add the readings' place to the documents; the new rows as the load cells have them."""
    name, packing = asked["experiment"], FIRST
    document, target = documents[name], name
    added = [Added(e["name"], e["scope_key"], e["parameters"]) for e in truth["effects"]]
    if asked["kind"] == "repeat":
        target, packing = f"{name}_again", SECOND
        documents[target] = document = deepcopy(document)
        added = [one for one in added if one.scope_key != name]
    elif asked["kind"] == "load_cell":
        place = {"name": "new", "x": asked["x"], "y": asked["y"]}
        document["load_cells"].append(document["load_cells"][0] | place)
    else:
        levels = [*document["filling"]["levels"], asked["fill_height"]]
        document["filling"]["levels"] = sorted(levels)
    source = replace(source, experiments={name: document})
    seed = (truth["seed"], PACKINGS, truth["index"], TRUE_PACKING, packing)
    reading = source.as_read(name, source.stress(name, theta, added, seed), added).ravel()
    known = {_place(row) for row in truth["rows"]}
    rows = [asdict(row) | {"experiment": target} for row in rows_of(name, document)]
    pairs = zip(rows, reading, strict=True)
    return [row | {"reading": float(one)} for row, one in pairs if _place(row) not in known]


def _place(row: Mapping[str, Any]) -> tuple:
    return tuple(row[key] for key in ("experiment", "load_cell", "fill_height", "mass_drawn"))


def _declare(documents: dict[str, Any], truth, asked, random) -> dict[str, list]:
    """Declare what was measured directly; the [effect, key] that it shows or would correct."""
    name, effect = asked["effect"], effects()[asked["effect"]]
    (parameter,) = effect.parameters
    true = {e["scope_key"]: e["parameters"] for e in truth["effects"] if e["name"] == name}
    places: dict[str | None, list[dict[str, Any]]] = {}
    for document in documents.values():
        for key in _keys(effect.scope, document, documents):
            if asked["key"] in (None, key):
                places.setdefault(key, []).append(document)
    says = {}
    for key, of_key in places.items():
        value = true.get(key, effect.neutral)[parameter.name]
        value += asked["std"] * random.standard_normal()
        off = abs(value - parameter.neutral) / asked["std"]
        if off > SHOWN:
            return {"shows": [name, key]}
        if off > CORRECTED:
            says["corrects"] = [name, key]
        values = {parameter.name: float(np.clip(value, parameter.low, parameter.high))}
        for document in of_key:
            block = document.setdefault("effects", {}).setdefault(name, {})
            block |= {key: values} if effect.scope == "load_cell" else values
    return says


def _keys(scope: str, document: Mapping[str, Any], documents: Mapping[str, Any]) -> list:
    """What an effect of this scope may belong to in an experiment."""
    match scope:
        case "material":
            return [document["material"]["name"]]
        case "load_cell":
            return [cell["name"] for cell in document["load_cells"]]
        case "experiment":
            return [name for name, one in documents.items() if one is document]
    return [None]
