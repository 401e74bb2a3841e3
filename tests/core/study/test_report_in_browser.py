"""The report in a real browser: everything is drawn, nothing is complained about, nothing is fetched."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from fopid_core.study.bag import read_bag
from fopid_core.study.report import write_report

from .recording import EXPERIMENT, Recording, record_loop

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on this machine"),
]

WATCHER = """<!DOCTYPE html><body style="margin:0">
<iframe id="page" src="report.html" style="border:0; width:{width}px; height:3000px"></iframe>
<pre id="seen"></pre>
<script>
const frame = document.getElementById("page");
const seen = {{}};
function look() {{
  const page = frame.contentDocument, view = frame.contentWindow;
  if (page.documentElement.dataset.drawn !== "true") return setTimeout(look, 50);
  seen.fetched = view.performance.getEntriesByType("resource").map((entry) => entry.name);
  seen.width = page.documentElement.scrollWidth;
  seen.plots = Array.from(page.querySelectorAll(".plot"), (plot) => ({{
    curves: plot.querySelectorAll(".scatterlayer .trace").length,
    titles: plot.querySelectorAll(".xtitle, .ytitle, .y2title, .y3title").length,
    width: plot.querySelector(".main-svg").getBoundingClientRect().width,
    place: plot.getBoundingClientRect().width,
  }}));
  seen.ink = view.getComputedStyle(page.querySelector(".xtitle")).fill;
  seen.phases = Array.from(page.querySelectorAll(".annotation-text"), (text) => text.textContent);
  const first = page.querySelector(".plot");
  const area = first.querySelector(".nsewdrag"), box = area.getBoundingClientRect();
  const middle = {{ clientX: box.x + box.width / 2, clientY: box.y + box.height / 2, bubbles: true }};
  area.dispatchEvent(new view.MouseEvent("mousemove", middle));
  setTimeout(() => {{
    seen.hover = first.querySelector(".hoverlayer").textContent;
    document.getElementById("seen").textContent = JSON.stringify(seen);
  }}, 500);
}}
frame.addEventListener("load", look);
</script>
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    recording = Recording(folder / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.set_custom_data("experiment", EXPERIMENT)
    recording.writer.close()
    write_report([read_bag(folder / "bag")], folder / "report.html")
    return folder


def open_in_browser(folder: Path, width: int, *more: str) -> tuple[dict, list[str]]:
    """What the page came to, and what the browser's console said."""
    (folder / "watcher.html").write_text(WATCHER.format(width=width))
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-extensions",
        "--disable-background-networking", "--allow-file-access-from-files", f"--user-data-dir={folder / 'profile'}",
        f"--window-size={max(width, 600)},3000", "--virtual-time-budget=20000", "--enable-logging=stderr", *more,
        "--dump-dom", (folder / "watcher.html").as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=True)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    seen = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.DOTALL)[1]
    return json.loads(html.unescape(seen)) if seen else {}, console


@pytest.mark.parametrize("width", [1280, 400])
def test_everything_is_drawn_within_the_page_without_complaint_or_request(folder: Path, width: int) -> None:
    seen, console = open_in_browser(folder, width)
    assert console == []
    assert seen["fetched"] == []
    assert seen["width"] <= width
    signals, *others = seen["plots"]
    assert (signals["curves"], signals["titles"]) == (4, 4)  # setpoint, measurement, control, disturbance; three panels
    assert len(others) == 12
    assert all(plot["curves"] >= 1 and plot["titles"] >= 2 for plot in others)
    assert all(plot["width"] == pytest.approx(plot["place"], abs=1.0) for plot in seen["plots"])
    assert seen["ink"] == "rgb(28, 33, 38)"
    label = "2 tuned by frequency" if width > 520 else "2"
    assert label in seen["phases"]
    assert "frequency" in seen["phases"]  # the retuning
    assert all(name in seen["hover"] for name in ("setpoint", "measurement", "control"))


def test_the_page_is_dark_for_those_who_want_it_dark(folder: Path) -> None:
    seen, console = open_in_browser(folder, 800, "--blink-settings=preferredColorScheme=0")
    assert console == []
    assert seen["ink"] == "rgb(230, 233, 236)"


def test_a_broken_or_talkative_page_would_be_noticed(folder: Path, tmp_path: Path) -> None:
    page = (folder / "report.html").read_text()
    loud = page.replace("</main>", '</main><img src="http://127.0.0.1:9/x.png"><script>console.error("oh")</script>')
    (tmp_path / "report.html").write_text(loud)
    _, console = open_in_browser(tmp_path, 800)
    assert any('"oh"' in line for line in console)
    assert any("Content Security Policy" in line for line in console)
