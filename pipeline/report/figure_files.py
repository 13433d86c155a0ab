"""Figures of a page as files of their own: SVG that needs no style sheet."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from pipeline.config.messages import ConfigError, did_you_mean, one_of
from pipeline.files.atomic import write_text

_FIGURE = re.compile(r'<figure id="figure-([\w-]+)".*?</figure>', re.DOTALL)
_PANEL = re.compile(r'<svg class="panel"(.*?)>(.*?)</svg>', re.DOTALL)
_COLORS = re.compile(r"(?s)^\s*:root \{(.*?)\}", re.MULTILINE)
_COLOR = re.compile(r"--(\w+): (#[0-9a-f]{3,8});")


def figures_of(page: str) -> dict[str, list[str]]:
    """SVG of each panel of each figure of a page, by the figure's name, colors put in.

    The first set of colors of the page's style sheet is taken, that of the light page; the
    background is its paper.
    """
    found = _COLORS.search(page)
    colors = dict(_COLOR.findall(found[1])) if found else {}
    paper = f'<rect width="100%" height="100%" fill="{colors.get("paper", "#fff")}"/>'

    def alone(attributes: str, content: str) -> str:
        text = f"<svg{attributes}>\n{paper}{content}</svg>\n"
        return re.sub(r"var\(--(\w+)\)", lambda name: colors.get(name[1], "#000"), text)

    return {
        figure[1]: [alone(*panel) for panel in _PANEL.findall(figure[0])]
        for figure in _FIGURE.finditer(page)
    }


def write_figures(page: Path, into: Path, only: Sequence[str] | None = None) -> list[Path]:
    """Write the figures of the file ``page`` into a folder; those named ``only``, if given.

    FIGURE.svg, or FIGURE_1.svg, FIGURE_2.svg, ... where it has several panels.

    Raises
    ------
    ConfigError
        Where there is no such page, no figure in it, or none of a name.
    """
    if not page.is_file():
        beside = sorted(path.name for path in page.parent.glob("*.html"))
        hint = did_you_mean(page.name, beside, "beside it:")
        raise ConfigError([(page, f"no such file{hint}")])
    figures = figures_of(page.read_text("utf-8"))
    if not figures:
        raise ConfigError([(page, "holds no figure; expected a report's page")])
    wrong = [name for name in only or () if name not in figures]
    if wrong:
        known = list(figures)
        raise ConfigError((page, f"--only {name}: {one_of(name, known)}") for name in wrong)
    written = []
    for name, panels in figures.items():
        for place, text in enumerate(panels, start=1) if only is None or name in only else ():
            written.append(into / (f"{name}.svg" if len(panels) == 1 else f"{name}_{place}.svg"))
            write_text(written[-1], text)
    return written
