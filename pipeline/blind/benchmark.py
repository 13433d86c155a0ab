"""The blind benchmark: worlds are made, the loop runs on each without its truth, then all scored.

Under the benchmark's folder: `worlds/` with a folder for each world and `hashes.json`, the SHA-256
of every truth, written before the loop sees a world; `sealed/` with the truths; `runs.json`;
`scores.json`; and `log.jsonl` with a line for every scored run.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pipeline.blind.loops import run_worlds
from pipeline.blind.remeasured import outcomes
from pipeline.blind.scored import open_world
from pipeline.blind.scores import append_log, score
from pipeline.files.atomic import read_json, write_json


def run_benchmark(
    folder: Path | str,
    count: int,
    hard_nulls: int = 0,
    attacks: int = 0,
    seed: int | None = None,
    workers: int = 1,
    code: str = "",
) -> dict[str, Any]:
    """Make, run and score an edition of the benchmark; the content of `scores.json`.

    Its `broken` lists the quantities whose rate is beyond the bar with 95 % certainty.
    Parameters are those of `run_worlds`.
    """
    run_worlds(folder, count, hard_nulls, attacks, seed, workers, code)
    return score_benchmark(folder)


def score_benchmark(folder: Path | str) -> dict[str, Any]:
    """Open the truths, score what `run_worlds` left, write `scores.json` and append to the log.

    Raises SealBrokenError if a truth is not the one whose hash was published.
    """
    folder = Path(folder)
    runs, hashes = read_json(folder / "runs.json"), read_json(folder / "worlds" / "hashes.json")
    worlds = [
        open_world(
            folder / "sealed" / f"{name}.json",
            hashes[name],
            folder / "worlds" / name / "closed_loop.json",
            folder / "worlds" / name / "predictions.json",
            peers=read_json(folder / "worlds" / name / "peers.json"),
            seconds=seconds,
            again=outcomes(folder / "worlds" / name),
        )
        for name, seconds in runs["seconds"].items()
    ]
    tables = score(worlds)
    date = datetime.now(UTC).date().isoformat()
    scores = {key: value for key, value in runs.items() if key != "seconds"}
    scores |= {"date": date} | tables
    write_json(folder / "scores.json", scores)
    append_log(folder / "log.jsonl", scores, runs["commit"], {"worlds": runs["seed"]}, date)
    return scores
