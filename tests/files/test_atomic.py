"""A file or a folder appears whole or not at all."""

import json
import math

import numpy as np
import pytest

from pipeline.files.atomic import read_json, whole_file, whole_folder, write_json, write_text


class InterruptionError(Exception):
    pass


@pytest.mark.parametrize("old", [None, "old"])
def test_a_write_that_fails_midway_leaves_what_was_there(tmp_path, old):
    target = tmp_path / "results" / "text.txt"
    if old is not None:
        write_text(target, old)

    def write_half():
        with whole_file(target) as partial:
            partial.write_text("half")
            assert not target.exists() or target.read_text() == old
            raise InterruptionError

    with pytest.raises(InterruptionError):
        write_half()
    left = [path.name for path in target.parent.iterdir()]
    assert left == ([] if old is None else ["text.txt"])
    if old is not None:
        assert target.read_text() == old


def test_what_a_killed_run_left_is_overwritten_by_the_next(tmp_path):
    target = tmp_path / "text.txt"
    with whole_file(target) as partial:
        partial.write_text("left behind by a kill")
        kept = partial.read_text()
    target.unlink()
    partial.write_text(kept * 10)
    write_text(target, "new")
    assert [path.name for path in tmp_path.iterdir()] == ["text.txt"]
    assert target.read_text() == "new"


def test_json_keeps_order_and_numbers_and_writes_null_for_what_is_not_finite(tmp_path):
    target = tmp_path / "a.json"
    write_json(
        target,
        {
            "b": np.float64(0.1),
            "a": [np.int32(3), math.nan, -math.inf],
            "c": {"d": (True, None, "σ")},
        },
    )
    assert read_json(target) == {"b": 0.1, "a": [3, None, None], "c": {"d": [True, None, "σ"]}}
    assert list(read_json(target)) == ["b", "a", "c"]
    json.loads(target.read_text(), parse_constant=lambda word: pytest.fail(word))


def test_a_folder_appears_whole_and_takes_the_place_of_the_old_one(tmp_path):
    target = tmp_path / "vtk"
    for number in (1, 2):
        with whole_folder(target) as partial:
            (partial / f"{number}.vti").write_text("whole")
            assert not (target / f"{number}.vti").exists()
    assert [path.name for path in target.iterdir()] == ["2.vti"]
    assert [path.name for path in tmp_path.iterdir()] == ["vtk"]


def test_a_folder_that_fails_midway_leaves_the_old_one(tmp_path):
    target = tmp_path / "vtk"
    target.mkdir()
    (target / "old.vti").write_text("old")

    def write():
        with whole_folder(target) as partial:
            (partial / "new.vti").write_text("half")
            raise InterruptionError

    with pytest.raises(InterruptionError):
        write()
    assert [path.name for path in target.iterdir()] == ["old.vti"]
    assert [path.name for path in tmp_path.iterdir()] == ["vtk"]
