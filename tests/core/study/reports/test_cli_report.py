"""``fopid report`` and ``fopid repair`` keep the contract of the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from rosbags.rosbag2 import Reader, StoragePlugin

from fopid_core.study.bags.bag import read_bag

from ...cli.runner import invoke
from ..recording import EXPERIMENT, Recording, record_loop


def fopid(*arguments: object) -> Result:
    return invoke([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "bag"
    recording = Recording(folder, StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.set_custom_data("experiment", EXPERIMENT)
    recording.writer.close()
    return folder


def test_report_writes_page_and_picture_into_the_bags_folder_and_shows_the_table(bag: Path) -> None:
    done = fopid("report", bag)
    assert done.exit_code == 0, done.output
    assert (bag / "report.html").stat().st_size > 1_000_000
    assert (bag / "report.png").exists()
    for words in ("disturbance", "ITAE", "overshoot"):
        assert words in " ".join(done.stdout.split())


@pytest.mark.slow
def test_report_as_json_is_one_object_with_every_segment(bag: Path, tmp_path: Path) -> None:
    done = fopid("report", bag, bag, "--out", tmp_path / "two.html", "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    assert answer["report"] == str(tmp_path / "two.html")
    assert Path(answer["image"]).exists()
    first, second = answer["runs"]
    assert first == second
    assert (first["whole"], [segment["name"] for segment in first["segments"]]) == (
        True,
        ["starting gains", "tuned by frequency", "load disturbance", "tuned in the time domain"],
    )
    assert first["segments"][2]["overshoot_pct"] is None
    assert first["segments"][3]["gains"]["mu"] == 1.1


@pytest.mark.slow
def test_report_says_how_many_samples_are_missing(bag: Path, tmp_path: Path) -> None:
    done = fopid("report", bag, "--out", tmp_path / "a.html", "--json")
    assert json.loads(done.stdout)["runs"][0]["samples"] == {
        name: {"expected": 2400, "missing": 0, "first_gap": None, "late": 0}
        for name in ("measurement", "control", "state")
    }
    assert "0 of 2,400 missing" in fopid("report", bag, "--out", tmp_path / "a.html").stdout


@pytest.mark.slow
def test_signals_elsewhere_and_the_process_can_be_named_and_figures_asked_for(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(100):
        recording.write("/oven/heat", 0.1 * k, "std_msgs/msg/Float64", data=1.0)
        recording.write("/oven/warm", 0.1 * k, "sensor_msgs/msg/Temperature", temperature=0.5, variance=9.0)
        recording.write("pid/state", 0.1 * k, "fopid_msgs/msg/FopidState", kp=1.0, ki=0.5, kd=0.0, lam=1.0, mu=1.0)
    recording.writer.close()
    places = ("--topic", "control=/oven/heat", "--topic", "measurement=/oven/warm:temperature", "--namespace", "")
    done = fopid("report", tmp_path / "bag", *places, "--process", "1/(s+1)^3", "--figures", tmp_path / "f", "--json")
    assert done.exit_code == 0, done.output
    (run,) = json.loads(done.stdout)["runs"]
    # sup |S| of (1 + 0.5/s)/(s+1)^3, by a fine grid
    w = 1j * np.logspace(-2, 2, 200_001)
    assert run["segments"][0]["ms"] == pytest.approx(np.max(np.abs(1 / (1 + (1 + 0.5 / w) / (w + 1) ** 3))), rel=1e-6)
    assert {path.name for path in (tmp_path / "f").glob("*bode*")} == {
        f"run1-gains1-bode.{e}" for e in ("png", "svg", "pdf")
    }
    for words in (("--topic", "control"), ("--topic", "speed=/a"), ("--process", "1/(s+1)(s+2)")):
        refused = fopid("report", tmp_path / "bag", *words)
        assert (refused.exit_code, len(refused.stderr.strip().splitlines())) == (2, 1), words


@pytest.mark.parametrize(
    "words",
    [
        (), ("no/such/bag",), (".",), ("BAG", "--namespace", "/nobody"), ("BAG", "--topic", "measurement=/nothing"),
        ("BAG", "--out", "page.png"),
    ],
)  # fmt: skip
def test_bad_input_ends_with_one_line_and_exit_code_2(bag: Path, tmp_path: Path, words, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = fopid("report", *(bag if word == "BAG" else word for word in words))
    assert done.exit_code == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1


def test_repair_gives_a_cut_off_bag_its_index_back(bag: Path, tmp_path: Path) -> None:
    data = (bag / f"{bag.name}.mcap").read_bytes()
    (tmp_path / "bag.mcap").write_bytes(data[: len(data) // 2])
    assert not read_bag(tmp_path).whole
    done = fopid("repair", tmp_path, "--json")
    assert done.exit_code == 0, done.output
    messages = json.loads(done.stdout)["messages"]
    with Reader(tmp_path) as reader:  # by the index, and by what the bag says of itself
        counted = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counted == messages
    run = read_bag(tmp_path)
    assert messages["/measurement"] == run.signals["measurement"].value.size > 0
    assert "cut off" in run.metadata["repaired"]
    assert fopid("repair", tmp_path / "nowhere").exit_code == 2
