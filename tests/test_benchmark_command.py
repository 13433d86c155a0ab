"""`python -m pipeline.benchmark`: the structure of what it prints, and its 2-D yardstick.

No test here asserts a speed.
"""

import json
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.benchmark import __main__ as command
from pipeline.benchmark import figures, replicates
from pipeline.benchmark.figures import Figure, Target
from pipeline.benchmark.replicates import Memory, scaling_figures
from pipeline.benchmark.table import as_table
from pipeline.benchmark.yardsticks import (
    published_sweep,
    published_sweep_by_levels,
    random_reads,
    triad,
)

TINY = command.Sizes(
    static=(6,),
    flow=(12,),
    reference=4,
    plane=6,
    memory=12,
    scaling=(6, 9),
    repeats=2,
    replicates=8,
)
SWEEPS = (published_sweep, published_sweep_by_levels)


@pytest.fixture(scope="module")
def printed():
    """What `--quick --json` prints, on lattices of a few cells."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "QUICK", TINY)
        patch.setattr(figures, "LEAST_SECONDS", 0.0)
        with redirect_stdout(StringIO()) as out:
            assert command.main(["--quick", "--json"]) == 0
    return out.getvalue()


def test_every_figure_has_its_yardstick_ratio_sizes_and_repeats(printed):
    document = json.loads(printed)
    assert document["figures"]
    for figure in document["figures"]:
        assert figure["name"]
        assert figure["sizes"]["cells"] == [np.prod(shape) for shape in figure["sizes"]["shapes"]]
        assert figure["dtype"]
        assert figure["repeats"] >= 2
        assert figure["yardstick"]["name"]
        for spread in (figure["value"], figure["yardstick"], figure["ratio"]):
            assert spread["min"] <= spread["median"] <= spread["max"]


def test_every_yardstick_and_every_part_is_there(printed):
    found = json.loads(printed)["figures"]
    yardsticks = {figure["yardstick"]["name"] for figure in found}
    for word in ("STREAM triad", "plain-Python", "published 2-D", "26 s", "random reads"):
        assert any(word in name for name in yardsticks), word
    names = " / ".join(figure["name"] for figure in found)
    for word in (
        "ranks of s",
        "sweep, weights by rank",
        "sweep, weights by cell",
        "sweep",
        "static replicate",
        "moving",
        "new ground",
    ):
        assert word in names
    for word in ("elsewhere", "memory of a static", "draw replicate adds", "power of wall time"):
        assert word in names
    for word in ("two threads", "two processes", "Dask, one worker", "Dask, two workers"):
        assert word.removesuffix("s") in names
    quoted = [figure for figure in found if figure["yardstick"]["quoted"]]
    assert [figure["unit"] for figure in quoted] == ["kg/s"]


def test_the_machine_is_described(printed):
    machine = json.loads(printed)["machine"]
    assert machine["cores"] >= 1
    assert len(machine["load_average"]) == 3
    assert {"processor", "caches", "numpy", "numba"} <= machine.keys()


def test_the_table_has_a_row_for_every_figure_and_says_what_was_left_out(printed):
    document = json.loads(printed) | {"skipped": ["the moon: too far"]}
    table = as_table(document)
    rows = [line.strip() for line in table.splitlines()]
    for figure in document["figures"]:
        assert any(row.startswith(figure["name"]) for row in rows)
    assert "left out: the moon: too far" in rows


def test_targets_are_judged_by_the_median_of_value_or_of_paired_ratios():
    figure = Figure(
        "f",
        "s",
        np.array([1.0, 4.0, 9.0]),
        "y",
        np.array([1.0, 2.0, 3.0]),
        ((3, 1, 1),),
        "float32",
        targets=(Target("value", 4.0), Target("ratio", 2.5), Target("value", 3.9, is_most=True)),
    )
    document = figure.document()
    assert document["ratio"] == {"min": 1.0, "median": 2.0, "max": 3.0}
    assert [target["met"] for target in document["targets"]] == [True, False, False]


def test_a_lattice_that_does_not_fit_is_left_out_with_the_reason():
    skipped = []
    greedy = Memory(yardstick=0.0, making=1e12, replicate=1.0)
    sides = (2, 3, 400)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "LEAST_SECONDS", 0.0)
        free = type("Free", (), {"available": 1e14})
        patch.setattr(replicates.psutil, "virtual_memory", lambda: free)
        power, *points = scaling_figures(sides, 1, greedy, skipped)
    assert len(points) == 2
    assert len(skipped) == 1
    assert str(400**3) in skipped[0]
    assert power.shapes == ((2, 2, 2), (3, 3, 3))


# ---------------------------------------------------------------------------------------------
# yardsticks

SHARES = st.floats(0.0, 1.0)
WEIGHTS = hnp.arrays(
    np.float64, hnp.array_shapes(min_dims=2, max_dims=2, max_side=7), elements=st.floats(0.0, 10.0)
)


@pytest.mark.parametrize("sweep", SWEEPS)
def test_the_published_sweep_of_three_levels_by_hand(sweep):
    """A unit of weight in the top middle, f = 1/2.

    Level 1: σ = 1/4 1/2 1/4, τ = −1/4 0 1/4. Level 0, left: half of 1/4 straight, a quarter of
    1/4 (mirrored) and of 1/2 from aside, and 1/2 (1/4 − 0) of shear: 7/16; middle: half of 1/2, a
    quarter of 1/4 twice, and 1/2 (−1/4 − 1/4): 1/8.
    """
    weight = np.zeros((3, 3))
    weight[2, 1] = 1.0
    stress, shear = sweep(weight, np.ones((3, 3), bool), 0.5)
    np.testing.assert_allclose(stress[1], [0.25, 0.5, 0.25])
    np.testing.assert_allclose(shear[1], [-0.25, 0.0, 0.25])
    np.testing.assert_allclose(stress[0], [0.4375, 0.125, 0.4375])
    np.testing.assert_allclose(shear[0], [0.0625, 0.0, -0.0625])


@pytest.mark.parametrize("sweep", SWEEPS)
@given(weight=WEIGHTS, straight=SHARES)
def test_the_published_sweep_conserves_weight_without_voids(sweep, weight, straight):
    stress, _ = sweep(weight, np.ones(weight.shape, bool), straight)
    above = np.cumsum(weight.sum(axis=1)[::-1])[::-1]
    np.testing.assert_allclose(stress.sum(axis=1), above, rtol=1e-12, atol=1e-12)


@given(weight=WEIGHTS, straight=SHARES, seed=st.integers(0, 2**32 - 1))
def test_both_forms_of_the_published_sweep_agree_around_voids(weight, straight, seed):
    granular = np.random.default_rng(seed).random(weight.shape) < 0.8
    one, other = (sweep(weight, granular, straight) for sweep in SWEEPS)
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-9)
    assert not one[0][~granular].any()


def test_triad_and_random_reads_do_what_they_say():
    a, b, c = np.zeros(5, np.float32), np.arange(5, dtype=np.float32), np.ones(5, np.float32)
    triad(a, b, c, np.float32(3.0))
    np.testing.assert_array_equal(a, b + 3.0)
    values = np.zeros(1000, np.int32)
    first = np.uint64(random_reads(values, 10, np.uint64(1)))
    assert random_reads(values, 10, first) == random_reads(values, 20, np.uint64(1))
    assert random_reads(values + np.int32(1), 10, np.uint64(1)) != first
