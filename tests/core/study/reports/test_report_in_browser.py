"""The report in a real browser: everything is drawn, nothing is complained about, nothing is fetched."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from fopid_core.study.bags.bag import read_bag
from fopid_core.study.reports.report import write_report

from ..browser import NEEDS_BROWSER, open_in_browser
from ..recording import EXPERIMENT, Recording, record_loop

pytestmark = NEEDS_BROWSER


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    recording = Recording(folder / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.set_custom_data("experiment", EXPERIMENT)
    recording.writer.close()
    write_report([read_bag(folder / "bag")], folder / "report.html")
    return folder


@pytest.mark.parametrize("width", [1280, 400])
def test_everything_is_drawn_within_the_page_without_complaint_or_request(folder: Path, width: int) -> None:
    seen, console = open_in_browser(folder, width)
    assert console == []
    assert seen["fetched"] == []
    assert seen["width"] <= width
    signals, *others = seen["plots"]
    # setpoint, measurement, control and where it is at a limit, disturbance; three panels and the time
    assert (signals["curves"], signals["titles"]) == (5, 4)
    assert len(others) == 14
    assert all(plot["curves"] >= 1 and plot["titles"] >= 2 for plot in others)
    assert all(plot["width"] == pytest.approx(plot["place"], abs=1.0) for plot in seen["plots"])
    assert seen["ink"] == "rgb(28, 33, 38)"
    label = "2 tuned by frequency" if width > 520 else "2"
    assert label in seen["phases"]
    assert "frequency" in seen["phases"]  # the retuning
    assert all(name in seen["hover"] for name in ("setpoint", "measurement", "control"))


def test_a_comparison_of_two_runs_fits_a_narrow_page(folder: Path, tmp_path: Path) -> None:
    run = read_bag(folder / "bag")
    write_report([run, run], tmp_path / "report.html")
    seen, console = open_in_browser(tmp_path, 400)
    assert console == []
    assert seen["width"] <= 400
    assert seen["plots"][0]["curves"] == 1 + 2 * 2  # the setpoint, and two signals of each run


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
