"""A page in headless Chromium, looked at from outside by a frame around it."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WITHOUT_BROWSER = "no Chromium or Chrome on this machine"
NEEDS_BROWSER = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None and "FOPID_NEED_BROWSER" not in os.environ, reason=WITHOUT_BROWSER),
]

WATCHER = """<!DOCTYPE html><body style="margin:0">
<iframe id="page" src="{page}" style="border:0; width:{width}px; height:3000px"></iframe>
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
    legend: Array.from(plot.querySelectorAll(".legendtext"), (text) => text.textContent),
    width: plot.querySelector(".main-svg").getBoundingClientRect().width,
    place: plot.getBoundingClientRect().width,
  }}));
  seen.scrolled = Array.from(page.querySelectorAll(".scroll"), (box) => box.scrollWidth - box.clientWidth);
  seen.spilt = Array.from(page.querySelectorAll(".under div"), (text) =>
    text.getBoundingClientRect().width - text.closest(".scroll").clientWidth);
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


def open_in_browser(folder: Path, width: int, *more: str, page: str = "report.html") -> tuple[dict, list[str]]:
    """What the page came to, and what the browser's console said."""
    assert BROWSER, WITHOUT_BROWSER
    (folder / "watcher.html").write_text(WATCHER.format(width=width, page=page))
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
