"""Effects outside the catalogue act on the package's lattice through the stages of an effect."""

import numpy as np
import pytest

from pipeline.blind import laboratory
from pipeline.blind.outside import OUTSIDE
from pipeline.blind.truth import THETA, Added, LatticeGenerator
from pipeline.effects import effects

DECLARED = np.zeros(len(THETA))


@pytest.fixture(scope="module")
def generator():
    return LatticeGenerator(laboratory.documents(0))


def readings(generator, name, *added):
    return generator.stress(name, DECLARED, added, (0, 0))


def test_there_are_many_kinds_and_none_is_in_the_catalogue():
    assert len(OUTSIDE) >= 8
    assert not set(OUTSIDE) & set(effects())


@pytest.mark.parametrize("kind", OUTSIDE)
def test_off_at_zero_and_on_at_its_ends(kind, generator):
    ends = [end for end in (OUTSIDE[kind].low, OUTSIDE[kind].high) if end]
    for name in ("static_1", "block_wide"):
        without = readings(generator, name)
        off = readings(generator, name, Added(kind, None, {"amplitude": 0.0}))
        np.testing.assert_array_equal(off, without)
    for end in ends:
        on = readings(generator, "block_wide", Added(kind, None, {"amplitude": end}))
        assert np.isfinite(on).all()
        assert (on > 0.0).all()
        assert np.abs(np.log(on / without)).max() > 0.01


def test_a_rough_wall_lowers_its_side_most(generator):
    rough = Added("one_rough_wall", None, {"amplitude": 6.0})
    change = readings(generator, "static_1", rough)[-1] / readings(generator, "static_1")[-1]
    assert change[0] < change[1] < change[3]


def test_wider_zones_come_from_the_flow(generator):
    wide = Added("wide_zone", None, {"amplitude": 0.3})
    np.testing.assert_array_equal(
        readings(generator, "static_1", wide), readings(generator, "static_1")
    )
