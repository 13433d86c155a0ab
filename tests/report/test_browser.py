"""The pages in a headless Chromium, as a reader sees them; skipped where none is installed."""

from pathlib import Path

import pytest
from chromium import CHROMIUM, Chromium

KINDS = (
    "static",
    "draw",
    "pillars",
    "regions",
    "study",
    "comparison",
    "prediction",
    "still",
    "blind",
    "catalogue",
    "index",
)
LEGIBILITY = Path(__file__).with_name("legibility.js").read_text("utf-8")
SHOWN = """
[...document.querySelectorAll(".player figure .panel-box")].map((panel) =>
  [...panel.querySelectorAll("[data-frame]")]
    .filter((part) => getComputedStyle(part).display !== "none").map((part) => part.dataset.frame))
"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Chromium(tmp_path_factory.mktemp("chromium")) as chromium:
        yield chromium


@pytest.fixture
def page(request):
    """page(kind): the file of a page of this kind."""

    def of(kind: str) -> Path:
        made = request.getfixturevalue(kind)
        return made if isinstance(made, Path) else made.folder / "report.html"

    return of


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [420, 1280])
@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_legible(browser, page, kind, width, scheme):
    browser.open(page(kind), width, scheme)
    assert browser.problems() == []
    found = browser.evaluate(LEGIBILITY)
    assert found == {kind: [] for kind in found}


@pytest.mark.parametrize("kind", KINDS)
def test_a_printed_page_is_legible(browser, page, kind):
    browser.open(page(kind), 720, media="print")  # the width of A4 at 96 dpi, less margins
    found = browser.evaluate(LEGIBILITY)
    assert found["faint"] == found["overlapping"] == []


@pytest.mark.parametrize("kind", ["draw", "pillars"])
def test_arrow_keys_move_section_plan_and_load_cells_together(browser, page, kind):
    browser.open(page(kind))
    last = int(browser.evaluate("document.querySelector('#reading').max"))
    assert last >= 2
    browser.evaluate("document.querySelector('#reading').focus()")
    for key, frame in (("ArrowLeft", last - 1), ("ArrowLeft", last - 2), ("Home", 0),
                       ("ArrowRight", 1), ("End", last)):  # fmt: skip
        browser.press(key)
        panels = browser.evaluate(SHOWN)
        assert len(panels) >= 3
        assert {frame for panel in panels for frame in panel} == {str(frame)}
        assert all(panels)
        words = browser.evaluate("document.querySelector('.player output').value")
        assert words.startswith(f"reading {frame + 1} of {last + 1}")
        assert browser.evaluate("document.querySelector('#reading').ariaValueText") == words
    assert browser.problems() == []


def test_the_slider_is_reached_by_tab_and_has_a_name(browser, page):
    browser.open(page("draw"))
    for _ in range(60):
        browser.press("Tab")
        if browser.evaluate("document.activeElement.id") == "reading":
            break
    assert browser.evaluate("document.activeElement.labels[0].innerText") == "Through the draw"


def test_without_scripts_the_last_reading_and_the_table_stand(browser, page):
    browser.send("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page("draw"))
    finally:
        browser.send("Emulation.setScriptExecutionDisabled", value=False)
    last = browser.evaluate("document.querySelector('#reading').max")
    assert {frame for panel in browser.evaluate(SHOWN) for frame in panel} == {last}
    assert browser.evaluate("document.querySelector('#reading').checkVisibility()") is False
    assert browser.evaluate("document.querySelector('#table-base_stress').checkVisibility()")
