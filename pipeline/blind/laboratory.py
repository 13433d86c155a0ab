"""The laboratory of the blind benchmark: what is declared of its experiments.

A box of 24 × 8 × 60 cells of 3 cm and smaller ones, two materials, six load cells in a row under
each. Static columns differ in width, height and walls; draws are one drawpoint, a panel, and blocks
with a wide and a narrow pillar. Documents are plain data in the contract's format.
"""

from __future__ import annotations

from typing import Any

CELL = 0.03  # m
MATERIALS = {
    "gravel": {
        "name": "gravel",
        "bulk_density": 1600.0,
        "particle_density": 2700.0,
        "particle_size": [0.004, 0.012],
        "internal_friction_angle": 39.0,
    },
    "sand": {
        "name": "sand",
        "bulk_density": 1350.0,
        "particle_density": 2650.0,
        "particle_size": [0.001, 0.003],
        "internal_friction_angle": 33.0,
    },
}
TRANSMISSION = {"gravel": 0.980, "sand": 0.975}
SPREADING = {"mean": 4.0, "std": 1.5}
RELAXATION = 0.3
E_MIN = {"type": "power", "at_height": 0.9, "value": 0.94, "exponent": 0.5}
FLOW = {"exponent": 3.0, "bulking": 0.15}

STATIC = {  # material, width, length, height in m, wall friction angle in degrees
    "static_1": ("gravel", 0.72, 0.24, 1.80, 25.0),
    "static_2": ("gravel", 0.36, 0.24, 1.50, 30.0),
    "static_3": ("gravel", 0.48, 0.24, 1.20, 18.0),
    "static_4": ("sand", 0.72, 0.24, 1.80, 20.0),
    "static_5": ("sand", 0.36, 0.24, 1.50, 28.0),
    "static_6": ("sand", 0.48, 0.24, 1.20, 16.0),
    "static_7": ("gravel", 0.60, 0.24, 1.62, 33.0),
    "static_8": ("sand", 0.54, 0.30, 1.35, 22.0),
}
DRAWS = {  # lines of (places drawn in turn, kg), and load cells
    "isolated": ([((3,), 15.0)], (1, 2, 3, 4, 5)),
    "panel": ([((place,), 5.0) for place in (1, 2, 3, 4)], (1, 2, 3, 4, 5, 6)),
    "block_wide": ([((1, 2, 5, 6), 30.0)], (1, 2, 3, 4, 5, 6)),
    "block_narrow": ([((1, 2, 4, 5), 30.0)], (1, 2, 3, 4, 5)),
}
HELD_OUT = ("block_narrow", "static_7", "static_8")
READINGS = 5  # of a draw, after the one before draw


def documents(seed: int) -> dict[str, dict[str, Any]]:
    """Every experiment by name, as its file has it; `seed` is the root of its replicates."""
    static = {name: _static(*values) for name, values in STATIC.items()}
    drawn = {name: _draw(*values) for name, values in DRAWS.items()}
    return {name: _placed(document, seed) for name, document in (static | drawn).items()}


def study(title: str) -> dict[str, Any]:
    """The study that calibrates on all but `HELD_OUT`.

    A surcharge and a tilt come from how this laboratory fills its boxes: one for all experiments.
    """
    return {
        "title": title,
        "source": "blind benchmark",
        "experiments": [*STATIC, *DRAWS],
        "hold_out": list(HELD_OUT),
        "parameters": [
            {"name": "E", "shared_by": "material"},
            {"name": "s", "shared_by": "study"},
            {"name": "R", "shared_by": "study"},
            {"name": "E_min", "shared_by": "study"},
        ],
        "candidates": "all",
        "scopes": {"surcharge": "study", "tilt": "study"},
        "alpha": 0.03,
        "max_effects": 3,
    }


def _placed(document: dict[str, Any], seed: int) -> dict[str, Any]:
    common = {"seed": seed, "measured": "measured/data.csv", "data_label": "synthetic"}
    return document | common


def _static(material, width, length, height, angle):
    return {
        "title": f"{material} at rest, {width:g} m × {length:g} m, {height:g} m high",
        "geometry": {"width": width, "length": length, "height": height, "cell_size": CELL},
        "material": MATERIALS[material],
        "walls": {"friction_angle": angle},
        "filling": {"levels": [round(height / 2, 6), round(0.75 * height, 6), height]},
        "stress": {"E": TRANSMISSION[material], "s": SPREADING},
        "load_cells": _load_cells(width, length, range(1, 7)),
    }


def _draw(lines, cells):
    width, length = 0.72, 0.24
    total = sum(mass for _, mass in lines)
    return {
        "title": f"gravel, {total:g} kg drawn",
        "geometry": {"width": width, "length": length, "height": 1.80, "cell_size": CELL},
        "material": MATERIALS["gravel"],
        "walls": {"friction_angle": 25.0},
        "stress": {
            "E": TRANSMISSION["gravel"],
            "s": SPREADING,
            "R": RELAXATION,
            "E_min": E_MIN,
        },
        "flow": FLOW,
        "drawpoints": [
            {"name": f"D{place}{side}", "x": x, "y": y, "width": 0.06, "length": 0.06}
            for place, x in _places(width).items()
            for side, y in (("F", 0.03), ("B", 0.21))
        ],
        "draw": [
            {
                "drawpoints": [f"D{place}{side}" for place in places for side in "FB"],
                "mass": mass,
                "increment": 0.5,
            }
            for places, mass in lines
        ],
        "readings": {
            "at_mass_drawn": [round(total * k / READINGS, 6) for k in range(1, READINGS + 1)]
        },
        "load_cells": _load_cells(width, length, cells),
    }


def _places(width: float) -> dict[int, float]:
    return {place: round((place - 0.5) * width / 6, 6) for place in range(1, 7)}


def _load_cells(width, length, places):
    x = _places(width)
    return [
        {"name": f"C{place}", "x": x[place], "y": length / 2, "width": 0.06, "length": 0.12}
        for place in places
    ]
