"""Figures of a page as files: every panel, complete by itself, and one clear error without."""

import re
from xml.etree import ElementTree

import pytest

from pipeline.__main__ import main
from pipeline.report.figure_files import figures_of


@pytest.fixture
def page(draw, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(draw.html, "utf-8")
    return path


def test_every_panel_of_the_page_becomes_a_file_that_needs_no_style_sheet(page, capsys):
    assert main(["figures", str(page)]) == 0
    html = page.read_text("utf-8")
    files = sorted((page.parent / "figures").glob("*.svg"))
    assert len(files) == len(re.findall('<svg class="panel"', html)) > 10
    assert capsys.readouterr().out.count("wrote ") == len(files)
    for file in files:
        text = file.read_text("utf-8")
        root = ElementTree.fromstring(text)
        assert root.get("viewBox")
        assert root.get("aria-label")
        assert "var(--" not in text
        for used in set(re.findall(r'href="#([\w-]+)"|url\(#([\w-]+)\)', text)):
            assert f'id="{used[0] or used[1]}"' in text


def test_one_figure_can_be_asked_for(page, tmp_path):
    name = next(iter(figures_of(page.read_text("utf-8"))))
    assert main(["figures", str(page), "--only", name, "--into", str(tmp_path / "some")]) == 0
    stems = {path.stem for path in (tmp_path / "some").iterdir()}
    assert {re.sub(r"_\d+$", "", stem) for stem in stems} == {name}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["reprt.html"], "no such file; did you mean report.html?"),
        (["other.html"], "holds no figure; expected a report's page"),
        (["report.html", "--only", "load_cels"], "--only load_cels: expected one of"),
    ],
)
def test_what_cannot_be_written_is_said(page, words, expected, capsys, monkeypatch):
    (page.parent / "other.html").write_text("<p>no figure</p>", "utf-8")
    monkeypatch.chdir(page.parent)
    assert main(["figures", *words]) == 1
    assert expected in capsys.readouterr().err
    assert not (page.parent / "figures").exists()
