"""`python -m pipeline.stages`: every stage is timed, and the replicate is that of a run."""

import json
from contextlib import redirect_stdout
from io import StringIO

import pytest
import yaml
from specs import COLUMN, DRAWN, merged

from pipeline import stages
from pipeline.parameters import declared_parameters
from pipeline.stages import STAGES, Stopwatch, as_table, time_stages


@pytest.fixture
def files(tmp_path):
    """A folder with a draw experiment that takes E from a static one."""
    mine = merged(COLUMN, DRAWN)
    mine["stress"] = mine["stress"] | {"from": "laboratory"}
    del mine["stress"]["E"]
    for name, content in (("laboratory", COLUMN), ("mine", mine)):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(content))
    return tmp_path


def test_the_stages_add_up_and_say_what_was_done(drawn):
    experiment = drawn()
    found = time_stages(experiment, declared_parameters(experiment))
    assert tuple(found["seconds"]) == STAGES
    assert all(seconds > 0 for seconds in found["seconds"].values())
    assert found["total_seconds"] == pytest.approx(sum(found["seconds"].values()))
    assert (found["cells"], found["readings"], found["drawpoints"]) == (12 * 10 * 16, 4, 1)
    assert found["cells_drawn"] == 60  # of 0.2 kg
    assert found["weight_balance_error"] < 1e-12


def test_the_command_takes_e_from_the_source_and_prints_a_table_or_data(files):
    with redirect_stdout(StringIO()) as out:
        assert stages.main([str(files / "mine.yaml"), "--json"]) == 0
    document = json.loads(out.getvalue())
    assert document["experiment"] == "mine"
    text = as_table(document)
    assert "60 cells drawn" in text
    assert all(stage in text for stage in STAGES)


def test_a_static_experiment_and_a_bad_file_are_refused(files, capsys):
    assert stages.main([str(files / "laboratory.yaml")]) == 1
    assert "expected draw lines" in capsys.readouterr().err
    assert stages.main([str(files / "none.yaml")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_a_stage_may_come_again(monkeypatch):
    now = iter([1.0, 2.0, 5.0, 6.0])
    monkeypatch.setattr(stages.time, "perf_counter", lambda: next(now))
    watch = Stopwatch()
    for stage in ("sweep", "reading", "sweep", None):
        watch.enter(stage)
    assert (watch.seconds["sweep"], watch.seconds["reading"]) == (2.0, 3.0)
