"""A bag of ``ros2 bag record``, played into the tuner as ``ros2 bag play`` does, teaches it the process.

The bags are laid out by hand as rosbag2 of Jazzy lays them out: NAME/NAME_0.mcap (its default) or NAME_0.db3, and
metadata.yaml of version 9. Messages are what rclpy itself serialises. Nothing of the project writes or reads them here,
but for the verb that is tried on them, too.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_msgs.srv import Identify

from ...core.cli.runner import invoke
from ..conftest import Graph

STEP, ORIGIN = 0.05, 1_700_000_000.0  # recorded long ago
TYPES = {"/measurement": ScalarStamped, "/control": ScalarStamped, "/fopid_controller/state": FopidState}
MESSAGES = Path(__file__).parents[3] / "src/fopid_msgs/msg"
QOS = [{"history": "keep_last", "depth": 1, "reliability": "reliable", "durability": "volatile",
        "deadline": {"sec": 9223372036, "nsec": 854775807}, "lifespan": {"sec": 9223372036, "nsec": 854775807},
        "liveliness": "automatic", "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
        "avoid_ros_namespace_conventions": False}]  # fmt: skip

Row = tuple[str, int, bytes]


def type_name(topic: str) -> str:
    return f"fopid_msgs/msg/{TYPES[topic].__name__}"


def recorded() -> list[Row]:
    """Topic, time of arrival and serialised message of a loop with P1 that makes a step."""
    plant = Plant(PlantSettings(read_process("P1"), sample_time=STEP))
    controller = FopidController(ControllerSettings(Fopid(0.5, 0.3), sample_time=STEP))
    rows = []
    for k in range(900):
        now = round((ORIGIN + k * STEP) * 1e9)
        state = FopidState(setpoint=float(k >= 40), measurement=plant.measurement)
        state.control = controller.step(state.setpoint, state.measurement)
        plant.step(state.control)
        for topic, message in (
            ("/measurement", ScalarStamped(value=state.measurement)),
            ("/control", ScalarStamped(value=state.control)),
            ("/fopid_controller/state", state),
        ):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
            rows.append((topic, now + 200_000, serialize_message(message)))
    return rows


def write_metadata(folder: Path, storage: str, rows: list[Row]) -> str:
    file = f"{folder.name}_0.{'db3' if storage == 'sqlite3' else 'mcap'}"
    began, ended = rows[0][1], rows[-1][1]
    information = {
        "version": 9, "storage_identifier": storage, "duration": {"nanoseconds": ended - began},
        "starting_time": {"nanoseconds_since_epoch": began}, "message_count": len(rows),
        "topics_with_message_count": [
            {"topic_metadata": {"name": topic, "type": type_name(topic), "serialization_format": "cdr",
                                "offered_qos_profiles": QOS, "type_description_hash": "RIHS01_" + 64 * "0"},
             "message_count": sum(row[0] == topic for row in rows)}
            for topic in TYPES
        ],
        "compression_format": "", "compression_mode": "", "relative_file_paths": [file],
        "files": [{"path": file, "starting_time": {"nanoseconds_since_epoch": began},
                   "duration": {"nanoseconds": ended - began}, "message_count": len(rows)}],
        "custom_data": None, "ros_distro": "jazzy",
    }  # fmt: skip
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
    return file


def write_sqlite(folder: Path, rows: list[Row]) -> None:
    with sqlite3.connect(folder / write_metadata(folder, "sqlite3", rows)) as database:
        database.executescript("""
            CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
            CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
                type_description_hash TEXT NOT NULL);
            CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
                encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
                data BLOB NOT NULL);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);
            INSERT INTO schema(schema_version, ros_distro) VALUES (4, 'jazzy');
        """)
        for k, topic in enumerate(TYPES, 1):
            qos = yaml.safe_dump(QOS)
            values = (k, topic, type_name(topic), "cdr", qos, "RIHS01_" + 64 * "0")
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", values)
        for name in {type_name(topic) for topic in TYPES}:
            values = (name, "ros2msg", definition(name), "RIHS01_" + 64 * "0")
            database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", values)
        numbers = {topic: k for k, topic in enumerate(TYPES, 1)}
        database.executemany(
            "INSERT INTO messages VALUES (NULL, ?, ?, ?)", [(numbers[topic], now, data) for topic, now, data in rows]
        )


def definition(name: str) -> str:
    """As rosbag2 writes it: the message's text, and those of all messages in it."""
    rule = 80 * "=" + "\n"
    own = (MESSAGES / f"{name.rsplit('/', 1)[1]}.msg").read_text()
    header = "builtin_interfaces/Time stamp\nstring frame_id\n"
    time = "int32 sec\nuint32 nanosec\n"
    return f"{own}\n{rule}MSG: std_msgs/Header\n{header}\n{rule}MSG: builtin_interfaces/Time\n{time}"


def write_mcap(folder: Path, rows: list[Row]) -> None:
    from mcap.writer import CompressionType, Writer

    with (folder / write_metadata(folder, "mcap", rows)).open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="libmcap 1.3.1")
        channels = {}
        for topic in TYPES:
            schema = writer.register_schema(type_name(topic), "ros2msg", definition(type_name(topic)).encode())
            qos = {"offered_qos_profiles": yaml.safe_dump(QOS)}
            channels[topic] = writer.register_channel(topic, "cdr", schema, qos)
        for topic, now, data in rows:
            writer.add_message(channels[topic], log_time=now, publish_time=now, data=data)
        writer.finish()


def read_back(folder: Path) -> Iterator[Row]:
    """The messages in the order in which they came, read by other code than ours."""
    (file,) = (each for each in folder.iterdir() if each.name != "metadata.yaml")
    if file.suffix == ".db3":
        with sqlite3.connect(file) as database:
            yield from database.execute(
                "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp"
            )
        return
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            yield channel.topic, message.log_time, message.data


@pytest.fixture(params=["mcap", pytest.param("sqlite3", marks=pytest.mark.slow)])
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "mcap":
        pytest.importorskip("mcap")
    folder = tmp_path / "rosbag2_2026_11_22-04_02_00"
    folder.mkdir()
    {"mcap": write_mcap, "sqlite3": write_sqlite}[request.param](folder, recorded())
    return folder


def is_p1(process: str) -> bool:
    s = 1j * np.geomspace(0.1, 1.0, 20)
    return bool(np.abs(read_process(process)(s) * (s + 1) ** 3 - 1.0).max() < 0.05)


@pytest.mark.slow
def test_a_bag_that_is_played_teaches_the_tuner_the_process(graph: Graph, bag: Path) -> None:
    graph.start("fopid_tuner", {})
    graph.parameters("fopid_tuner")
    publishers = {topic: graph.node.create_publisher(kind, topic, 10) for topic, kind in TYPES.items()}
    for topic, publisher in publishers.items():
        graph.until(publisher.get_subscription_count, f"the tuner on {topic}")
    graph.spin(0.5)
    for k, (topic, _, data) in enumerate(read_back(bag)):
        publishers[topic].publish(bytes(data))
        if k % 30 == 0:
            graph.spin(0.01)  # as ros2 bag play -r 25
    graph.spin(1.0)
    answer = graph.call(Identify, "fopid_tuner/identify", Identify.Request(template_name="all"))
    assert answer.success, answer.message
    assert answer.models[0].fit_pct > 98.0
    assert is_p1(answer.models[0].process)


@pytest.mark.slow
def test_the_same_bag_is_read_without_ros(bag: Path) -> None:
    from json import loads

    found = loads(invoke(["identify", str(bag), "--json"]).stdout)
    assert found["fit_pct"] > 98.0
