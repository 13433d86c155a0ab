"""Features of places in the ground: what their values are, and where they say that they act."""

from copy import deepcopy

import numpy as np
import pytest
from runs import run

from pipeline.effects._features import FEATURES
from pipeline.effects.local_rule import CHANNELS, in_words
from pipeline.lattice.cells import MOVEMENT, STAGNANT


@pytest.fixture(scope="session")
def states(filling, pillar):
    """experiment → the lattice at each of its readings."""
    found = {}
    for experiment in (filling(), pillar()):
        kept = found[experiment.name] = []
        run(experiment, inspect=lambda t, sweep, state, kept=kept: kept.append(deepcopy(state)))
    return found


@pytest.fixture(params=["filling", "pillar"])
def state(request, states):
    """The last reading of both in turn."""
    return states[request.param][-1]


@pytest.mark.parametrize("name", FEATURES)
def test_values_lie_within_one_and_fit_the_lattice(name, states):
    for state in (one for kept in states.values() for one in kept):
        phi = FEATURES[name](state)
        assert np.broadcast_shapes(phi.shape, state.code.shape) == state.code.shape
        assert np.isfinite(phi).all()
        assert np.abs(phi).max() <= 1.0


@pytest.mark.parametrize("name", FEATURES)
def test_every_feature_acts_somewhere(name, states):
    assert any(FEATURES[name](one).any() for kept in states.values() for one in kept)


@pytest.mark.parametrize("name", FEATURES)
def test_it_says_in_words_where_that_is(name):
    words = FEATURES[name].__doc__.strip()
    assert "\n" not in words
    assert words.split()[0].rstrip(",") in {"at", "in", "within", "around", "everywhere"}
    for channel in CHANNELS:
        up, down = (in_words(channel, name, amplitude) for amplitude in (0.3, -0.3))
        assert up.endswith(words)
        assert down == up.replace("rises", "falls") != up


def test_no_two_features_are_the_same_everywhere(states):
    last = [kept[-1] for kept in states.values()]
    seen = {}
    for name, feature in FEATURES.items():
        phi = [np.broadcast_to(feature(one), one.code.shape).astype(float) for one in last]
        other = seen.setdefault(b"".join(part.tobytes() for part in phi), name)
        assert other == name


def test_walls_and_sides_are_mirrored(state):
    mirrored = {"west_wall": ("east_wall", 2), "south_wall": ("north_wall", 1)}
    for name, (other, axis) in mirrored.items():
        phi = FEATURES[name](state)
        np.testing.assert_array_equal(np.flip(FEATURES[other](state), axis), phi)
        assert (np.take(phi, 0, axis) == 1.0).all()
        assert phi.sum() == np.take(phi, 0, axis).size
    for name, axis in (("along_x", 2), ("along_y", 1)):
        phi = FEATURES[name](state)
        assert np.take(phi, 0, axis).max() < 0.0
        np.testing.assert_allclose(np.flip(phi, axis), -phi)


def test_thirds_overlap_nowhere(state):
    thirds = [FEATURES[f"{part}_third"](state) for part in ("lower", "middle", "upper")]
    assert sum(thirds).max() == 1.0
    assert all(one.any() for one in thirds)


def test_zones_and_what_surrounds_them_are_in_their_own_ground(states):
    state = states["pillar"][-1]
    for name in ("zone", "zone_floor", "zone_top", "zone_edge", "resting_zone"):
        assert not FEATURES[name](state)[state.code != MOVEMENT].any()
    for name in ("shell", "near_zone", "above_zone", "pillar", "beside_zones"):
        assert not FEATURES[name](state)[state.code != STAGNANT].any()


def test_before_draw_nothing_is_in_or_beside_a_movement_zone(states):
    for state in (states["pillar"][0], states["filling"][-1]):
        for name in ("zone", "shell", "near_zone", "pillar", "growth", "beside_zones"):
            assert not FEATURES[name](state).any()
