"""The independent simulator: that it is one, its laws, and the directions of its effects."""

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.blind import independent, laboratory
from pipeline.blind.independent import Physics, as_read, ground_stress

DECLARED = {"E": laboratory.TRANSMISSION, "s": 1.5, "R": 0.3, "E_min": 0.0}
LABORATORIES = (
    Physics(receivers=9),
    Physics(receivers=25, law="uniform"),
    Physics(continuum=True),
)


def experiment(name, **changes):
    """A document of the laboratory under its name."""
    return {**laboratory.documents(0)[name], "name": name, **changes}


def stress(name, *effects, physics=Physics(), theta=DECLARED, seed=0, **changes):
    """Stress (time, load_cell) of one packing of an experiment."""
    streams = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
    return ground_stress(experiment(name, **changes), theta, effects, physics, *streams)


def effect(name, scope_key=None, **parameters):
    return {"name": name, "scope_key": scope_key, "parameters": parameters}


def test_imports_nothing_of_the_model():
    modules = set()
    files = sorted(Path(independent.__file__).parent.glob("*.py"))
    assert len(files) > 1
    for node in (node for file in files for node in ast.walk(ast.parse(file.read_text()))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            modules.add(node.module)
        elif isinstance(node, ast.Call):
            assert getattr(node.func, "id", "") not in {"__import__", "exec", "eval"}
    others = {module for module in modules if not module.startswith(f"{independent.__name__}.")}
    assert {module.split(".")[0] for module in others} <= {
        "__future__",
        "collections",
        "dataclasses",
        "functools",
        "math",
        "numba",
        "numpy",
        "scipy",
        "typing",
    }


@pytest.mark.parametrize("physics", LABORATORIES)
def test_without_shedding_the_base_carries_the_whole_bed(physics):
    whole = [{"name": "C1", "x": 0.18, "y": 0.12, "width": 0.36, "length": 0.24}]
    lossless = {**DECLARED, "E": {"gravel": 1.0, "sand": 1.0}, "s": 0.0}
    found = stress("static_2", physics=physics, theta=lossless, load_cells=whole)
    wanted = 1600 * 9.81 * np.array([0.75, 1.125, 1.5]) * 1e-3
    np.testing.assert_allclose(found[:, 0], wanted, rtol=2e-3)


def test_the_continuum_is_janssens_column():
    flat = {**DECLARED, "s": 0.0}
    found = stress(
        "static_1",
        effect("wall_friction", "gravel", K=0.4),
        physics=Physics(continuum=True),
        theta=flat,
    )
    walls = 0.4 * math.tan(math.radians(25)) / (0.72 * 0.24 / (2 * 0.96))
    rate = walls - math.log(0.98) / 0.03
    heights = np.array([[0.9], [1.35], [1.8]])
    wanted = 1600 * 9.81 / rate * (1 - np.exp(-rate * heights)) * 1e-3
    np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), rtol=5e-3)


def test_attenuation_for_each_meter_is_that_of_the_declared_cells():
    whole = [{"name": "C1", "x": 0.36, "y": 0.12, "width": 0.72, "length": 0.24}]
    found = stress("static_1", load_cells=whole)[-1, 0]
    declared = 1600 * 9.81 * 0.03 * (1 - 0.98**60) / (1 - 0.98) * 1e-3
    assert found == pytest.approx(declared, rel=0.01)


def test_draw_lowers_moving_ground_and_loads_the_pillar():
    readings = np.mean([stress("block_wide", seed=seed) for seed in range(3)], axis=0)
    change = readings[-1] / readings[0]
    assert (change[[0, 1, 4, 5]] < 0.9).all()
    assert (change[[2, 3]] > 1.05).all()


def test_same_streams_same_numbers():
    np.testing.assert_array_equal(stress("isolated", seed=3), stress("isolated", seed=3))
    assert (stress("isolated", seed=3) != stress("isolated", seed=4)).all()


RAISES, LOWERS = 1, -1
DIRECTIONS = {  # (effect, experiment, load cells): what its readings at the end do
    "wall_friction": (effect("wall_friction", "gravel", K=0.3), "static_2", slice(None), LOWERS),
    "density": (
        effect("density_misdeclared", "gravel", factor=1.2),
        "static_1",
        slice(None),
        RAISES,
    ),
    "height": (
        effect("fill_height_misdeclared", "static_1", factor=1.1),
        "static_1",
        slice(None),
        RAISES,
    ),
    "surcharge": (effect("surcharge", stress=2.0), "static_1", slice(None), RAISES),
    "tilt": (effect("tilt", angle_x=4.0), "static_1", [5], RAISES),
    "tilt away": (effect("tilt", angle_x=4.0), "static_1", [0], LOWERS),
    "compaction": (effect("compaction", "gravel", index=0.1), "static_1", slice(None), RAISES),
    "slope": (
        effect("stress_dependent_transmission", "gravel", slope=-0.5),
        "static_1",
        slice(None),
        LOWERS,
    ),
    "arching": (effect("arching", transfer=0.8), "block_wide", [2, 3], RAISES),
    "pillar": (effect("pillar_relaxation", width=0.5), "block_wide", [2, 3], RAISES),
    "loosening": (
        effect("loosening_density", porosity_increase=0.1),
        "block_wide",
        [0, 1, 4, 5],
        LOWERS,
    ),
}


@pytest.mark.parametrize("case", DIRECTIONS)
def test_effects_move_readings_their_way(case):
    added, name, cells, direction = DIRECTIONS[case]
    change = stress(name, added)[-1, cells] - stress(name)[-1, cells]
    assert (direction * change > 0).all()


@pytest.mark.parametrize("physics", LABORATORIES)
@pytest.mark.parametrize(
    "neutral",
    [
        effect("wall_friction", "gravel", K=0.0),
        effect("density_misdeclared", "gravel", factor=1.0),
        effect("fill_height_misdeclared", "static_2", factor=1.0),
        effect("surcharge", stress=0.0),
        effect("tilt", angle_x=0.0),
        effect("compaction", "gravel", index=0.0),
        effect("stress_dependent_transmission", "gravel", slope=0.0),
        effect("arching", transfer=0.0),
        effect("loosening_density", porosity_increase=0.0),
        effect("tilt", "sand", angle_x=10.0),  # of another material
    ],
    ids=lambda one: one["name"],
)
def test_neutral_effects_change_no_bit(neutral, physics):
    np.testing.assert_array_equal(
        stress("static_2", neutral, physics=physics), stress("static_2", physics=physics)
    )


def test_physics_outside_the_catalogue_is_off_at_zero():
    for change in independent.CHANGES.values():
        assert change.change(Physics(), 0.0) == Physics()
        assert change.change(Physics(), change.high) != Physics()


def test_sensors_change_their_load_cell_alone():
    document = experiment("isolated")
    ground = np.full((6, 5), 10.0)
    added = [
        effect("sensor_gain", "C2", gain=1.5),
        effect("sensor_drift", "C3", rate=0.02),
        effect("sensor_offset", "C4", offset=-1.0),
        effect("sensor_gain", "C6", gain=9.0),
    ]
    read = as_read(document, ground, added)
    masses = np.array([0.0, 3.0, 6.0, 9.0, 12.0, 15.0])
    np.testing.assert_allclose(read[:, 1], 15.0)
    np.testing.assert_allclose(read[:, 2], 10.0 * (1 + 0.02 * masses))
    np.testing.assert_allclose(read[:, 3], 9.0)
    np.testing.assert_array_equal(read[:, [0, 4]], ground[:, [0, 4]])
    assert (ground == 10.0).all()


def test_wider_zones_reach_further():
    narrow, wide = (
        np.mean(
            [
                stress("isolated", physics=replace(Physics(), zone=zone), seed=seed)
                for seed in range(4)
            ],
            axis=0,
        )
        for zone in (0.8, 1.4)
    )
    assert wide[-1, [1, 3]].mean() < narrow[-1, [1, 3]].mean()
