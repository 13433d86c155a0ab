"""What every kind of page has to be, as far as no browser is needed to tell."""

import re
from itertools import pairwise
from pathlib import Path

import pytest
from legibility import GROUNDS, TEXTS, contrast, stumbles, themes

from pipeline.report.figures import Panel, panel_style
from pipeline.report.page import Data, resource

KINDS = (
    *("static", "draw", "pillars", "study", "comparison", "prediction", "still"),
    *("blind", "catalogue", "index"),
)


@pytest.fixture(params=KINDS)
def html(request):
    made = request.getfixturevalue(request.param)
    return made.read_text("utf-8") if isinstance(made, Path) else made.html


def test_no_text_of_a_panel_overlaps_another_or_is_cut_off(html):
    assert stumbles(html) == []


def test_texts_that_overlap_or_are_cut_off_are_seen():
    with panel_style():
        panel = Panel(Data(), "name", "title", "x (m)", "y (m)", "alt", (0.75, 2.0))
        panel.axes.set(
            xlim=(0.0, 0.7), xticks=[0.0, 0.1, 0.2], xticklabels=["0.00", "0.10", "0.20"]
        )
        panel.axes.set_ylabel("a name that is far too long for so low a panel" * 2)
        found = stumbles(str(panel.svg))
    assert "alt: 0.00 over 0.10" in found
    assert any("is cut off" in one for one in found)


def test_every_picture_has_a_text_and_every_figure_a_download(html):
    for picture in re.findall(r"<(?:img|svg)\b[^>]*>", html):
        assert re.search(r'(?:alt|aria-label)="[^"]{10,}"|aria-hidden="true"', picture)
    figures = re.findall(r"<figure id=.*?</figure>", html, re.DOTALL)
    captions = re.findall(r"<figcaption>.*?</figcaption>", "".join(figures), re.DOTALL)
    assert len(captions) == len(figures)
    assert all('class="download"' in caption for caption in captions)


def test_headings_go_down_one_level_at_a_time(html):
    levels = [int(level) for level in re.findall(r"<h(\d)", html)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_the_page_loads_nothing_from_elsewhere(html):
    assert not re.search(r'(?:src|href)="(?:https?:)?//', html)
    assert "@import" not in html
    assert not re.search(r"<script[^>]+src=", html)


def test_texts_and_lines_stand_out_in_every_theme():
    found = themes(str(resource("style.css")))
    assert len(found) == 3  # light, dark, print
    for theme in found:
        for text in TEXTS:
            for ground in GROUNDS:
                assert contrast(theme[text], theme[ground]) >= 4.5, (text, ground, theme[ground])


@pytest.mark.parametrize(
    ("colors", "ratio"),
    [(("#000000", "#ffffff"), 21.0), (("#777777", "#ffffff"), 4.48), (("#123456", "#123456"), 1.0)],
)
def test_contrast_is_that_of_the_guidelines(colors, ratio):
    assert contrast(*colors) == pytest.approx(ratio, abs=0.005)
