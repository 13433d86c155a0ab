"""The example values move readings the way that each effect says."""

import numpy as np
import pytest
from runs import example, run

from pipeline.effects import effects

REPLICATES = 24


def mean_of(cell):
    """Mean stress of a load cell over replicates and the readings after the first."""
    return lambda runs: np.mean([r.vertical_stress[1:, cell] for r in runs])


def at(time, cell):
    """Mean stress of a load cell at one reading."""
    return lambda runs: np.mean([r.vertical_stress[time, cell] for r in runs])


def spread_over_base(runs):
    """Standard deviation over the base."""
    return np.mean([r.base_vertical_stress_std[1:] for r in runs])


def spread_over_replicates(runs):
    """Standard deviation of the base mean from replicate to replicate."""
    return np.std([r.base_vertical_stress[-1] for r in runs])


def change_in_flow(runs):
    """Mean change of the log of the reading in the flowing ground from reading to reading."""
    logs = np.log([r.vertical_stress[4:, ZONE] for r in runs])
    return np.abs(np.diff(logs, axis=1)).mean()


WEST, EAST = 0, 1  # load cells of the filling,
PILLAR, ZONE, OUTER = 0, 1, 2  # and of the pillar
FLOWING = {"flow": {"bulking": 0.0}, "readings": {"every": 1.0}}
DEEP = {"stress": {"E": 0.98}}
# effect: (experiment, changes to it, what is looked at, the sign of its change)
DIRECTIONS = {
    "arch_memory": [("pillar", FLOWING, change_in_flow, -1)],
    "arching": [
        ("pillar", {}, mean_of(PILLAR), +1),
        ("pillar", {}, mean_of(OUTER), +1),
    ],
    "cohesion": [("pillar", {}, mean_of(PILLAR), +1), ("pillar", {}, mean_of(ZONE), -1)],
    "compaction": [("filling", {}, mean_of(WEST), +1), ("pillar", {}, at(0, PILLAR), +1)],
    "density_misdeclared": [("filling", {}, mean_of(WEST), +1), ("pillar", {}, at(0, ZONE), +1)],
    "fill_height_misdeclared": [
        ("filling", {}, mean_of(WEST), +1),
        ("pillar", {}, at(0, ZONE), +1),
    ],
    "local_rule": [("filling", {}, mean_of(WEST), -1), ("pillar", {}, mean_of(OUTER), -1)],
    "loosening_density": [("pillar", {}, mean_of(ZONE), -1)],
    "packing_variability": [("filling", {}, spread_over_replicates, +1)],
    "pillar_relaxation": [("pillar", {}, mean_of(PILLAR), +1), ("pillar", {}, mean_of(ZONE), -1)],
    "relaxation_in_time": [("pillar", {}, spread_over_base, -1)],
    "segregation": [("filling", {}, spread_over_base, +1), ("pillar", {}, spread_over_base, +1)],
    "sensor_drift": [("pillar", {}, mean_of(PILLAR), +1)],
    "sensor_gain": [("filling", {}, mean_of(WEST), +1)],
    "sensor_offset": [("filling", {}, mean_of(WEST), +1)],
    "stress_dependent_transmission": [
        ("filling", DEEP, at(0, WEST), +1),  # under a third of the bed, below the reference
        ("filling", DEEP, at(2, WEST), -1),  # under the full bed
    ],
    "surcharge": [("filling", {}, mean_of(WEST), +1), ("pillar", {}, mean_of(ZONE), +1)],
    "tilt": [("filling", {}, mean_of(WEST), -1), ("filling", {}, mean_of(EAST), +1)],
    "wall_friction": [("filling", {}, mean_of(WEST), -1), ("pillar", {}, mean_of(PILLAR), -1)],
}


@pytest.fixture(scope="session")
def without():
    """Runs without effects, kept from test to test."""
    return {}


def test_every_effect_has_a_direction():
    assert set(effects()) == set(DIRECTIONS)


@pytest.mark.parametrize(
    ("name", "case"),
    [(name, case) for name, cases in DIRECTIONS.items() for case in cases],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_readings_move_as_the_effect_says(name, case, request, without):
    kind, changes, look, sign = case
    experiment = request.getfixturevalue(kind)(**changes)
    key = experiment.model_dump_json()
    if key not in without:
        without[key] = run(experiment, replicates=REPLICATES)
    before = look(without[key])
    after = look(run(experiment, [example(name, experiment)], REPLICATES))
    assert sign * (after - before) > 0.005 * before, (before, after)
