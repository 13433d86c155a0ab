"""The page of the full run says what the log of scored runs says."""

import json

import pytest


@pytest.fixture(scope="module")
def run(repository):
    log = repository / "results" / "blind_benchmark" / "log.jsonl"
    return json.loads(log.read_text(encoding="utf-8").splitlines()[-1])


@pytest.fixture(scope="module")
def page(repository):
    return (repository / "docs" / "blind_benchmark.md").read_text(encoding="utf-8")


def figure(bar):
    if (of := bar["rate"]) is None:
        return f"{bar['figure']:.3g}"
    low, high = 100 * of["low"], 100 * of["high"]
    counts = f"{of['count']} of {of['of']}; {low:.1f} to {high:.1f}"
    return f"{100 * of['rate']:.1f} % ({counts})"


def outcome(bar):
    if bar["met"] is None:
        return "–"
    if bar["met"]:
        return "stretch met" if bar["met_stretch"] else "met"
    return "**missed for sure**" if bar["broken"] else "**missed**"


def test_every_bar_is_on_the_page_as_it_was_logged(run, page):
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")]
    shown = {row[0]: (row[1], row[-1]) for row in rows if len(row) == 5}
    for bar in run["bars"]:
        assert shown[bar["quantity"]] == (figure(bar), outcome(bar))


def test_the_readme_counts_the_bars_that_were_missed(run, page, repository):
    words = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen"
    bars = [bar["met"] for bar in run["bars"] if bar["met"] is not None]
    missed, all_of_them = (words.split()[n] for n in (bars.count(False), len(bars)))
    readme = (repository / "README.md").read_text(encoding="utf-8")
    assert f"It missed {missed} of its {all_of_them} bars" in " ".join(readme.split())
    assert run["commit"][:12] in page
    assert str(run["seeds"]["worlds"]) in page
