"""``fopid report`` and ``fopid repair`` keep the contract of the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from rosbags.rosbag2 import StoragePlugin

from fopid_core.cli import main
from fopid_core.study.bag import read_bag

from .recording import EXPERIMENT, Recording, record_loop


def fopid(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


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
        ["starting gains", "tuned by frequency", "load disturbance", "tuned in time"],
    )
    assert first["segments"][2]["overshoot_pct"] is None
    assert first["segments"][3]["gains"]["mu"] == 1.1


@pytest.mark.parametrize("words", [(), ("no/such/bag",), (".",), ("BAG", "--namespace", "/nobody")])
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
    run = read_bag(tmp_path)
    assert run.whole
    assert messages["/measurement"] == run.signals["measurement"].value.size > 0
    assert fopid("repair", tmp_path / "nowhere").exit_code == 2
