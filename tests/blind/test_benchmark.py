"""The benchmark as a whole, on a small laboratory of coarse cells."""

import json
import os
import shutil
from pathlib import Path

import pytest

from pipeline.blind import injection, laboratory, loops, worlds
from pipeline.blind.benchmark import run_benchmark, score_benchmark
from pipeline.blind.loops import close_world, run_worlds
from pipeline.blind.scored import SealBrokenError
from pipeline.blind.seal import SealedError, sealed
from pipeline.blind.tasks import each
from pipeline.files.atomic import read_json
from pipeline.loop import gate, model
from pipeline.report.blind import write_blind_report
from pipeline.workflow.catalog import blind_seed

SEED = 9
COLUMNS = ("static_1", "static_5", "static_7", "static_8")
NAMES = ["world_0000", "world_0001"]


@pytest.fixture(autouse=True, scope="module")
def small():
    """A small laboratory and few replicates: these tests look at no figure that needs more."""
    patch = pytest.MonkeyPatch()
    patch.setattr(laboratory, "CELL", 0.06)
    patch.setattr(laboratory, "STATIC", {name: laboratory.STATIC[name] for name in COLUMNS})
    patch.setattr(laboratory, "DRAWS", {"isolated": laboratory.DRAWS["isolated"]})
    patch.setattr(laboratory, "HELD_OUT", COLUMNS[2:])
    for name in ("REPLICATES", "SCATTER", "COMMON", "LOOKS", "PROBES"):
        patch.setattr(injection, name, 4)
    patch.setattr(model, "SCATTER", 24)
    patch.setattr(model, "OTHERS", 12)
    patch.setattr(gate, "DRAWS", 200)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def edition(tmp_path_factory):
    """(folder, scores) of an edition of two worlds; not to be changed."""
    folder = tmp_path_factory.mktemp("edition")
    return folder, run_benchmark(folder, 2, seed=SEED)


@pytest.fixture
def copied(edition, tmp_path) -> Path:
    """A copy of its own of the edition's folder."""
    return Path(shutil.copytree(edition[0], tmp_path / "edition"))


@pytest.fixture
def counted(monkeypatch, edition) -> list[str]:
    """Names of the worlds on which the loop was run; it finds what it found before."""
    ran = []

    def found_before(folder):
        ran.append(folder.name)
        return documents(edition[0], folder.name), None

    monkeypatch.setattr(loops, "_closed_loop", found_before)
    monkeypatch.setattr(loops, "peer_claims", lambda first: {})
    return ran


def documents(folder, world):
    return {n: read_json(folder / "worlds" / world / f"{n}.json") for n in loops.RESULTS}


def test_every_world_is_scored_and_logged(edition):
    folder, scores = edition
    assert [one["world"] for one in scores["each"]] == NAMES
    assert read_json(folder / "scores.json")["worlds"] == 2
    (line,) = (folder / "log.jsonl").read_text().splitlines()
    assert json.loads(line)["seeds"] == {"worlds": SEED}
    assert scores["seed_is_the_commits"] is False
    assert scores["seconds"]["median"] > 0.0
    assert set(scores["broken"]) <= {bar["quantity"] for bar in scores["bars"]}
    for one in scores["each"]:
        assert set(one["held_out"]) == {
            "before",
            "after",
            "recalibrated_only",
            "gaussian_process",
        }


def test_peers_claim_from_the_same_arrays(edition):
    folder, scores = edition
    assert len(scores["peers"]) == 5
    for world in NAMES:
        claims = documents(folder, world)["peers"]
        assert set(claims) == set(scores["peers"])
        assert len(claims["raw_correlation"]) == 1
        assert not any(name == "local_rule" for named in claims.values() for name, _ in named)


@pytest.mark.parametrize("spoil", ["garbage", "deleted"])
def test_the_loop_says_the_same_whatever_the_truth_is(edition, copied, spoil):
    shutil.rmtree(copied / "sealed")
    if spoil == "garbage":
        (copied / "sealed").mkdir()
        (copied / "sealed" / f"{NAMES[1]}.json").write_text("no truth at all")
    world = copied / "worlds" / NAMES[1]
    (world / "closed_loop.json").unlink()
    close_world(world, copied / "sealed")
    assert documents(copied, NAMES[1]) == documents(edition[0], NAMES[1])


def test_the_loop_cannot_open_the_truth(copied, monkeypatch):
    run = loops._closed_loop

    def peeking(folder):
        (folder.parents[1] / "sealed" / f"{folder.name}.json").read_text()
        return run(folder)

    monkeypatch.setattr(loops, "_closed_loop", peeking)
    world = copied / "worlds" / NAMES[0]
    (world / "run.json").unlink()
    with pytest.raises(SealedError, match=f"sealed/{NAMES[0]}.json"):
        close_world(world, copied / "sealed")
    assert not (world / "run.json").exists()


def test_a_seal_holds_for_every_way_in_and_only_within(tmp_path):
    folder, beside = tmp_path / "sealed", tmp_path / "sealed_not"
    for one in (folder, beside):
        one.mkdir()
        (one / "file").write_text("text")
    (tmp_path / "link").symlink_to(folder)
    with sealed(folder):
        for way in (folder, tmp_path / "link", beside / ".." / "sealed"):
            with pytest.raises(SealedError):
                (way / "file").read_text()
        for ask in (os.listdir, os.scandir, lambda path: os.open(f"{path}/file", os.O_RDONLY)):
            with pytest.raises(SealedError):
                ask(folder)
        with pytest.raises(SealedError):
            os.rename(folder / "file", beside / "moved")
        assert (beside / "file").read_text() == "text"
    assert (folder / "file").read_text() == "text"


def test_finished_worlds_are_kept(edition, copied, counted):
    (copied / "worlds" / NAMES[1] / "closed_loop.json").unlink()
    run_worlds(copied, 2, seed=SEED)
    assert counted == NAMES[1:]
    seconds = read_json(copied / "runs.json")["seconds"]
    assert list(seconds) == NAMES
    assert seconds[NAMES[0]] == read_json(edition[0] / "runs.json")["seconds"][NAMES[0]]


def test_other_code_other_data_and_another_seed_run_again(copied, counted):
    first, second = (copied / "worlds" / name for name in NAMES)
    close_world(first, copied / "sealed", code="other")
    assert counted == NAMES[:1]
    table = second / "experiments" / "measured" / "data.csv"
    table.write_text(table.read_text() + "# changed\n")
    close_world(second, copied / "sealed")
    assert counted == NAMES
    run_worlds(copied, 1, seed=SEED + 1, code="other")
    assert counted == [*NAMES, NAMES[0]]


def test_undecided_worlds_are_measured_once_more(edition, copied, monkeypatch):
    ran = []
    repeat = {"kind": "repeat", "experiment": "static_5", "expected_gain": 0.1}
    words = {"what": "repeat the experiment", "where": "static_5"}

    def undecided(folder):
        ran.append(folder.name)
        found = documents(edition[0], NAMES[0])
        names = {"verdict": "ambiguous", "candidate_set": ["tilt", "arching"]}
        found["closed_loop"] |= names | {"possible_measurements": [repeat | words]}
        return found, None

    monkeypatch.setattr(loops, "_closed_loop", undecided)
    monkeypatch.setattr(loops, "peer_claims", lambda first: {})
    run_worlds(copied, 1, seed=SEED, code="other")
    assert ran == [NAMES[0], "then_recommended", "then_random"]
    run_worlds(copied, 1, seed=SEED, code="other")
    assert len(ran) == 3
    scores = score_benchmark(copied)
    (world,) = scores["remeasured"]["each"]
    assert world["recommended"] == world["random"] == words | {"resolved": False}
    write_blind_report(scores, copied / "report.html", copied / "report_data.csv")
    html = (copied / "report.html").read_text()
    for choice in ("recommended", "random"):
        assert f'href="worlds/{NAMES[0]}/then_{choice}/measurement.json"' in html


def test_scores_refuse_a_truth_that_was_changed(copied):
    truth = copied / "sealed" / f"{NAMES[0]}.json"
    truth.write_text(truth.read_text() + " ")
    with pytest.raises(SealBrokenError):
        score_benchmark(copied)


def test_the_page_lists_every_world_and_says_that_the_edition_is_small(edition):
    folder, scores = edition
    write_blind_report(scores, folder / "report.html", folder / "report_data.csv")
    html = (folder / "report.html").read_text()
    assert "small edition" in html
    assert "Tuning worlds" in html
    assert scores["commit"] in html
    for name in NAMES:
        assert f'href="worlds/{name}/closed_loop.json"' in html
    for bar in scores["bars"]:
        assert bar["quantity"] in html


def test_a_seed_is_the_commits_own_unless_one_is_given(monkeypatch):
    assert blind_seed({"blind_seed": 7}) == blind_seed({"blind_seed": "7"}) == 7
    own = []
    for commit in ("a" * 40, "b" * 40):
        monkeypatch.setattr("pipeline.files.netcdf.git_revision", lambda commit=commit: commit)
        own.append(blind_seed({"blind_seed": None}))
        assert own[-1] == worlds.scoring_seed(commit)
    assert len(set(own)) == 2
    with pytest.raises(ValueError, match="git checkout"):
        worlds.scoring_seed("unknown")


def _halves(item: int) -> float:
    return 1 / item


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_lets_the_other_items_finish(workers, caplog):
    assert each("halves", _halves, [4, 2, 1], workers) == [0.25, 0.5, 1.0]
    caplog.clear()
    with caplog.at_level("INFO"), pytest.raises(ExceptionGroup, match="1 of 3") as failed:
        each("halves", _halves, [0, 2, 1], workers)
    assert isinstance(failed.value.exceptions[0], ZeroDivisionError)
    assert "halves: 3 of 3" in caplog.text
