"""`python -m pipeline.benchmark --workflow`, on one tiny experiment; no speed is asserted."""

import json
from contextlib import redirect_stdout
from functools import partial
from io import StringIO

from pipeline.benchmark import __main__ as command
from pipeline.benchmark.workflow import workflow_figures


def test_whole_runs_are_timed_beside_bare_jobs(checkout, monkeypatch):
    tiny = partial(workflow_figures, names=("alpha",), source=checkout.folder)
    monkeypatch.setattr(command, "workflow_figures", tiny)
    monkeypatch.setattr(command, "WORKFLOW_REPEATS", 1)
    before = sorted(path.name for path in checkout.folder.iterdir())
    with redirect_stdout(StringIO()) as out:
        assert command.main(["--workflow", "--json"]) == 0
    assert sorted(path.name for path in checkout.folder.iterdir()) == before
    document = json.loads(out.getvalue())
    first, again, idle, imports = document["figures"]
    assert first["yardstick"]["median"] == again["yardstick"]["median"] > 0.0
    assert idle["value"]["median"] < again["value"]["median"]
    assert first["sizes"]["remark"].startswith("1 pages in ")
    assert imports["value"]["median"] > imports["yardstick"]["median"]
    assert "nothing to do" in command.as_table(document)
