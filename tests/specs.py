"""Experiments of the tests in a few words, how to change them, and what bad files should give."""

from pathlib import Path

COLUMN = {
    "title": "A small column",
    "geometry": {"width": 0.5, "length": 0.4, "height": 1.0, "cell_size": 0.1},
    "material": {"name": "gravel", "bulk_density": 1600, "particle_density": 2700},
    "stress": {"E": 0.9, "s": {"mean": 4, "std": 3}},
    "replicates": 8,
    "seed": 2022,
}
DRAWN = {
    "geometry": {"width": 0.6, "length": 0.5, "height": 0.8, "cell_size": 0.05},
    "stress": {
        "R": 0.3,
        "E_min": {"type": "power", "at_height": 0.4, "value": 0.5},
    },
    "flow": {"exponent": 2, "bulking": 0.2},
    "drawpoints": [{"name": "west", "x": 0.3, "y": 0.25, "width": 0.1, "length": 0.1}],
    "draw": [{"drawpoints": ["west"], "mass": 12.0, "increment": 1.0}],
    "readings": {"every": 4.0},
    "load_cells": [
        {"name": "beside", "x": 0.1, "y": 0.25, "width": 0.1, "length": 0.1},
        {"name": "above", "x": 0.3, "y": 0.1, "width": 0.13, "length": 0.1},
    ],
}
MINE_ORIGIN = {"easting": 412345.5, "northing": 7654321.25, "elevation": -230.0}


def merged(base: dict, changes: dict) -> dict:
    """`base` with `changes`, mapping by mapping; None takes a key away."""
    result = dict(base)
    for key, value in changes.items():
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(result.get(key), dict):
            result[key] = merged(result[key], value)
        else:
            result[key] = value
    return result


def expectations(path: Path) -> list[str]:
    """What a bad file of the corpus says, in its first lines, that the messages about it hold."""
    lines = path.read_bytes().decode("utf-8", "replace").splitlines()
    return [line.removeprefix("# expect: ") for line in lines if line.startswith("# expect: ")]
