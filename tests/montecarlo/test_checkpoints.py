"""Parts of replicates on disk: taken up by a later run, and only by one that they are right for."""

import logging
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.experiment import LoadCell
from pipeline.montecarlo import checkpoints, replicates
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.parts import Collected
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

COUNT = 10
CHANGES = {
    "seed": ("seed", 3),
    "parameter": ("stress", {"E": 0.85}),
    "density": ("material", {"bulk_density": 1601.0}),
    "load cells": ("load_cells", (LoadCell(name="C", x=0.2, y=0.2, width=0.2, length=0.2),)),
}


@pytest.fixture(autouse=True)
def _keep_all(monkeypatch):
    monkeypatch.setattr(checkpoints, "WRITING", np.inf)


@pytest.fixture
def computed(monkeypatch):
    """(parameters, replicate) of each replicate that is computed."""
    seen = []
    run_part = replicates.run_part

    def watched(run, first, last):
        seen.extend((str(run.parameters), k) for k in range(first, last))
        return run_part(run, first, last)

    monkeypatch.setattr(replicates, "run_part", watched)
    return seen


@pytest.fixture
def stopped(monkeypatch, setup, run):
    """stopped(store, after): a run in parts of three that ends after some of them."""

    def start(store, after):
        keep, left = checkpoints.Shelf.keep, [after]

        def last_breath(shelf, part):
            path = keep(shelf, part)
            left[0] -= 1
            if not left[0]:
                raise KeyboardInterrupt
            return path

        with monkeypatch.context() as patch:
            patch.setattr(checkpoints.Shelf, "keep", last_breath)
            with pytest.raises(KeyboardInterrupt):
                run(setup, Execution(chunk=3), store)

    return start


def with_count(setup, count, **changes):
    experiment = setup.experiment.model_copy(update={"replicates": count, **changes})
    return make_setup(experiment)


@pytest.mark.parametrize("after", [1, 3, 5])
@pytest.mark.parametrize("chunk", [2, 3, None])
def test_a_stopped_run_goes_on_to_the_same_bits_and_repeats_no_part(
    setup, alone, run, assert_same_bits, stopped, computed, tmp_path, after, chunk
):
    stopped(Checkpoints(tmp_path, "code"), after)
    done = list(computed)
    assert len(done) >= 3
    computed.clear()
    assert_same_bits(run(setup, Execution(chunk=chunk), Checkpoints(tmp_path, "code")), alone)
    assert not set(computed) & set(done)
    assert len(computed) == len(set(computed))


def test_one_file_of_each_set_of_parameters_is_left(setup, run, stopped, tmp_path):
    folder = tmp_path / "checkpoints"
    stopped(Checkpoints(folder, "code"), 2)
    (folder / ".left.npz.partial").write_text("by a kill")
    run(setup, Execution(chunk=3), Checkpoints(folder, "code"))
    names = [path.name for path in folder.iterdir()]
    assert len(names) == (3 if setup.masses else 2)  # used, declared and, in draw, without zone
    assert all(name.endswith(f"_0-{COUNT}.npz") for name in names)


def test_more_replicates_run_only_what_is_more(setup, run, assert_same_bits, computed, tmp_path):
    run(setup, Execution(), Checkpoints(tmp_path, "code"))
    more = with_count(setup, 25)
    expected = run(more)
    computed.clear()
    assert_same_bits(run(more, Execution(2, chunk=4), Checkpoints(tmp_path, "code")), expected)
    assert {k for _, k in computed} == set(range(COUNT, 25))


def test_fewer_replicates_are_those_of_a_run_of_so_many(setup, run, assert_same_bits, tmp_path):
    run(setup, Execution(), Checkpoints(tmp_path, "code"))
    few = with_count(setup, 4)
    assert_same_bits(run(few, Execution(), Checkpoints(tmp_path, "code")), run(few))


@pytest.mark.parametrize("change", [*CHANGES, "code", "name"])
def test_what_decides_a_replicate_finds_no_other_s(setup, run, computed, tmp_path, change):
    run(setup, Execution(), Checkpoints(tmp_path, "code"))
    first = len(computed)
    computed.clear()
    experiment, code = setup.experiment, "code"
    if change == "code":
        code = "other code"
    elif change == "name":
        experiment = experiment.at("other.yaml")
    else:
        block, content = CHANGES[change]
        if isinstance(content, dict):
            content = getattr(experiment, block).model_copy(update=content)
        experiment = experiment.model_copy(update={block: content})
    other = make_setup(experiment)
    run(other, Execution(), Checkpoints(tmp_path, code))
    assert len(computed) == first


@pytest.mark.parametrize("damage", ["cut", "bit", "empty", "text", "others"])
def test_a_damaged_file_is_said_and_computed_again(
    setup, alone, run, assert_same_bits, stopped, computed, tmp_path, caplog, damage
):
    stopped(Checkpoints(tmp_path, "code"), 3)
    path = next(tmp_path.glob("*_3-6.npz"))
    content = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "bit":
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    elif damage == "others":
        path.write_bytes(next(tmp_path.glob("*_6-9.npz")).read_bytes()[:-30])
    else:
        path.write_text("" if damage == "empty" else "not a part")
    computed.clear()
    with caplog.at_level(logging.WARNING):
        assert_same_bits(run(setup, Execution(), Checkpoints(tmp_path, "code")), alone)
    assert f"{path} cannot be read" in caplog.text
    first_run = computed[0][0]
    own = {k for parameters, k in computed if parameters == first_run}
    assert own >= {3, 4, 5}
    assert not own & {0, 1, 2, 6, 7, 8}


def test_what_is_sooner_computed_than_written_is_not_kept(setup, run, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "WRITING", 1.0)
    folder = tmp_path / "checkpoints"
    run(setup, Execution(chunk=2), Checkpoints(folder, "code"))
    assert not folder.exists() or not any(folder.iterdir())


@given(
    cuts=st.sets(st.integers(1, COUNT - 1)), order=st.randoms(use_true_random=False), some=st.data()
)
def test_parts_join_to_the_same_whole_in_any_cut_and_order(setup, cuts, order, some):
    run = replicates.Run(setup, declared_parameters(setup.experiment))
    bounds = [0, *sorted(cuts), COUNT]
    parts = list(pairwise(bounds))
    order.shuffle(parts)
    collected = Collected()
    early = some.draw(st.integers(0, len(parts)))
    for part in parts[:early]:
        collected.add(replicates.run_part(run, *part))
    assert sorted(parts[early:]) == _fused(collected.gaps(COUNT), bounds)
    for part in parts[early:]:
        collected.add(replicates.run_part(run, *part))
    assert collected.gaps(COUNT) == []
    whole, expected = collected.whole(), replicates.run_part(run, 0, COUNT)
    assert whole.readings.keys() == expected.readings.keys()
    for name, values in whole.readings.items():
        np.testing.assert_array_equal(values, expected.readings[name])
        assert values.dtype == expected.readings[name].dtype
    for name in checkpoints.SUMS:
        np.testing.assert_array_equal(getattr(whole.sums, name), getattr(expected.sums, name))


def _fused(gaps, bounds):
    """Gaps cut at the bounds inside them."""
    return [
        pair
        for first, last in gaps
        for inside in [[b for b in bounds if first <= b <= last]]
        for pair in pairwise(inside)
    ]
