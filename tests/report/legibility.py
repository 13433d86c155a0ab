"""What can be told of a page without a browser: texts in its panels, colors, names of pictures."""

import re
from dataclasses import dataclass
from itertools import combinations
from xml.etree import ElementTree

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextToPath

TEXTS = ("ink", "muted", "good", "bad", "warn", "link", "blue", "orange", "green", "purple")
GROUNDS = ("paper", "raised")
FONT = "DejaVu Sans"  # wider than what a browser takes


@dataclass(frozen=True)
class Text:
    """A text of a panel and the box that it fills, in the units of the drawing, y downwards."""

    words: str
    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other: "Text") -> bool:
        """Whether the two share more than a touch."""
        wide = min(self.right, other.right) - max(self.left, other.left)
        high = min(self.bottom, other.bottom) - max(self.top, other.top)
        return wide > 1.0 and high > 1.0


def texts(svg: ElementTree.Element) -> list[Text]:
    """Texts of a panel that matplotlib drew."""
    found = []
    for one in svg.iter("{http://www.w3.org/2000/svg}text"):
        style = one.get("style")
        size = float(re.search(r"font-size: ([\d.]+)px", style)[1])
        anchor = re.search(r"text-anchor: (\w+)", style)
        width, height, descent = TextToPath().get_text_width_height_descent(
            one.text, FontProperties(family=FONT, size=size), False
        )
        left = {"start": 0.0, "middle": -width / 2, "end": -width}[anchor[1] if anchor else "start"]
        turn, x, y = map(
            float, re.search(r"rotate\((\S+) (\S+) (\S+)\)", one.get("transform")).groups()
        )
        top, bottom = descent - height, descent
        if turn == -90.0:
            box = x + top, y - left - width, x + bottom, y - left
        else:
            assert turn == 0.0
            box = x + left, y + top, x + left + width, y + bottom
        found.append(Text(one.text, *box))
    return found


def stumbles(html: str) -> list[str]:
    """Texts that overlap or leave the panel in any panel of a page."""
    found = []
    for panel in re.findall(r'<svg class="panel".*?</svg>', html, re.DOTALL):
        svg = ElementTree.fromstring(panel)
        _, _, width, height = map(float, svg.get("viewBox").split())
        boxes = texts(svg)
        name = svg.get("aria-label")
        found += [
            f"{name}: {one.words} is cut off"
            for one in boxes
            if min(one.left, one.top) < -1 or one.right > width + 1 or one.bottom > height + 1
        ]
        found += [
            f"{name}: {one.words} over {other.words}"
            for one, other in combinations(boxes, 2)
            if one.overlaps(other)
        ]
    return found


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colors #rrggbb, as WCAG 2.2 defines it."""
    lights = []
    for color in (one, other):
        parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        lights.append(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])
    return (max(lights) + 0.05) / (min(lights) + 0.05)


def themes(style: str) -> list[dict[str, str]]:
    """Colors by name of each theme of a style sheet."""
    blocks = re.findall(r":root \{([^}]*--paper[^}]*)\}", style)
    return [dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block)) for block in blocks]
