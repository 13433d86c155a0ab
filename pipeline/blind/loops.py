"""The loop on blind worlds, which it sees without their truths.

Its results stand in the world's folder: `closed_loop.json`, `attribution.json`, `predictions.json`,
what other methods claim in `peers.json`, and what they were made from in `run.json`. Where it was
left undecided, the same of one more measurement stands in folders of their own, see `remeasured`.
"""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pipeline import __version__
from pipeline.blind.peers import forward_selection, raw_correlation, thresholded_least_squares
from pipeline.blind.remeasured import is_undecided, measure_again
from pipeline.blind.scored import CHOICES, SINGLE, Claim
from pipeline.blind.seal import sealed
from pipeline.blind.tasks import each
from pipeline.blind.worlds import digest_of, index_of, kind_of, make_worlds, scoring_seed
from pipeline.config.load import load_experiments, load_study
from pipeline.files.atomic import read_json, write_json
from pipeline.files.netcdf import git_revision
from pipeline.loop.covariance import COMPONENTS
from pipeline.loop.problem import make_problem, measured_rows
from pipeline.loop.steps import attribution, closed, residual

SCHEMA_VERSION = "1.0"
RESULTS = ("closed_loop", "attribution", "predictions", "peers")  # of a world, as JSON


def run_worlds(
    folder: Path | str,
    count: int,
    hard_nulls: int = 0,
    attacks: int = 0,
    seed: int | None = None,
    workers: int = 1,
    code: str = "",
) -> None:
    """Make the worlds and run the loop on each, up to `runs.json`.

    Parameters
    ----------
    count, hard_nulls, attacks : worlds of the mix, hard nulls of each of the two kinds, and attacks
        of each kind
    seed : of the worlds; None: the one with which the commit under test is scored
    workers : processes; they change no number
    code : digest of the code that runs. A world that the same code has finished on the same files
        is kept

    Raises
    ------
    ExceptionGroup
        After all worlds, with the errors of those on which the loop failed.
    """
    folder, commit = Path(folder), git_revision()
    seed = scoring_seed(commit) if seed is None else seed
    worlds, truths = folder / "worlds", folder / "sealed"
    names = make_worlds(worlds, truths, count, seed, hard_nulls, attacks, workers)
    one = partial(_seconds_of, worlds, truths, code)
    seconds = each("blind worlds, the loop", one, names, workers)
    undecided = [n for n in names if _is_undecided(worlds / n, seed)]
    again = partial(_once_more, worlds, truths, code)
    pairs = [(name, choice) for name in undecided for choice in CHOICES]
    each("blind worlds, measured once more", again, pairs, workers)
    content = {
        "schema_version": SCHEMA_VERSION,
        "commit": commit,
        "seed": seed,
        "seed_is_the_commits": commit != "unknown" and seed == scoring_seed(commit),
        "hard_nulls_of_each_kind": hard_nulls,
        "attacks_of_each_kind": attacks,
        "seconds": dict(zip(names, seconds, strict=True)),
        "versions": {"pipeline": __version__},
    }
    write_json(folder / "runs.json", content)


def _seconds_of(worlds: Path, truths: Path, code: str, name: str) -> float:
    return close_world(worlds / name, truths, code)


def _is_undecided(world: Path, seed: int) -> bool:
    """Whether a world with one effect is left undecided."""
    kind, _ = kind_of(seed, index_of(world.name))
    return kind in SINGLE and is_undecided(read_json(world / "closed_loop.json"))


def _once_more(worlds: Path, truths: Path, code: str, which: tuple[str, str]) -> None:
    name, choice = which
    folder = measure_again(worlds / name, truths / f"{name}.json", choice)
    if folder is not None:
        close_world(folder, truths, code)


def close_world(folder: Path, truths: Path, code: str = "") -> float:
    """Run the whole loop on a world, or keep what the same code found on the same files.

    Returns the processor seconds that the loop took. Opening anything under `truths` meanwhile
    raises SealedError.
    """
    with sealed(truths):
        inputs = {"code": code, "files": _digests(folder)}
        record = folder / "run.json"
        if record.is_file() and all((folder / f"{name}.json").is_file() for name in RESULTS):
            known = read_json(record)
            if {key: known[key] for key in inputs} == inputs:
                return known["seconds"]
        record.unlink(missing_ok=True)
        start = time.process_time()
        results, first = _closed_loop(folder)
        seconds = time.process_time() - start
        results["peers"] = peer_claims(first)
        for name in RESULTS:
            write_json(folder / f"{name}.json", results[name])
        write_json(record, inputs | {"seconds": seconds})
    return seconds


def _closed_loop(folder: Path) -> tuple[dict[str, Any], xr.Dataset]:
    """What the loop finds in a world, as documents, and the arrays of its first round."""
    study = load_study(folder / "studies" / f"{folder.name}.yaml")
    experiments = load_experiments(folder / "experiments")
    problem, measured = make_problem(study, experiments), measured_rows(study, experiments)
    _, baseline = residual(problem, measured)
    found, rounds = attribution(problem, baseline)
    document, predictions = closed(problem, measured, baseline, found)
    results = {"closed_loop": document, "attribution": found, "predictions": predictions}
    return results, rounds[0]


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file that a world's loop reads, by its path in the world's folder."""
    files = (f for part in ("experiments", "studies") for f in (folder / part).rglob("*"))
    return {
        str(file.relative_to(folder)): digest_of(file.read_bytes())
        for file in sorted(files)
        if file.is_file()
    }


# ---------------------------------------------------------------------------------------------
# other methods


def peer_claims(first: xr.Dataset) -> dict[str, list[Claim]]:
    """What other methods claim from the arrays of the loop's first round, by method.

    They get the residual of the calibrated baseline, the derivatives that the loop computed and
    the noise as declared. The `whitened` ones know the readings' whole covariance, the others take
    readings for independent.
    """
    places, names = _candidates(first)
    r, J, G = (
        first[name].values for name in ("residual", "parameter_sensitivity", "term_sensitivity")
    )
    G = G[:, places]
    covariance = sum(first[f"covariance_{part}"].values for part in COMPONENTS)
    std = np.sqrt(np.diag(covariance))
    claims = {"raw_correlation": raw_correlation(r, G, names)}
    for method in (forward_selection, thresholded_least_squares):
        claims[method.__name__] = method(r, J, G, names, std)
        claims[f"{method.__name__}_whitened"] = method(r, J, G, names, std, covariance)
    return {method: list(dict.fromkeys(named)) for method, named in claims.items()}


def _candidates(first: xr.Dataset) -> tuple[list[int], list[Claim]]:
    """Places and names of the catalogue's terms, less those that are sums of others."""
    terms = json.loads(first.attrs["terms"])
    keyed = {(t["effect"], t["parameter"]) for t in terms if t["key"] is not None}
    places = [
        place
        for place, t in enumerate(terms)
        if t["effect"] != "local_rule"
        and (t["key"] is not None or (t["effect"], t["parameter"]) not in keyed)
    ]
    return places, [(terms[place]["effect"], terms[place]["key"]) for place in places]
