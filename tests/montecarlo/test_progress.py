"""What the log and a terminal say of replicates that run."""

import io
import logging

import pytest

from pipeline.montecarlo import progress
from pipeline.montecarlo.progress import Progress, duration


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand, s."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


def test_the_log_says_how_many_are_done_and_how_long_the_rest_takes(clock, caplog):
    with caplog.at_level(logging.INFO):
        counted = Progress("castro", 1000)
        counted.found(200)
        for _ in range(4):
            clock[0] += 6.0
            counted.computed(100)
        counted.end()
    assert [record.getMessage() for record in caplog.records] == [
        "castro: 1000 replicates",
        "castro: 200 of 1000 replicates were kept by an earlier run and are not run again",
        # those that were found took no time: 200 more took 12 s, and 600 are left
        "castro: 400 of 1000 replicates, about 36 s left",
        "castro: 600 of 1000 replicates, about 24 s left",
        "castro: 400 replicates took 24.00 s",
    ]


def test_a_terminal_sees_every_part_on_one_line(clock, monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(progress.sys, "stderr", terminal)
    counted = Progress("castro", 4)
    for _ in range(4):
        clock[0] += 1.0
        counted.computed(1)
    counted.end()
    first, *lines, last = terminal.getvalue().split("\r")
    assert first == ""
    assert [line.strip() for line in lines] == [
        "castro: 1 of 4 replicates, about 3 s left",
        "castro: 2 of 4 replicates, about 2 s left",
        "castro: 3 of 4 replicates, about 1 s left",
    ]
    assert last.strip() == "castro: 4 of 4 replicates"
    assert last.endswith("\n")


def test_no_terminal_sees_nothing(clock, capsys):
    counted = Progress("castro", 4)
    counted.computed(4)
    counted.end()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (89, "89 s"), (90, "2 min"), (3600, "60 min"), (12000, "3 h 20 min")],
)
def test_durations_are_told_in_words(seconds, words):
    assert duration(seconds) == words
