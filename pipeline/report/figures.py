"""Panels: small matplotlib figures as inline SVG, in the colors of the page's theme.

A panel records what it draws in the page's `Data`. Its colors are the theme's variables, so that
the same figure reads on a light and on a dark page; text stays text.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, StringIO

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import to_hex
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Rectangle
from PIL import Image

from pipeline.report.page import Data

# Stand-ins that matplotlib draws with; each becomes a variable of style.css.
INK, MUTED, RULE = "#010101", "#010102", "#010103"
BLUE, ORANGE, GREEN, PURPLE = "#010111", "#010112", "#010113", "#010114"
_VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    RULE: "rule",
    BLUE: "blue",
    ORANGE: "orange",
    GREEN: "green",
    PURPLE: "purple",
}
DASHES = {"solid": "", "dashed": "5 3", "dotted": "1.5 2.5", "dashdot": "6 2 1.5 2"}
STRESS_COLORS, SPREAD_COLORS, SHARE_COLORS = "viridis", "cividis", "cividis"
DIFFERENCE_COLORS = "RdBu_r"  # from the negative to the positive of a scale about 0
PIXELS_PER_INCH = 96
MOST_PIXELS = 20_000  # an image with more cells is shown in block means
PALETTE = 255  # colors of a scale; one more is for blank cells
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "panel",
    "font.family": ["DejaVu Sans"],
    "font.size": 8.5,
    "text.color": INK,
    "text.parse_math": False,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 6),
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "figure.facecolor": "none",
    "lines.linewidth": 1.6,
    "image.interpolation": "none",
    "image.composite_image": False,
}


@contextmanager
def panel_style() -> Iterator[None]:
    """Within it panels have the page's style, whatever matplotlib is set to elsewhere."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


class Panel:
    """One set of axes.

    Parameters
    ----------
    data, figure : where and under which name its data are recorded
    title : what tells it from the other panels of the figure; also in the recorded data
    x, y : names of the axes with units. x is what the data are given over
    alt : what a reader who cannot see it should know
    size : of the axes, inches
    upright : draw x on the vertical axis, increasing downwards (a depth)
    bar : leave room for a color bar
    left : margin for the labels of the vertical axis, inches

    What is drawn with a `frame` shows one reading of a draw: on the page a slider chooses the
    frame, and the last one stands there without it. `notes` has a line of words for each frame.
    """

    LEFT, RIGHT, BOTTOM, TOP = 0.66, 0.2, 0.52, 0.14  # margins, inches
    BAR = 0.96  # right margin with a color bar and its labels

    def __init__(
        self,
        data: Data,
        figure: str,
        title: str,
        x: str,
        y: str,
        alt: str,
        size: tuple[float, float] = (3.4, 2.3),
        upright: bool = False,
        bar: bool = False,
        left: float = LEFT,
    ):
        self.title, self.alt = title, alt
        self.legend: dict[str, Markup] = {}
        self.notes: list[str] = []
        self._data, self._figure, self._x, self._y = data, figure, x, y
        self._upright = upright
        right = self.BAR if bar else self.RIGHT
        self._width, self._height = left + size[0] + right, self.BOTTOM + size[1] + self.TOP
        self._left, self._size = left, size
        self._mpl = MplFigure(figsize=(self._width, self._height))
        FigureCanvasSVG(self._mpl)
        self.axes = self._mpl.add_axes(self._box(left, size[0]))
        self.axes.set(xlabel=y if upright else x, ylabel=x if upright else y)
        self.axes.locator_params(axis="x", nbins=max(1, int(size[0] / 0.42)), min_n_ticks=1)
        self.axes.locator_params(axis="y", nbins=max(2, int(size[1] / 0.36)))
        if upright:
            self.axes.invert_yaxis()

    @classmethod
    def of_rows(cls, data: Data, figure: str, title: str, x: str, alt: str, names) -> Panel:
        """A panel with a row for each name, the first on top, for `dots` and `bars`."""
        names = list(names)
        size = (2.5, 0.3 + 0.27 * len(names))
        left = max(cls.LEFT, 0.3 + 0.07 * max(map(len, names)))
        panel = cls(data, figure, title, x, "", alt, size, left=left)
        panel._rows = names
        panel.axes.set_yticks(range(len(names)), names)
        panel.axes.set_ylim(len(names) - 0.5, -0.5)
        return panel

    def _box(self, left: float, width: float) -> tuple[float, float, float, float]:
        w, h = self._width, self._height
        return left / w, self.BOTTOM / h, width / w, self._size[1] / h

    def curve(self, label, x, y, low=None, high=None, color=BLUE, dash="solid", band="") -> None:
        """A line and, with `low` and `high`, a band that the legend calls `band`."""
        self._data.add(self._figure, self.title, label, self._x, x, self._y, y, low, high)
        style = {"color": color, "linestyle": (0, _dashes(dash)) if DASHES[dash] else "solid"}
        self.axes.plot(*self._turned(x, y), **style)
        stroke = f'stroke="var(--{_VARIABLES[color]})" stroke-width="2"'
        if DASHES[dash]:
            stroke += f' stroke-dasharray="{DASHES[dash]}"'
        self.legend[label] = _swatch(f'<path d="M0 6H26" {stroke}/>')
        if low is not None:
            fill = self.axes.fill_betweenx if self._upright else self.axes.fill_between
            fill(x, low, high, color=color, alpha=0.22, linewidth=0)
            self.legend[band] = _band_swatch(color)

    def points(self, label, x, y, low=None, high=None, color=INK, marker="o", filled=True) -> None:
        """Markers, with error bars from `low` to `high`."""
        self._data.add(self._figure, self.title, label, self._x, x, self._y, y, low, high)
        y = np.asarray(y, dtype=np.float64)
        error = None if low is None else np.abs(np.array([y - low, high - y], dtype=np.float64))
        self.axes.errorbar(
            *self._turned(x, y),
            **{"xerr" if self._upright else "yerr": error},
            fmt=marker,
            color=color,
            markersize=4.5,
            markerfacecolor=color if filled else "none",
            elinewidth=1,
            zorder=3,
        )
        self.legend[label] = _marker_swatch(color, marker, filled)

    def dots(self, label, x, names, color=INK, marker="o", filled=True, offset=0.0) -> None:
        """Markers at `x` in the row of each name, `offset` of a row below its middle."""
        for name, value in zip(names, x, strict=True):
            self._data.add(self._figure, name, label, "", None, self._x, [value])
        self.axes.plot(
            x,
            [self._rows.index(name) + offset for name in names],
            marker,
            color=color,
            markersize=5,
            markerfacecolor=color if filled else "none",
        )
        self.legend[label] = _marker_swatch(color, marker, filled)

    def bars(self, label, x, names, color=BLUE, start=0.0) -> None:
        """Bars of length `x` from `start` in the row of each name."""
        for name, value in zip(names, x, strict=True):
            self._data.add(self._figure, name, label, "", None, self._x, [value])
        rows = [self._rows.index(name) for name in names]
        self.axes.barh(rows, x, 0.62, start, color=color)
        self.legend[label] = _swatch(
            f'<rect x="3" y="2" width="20" height="8" fill="var(--{_VARIABLES[color]})"/>'
        )

    def shaded_points(
        self, label, x, y, shade, name, low, high, marker="o", error=None, colors=STRESS_COLORS
    ) -> None:
        """Markers filled by `shade` on the scale from `low` to `high`, hollow where it is NaN.

        `name` is the scale's name, `error` (2, point) the lengths of error bars below and above.
        """
        ends = [None, None] if error is None else [y - error[0], y + error[1]]
        self._data.add(self._figure, self.title, label, self._x, x, self._y, y, *ends)
        self._data.add(self._figure, self.title, label, self._x, x, name, shade)
        if error is not None:
            self.axes.errorbar(x, y, error, fmt="none", ecolor=MUTED, elinewidth=1)
        colormap = matplotlib.colormaps[colors]
        for at, value, s in zip(x, y, shade, strict=True):
            fill = colormap((s - low) / (high - low)) if np.isfinite(s) else "none"
            style = {"markeredgecolor": INK, "markerfacecolor": fill, "markersize": 6.5}
            self.axes.plot([at], [value], marker, markeredgewidth=0.8, **style)
        self.legend[label] = _marker_swatch(INK, marker, False)

    def reference(self, label, x=None, y=None, color=MUTED, dash="dashed") -> None:
        """A line across the axes at `x` or at `y`."""
        self._data.add(
            self._figure, self.title, label, self._x, None if x is None else [x], self._y, [y]
        )
        line = self.axes.axhline if (x is None) != self._upright else self.axes.axvline
        line(y if x is None else x, color=color, linewidth=1.1, linestyle=(0, _dashes(dash)))
        stroke = f'stroke="var(--{_VARIABLES[color]})" stroke-dasharray="{DASHES[dash]}"'
        path = "M0 6H26" if (x is None) != self._upright else "M13 0V12"
        self.legend[label] = _swatch(f'<path d="{path}" {stroke} stroke-width="1.5"/>')

    def span(self, label, low, high, color=MUTED) -> None:
        """A shaded range of the horizontal axis."""
        self._data.add(self._figure, self.title, label, self._x, [low, high], "", [np.nan] * 2)
        self.axes.axvspan(low, high, color=color, alpha=0.14, linewidth=0)
        self.legend[label] = _band_swatch(color)

    def classes(self, x, y, values, name, labels, colors=SPREAD_COLORS) -> None:
        """Cells (y, x) in the color of their class, its place among `labels`; NaN stays blank.

        The legend names the classes that occur. Where cells are too many, some stand for all.
        """
        step = _block(values)
        shown = slice(step // 2, None, step)
        x, y, values = x[shown], y[shown], values[shown, shown]
        high = max(len(labels) - 1, 1)
        self.image(x, y, values, name, 0, high, colors, bar=False)
        for place in np.unique(values[np.isfinite(values)]).astype(int):
            color = to_hex(matplotlib.colormaps[colors](place / high))
            self.legend[labels[place]] = _swatch(
                f'<rect x="1" y="1" width="24" height="10" fill="{color}" stroke="var(--muted)"/>'
            )

    def image(
        self, x, y, values, name, low, high, colors=STRESS_COLORS, stored="", frame=None, bar=True
    ) -> None:
        """Cells (y, x) in color, at centers `x` and `y`; NaN stays blank. A `bar` has the scale.

        `stored` says which file, variable and indices hold the cells: the data then have their
        range in place of each.
        """
        known = np.asarray(values)[np.isfinite(values)]
        x, y, values = block_means(x, y, values)
        if stored:
            ends = [known.min(), known.max()] if known.size else [np.nan, np.nan]
            self._data.add(
                self._figure,
                self.title,
                stored,
                self._x,
                None,
                name,
                [np.nan],
                *([end] for end in ends),
            )
        else:
            for height, row in zip(y, values, strict=True):
                series = f"{self._y.split(' (')[0]} = {height:.6g} m"
                self._data.add(self._figure, self.title, series, self._x, x, name, np.round(row, 7))
        colormap = matplotlib.colormaps[colors].resampled(PALETTE)
        x0, x1 = _ends(x)
        y0, y1 = _ends(y)
        shown = self.axes.imshow(
            np.asarray(values, dtype=np.float64),
            origin="lower",
            extent=(x0, x1, y0, y1),
            aspect="auto",
            vmin=low,
            vmax=high,
            cmap=colormap.with_extremes(bad=(0, 0, 0, 0)),
        )
        _mark(shown, frame)
        self.axes.grid(False)
        if bar and not frame:
            self.color_bar(name, low, high, colors)

    def cursor(self, x) -> None:
        """An upright line in each frame, at `x` of the horizontal axis."""
        for frame, at in enumerate(x):
            _mark(self.axes.axvline(at, color=INK, linewidth=1.3), frame)

    def shaded_areas(self, areas, values, name, low, high, colors=STRESS_COLORS) -> None:
        """Rectangles of a plan filled by `values` on the scale from `low` to `high`, `name`.

        `areas` are (name, x, y, width, length), m; NaN stays blank. A color bar stands beside.
        """
        colormap, span = matplotlib.colormaps[colors], (high - low) or 1.0
        for (area, x, y, width, length), value in zip(areas, values, strict=True):
            self._data.add(self._figure, self.title, area, self._x, [x], name, [value])
            fill = colormap((value - low) / span) if np.isfinite(value) else "none"
            self.axes.add_patch(
                Rectangle((x - width / 2, y - length / 2), width, length, facecolor=fill)
            )
        self.axes.grid(False)
        self.color_bar(name, low, high, colors)

    def outlined_areas(self, label, areas, dash="solid") -> None:
        """Outlines of the rectangles of a plan, (name, x, y, width, length) in m.

        White on black, so that they stand out on every color of an image and on either page.
        """
        for area, x, y, width, length in areas:
            self._data.add(self._figure, self.title, label, self._x, [x], f"y of {area} (m)", [y])
            corner = (x - width / 2, y - length / 2)
            for color, thick, dashes in (("black", 1.8, "solid"), ("white", 0.8, dash)):
                line = (0, _dashes(dashes)) if DASHES[dashes] else "solid"
                style = {"edgecolor": color, "linewidth": thick, "linestyle": line}
                self.axes.add_patch(Rectangle(corner, width, length, fill=False, **style))
        square = '<rect x="8" y="1" width="10" height="10" stroke="{}" stroke-width="{}"{}/>'
        dashed = f' stroke-dasharray="{DASHES[dash]}"' if DASHES[dash] else ""
        self.legend[label] = _swatch(
            square.format("black", 3, "") + square.format("white", 1.3, dashed)
        )

    def color_bar(self, name, low, high, colors=STRESS_COLORS) -> None:
        """The scale of an image or of shaded points, at the right."""
        bar = self._mpl.add_axes(self._box(self._left + self._size[0] + 0.12, 0.11))
        bar.imshow(
            np.linspace(0, 1, 128)[:, None],
            origin="lower",
            extent=(0, 1, low, high),
            aspect="auto",
            cmap=matplotlib.colormaps[colors],
        )
        bar.grid(False)
        bar.spines[:].set_visible(False)
        bar.set_xticks([])
        bar.yaxis.tick_right()
        bar.yaxis.set_label_position("right")
        bar.set_ylabel(name)

    def outline(self, label, x, y, values, level, frame=None) -> None:
        """The contour of `values` (y, x) at `level`, over an image."""
        x, y, values = block_means(x, y, values)
        if min(values.shape) < 2 or not np.nanmin(values) < level < np.nanmax(values):
            return
        for color, width in (("black", 2.2), ("white", 1.1)):
            _mark(self.axes.contour(x, y, values, [level], colors=color, linewidths=width), frame)
        self.legend[label] = _swatch(
            '<path d="M0 6H26" stroke="black" stroke-width="4"/>'
            '<path d="M0 6H26" stroke="white" stroke-width="2"/>'
        )

    def base_marks(self, label, areas, color, place) -> None:
        """The extent along x of drawpoints or load cells, as bars in row `place` under the base."""
        height = self.axes.get_ylim()[1]
        level = -0.025 * height * (1 + 2 * place)
        for area in areas:
            ends = [area.x - area.width / 2, area.x + area.width / 2]
            self._data.add(
                self._figure, self.title, f"{label} {area.name}", self._x, ends, self._y, [0, 0]
            )
            self.axes.plot(ends, [level] * 2, color=color, linewidth=3.2, solid_capstyle="butt")
        self.axes.set_ylim(min(self.axes.get_ylim()[0], level - 0.03 * height), height)
        self.legend[label] = _swatch(
            f'<path d="M0 6H26" stroke="var(--{_VARIABLES[color]})" stroke-width="4"/>'
        )

    def _turned(self, x, y):
        return (y, x) if self._upright else (x, y)

    @property
    def svg(self) -> Markup:
        """The panel as inline SVG that scales with the page."""
        text = StringIO()
        self._mpl.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
        svg = text.getvalue()
        svg = svg[svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", svg, flags=re.DOTALL)
        svg = re.sub(r"(?<=data:image/png;base64,)[^\"]+", _with_palette, svg)
        frames = [int(n) for n in re.findall(r' id="frame-(\d+)"', svg)]
        svg = re.sub(
            r' id="frame-(\d+)"',
            lambda m: f' data-frame="{m[1]}"' + ' hidden=""' * (int(m[1]) < max(frames)),
            svg,
        )
        name = re.sub(r"\W+", "-", f"{self._figure}-{self.title}")
        svg = re.sub(
            r' id="(?:figure|axes|patch|line2d|text|matplotlib|xtick|ytick|'
            r'[A-Za-z]*Collection)[\w.]*"',
            "",
            svg,
        )
        svg = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{name}-", svg)
        for color, variable in _VARIABLES.items():
            svg = svg.replace(color, f"var(--{variable})")
        svg = re.sub(r"\n\s*", "\n", svg).replace("'DejaVu Sans'", "sans-serif")
        width = round(self._width * PIXELS_PER_INCH)
        view_box = re.search(r'viewBox="[^"]*"', svg).group()
        opening = (
            f'<svg class="panel" role="img" aria-label="{escape(self.alt)}" {view_box} '
            f'width="{width}" xmlns="http://www.w3.org/2000/svg" '
            'xmlns:xlink="http://www.w3.org/1999/xlink">'
        )
        return Markup(re.sub(r"<svg[^>]*>", lambda _: opening, svg, count=1))


def _mark(artist, frame: int | None) -> None:
    if frame is not None:
        artist.set_gid(f"frame-{frame}")


def _with_palette(encoded: re.Match) -> str:
    """A PNG in base64 with a palette, where it has few enough colors: a third of its size."""
    pixels = np.asarray(Image.open(BytesIO(base64.b64decode(encoded[0]))).convert("RGBA"))
    colors, index = np.unique(pixels.reshape(-1, 4), axis=0, return_inverse=True)
    if len(colors) > PALETTE + 1:
        return encoded[0]
    image = Image.fromarray(index.reshape(pixels.shape[:2]).astype(np.uint8), "P")
    image.putpalette(colors[:, :3].tobytes())
    out = BytesIO()
    image.save(out, "PNG", optimize=True, transparency=colors[:, 3].tobytes())
    return base64.b64encode(out.getvalue()).decode()


def section_size(width: float, height: float, largest=(2.9, 2.5)) -> tuple[float, float]:
    """Axes in inches for a section of these extents, at equal scales where it stays readable."""
    scale = min(largest[0] / width, largest[1] / height)
    return max(width * scale, 0.75), max(height * scale, 0.9)


def _block(values) -> int:
    """Side, in cells, of the blocks in which a field with too many cells is shown."""
    return int(np.ceil(np.sqrt(np.size(values) / MOST_PIXELS)))


def block_means(x, y, values):
    """A field (y, x) with centers, in means over square blocks where it has too many cells."""
    values = np.asarray(values, dtype=np.float64)
    block = _block(values)
    if block <= 1:
        return np.asarray(x), np.asarray(y), values
    ny, nx = (-(-n // block) for n in values.shape)
    padded = np.full((ny * block, nx * block), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(ny, block, nx, block)
    filled = np.isfinite(blocks)
    count = filled.sum(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        means = np.where(filled, blocks, 0.0).sum(axis=(1, 3)) / count
    step_x, step_y = x[1] - x[0], y[1] - y[0]
    return (
        x[0] + step_x * (block * np.arange(nx) + (block - 1) / 2),
        y[0] + step_y * (block * np.arange(ny) + (block - 1) / 2),
        means,
    )


def _ends(centers) -> tuple[float, float]:
    half = 0.5 * (centers[1] - centers[0]) if len(centers) > 1 else centers[0]
    return centers[0] - half, centers[-1] + half


def _dashes(name: str) -> list[float]:
    return [float(length) for length in DASHES[name].split()]


def _swatch(shapes: str) -> Markup:
    return Markup(
        f'<svg class="swatch" width="26" height="12" aria-hidden="true" fill="none">{shapes}</svg>'
    )


def _band_swatch(color: str) -> Markup:
    return _swatch(
        f'<rect width="26" height="12" fill="var(--{_VARIABLES[color]})" opacity="0.25"/>'
    )


MARKERS = {  # matplotlib's name: the same shape in a swatch
    "o": '<circle cx="13" cy="6" r="4" {}/>',
    "s": '<path d="M9 2h8v8h-8z" {}/>',
    "D": '<path d="M13 1l5 5l-5 5l-5-5z" {}/>',
    "^": '<path d="M13 1l5 10h-10z" {}/>',
    "v": '<path d="M13 11l5-10h-10z" {}/>',
    "<": '<path d="M8 6l10-5v10z" {}/>',
    ">": '<path d="M18 6l-10-5v10z" {}/>',
    "P": '<path d="M11.5 1h3v3.5h3.5v3h-3.5v3.5h-3v-3.5h-3.5v-3h3.5z" {}/>',
}


def _marker_swatch(color: str, marker: str, filled: bool) -> Markup:
    theme = f"var(--{_VARIABLES[color]})"
    paint = f'stroke="{theme}" stroke-width="1.5" fill="{theme if filled else "none"}"'
    return _swatch(MARKERS[marker].format(paint))
