"""The pages in a browser, where one is installed."""

import re
import shutil
import subprocess

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDTHS = (420, 1280)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
@pytest.mark.parametrize("name", ["static", "draw", "regions", "study", "comparison", "pillars"])
def test_no_page_is_wider_than_its_window(request, tmp_path, name):
    html = request.getfixturevalue(name).html
    report = "<script>parent.postMessage([innerWidth, document.documentElement.scrollWidth], '*')"
    (tmp_path / "page.html").write_text(html.replace("</body>", f"{report}</script></body>"))
    frames = "".join(f"<iframe src=page.html width={w} height=900></iframe>" for w in WIDTHS)
    listen = "onmessage = e => document.title += ' ' + e.data[0] + '/' + e.data[1]"
    (tmp_path / "frames.html").write_text(f"<title></title><script>{listen}</script>{frames}")
    found = subprocess.run(
        [
            CHROMIUM,
            *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            f"--user-data-dir={tmp_path / 'profile'}",
            "--window-size=1800,1000",
            "--virtual-time-budget=5000",
            "--dump-dom",
            (tmp_path / "frames.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stdout
    title = found.split("<script")[0]
    sizes = [tuple(map(int, pair)) for pair in re.findall(r"(\d+)/(\d+)", title)]
    assert sorted(window for window, _ in sizes) == list(WIDTHS)
    assert all(page <= window for window, page in sizes)
