"""Panels: what they draw is recorded, and their SVG fits the page."""

import re
import xml.etree.ElementTree as ElementTree

import matplotlib
import numpy as np
import pytest

from pipeline.report.figures import MOST_PIXELS, Panel, block_means, panel_style
from pipeline.report.page import Data


@pytest.fixture
def panel():
    with panel_style():
        yield Panel(Data(), "name", "A title", "x (m)", "y (kPa)", 'A "line" & <more>')


def test_a_panel_is_valid_xml_with_alternative_text_and_theme_colors(panel):
    panel.curve("curve", [0, 1], [1, 2], [0, 1], [2, 3], band="band")
    panel.points("points", [0.5], [1.5], [1.0], [2.0], filled=False)
    svg = str(panel.svg)
    root = ElementTree.fromstring(svg)
    assert root.get("role") == "img"
    assert root.get("aria-label") == 'A "line" & <more>'
    assert "var(--blue)" in svg
    assert "#0101" not in svg
    assert set(panel.legend) == {"curve", "band", "points"}


def test_what_is_drawn_is_recorded(panel):
    panel.curve("curve", [0, 1], [1, 2], [0, 1], [2, 3], band="band")
    panel.image([0.5, 1.5], [0.5], np.array([[3.0, np.nan]]), "stress (kPa)", 0, 3)
    rows = panel._data.rows
    assert rows[1] == ("name", "A title", "curve", "x (m)", "1", "y (kPa)", "2", "1", "3")
    assert [row[6] for row in rows[2:]] == ["3", ""]


def test_ids_of_two_panels_differ():
    with panel_style():
        svgs = []
        for title in ("one", "two"):
            panel = Panel(Data(), "name", title, "x", "y", "alt")
            panel.points("points", [0, 1], [0, 1])
            svgs.append(str(panel.svg))
    ids = [set(re.findall(r' id="([^"]+)"', svg)) for svg in svgs]
    assert not ids[0] & ids[1]
    for svg, known in zip(svgs, ids, strict=True):
        assert set(re.findall(r'(?:url\(#|href="#)([^")]+)', svg)) <= known


def test_the_style_is_left_behind_unchanged():
    before = dict(matplotlib.rcParams)
    with panel_style():
        assert matplotlib.rcParams["svg.fonttype"] == "none"
    assert dict(matplotlib.rcParams) == before


def test_a_large_field_is_shown_in_block_means():
    x, y = np.arange(301) + 0.5, np.arange(200) + 0.5
    values = np.broadcast_to(x, (200, 301)).copy()
    values[:2, :2] = np.nan
    few_x, few_y, few = block_means(x, y, values)
    assert few.size <= MOST_PIXELS
    assert (few_x[0], few_y[0], few_x[1] - few_x[0]) == (1.0, 1.0, 2.0)
    assert np.isnan(few[0, 0])
    np.testing.assert_allclose(few[5, :-1], few_x[:-1])


@pytest.mark.parametrize("size", [3, 300])
def test_classes_are_never_mixed_and_only_those_that_occur_are_named(panel, size):
    codes = np.full((size, size), 2.0)
    codes[: size // 2] = 0.0
    panel.classes(np.arange(size), np.arange(size), codes, "class", ["ore", "rock", "cap"])
    assert list(panel.legend) == ["ore", "cap"]
    (image,) = panel.axes.images
    assert set(np.unique(image.get_array())) == {0.0, 2.0}


def test_a_small_field_is_shown_as_it_is():
    values = np.ones((3, 4))
    np.testing.assert_array_equal(block_means(np.arange(4), np.arange(3), values)[2], values)
