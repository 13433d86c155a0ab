"""What each effect does to a static column and to a pillar between two movement zones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.effects import Active, effects
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import Setup, make_setup

REPLICATES = 10
GROUND: dict[str, Any] = {
    "material": {
        "name": "gravel",
        "bulk_density": 1600,
        "particle_density": 2700,
        "particle_size": [0.004, 0.014],
        "internal_friction_angle": 39,
    },
    "walls": {"friction_angle": 25},
    "seed": 1,
}
CASES: dict[str, dict[str, Any]] = {
    "column": {
        "title": "A static column",
        "geometry": {"width": 0.3, "length": 0.1, "height": 0.6, "cell_size": 0.02},
        "stress": {"E": 0.95, "s": {"mean": 4, "std": 3}},
    },
    "pillar": {
        "title": "A pillar between two movement zones",
        "geometry": {"width": 0.6, "length": 0.1, "height": 0.6, "cell_size": 0.02},
        "stress": {
            "E": 0.97,
            "s": {"mean": 4, "std": 3},
            "R": 0.3,
            "E_min": {"type": "power", "at_height": 0.4, "value": 0.85},
        },
        "flow": {"exponent": 5, "bulking": 0.25},
        "drawpoints": [
            {"name": "left", "x": 0.13, "y": 0.05, "width": 0.06, "length": 0.1},
            {"name": "right", "x": 0.47, "y": 0.05, "width": 0.06, "length": 0.1},
        ],
        "draw": [{"drawpoints": ["left", "right"], "mass": 4.0, "increment": 0.1}],
        "readings": {"every": 0.5},
    },
}


def effect_pictures(execution: Execution = Execution()) -> xr.Dataset:
    """Mean vertical stress with each effect's example values beside that without.

    Returns
    -------
    Dataset with `column_stress`, `column_change` on (effect, z, column_x) and `pillar_stress`,
    `pillar_change` on (effect, z, pillar_x): stress in kPa without the effect (the same for all)
    and its relative change, both averaged over y and the replicates, at the last reading;
    `column_base_change` and `pillar_base_change` (effect): of the mean base stress. Common random
    numbers. Effects of sensors leave the ground as it is: their change is 0.
    """
    names = list(effects())
    data: dict[str, Any] = {}
    coords: dict[str, Any] = {"effect": ("effect", np.array(names, dtype="S"))}
    for case, declared in CASES.items():
        experiment = Experiment.model_validate(GROUND | declared).at(Path(f"{case}.yaml"))
        plain = _mean_stress(experiment, (), execution)
        changed = []
        for name in names:
            effect = effects()[name]
            if effect.scope == "load_cell":
                changed.append(plain)
                continue
            active = (Active(name, effect.neutral | dict(effect.example)),)
            changed.append(_mean_stress(experiment, active, execution))
        stress = np.array([field for field, _ in changed])
        base = np.array([mean for _, mean in changed])
        dims = ("effect", "z", f"{case}_x")
        data[f"{case}_stress"] = (dims[1:], plain[0])
        data[f"{case}_change"] = (dims, stress / plain[0] - 1.0)
        data[f"{case}_base_change"] = ("effect", base / plain[1] - 1.0)
        g = experiment.geometry
        for axis, extent in (("z", g.height), (f"{case}_x", g.width)):
            coords[axis] = (axis, (np.arange(round(extent / g.cell_size)) + 0.5) * g.cell_size)
    return xr.Dataset(data, coords=coords, attrs={"replicate_count": REPLICATES})


def _mean_stress(
    experiment: Experiment, active: tuple[Active, ...], execution: Execution
) -> tuple[np.ndarray, float]:
    """Stress (z, x) and mean base stress, kPa, at the last reading over the replicates.

    Brought back to the declared height where an effect changes it.
    """
    block_model = build_block_model(experiment)
    setup = make_setup(experiment, block_model, effects=active)
    dataset, sums = run_replicates(setup, declared_parameters(experiment), REPLICATES, execution)
    field = sums.finalise()["vertical_stress_mean"].values[-1]
    section = _level_mean(field, setup)
    levels = block_model.sizes["z"]
    height = np.full((levels, section.shape[1]), np.nan)
    kept = min(levels, len(section))
    height[:kept] = section[:kept]
    return height, float(dataset["base_vertical_stress"][:, -1].mean())


def _level_mean(field: np.ndarray, setup: Setup) -> np.ndarray:
    """Mean over y of a field (z, y, x); NaN where no cell holds material."""
    filled = np.isfinite(field)
    total = np.where(filled, field, 0.0).sum(axis=1)
    count = filled.sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
