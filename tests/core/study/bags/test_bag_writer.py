"""A bag is readable by tools that share no code with its writer, whatever ended the recording."""

from __future__ import annotations

import errno
import signal
import struct
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fopid_core.errors import InputError
from fopid_core.study.bags.repair import repair
from fopid_core.study.bags.rosbag2 import Topic, qos
from fopid_core.study.bags.writer import BagWriter

FLOAT64 = Topic("/loop/measurement", "std_msgs/msg/Float64", "float64 data")
TIME = Topic("/clock", "builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec")


def float64(value: float) -> bytes:
    """A std_msgs/Float64 in CDR, little endian."""
    return struct.pack("<4Bd", 0, 1, 0, 0, value)


def stored(bag: Path) -> list[tuple[str, int, bytes]]:
    with Reader(bag) as reader:
        return [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]


def test_holds_what_was_written_in_the_order_of_time(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", [FLOAT64, TIME], {})
    bag.write("/loop/measurement", 30, float64(3.0))
    bag.write("/clock", 20, struct.pack("<4BiI", 0, 1, 0, 0, 1, 2))
    bag.flush()
    bag.write("/loop/measurement", 10, float64(1.0))
    bag.close()
    assert stored(tmp_path / "bag") == [
        ("/loop/measurement", 10, float64(1.0)),
        ("/clock", 20, struct.pack("<4BiI", 0, 1, 0, 0, 1, 2)),
        ("/loop/measurement", 30, float64(3.0)),
    ]
    assert bag.counts == {"/loop/measurement": 2, "/clock": 1}


def test_mcap_tools_find_messages_by_the_index(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", [FLOAT64, TIME], {})
    for k in range(100):
        bag.write("/loop/measurement", k, float64(k))
        if k % 10 == 0:
            bag.flush()
    bag.close()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == 100
        found = [message.log_time for _, _, message in reader.iter_messages(starting_at=40, ending_before=60)]
    assert found == list(range(40, 60))


def test_metadata_is_what_the_rosbags_library_would_have_written(tmp_path: Path) -> None:
    ours = BagWriter(tmp_path / "ours", [Topic("/a", "std_msgs/msg/Float64", "float64 data")], {"experiment": "x: 1\n"})
    ours.offered("/a", [qos(depth=5)])
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.MCAP) as theirs:
        connection = theirs.add_connection("/a", "std_msgs/msg/Float64", typestore=store,
                                           offered_qos_profiles=[qos(depth=5)])  # fmt: skip
        theirs.set_custom_data("experiment", "x: 1\n")
        for time in (5, 9):
            theirs.write(connection, time, float64(1.0))
            ours.write("/a", time, float64(1.0))
    ours.close()
    written, expected = (
        yaml.safe_load((tmp_path / name / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        for name in ("ours", "theirs")
    )
    for information in (written, expected):
        information.pop("ros_distro")
        information["relative_file_paths"] = information["files"][0]["path"] = "same"
    assert written == expected


def test_definitions_types_and_qos_come_back(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", [FLOAT64, TIME], {})
    bag.offered("/clock", [qos(depth=7, latched=True), qos(reliable=False)])
    bag.write("/clock", 20, struct.pack("<4BiI", 0, 1, 0, 0, 1, 2))
    with pytest.raises(InputError, match="topic '/clock' has messages already"):
        bag.offered("/clock", [])
    bag.close()
    with Reader(tmp_path / "bag") as reader:
        measurement, clock = reader.connections
    assert (measurement.topic, measurement.msgtype, measurement.msgdef.data) == (
        "/loop/measurement",
        "std_msgs/msg/Float64",
        "float64 data",
    )
    assert measurement.digest == get_typestore(Stores.ROS2_JAZZY).hash_rihs01("std_msgs/msg/Float64")
    assert [(q.depth, q.reliability, q.durability) for q in clock.ext.offered_qos_profiles] == [
        (7, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL),
        (1, QosReliability.BEST_EFFORT, QosDurability.VOLATILE),
    ]  # fmt: skip
    with Reader(tmp_path / "bag" / "bag.mcap") as reader:  # the file for itself says the same
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert offered == {"/clock": clock.ext.offered_qos_profiles, "/loop/measurement": []}


def test_an_empty_bag_opens(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag", [FLOAT64], {"note": "nothing came"}).close()
    with Reader(tmp_path / "bag") as reader:
        assert (reader.message_count, reader.storage.metadata.custom) == (0, {"note": "nothing came"})
    with Reader(tmp_path / "bag" / "bag.mcap") as reader:
        assert reader.message_count == 0


def test_an_existing_folder_is_refused_by_name_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match=f"{tmp_path}/bag.*exists already"):
        BagWriter(tmp_path / "bag", [FLOAT64], {})
    assert list((tmp_path / "bag").iterdir()) == []


def test_closing_twice_changes_nothing(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", [FLOAT64], {})
    bag.write("/loop/measurement", 1, float64(1.0))
    bag.close()
    before = {path.name: path.read_bytes() for path in (tmp_path / "bag").iterdir()}
    bag.close()
    assert {path.name: path.read_bytes() for path in (tmp_path / "bag").iterdir()} == before


FILL = """
import resource, struct, sys
from pathlib import Path
from fopid_core.study.bags.writer import BagWriter
from fopid_core.study.bags.rosbag2 import Topic
import random
folder, limit = Path(sys.argv[1]), int(sys.argv[2])
noise = random.Random(1)
bag = BagWriter(folder, [Topic("/a", "std_msgs/msg/Float64", "float64 data")], {"note": "kept"})
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    for k in range(200_000):
        bag.write("/a", k, struct.pack("<4Bd", 0, 1, 0, 0, noise.random()))
        if k % 500 == 0:
            bag.flush()
    print("never full")
except OSError as error:
    print(error.errno, bag.closed, bag.counts["/a"])
bag.close()
"""


@pytest.mark.parametrize("limit", [20_000, 60_001, 250_000])
def test_a_full_disk_leaves_a_whole_bag_with_what_was_written(tmp_path: Path, limit: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FILL, tmp_path / "bag", str(limit)], capture_output=True, text=True, check=True
    )
    number, closed, kept = done.stdout.split()
    assert (int(number), closed) == (errno.EFBIG, "True"), done.stdout
    times = [time for _, time, _ in stored(tmp_path / "bag")]
    assert times == list(range(int(kept)))
    assert int(kept) > limit // 40  # a message takes 22 to 60 bytes of the file, its index included
    with Reader(tmp_path / "bag") as reader:
        assert reader.storage.metadata.custom == {"note": "kept", "repaired": "the recording was cut off or damaged"}
        assert reader.message_count == int(kept)


KILLED = """
import os, signal, struct, sys
from pathlib import Path
from fopid_core.study.bags.writer import BagWriter
from fopid_core.study.bags.rosbag2 import Topic
bag = BagWriter(Path(sys.argv[1]), [Topic("/a", "std_msgs/msg/Float64", "float64 data")], {"note": "kept"})
for k in range(1000):
    bag.write("/a", k, struct.pack("<4Bd", 0, 1, 0, 0, k))
    if k == 700:
        bag.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_was_flushed_survives_a_kill(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED, tmp_path / "bag"], check=False)
    assert done.returncode == -signal.SIGKILL
    repair(tmp_path / "bag")
    assert [time for _, time, _ in stored(tmp_path / "bag")] == list(range(701))
