"""The recorder writes down every message at the time it was stamped with, and survives what befalls a recording."""

from __future__ import annotations

import json
import math
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, Header

import fopid_ros.experiment.recorder
from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.reports.completeness import samples
from fopid_msgs.msg import ExperimentPhase, FopidState, ScalarStamped, TuningResult
from fopid_ros.experiment.recorder import Recorder

from ..conftest import BIN, MALFORMED, Graph, without_middleware

FAST_TOPICS = {"setpoint": ScalarStamped, "measurement": ScalarStamped, "state": FopidState, "/clock": Clock}

PUBLISH = """
import sys, time, rclpy
from fopid_msgs.msg import FopidState, ScalarStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
count = int(sys.argv[1])
rclpy.init()
node = rclpy.create_node("source", namespace="loop")
qos = QoSProfile(depth=10_000)
kinds = {"setpoint": ScalarStamped, "measurement": ScalarStamped, "state": FopidState, "/clock": Clock}
publishers = [(node.create_publisher(kind, name, qos), kind()) for name, kind in kinds.items()]
while any(publisher.get_subscription_count() == 0 for publisher, _ in publishers):
    time.sleep(0.02)
print("matched", flush=True)
sys.stdin.readline()
for k in range(count):
    for publisher, message in publishers:
        stamp = message.clock if isinstance(message, Clock) else message.header.stamp
        stamp.sec, stamp.nanosec = divmod(k * 1_000_000 + 1, 1_000_000_000)
        publisher.publish(message)
for publisher, _ in publishers:
    assert publisher.wait_for_all_acked(Duration(seconds=60))
print("sent", flush=True)
sys.stdin.readline()
"""

RECORD = """
import resource, sys, threading, time
from pathlib import Path
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.experiment.recorder import Recorder
from rosgraph_msgs.msg import Clock
folder, limit = Path(sys.argv[1]), int(sys.argv[2])
rclpy.init()
node = rclpy.create_node("sink", namespace="loop")
kinds = {"setpoint": ScalarStamped, "measurement": ScalarStamped, "state": FopidState, "/clock": Clock}
recorder = Recorder(node, folder, kinds, metadata={"process": "P1"}, on_failure=lambda text: print(text, flush=True))
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
print("recording", flush=True)
executor, stop = EventsExecutor(), Future()
executor.add_node(node)
thread = threading.Thread(target=lambda: executor.spin_until_future_complete(stop, timeout_sec=600.0))
thread.start()
expected, deadline = int(sys.stdin.readline() or 0), time.monotonic() + 60.0
while sum(recorder.counts.values()) < expected and time.monotonic() < deadline:
    time.sleep(0.05)
stop.set_result(None)
executor.wake()
thread.join()
recorder.close()
print(sum(recorder.counts.values()), flush=True)
"""


class Helper:
    """A program in a process of its own that is talked to line by line."""

    def __init__(self, graph: Graph, program: str, *arguments: object) -> None:
        command = [sys.executable, "-c", program, *map(str, arguments)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(command, env=graph.environment, text=True, **pipes)

    def hear(self) -> str:
        while not (line := without_middleware(told := self.process.stdout.readline())) and told:
            pass
        return line.strip()

    def say(self, line: object = "") -> None:
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        """Let it come to its end."""
        self.process.stdin.close()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


@pytest.fixture
def start(graph: Graph) -> Iterator[Callable[..., Helper]]:
    """Start a helper: ``start(program, argument, ...)``."""
    helpers: list[Helper] = []

    def start(program: str, *arguments: object) -> Helper:
        helpers.append(Helper(graph, program, *arguments))
        return helpers[-1]

    yield start
    for helper in helpers:
        helper.end()


def stored(bag: Path) -> list[tuple[str, int]]:
    with Reader(bag) as reader:
        return [(connection.topic, time) for connection, time, _ in reader.messages()]


def record(graph: Graph, folder: Path, topics: dict[str, type], **more) -> Recorder:
    recorder = Recorder(graph.node, folder, topics, **more)
    graph.spin(0.1)
    return recorder


def publish(graph: Graph, recorder: Recorder, topic: str, *messages, qos: QoSProfile | int = 100) -> None:
    publisher = graph.node.create_publisher(type(messages[0]), topic, qos)
    graph.until(publisher.get_subscription_count, f"a subscriber of {topic}")
    wanted = recorder.counts[graph.node.resolve_topic_name(topic)] + len(messages)
    for message in messages:
        publisher.publish(message)
    graph.until(lambda: recorder.counts[graph.node.resolve_topic_name(topic)] == wanted, f"{wanted} on {topic}")


@pytest.mark.slow
def test_nothing_is_lost_at_full_speed_from_another_process(start, graph: Graph, tmp_path: Path) -> None:
    count = 8000
    recorder = start(RECORD, tmp_path / "bag", 0)
    assert recorder.hear() == "recording"
    source = start(PUBLISH, count)
    assert source.hear() == "matched"
    graph.spin(0.5)
    source.say()
    assert source.hear() == "sent"
    recorder.say(4 * count)
    assert recorder.hear() == str(4 * count)
    expected = [k * 1_000_000 + 1 for k in range(count)]
    times: dict[str, list[int]] = {}
    for topic, time in stored(tmp_path / "bag"):
        times.setdefault(topic, []).append(time)
    assert times == dict.fromkeys(("/loop/setpoint", "/loop/measurement", "/loop/state", "/clock"), expected)


def test_messages_are_logged_at_their_own_stamp_or_else_at_the_nodes_clock(graph: Graph, tmp_path: Path) -> None:
    start = graph.node.get_clock().now().nanoseconds
    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped, "b": Clock, "c": ParameterEvent, "d": Float64})
    publish(graph, recorder, "a", ScalarStamped(header=Header(stamp=Time(sec=5, nanosec=7))), ScalarStamped())
    publish(graph, recorder, "b", Clock(clock=Time(sec=6)))
    publish(graph, recorder, "c", ParameterEvent(stamp=Time(sec=-1, nanosec=1)), ParameterEvent(stamp=Time(sec=8)))
    before = graph.node.get_clock().now().nanoseconds
    publish(graph, recorder, "d", Float64(data=1.0))
    after = graph.node.get_clock().now().nanoseconds
    recorder.close()
    times = stored(tmp_path / "bag")
    assert ("/a", 5_000_000_007) in times
    assert ("/b", 6_000_000_000) in times
    assert ("/c", 8_000_000_000) in times
    (unstamped,) = [time for topic, time in times if topic == "/d"]
    assert before <= unstamped <= after
    unset = [time for topic, time in times if topic in "/a/c" and time not in (5_000_000_007, 8_000_000_000)]
    assert len(unset) == 2  # a stamp that nobody filled in, and one from before 1970
    assert all(start < time < before for time in unset)


def test_bytes_that_are_no_message_are_not_recorded_and_the_rest_is(
    graph: Graph, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    kinds = {"a": ScalarStamped, "b": TuningResult}
    recorder = record(graph, tmp_path / "bag", kinds)
    for topic, kind in kinds.items():
        publisher = graph.node.create_publisher(kind, topic, 100)
        graph.until(publisher.get_subscription_count, f"a subscriber of {topic}")
        for data in MALFORMED:
            publisher.publish(data)
        publish(graph, recorder, topic, kind())
    recorder.close()
    assert [topic for topic, _ in stored(tmp_path / "bag")] == ["/a", "/b"]
    assert re.search(r"/a: \d+ bytes that are no ScalarStamped; not recorded \(1 so far\)", capfd.readouterr().err)


def test_definitions_are_complete_and_their_hashes_those_of_the_installed_types(graph: Graph, tmp_path: Path) -> None:
    kinds = (ScalarStamped, FopidState, TuningResult, ExperimentPhase, ParameterEvent, Clock, Float64)
    record(graph, tmp_path / "bag", {f"topic{i}": kind for i, kind in enumerate(kinds)}).close()
    share = Path(sys.prefix) / "share"
    with Reader(tmp_path / "bag") as reader:
        for connection in reader.connections:
            package, _, name = connection.msgtype.split("/")
            generated = json.loads((share / package / "msg" / f"{name}.json").read_text())["type_hashes"]
            assert connection.digest == {h["type_name"]: h["hash_string"] for h in generated}[connection.msgtype]
            store = get_typestore(Stores.EMPTY)  # nothing but what the bag says
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            assert store.hash_rihs01(connection.msgtype) == connection.digest


def test_what_was_published_before_is_recorded_where_the_qos_asks_for_it(graph: Graph, tmp_path: Path) -> None:
    latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    early = graph.node.create_publisher(ScalarStamped, "result", latched)
    early.publish(ScalarStamped(header=Header(stamp=Time(sec=3))))
    recorder = record(graph, tmp_path / "bag", {"result": ScalarStamped}, qos={"result": latched})
    graph.until(lambda: recorder.counts["/result"], "the early message")
    recorder.close()
    assert stored(tmp_path / "bag") == [("/result", 3_000_000_000)]


def test_a_topic_is_described_as_its_publishers_offer_it(graph: Graph, tmp_path: Path) -> None:
    latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped, "b": ScalarStamped, "silent": ScalarStamped})
    publish(graph, recorder, "a", ScalarStamped(), qos=latched)
    graph.node.create_publisher(ScalarStamped, "b", QoSProfile(depth=1))
    graph.until(lambda: graph.node.count_publishers("b") == 1, "the first publisher")
    publish(graph, recorder, "b", ScalarStamped(), qos=latched)
    recorder.close()
    for bag in (tmp_path / "bag", tmp_path / "bag" / "bag.mcap"):
        with Reader(bag) as reader:
            offered = {
                c.topic: sorted(q.durability.name for q in c.ext.offered_qos_profiles) for c in reader.connections
            }
        assert offered == {"/a": ["TRANSIENT_LOCAL"], "/b": ["TRANSIENT_LOCAL", "VOLATILE"], "/silent": []}


def test_in_simulated_time_wall_clock_stamps_are_logged_at_the_time_of_the_loop(graph: Graph, tmp_path: Path) -> None:
    simulated = Parameter("use_sim_time", value=True)
    node = Node("simulated", context=graph.context, parameter_overrides=[simulated])
    graph.executor.add_node(node)
    recorder = Recorder(node, tmp_path / "bag", {"a": ScalarStamped})
    clock = graph.node.create_publisher(Clock, "/clock", 1)
    graph.until(clock.get_subscription_count, "a subscriber of the clock")
    clock.publish(Clock(clock=Time(sec=42)))
    graph.until(lambda: node.get_clock().now().nanoseconds == 42 * 10**9, "the simulated time")
    publish(graph, recorder, "a", ScalarStamped(header=Header(stamp=Time(sec=1_790_000_000))))
    recorder.close()
    assert stored(tmp_path / "bag") == [("/a", 42 * 10**9)]
    graph.executor.remove_node(node)
    node.destroy_node()


def test_it_tells_how_far_all_of_some_topics_are_recorded(graph: Graph, tmp_path: Path) -> None:
    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped, "b": ScalarStamped})
    assert (recorder.reached([]), recorder.reached(["a", "b"])) == (math.inf, 0)
    publish(graph, recorder, "a", *[ScalarStamped(header=Header(stamp=Time(sec=second))) for second in (7, 9, 8)])
    assert (recorder.reached(["a"]), recorder.reached(["b"]), recorder.reached(["a", "b"])) == (9 * 10**9, 0, 9 * 10**9)
    publish(graph, recorder, "b", ScalarStamped(header=Header(stamp=Time(sec=5))))
    assert recorder.reached(["a", "b"]) == 5 * 10**9
    recorder.close()


STEP = """
process: 1/(s+1)
name: long
sample_time: 0.001
gains: {kp: 1.0, ki: 1.0}
phases:
- {name: step, duration: 10.0, setpoint: 1.0}
"""


@pytest.mark.slow
def test_a_recorder_that_stalls_loses_nothing_of_a_loop_at_full_speed(graph: Graph, tmp_path: Path) -> None:
    """Stopped twice, for longer than it takes the loop to go beyond what its publishers remember."""
    (tmp_path / "step.yaml").write_text(STEP)
    lockstep = {"trigger": "lockstep", "sample_time": 0.001}
    graph.start("plant_simulator", {**lockstep, "process": "1/(s+1)", "advance_until": 0.0})
    graph.start("fopid_controller", {**lockstep, "kp": 1.0, "ki": 1.0, "use_sim_time": True})
    arguments = [tmp_path / "step.yaml", "--no-report", "--out", tmp_path / "run"]
    process = subprocess.Popen(
        [BIN / "experiment", *arguments], env=graph.environment, stderr=subprocess.PIPE, text=True
    )
    states = graph.listen(FopidState, "/fopid_controller/state", QoSProfile(depth=1))
    for k in range(2):
        graph.until(lambda k=k: states and states[-1].header.stamp.sec >= 4 * k + 1, f"{4 * k + 1} s of the loop")
        process.send_signal(signal.SIGSTOP)
        graph.spin(2.0)
        process.send_signal(signal.SIGCONT)
    _, told = process.communicate(timeout=250)
    assert process.returncode == 0, told
    run = read_bag(tmp_path / "run" / "bag")
    assert {name: (found.expected, found.missing) for name, found in samples(run).items()} == dict.fromkeys(
        ("measurement", "control", "state"), (10_000, 0)
    )
    for stamps in (run.signals["measurement"].time, run.signals["control"].time, run.state["time"]):
        assert np.array_equal(np.unique(np.round(stamps / 0.001).astype(int)), np.arange(10_000))


def test_an_existing_folder_is_refused_by_name(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match=f"{tmp_path}/bag.*exists already"):
        Recorder(graph.node, tmp_path / "bag", {"a": Float64})


def test_a_place_that_cannot_be_written_is_refused_by_name(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/bag.*cannot be made: Not a directory"):
        Recorder(graph.node, tmp_path / "file" / "bag", {"a": Float64})


def test_closing_is_safe_twice_and_while_messages_arrive(graph: Graph, tmp_path: Path) -> None:
    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped})
    publish(graph, recorder, "a", *[ScalarStamped(header=Header(stamp=Time(sec=i + 1))) for i in range(50)])
    publisher = graph.node.create_publisher(ScalarStamped, "a", 100)
    closers = [threading.Thread(target=recorder.close) for _ in range(3)]
    for closer in closers:
        publisher.publish(ScalarStamped(header=Header(stamp=Time(sec=99))))
        closer.start()
        graph.spin(0.05)
    for closer in closers:
        closer.join()
    graph.spin(0.2)
    assert recorder.failure is None
    assert len(stored(tmp_path / "bag")) == recorder.counts["/a"] >= 50


@pytest.mark.slow
def test_a_full_disk_ends_the_recording_in_one_line_and_not_the_run(start, tmp_path: Path) -> None:
    recorder = start(RECORD, tmp_path / "bag", 100_000)
    assert recorder.hear() == "recording"
    source = start(PUBLISH, 12_000)
    assert source.hear() == "matched"
    source.say()
    assert source.hear() == "sent"
    complaint = recorder.hear()
    assert complaint.startswith("recording stopped: File too large")
    assert str(tmp_path / "bag") in complaint
    assert "MB free" in complaint
    recorder.say(0)
    kept = recorder.hear()  # the very next line: it complained once, and went on until it was told to end
    assert f"{kept} messages are kept" in complaint
    assert len(stored(tmp_path / "bag")) == int(kept) > 0
    assert recorder.process.wait(20) == 0
    run = read_bag(tmp_path / "bag", namespace="/loop", needed=["measurement"])
    assert run.metadata["process"] == "P1"
    assert not run.whole


def test_a_folder_that_vanishes_is_told_and_the_run_goes_on(graph: Graph, tmp_path: Path) -> None:
    told: list[str] = []

    def on_failure(text: str) -> None:
        told.append(text)
        recorder.close()

    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped}, on_failure=on_failure)
    shutil.rmtree(tmp_path / "bag")
    publish(graph, recorder, "a", ScalarStamped(header=Header(stamp=Time(sec=1))))
    recorder.close()
    assert told == [recorder.failure]
    assert told[0].startswith("recording stopped: No such file or directory")


@pytest.mark.slow
def test_after_a_kill_the_bag_is_readable_up_to_the_last_flush(start, graph: Graph, tmp_path: Path) -> None:
    recorder = start(RECORD, tmp_path / "bag", 0)
    assert recorder.hear() == "recording"
    source = start(PUBLISH, 2000)
    assert source.hear() == "matched"
    source.say()
    assert source.hear() == "sent"
    graph.until(lambda: (tmp_path / "bag" / "bag.mcap").stat().st_size > 10_000, "a flush")
    recorder.process.send_signal(signal.SIGKILL)
    recorder.process.wait()
    run = read_bag(tmp_path / "bag", namespace="/loop", needed=["measurement"])
    assert not run.whole
    assert run.metadata == {"process": "P1"}
    time = run.signals["measurement"].time
    assert list(time) == [(k * 1_000_000 + 1) / 1e9 for k in range(time.size)]
    assert time.size > 0


def test_what_arrives_is_flushed_every_second(graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fopid_ros.experiment.recorder.FLUSH_PERIOD <= 1.0
    monkeypatch.setattr(fopid_ros.experiment.recorder, "FLUSH_PERIOD", 0.05)
    recorder = record(graph, tmp_path / "bag", {"a": ScalarStamped})
    before = (tmp_path / "bag" / "bag.mcap").stat().st_size
    publish(graph, recorder, "a", ScalarStamped(header=Header(stamp=Time(sec=1))))
    graph.until(lambda: (tmp_path / "bag" / "bag.mcap").stat().st_size > before, "a flush without further messages")
    recorder.close()
