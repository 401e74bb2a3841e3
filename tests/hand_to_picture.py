"""From a slider's move to the picture, in a browser: ``python -m tests.hand_to_picture`` prints figures as JSON.

Each move waits for the picture before, as a hand does that follows what it sees. The baseline is a move after which
nothing is asked for and nothing drawn: what the browser itself takes to its next frame.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from fopid_ros.benchmarks.cpu import cpu_seconds

from .chromium import CHROMIUM, Browser, Page

PROCESSES = {"1/(s+1)^3": "without delay", "2/(s+1)*exp(-0.5s)": "with delay"}
MOVES = 40
MOVE = """(async (places) => {
  const slider = document.querySelector("#kp"), times = [], name = "hand to picture";
  for (const place of places) {
    performance.clearMeasures(name);
    slider.value = place;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    const begun = performance.now();
    while (performance.getEntriesByName(name).length === 0 && performance.now() - begun < 5000) {
      await new Promise((resolve) => setTimeout(resolve, 2));
    }
    times.push(performance.getEntriesByName(name)[0]?.duration ?? 5000);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  return times;
})"""
EMPTY = """(async (moves) => {
  const times = [];
  for (let move = 0; move < moves; move++) {
    const begun = performance.now();
    await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
    times.push(performance.now() - begun);
  }
  return times;
})"""


def measured(browser: Browser, process: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Times [ms] from hand to picture, and of the browser alone; the server's processor time for a move [ms]."""
    command = [Path(sys.executable).with_name("fopid"), "explore", process, "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            page: Page = browser.open(re.search(r"http://\S+", server.stdout.readline())[0])
            page.until("document.querySelectorAll('#front circle').length >= 12", "the page at rest", 120.0)
            before = cpu_seconds(server.pid)
            times = page.run(f"{MOVE}({np.linspace(450, 700, MOVES).round().tolist()})")
            used = cpu_seconds(server.pid) - before
            alone = page.run(f"{EMPTY}({MOVES})")
            page.close()
        finally:
            server.terminate()
    return np.array(times[5:]), np.array(alone), 1e3 * used / MOVES


def figures() -> list[dict[str, str]]:
    """The rows of the performance table; none where there is no browser."""
    if CHROMIUM is None:
        return []
    rows = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(Path(folder, "profile"))
        try:
            for process, how in PROCESSES.items():
                times, alone, server = measured(browser, process)
                half, most, frame = np.median(times), np.quantile(times, 0.9), np.median(alone)
                rows.append({
                    "figure": f"from a slider's move to the picture, in Chromium, {how}: half below / 90 % below",
                    "value": f"{half:.0f} ms / {most:.0f} ms; {server:.0f} ms of the server's processor",
                    "baseline": f"a frame of the browser alone: {frame:.0f} ms",
                    "ratio": f"{half / frame:.2g}",
                })  # fmt: skip
        finally:
            browser.close()
    return rows


if __name__ == "__main__":
    print(json.dumps({"figures": figures()}))
