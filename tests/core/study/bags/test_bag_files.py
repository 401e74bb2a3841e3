"""A bag opens in every shape that ``ros2 bag record`` gives it, and in those that a kill leaves."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin

from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.bags.mcap_repair import is_whole
from fopid_core.study.bags.repair import repair

from ..recording import Recording, message_types

SCALAR = "fopid_msgs/msg/ScalarStamped"
EPOCH = 1_790_000_000.0


def record(
    folder: Path, storage: StoragePlugin = StoragePlugin.MCAP, first: int = 0, count: int = 200,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:  # fmt: skip
    """Samples 0.1 s apart, measurement = -control = number of the sample, as another recorder writes them."""
    recording = Recording(folder, storage, compression=compression)
    for k in range(first, first + count):
        header = recording.header(0.1 * k)
        recording.write("measurement", 0.1 * k, SCALAR, header=header, value=float(k))
        recording.write("control", 0.1 * k, SCALAR, header=header, value=-float(k))
        if k % 50 == 49 and compression == CompressionMode.NONE:
            recording.end_chunk()
    recording.writer.close()
    return folder


def values(bag: Path) -> list[float]:
    run = read_bag(bag)
    assert np.array_equal(run.signals["control"].value, -run.signals["measurement"].value)
    return run.signals["measurement"].value.tolist()


def expected(count: int, first: int = 0) -> list[float]:
    return [float(k) for k in range(first, first + count)]


def metadata(folder: Path) -> dict:
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


@pytest.fixture(params=list(StoragePlugin), ids=lambda plugin: plugin.name.lower())
def storage(request: pytest.FixtureRequest) -> StoragePlugin:
    return request.param


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE], ids=lambda mode: mode.name.lower())
def test_compressed_files_and_messages_are_read(tmp_path: Path, storage: StoragePlugin, mode: CompressionMode) -> None:
    bag = record(tmp_path / "bag", storage, compression=mode)
    assert [path.suffix for path in bag.iterdir() if "zstd" in path.name] == [".zstd"] * (mode == CompressionMode.FILE)
    assert values(bag) == expected(200)
    (bag / "metadata.yaml").unlink()
    assert values(bag) == expected(200)


@pytest.fixture
def split(tmp_path: Path, storage: StoragePlugin) -> Path:
    """A bag of twelve files with 20 samples each, numbered as rosbag2 does; its metadata names all."""
    folder = tmp_path / "split"
    folder.mkdir()
    for i in range(12):
        part = record(tmp_path / f"part{i}", storage, first=20 * i, count=20)
        (file,) = (path for path in part.iterdir() if path.suffix in (".mcap", ".db3"))
        file.rename(folder / f"split_{i}{file.suffix}")
    described = metadata(part)
    described["relative_file_paths"] = [path.name for path in folder.iterdir()]
    (folder / "metadata.yaml").write_text(yaml.dump({"rosbag2_bagfile_information": described}))
    return folder


def test_all_files_of_a_split_bag_are_read_in_order_with_metadata_or_without(split: Path) -> None:
    assert values(split) == expected(240)
    (split / "metadata.yaml").unlink()
    assert values(split) == expected(240)


def test_a_missing_file_of_a_split_bag_is_named(split: Path) -> None:
    (name,) = (path.name for path in split.glob("split_7.*"))
    (split / name).unlink()
    with pytest.raises(InputError, match=f"lacks its file '{name}'"):
        read_bag(split)


@pytest.mark.parametrize("version", [4, 5, 6, 7, 8, 9, 10])
def test_every_version_of_the_metadata_file_will_do(tmp_path: Path, storage: StoragePlugin, version: int) -> None:
    bag = record(tmp_path / "bag", storage, count=20)
    described = metadata(bag)
    described["version"] = version
    for key, since in (("files", 5), ("custom_data", 6), ("ros_distro", 8)):
        if version < since:
            del described[key]
    for topic in described["topics_with_message_count"]:
        if version < 7:
            del topic["topic_metadata"]["type_description_hash"]
        if version < 9:
            topic["topic_metadata"]["offered_qos_profiles"] = "- history: 3\n  depth: 0\n"
    (bag / "metadata.yaml").write_text(yaml.dump({"rosbag2_bagfile_information": described}))
    assert values(bag) == expected(20)


def test_events_on_a_wall_clock_are_put_where_the_loop_was(tmp_path: Path) -> None:
    """As ``ros2 bag record`` logs a loop in lockstep: by its own clock, here 100 times slower than the loop's."""
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    value = recording.message("rcl_interfaces/msg/ParameterValue", type=3, double_value=5.0)
    change = recording.message("rcl_interfaces/msg/Parameter", name="control_max", value=value)
    for k in range(100):
        wall = EPOCH + 10.0 * k
        for topic in ("measurement", "control"):
            recording.write(topic, wall, SCALAR, header=recording.header(0.1 * k), value=float(k))
        if k == 60:
            event = {"node": "/fopid_controller", "stamp": recording.header(wall + 5.0).stamp}
            recording.write("/parameter_events", wall + 5.0, "rcl_interfaces/msg/ParameterEvent", **event,
                            changed_parameters=[change])  # fmt: skip
    recording.writer.close()
    (found,) = read_bag(tmp_path / "bag").parameters
    assert (found.name, found.value) == ("control_max", 5.0)
    assert found.time == pytest.approx(6.05, abs=1e-6)  # half-way between the samples 60 and 61


def test_signals_may_be_on_topics_of_other_names_and_types(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(3):
        speed = recording.message("geometry_msgs/msg/Vector3", x=float(k), y=0.0, z=0.0)
        recording.write(
            "/car/wheels",
            0.1 * k,
            "geometry_msgs/msg/TwistStamped",
            header=recording.header(0.1 * k),
            twist=recording.message("geometry_msgs/msg/Twist", linear=speed),
        )
        recording.write("/car/throttle", 0.1 * k, "std_msgs/msg/Int16", data=-k)  # fmt: skip
        recording.write("/measurement", 0.1 * k, SCALAR, header=recording.header(0.1 * k), value=99.0)
    recording.writer.close()
    places = {"measurement": "/car/wheels:twist.linear.x", "control": "car/throttle"}
    signals = read_bag(tmp_path / "bag", topics=places).signals
    assert signals["measurement"].value.tolist() == [0.0, 1.0, 2.0]
    assert signals["control"].value.tolist() == [0.0, -1.0, -2.0]
    with pytest.raises(InputError, match=r"no messages on /car/brake; it has /car/throttle, /car/wheels"):
        read_bag(tmp_path / "bag", topics={**places, "control": "/car/brake"})
    with pytest.raises(
        InputError, match=r"field 'linear.x' of geometry_msgs/msg/TwistStamped; allowed: .*twist.linear.x"
    ):
        read_bag(tmp_path / "bag", topics={**places, "measurement": "/car/wheels:linear.x"})
    with pytest.raises(InputError, match="no number of its own"):
        read_bag(tmp_path / "bag", topics={**places, "measurement": "/car/wheels"})
    with pytest.raises(InputError, match="signal 'speed'; allowed: setpoint, disturbance, control, measurement"):
        read_bag(tmp_path / "bag", topics={"speed": "/car/wheels"})


@pytest.fixture(scope="module")
def small_bags(tmp_path_factory: pytest.TempPathFactory) -> dict[StoragePlugin, Path]:
    folder = tmp_path_factory.mktemp("small")
    return {storage: record(folder / storage.name, storage, count=20) for storage in StoragePlugin}


def refusal(attempt: Callable[[Path], object], bag: Path) -> str:
    """Why it is refused; empty when it is not."""
    try:
        attempt(bag)
    except InputError as error:
        return str(error)
    return ""


@settings(derandomize=True, deadline=None, max_examples=40)
@given(
    storage=st.sampled_from(StoragePlugin), name=st.sampled_from(["messages", "metadata"]), kept=st.floats(0.5, 1.5),
    flips=st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 7)), max_size=3),
)  # fmt: skip
def test_damage_anywhere_is_survived_or_refused_in_one_line(small_bags, storage, name, kept, flips) -> None:
    with TemporaryDirectory() as folder:
        bag = Path(shutil.copytree(small_bags[storage], Path(folder, "bag")))
        file = next(path for path in bag.iterdir() if (path.name == "metadata.yaml") == (name == "metadata"))
        data = bytearray(file.read_bytes())
        for place, bit in flips:
            data[int(place * len(data))] ^= 1 << bit
        file.write_bytes(data[: int(kept * len(data))])
        assert all("\n" not in refusal(attempt, bag) for attempt in (read_bag, repair, read_bag))


@pytest.mark.parametrize("text", ["a text", "[1, 2]", "{1: [2]}"])
def test_custom_data_of_any_shape_is_no_obstacle(tmp_path: Path, text: str) -> None:
    bag = record(tmp_path / "bag", count=3)
    written = (bag / "metadata.yaml").read_text()
    changed = re.sub(r"custom_data:.*", f"custom_data: {text}", written)
    assert changed != written
    (bag / "metadata.yaml").write_text(changed)
    assert values(bag) == expected(3)
    assert repair(bag).counts == {"/control": 3, "/measurement": 3}


KILLED = """
import os, signal, sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
mode = sys.argv[2]
database.execute(f"PRAGMA journal_mode={mode}")
database.execute("PRAGMA cache_size=1")
database.execute("BEGIN")
database.execute("UPDATE messages SET timestamp = timestamp + 0")
database.execute("DELETE FROM messages WHERE id > 300")
if mode == "wal":
    database.execute("COMMIT")
os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_writer(bag: Path, mode: str) -> Path:
    """Kill a writer: in WAL mode right after it took 50 samples away, else in the middle of doing so."""
    (file,) = bag.glob("*.db3")
    done = subprocess.run([sys.executable, "-c", KILLED, file, mode], check=False)
    assert done.returncode == -signal.SIGKILL
    (bag / "metadata.yaml").unlink()
    ending = {"wal": "-wal", "delete": "-journal"}[mode]
    assert (bag / f"{file.name}{ending}").stat().st_size > 0
    return file


@pytest.mark.parametrize(("mode", "left"), [("wal", 150), ("delete", 200)])
def test_what_sqlite_left_in_a_log_or_a_journal_is_honoured_and_repaired(tmp_path: Path, mode: str, left: int) -> None:
    bag = record(tmp_path / "bag", StoragePlugin.SQLITE3)
    file = kill_a_writer(bag, mode)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    assert values(bag) == expected(left)
    assert not read_bag(bag).whole
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    assert repair(bag).counts == {"/control": left, "/measurement": left}
    assert sorted(path.name for path in bag.iterdir()) == [file.name, "metadata.yaml"]
    assert "repaired" in metadata(bag)["custom_data"]
    with Reader(bag) as reader:  # by another reader, which goes by metadata.yaml
        assert reader.message_count == 2 * left
    with sqlite3.connect(file) as database:
        assert database.execute("SELECT count(*) FROM messages").fetchone() == (2 * left,)


def test_a_killed_recording_of_several_files_is_repaired(tmp_path: Path, split: Path, storage: StoragePlugin) -> None:
    (split / "metadata.yaml").unlink()
    if storage == StoragePlugin.MCAP:
        last = split / "split_11.mcap"
        os.truncate(last, last.stat().st_size - 10)
        assert not read_bag(split).whole
    whole = {path.name: path.read_bytes() for path in split.iterdir() if "_11" not in path.name}
    assert repair(split).counts == {"/control": 240, "/measurement": 240}
    assert {name: (split / name).read_bytes() for name in whole} == whole
    assert metadata(split)["relative_file_paths"] == [
        f"split_{i}{next(split.glob('split_0.*')).suffix}" for i in range(12)
    ]
    with Reader(split) as reader:
        assert [time for connection, time, _ in reader.messages() if connection.topic == "/control"] == [
            round(1e8 * k) for k in range(240)
        ]


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE], ids=lambda mode: mode.name.lower())
def test_compressed_bags_get_their_metadata_back(tmp_path: Path, storage: StoragePlugin, mode: CompressionMode) -> None:
    bag = record(tmp_path / "bag", storage, compression=mode)
    (bag / "metadata.yaml").unlink()
    repair(bag)
    assert values(bag) == expected(200)
    with Reader(bag) as reader:
        types = message_types()
        found = [
            types.deserialize_cdr(data, c.msgtype).value
            for c, _, data in reader.messages()
            if c.topic == "/measurement"
        ]
    assert found == expected(200)


def test_messages_outside_chunks_are_kept_up_to_the_cut(tmp_path: Path) -> None:
    """As rosbag2 writes them with the preset ``fastwrite``."""
    types, path = message_types(), tmp_path / "bag.mcap"
    definition, _ = types.generate_msgdef(SCALAR, ros_version=2)
    with path.open("wb") as stream:
        writer = McapWriter(stream, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema(SCALAR, "ros2msg", definition.encode())
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/measurement", "/control")]
        blank = Recording(tmp_path / "unused", StoragePlugin.MCAP)
        ends = []
        for k in range(100):
            for sign, channel in zip((1, -1), channels, strict=True):
                message = blank.message(SCALAR, header=blank.header(0.1 * k), value=float(sign * k))
                writer.add_message(channel, round(1e8 * k), types.serialize_cdr(message, SCALAR), round(1e8 * k))
            ends.append(stream.tell())
        writer.finish()
    assert values(path) == expected(100)
    os.truncate(path, ends[70] - 3)  # within the control of sample 70
    copy = tmp_path / "copy"
    copy.mkdir()
    shutil.copy(path, copy)
    for bag in (path, copy):
        signals = read_bag(bag).signals
        assert signals["measurement"].value.tolist() == expected(71)
        assert signals["control"].value.tolist() == [-value for value in expected(70)]
    assert repair(copy).counts == {"/measurement": 71, "/control": 70}
    assert is_whole(copy / "bag.mcap")
    with Reader(copy) as reader:
        assert reader.message_count == 141
