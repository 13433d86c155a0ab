"""The slider of a draw's page: a frame for each reading, in each of its panels."""

import base64
import json
import re
from io import BytesIO
from types import SimpleNamespace
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
import xarray as xr
from PIL import Image

from pipeline.report.draw_player import FEWEST_FRAMES, MOST_CELLS, MOST_FRAMES, shown_times
from pipeline.report.figures import PALETTE, STRESS_COLORS

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"


@pytest.fixture(params=["draw", "pillars"])
def made(request):
    return request.getfixturevalue(request.param)


def player(html: str) -> str:
    return html.split('<section class="player"')[1].split("</section>")[0]


def panels(html: str) -> dict[str, ElementTree.Element]:
    """Panels of the player by their titles."""
    boxes = re.findall(r'<div class="panel-box">.*?</svg>', player(html), re.DOTALL)
    return {
        re.search(r'class="panel-title">([^<]*)', box)[1]: ElementTree.fromstring(
            box[box.index("<svg") :]
        )
        for box in boxes
    }


def fields(made):
    with xr.open_dataset(made.inputs["fields"], decode_times=False) as dataset:
        return dataset.load()


def test_every_panel_has_a_frame_for_every_reading_and_shows_the_last(made):
    count = fields(made).sizes["time"]
    boxes = re.findall(r'<div class="panel-box">.*?</div>', player(made.html), re.DOTALL)
    assert len(boxes) == 2 + min(len(made.experiment.load_cells), 7)
    for box in boxes:
        parts = re.findall(r'data-frame="(\d+)"( hidden)?', box)
        assert {int(frame) for frame, _ in parts} == set(range(count))
        assert all(bool(hidden) == (int(frame) < count - 1) for frame, hidden in parts)


def test_the_slider_says_each_reading_in_words(made):
    slider = re.search(r"<input [^>]*>", player(made.html))[0]
    words = json.loads(re.search(r'data-frames="([^"]*)"', slider)[1].replace("&#34;", '"'))
    mass = fields(made)["mass_drawn"].values
    assert words[0] == f"reading 1 of {len(mass)}, before draw"
    assert words[1:] == [
        f"reading {t + 1} of {len(mass)}, {mass[t]:.4g} kg drawn" for t in range(1, len(mass))
    ]
    assert f'max="{len(mass) - 1}" value="{len(mass) - 1}"' in slider
    assert f'aria-valuetext="{words[-1]}"' in slider
    assert '<label for="reading">' in player(made.html)


def test_the_frames_are_the_mean_stress_on_one_scale(draw):
    found = panels(draw.html)
    stress = fields(draw)["vertical_stress_mean"].values
    row = int(re.search(r"time=0, y=(\d+)", "".join(r["series"] for r in draw.rows))[1])
    views = {"Vertical section": stress[:, :, row], "Plan of the base": stress[:, 0]}
    high = max(np.nanmax(view) for view in views.values())
    colors = matplotlib.colormaps[STRESS_COLORS].resampled(PALETTE)
    for title, view in views.items():
        images = [i for i in found[title].iter(f"{SVG}image") if i.get("data-frame")]
        assert [int(image.get("data-frame")) for image in images] == list(range(len(view)))
        for image, values in zip(images, view, strict=True):
            png = base64.b64decode(image.get(HREF).split(",")[1])
            shown = np.asarray(Image.open(BytesIO(png)).convert("RGBA"))
            wanted = colors(values / high, bytes=True)
            known = np.isfinite(values)
            assert shown.shape[:2] == values.shape
            np.testing.assert_array_equal(shown[known], wanted[known])
            assert not shown[~known][:, 3].any()


def test_the_cursor_stands_at_the_mass_drawn(draw):
    mass = fields(draw)["mass_drawn"].values
    svg = panels(draw.html)["Load cell above"]
    lines = [
        float(re.match(r"M ([\d.]+)", path.get("d"))[1])
        for group in svg.iter(f"{SVG}g")
        if group.get("data-frame")
        for path in group.iter(f"{SVG}path")
    ]
    steps = np.diff(lines) / (lines[-1] - lines[0])
    np.testing.assert_allclose(steps, np.diff(mass) / mass[-1], rtol=1e-4)


def test_the_notes_are_the_numbers_of_the_curves(draw):
    box = re.search(r">Load cell above</p>.*?</p>", player(draw.html), re.DOTALL)[0]
    notes = re.findall(r"<span[^>]*>([^<]*)</span>", box)
    rows = [
        row
        for row in draw.rows
        if (row["figure"], row["panel"], row["series"])
        == ("load_cells", "Load cell above", "model, mean")
    ]
    assert notes == [
        f"σᵥ/σᵥ₀ {float(r['y']):.2f}, 5–95 %: {float(r['y_low']):.2f} to {float(r['y_high']):.2f}"
        for r in rows
    ]


def test_the_data_name_the_file_of_the_cells_that_they_leave_out(draw):
    row = next(r for r in draw.rows if r["figure"] == "draw_views" and "z=0" in r["series"])
    name, time = re.match(r"fields.nc: (\w+)\[time=(\d+), z=0\]", row["series"]).groups()
    base = fields(draw)[name].values[int(time), 0]
    ends = float(row["y_low"]), float(row["y_high"])
    np.testing.assert_allclose(ends, [np.nanmin(base), np.nanmax(base)], rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "readings", "frames"),
    [
        ((40, 20, 30), 31, 31),
        ((40, 20, 30), 400, MOST_FRAMES),
        ((150, 80, 100), 61, MOST_CELLS // 23000),
        ((600, 300, 400), 61, FEWEST_FRAMES),
    ],
)
def test_many_readings_of_a_large_lattice_are_thinned(shape, readings, frames):
    sizes = dict(zip("zyx", shape, strict=True))
    results = SimpleNamespace(fields=SimpleNamespace(sizes=sizes), clock=np.arange(readings))
    times = shown_times(results)
    assert len(times) == frames
    assert (times[0], times[-1]) == (0, readings - 1)
    assert max(np.diff(times)) - min(np.diff(times)) <= 1
