"""The report is one page that needs nothing else, and says what was run."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image
from rosbags.rosbag2 import StoragePlugin

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.reports.parts import controller_text
from fopid_core.study.reports.report import render, write_report

from .. import recording
from ..recording import EXPERIMENT, Recording, record_loop


class Outline(HTMLParser):
    """Elements of a page with their attributes, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag, tag

    def handle_data(self, data) -> None:
        if not self.open or self.open[-1] not in ("script", "style"):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.texts))


def record(folder: Path, experiment: str = EXPERIMENT) -> Path:
    made = Recording(folder, StoragePlugin.MCAP)
    record_loop(made)
    made.writer.set_custom_data("experiment", experiment)
    made.writer.set_custom_data("versions", "fopid_core 1.2.3")
    made.writer.close()
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("runs") / "bag")


@pytest.fixture(scope="module")
def outline(bag: Path) -> Outline:
    return Outline(render([read_bag(bag)]))


def test_the_page_refers_to_nothing_outside_itself(outline: Outline) -> None:
    for tag, attributes in outline.elements:
        for name in ("src", "href", "data", "srcset"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#")), (tag, attributes)
    (policy,) = [a["content"] for t, a in outline.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy  # and the browser holds it to that
    assert "http" not in policy


def test_the_page_is_well_formed(outline: Outline) -> None:
    assert outline.open == []
    ids = [a["id"] for _, a in outline.elements if "id" in a]
    assert len(ids) == len(set(ids))


def test_the_page_says_what_was_run_and_how_it_went(outline: Outline) -> None:
    for words in (
        "demo on P1", "P(s) = 1/(s+1) 3", "120 s", "2,400", "0.05 s", "fopid_core 1.2.3", "control_max: 10.0",
        "starting gains", "tuned by frequency", "load disturbance", "tuned in the time domain",
        "C(s) = 1.27 + 0.532 s −0.982",
        "Ms", "phase margin", "crossover", "delay margin",
    ):  # fmt: skip
        assert words in outline.text, words


def test_each_place_for_a_figure_has_its_figure(outline: Outline, bag: Path) -> None:
    places = [a["data-figure"] for _, a in outline.elements if "data-figure" in a]
    figures = re.search(r'id="figures">(.*?)</script>', render([read_bag(bag)]), re.DOTALL)[1]
    assert (
        len(places) == len(set(places)) == 1 + 1 + 3 * 4 + 1
    )  # signals, steps, four for each of three sets of gains, process
    assert all(f'"{place}":' in figures for place in places)
    assert all(a.get("aria-label") for _, a in outline.elements if "data-figure" in a)


def test_the_picture_is_as_wide_as_a_page_of_a_journal(bag: Path, tmp_path: Path) -> None:
    page, image = write_report([read_bag(bag)], tmp_path / "new" / "report.html")
    assert (page.name, image.name) == ("report.html", "report.png")
    with Image.open(image) as picture:
        assert picture.size == (2148, 1320)  # 7.16 by 4.4 inch at 300 dots per inch
        assert len(picture.convert("RGB").getcolors(maxcolors=2148 * 1320)) > 100


def test_a_loop_that_began_without_gains_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "START", Fopid(kp=0.0))  # |L| is 0, and its logarithm fits no page
    outline = Outline(render([read_bag(record(tmp_path / "bag"))]))
    assert "there is no feedback" in outline.text
    assert "tuned by frequency" in outline.text


def test_texts_from_a_bag_cannot_become_markup(tmp_path: Path) -> None:
    nasty = "name: '</script><script>alert(1)</script>'\nprocess: P1\n"
    page = render([read_bag(record(tmp_path / "<b>bag", nasty))])
    assert "<script>alert" not in page
    assert "<b>bag" not in page
    assert Outline(page).open == []


@pytest.mark.slow
def test_several_runs_stand_side_by_side(bag: Path, tmp_path: Path) -> None:
    second = record(tmp_path / "second")
    outline = Outline(render([read_bag(bag), read_bag(second)]))
    assert "2 runs side by side" in outline.text
    places = [a["data-figure"] for _, a in outline.elements if "data-figure" in a]
    assert len(places) == len(set(places)) == 1 + 2 * 15
    write_report([read_bag(bag), read_bag(second)], tmp_path / "report.html")
    assert (tmp_path / "report.png").stat().st_size > 10_000


def test_what_is_wrong_with_a_recording_is_said(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in (0, 1, 2, 5, 6, 7, 8, 9):
        for topic in ("measurement", "control"):
            value = math.nan if (topic, k) == ("measurement", 8) else 1.0
            header = recording.header(0.1 * k)
            recording.write(topic, 0.1 * k, "fopid_msgs/msg/ScalarStamped", header=header, value=value)
    recording.writer.close()
    text = Outline(render([read_bag(tmp_path / "bag")])).text
    assert "control: 2 of 10 samples lost, the first one at 0.3 s." in text
    assert "measurement: 1 values that are no numbers." in text
    assert "every sample" not in text


def test_a_whole_recording_is_said_to_be_whole_with_its_limits(outline: Outline) -> None:
    assert "recorded every sample" in outline.text
    assert "limits of the control -10 to 10" in outline.text


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_shortest_bags_make_a_report(tmp_path: Path, count: int) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(count):
        for topic in ("setpoint", "measurement", "control"):
            recording.write(topic, 0.1 * k, "std_msgs/msg/Float64", data=float(k))
    recording.writer.close()
    _, image = write_report([read_bag(tmp_path / "bag")], tmp_path / "report.html")
    assert image.exists()


def test_where_the_process_is_not_known_the_page_says_so(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(20):
        recording.write("pid/state", 0.1 * k, "fopid_msgs/msg/FopidState", setpoint=1.0, measurement=0.0, control=0.0,
                        kp=1.0, ki=0.0, kd=0.0, lam=1.0, mu=1.0)  # fmt: skip
    recording.writer.close()
    assert "does not say which process" in Outline(render([read_bag(tmp_path / "bag")])).text


def test_a_bag_of_two_signals_alone_makes_a_report(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(50):
        for topic in ("measurement", "control"):
            recording.write(topic, 0.1 * k, "std_msgs/msg/Float64", data=float(k))
    recording.writer.close()
    page, image = write_report([read_bag(tmp_path / "bag")], tmp_path / "report.html")
    assert image.exists()
    assert "Gains" not in Outline(page.read_text()).text


def test_a_loop_that_is_not_stable_is_said_to_be_so(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(50):
        signals = {"setpoint": 1.0, "measurement": 0.0, "control": 0.0}
        gains = {"kp": 9.0, "ki": 0.0, "kd": 0.0, "lam": 1.0, "mu": 1.0}
        recording.write("pid/state", 0.1 * k, "fopid_msgs/msg/FopidState", **signals, **gains)
    recording.writer.set_custom_data("process", "1/(s+1)^3")
    recording.writer.close()
    assert "not stable: 2 unstable poles" in Outline(render([read_bag(tmp_path / "bag")])).text


def test_a_place_that_cannot_be_written_is_named(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"report '[^']*/file' cannot be written"):
        write_report([read_bag(bag)], tmp_path / "file" / "report.html")
    with pytest.raises(InputError, match=r"report '[^']*/file' cannot be written"):
        write_report([read_bag(bag)], tmp_path / "report.html", figures=tmp_path / "file")
    with pytest.raises(InputError, match="at least one"):
        write_report([], tmp_path / "report.html")


@pytest.mark.parametrize(
    ("controller", "text"),
    [
        (Fopid(0.0), "0"),
        (Fopid(-1.5, 0.25), "− 1.5 + 0.25 s^-1"),
        (Fopid(0.0, 2.0, -0.5, 0.9, 1.1), "2 s^-0.9 − 0.5 s^1.1"),
    ],
)
def test_a_controller_is_written_as_people_write_it(controller: Fopid, text: str) -> None:
    assert controller_text(controller) == text
