"""A loop under load: many clients, ten times the messages, twenty loops on one graph, a million samples."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from rclpy.clock import Clock, ClockType
from std_msgs.msg import Float64

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from fopid_msgs.msg import ScalarStamped
from fopid_msgs.srv import Advance
from fopid_ros.benchmarks.cpu import cpu_seconds
from fopid_ros.benchmarks.idle import memory

from ..ros.conftest import SETTLE, Graph
from ..share import SHARE, share_of
from .record import Record, outside_limits
from .rig import FLOAT, GAINS, LIMITS, PROCESS, SETPOINT, SIGNAL_TYPES, Rig

REQUESTS, CLIENTS = 1000, 10
LOOPS, LOOP_SAMPLE_TIME = 20 if SHARE >= 0.5 else 6, 0.05
SAMPLES = 1_000_000
MEMORY_GATE = 1.0
"""Growth of a node after the first fifth of the samples [MB]."""


def test_each_of_a_thousand_requests_is_answered(rig: Rig, figures: Callable[..., None]) -> None:
    each = share_of(REQUESTS // CLIENTS)
    began, before = time.monotonic(), memory(rig.nodes["fopid_tuner"].pid)[0]
    script = [sys.executable, str(Path(__file__).with_name("tune_client.py")), str(each)]
    environment = rig.graph.environment
    clients = [
        subprocess.Popen([*script, str(seed)], env=environment, stdout=subprocess.PIPE, text=True)
        for seed in range(CLIENTS)
    ]
    rig.wait(lambda: all(client.poll() is not None for client in clients), "all clients", 600.0 + 1500.0 * SHARE)
    answers = [json.loads(client.stdout.read().splitlines()[-1]) for client in clients]
    total = {key: sum(answer[key] for answer in answers) for key in ("tuned", "busy", "refused", "none")}
    assert sum(total.values()) == each * CLIENTS
    assert total["none"] == 0
    assert total["tuned"] > 0
    assert rig.nodes["fopid_tuner"].poll() is None
    assert not outside_limits(rig.samples("control", began), *LIMITS)
    gaps = [after[0] - former[0] for former, after in pairwise(rig.samples("control", began))]
    figures("requests", **total, slowest=max(answer["slowest"] for answer in answers), longest_gap=max(gaps),
            seconds=time.monotonic() - began, before=before, after=memory(rig.nodes["fopid_tuner"].pid)[0])  # fmt: skip


def test_ten_times_the_messages_change_nothing(graph: Graph, tmp_path: Path, figures: Callable[..., None]) -> None:
    limits = {"control_min": LIMITS[0], "control_max": LIMITS[1]}
    controller = graph.start("fopid_controller", {**GAINS, **SIGNAL_TYPES, **limits, "setpoint.initial": SETPOINT})
    controls = graph.listen(Float64, "control")
    measurement = graph.node.create_publisher(Float64, "measurement", 1)
    others = [graph.node.create_publisher(ScalarStamped, name, 1) for name in ("setpoint", "feedforward")]
    sent = per_tick = 0

    def send() -> None:
        nonlocal sent
        for _ in range(per_tick):
            sent += 3
            measurement.publish(Float64(data=0.9))
            for publisher, value in zip(others, (SETPOINT, 0.0), strict=True):
                publisher.publish(ScalarStamped(value=value))

    graph.node.create_timer(0.01, send, clock=Clock(clock_type=ClockType.STEADY_TIME))
    seen = {}
    for per_tick in (1, 10):
        graph.until(lambda: controls, "a control")
        graph.spin(2.0)
        controls.clear()
        used, sent, began = cpu_seconds(controller.pid), 0, time.monotonic()
        graph.spin(max(5.0, 60.0 * SHARE))
        seconds = time.monotonic() - began
        cost = (cpu_seconds(controller.pid) - used) / seconds
        seen[per_tick] = {"rate": len(controls) / seconds, "sent": sent / seconds, "share_of_core": cost}
        assert not outside_limits(((0.0, message.data) for message in controls), *LIMITS)
    assert seen[10]["rate"] > 0.5 * seen[1]["rate"]  # beside that of the same minute: the machine may be busy
    figures("flood", **seen[10], ordinary=seen[1])


def test_many_loops_in_namespaces_do_not_touch(graph: Graph, tmp_path: Path, figures: Callable[..., None]) -> None:
    names = [f"loop{k:02}" for k in range(LOOPS)]
    topics = [f"{name}/{signal}:{FLOAT}:data" for name in names for signal in ("measurement", "control")]
    observer = graph.run_script(Path(__file__).with_name("observer.py"), str(tmp_path / "record"), *topics)
    processes = []
    common = {**SIGNAL_TYPES, "sample_time": LOOP_SAMPLE_TIME}
    record = Record(tmp_path / "record")

    def start(executable: str, k: int, parameters: dict[str, object]) -> None:
        processes.append(graph.start(executable, {**common, **parameters}, "-r", f"__ns:=/{names[k]}"))

    def all_heard() -> bool:
        record.update()
        return all(f"{name}/measurement" in record.lines for name in names)

    # Plants first: with LOCALHOST, Fast DDS calls on the first 32 processes of a domain only, and those that came after
    # them never find each other (docs/troubleshooting.md).
    for k in range(LOOPS):
        start("plant_simulator", k, {"process": "1/(s+1)"})
    graph.until(all_heard, "all plants", 120.0)
    for k in range(LOOPS):
        gains = {"kp": 1.0, "ki": 1.0, "setpoint.initial": 0.1 * k}
        start("fopid_controller", k, {**gains, "control_min": LIMITS[0], "control_max": LIMITS[1]})

    def settled() -> bool:
        newest = [record.lines.get(f"{name}/measurement", [(0.0, 99.0)])[-1][1] for name in names]
        return all(abs(value - 0.1 * k) < 0.01 for k, value in enumerate(newest))

    began = time.monotonic()
    try:
        while not settled():
            assert time.monotonic() - began < 300.0, "all loops at their own setpoints"
            graph.spin(0.2)
            record.update()
        settling, since = time.monotonic() - began, time.monotonic()
        used = [cpu_seconds(process.pid) for process in processes]
        graph.spin(max(5.0, 60.0 * SHARE))
        seconds = time.monotonic() - since
        share = sum(cpu_seconds(process.pid) - was for process, was in zip(processes, used, strict=True)) / seconds
        record.update()
    finally:
        observer.terminate()
        observer.wait(10)
    rates = [len(record.of(f"{name}/control", since)) / seconds for name in names]
    assert settled()
    assert min(rates) > 0.5 / LOOP_SAMPLE_TIME  # on a busy machine as well
    for name in names:
        assert not outside_limits(record.of(f"{name}/control"), *LIMITS)
    figures("loops", loops=LOOPS, sample_time=LOOP_SAMPLE_TIME, settling=settling, slowest_rate=min(rates), cores=share,
            memory=sum(memory(process.pid)[1] for process in processes))  # fmt: skip


def test_a_million_samples_in_lockstep_are_the_offline_ones_and_no_memory_grows(
    graph: Graph, figures: Callable[..., None]
) -> None:
    samples = share_of(SAMPLES)
    common, plant = {"trigger": "lockstep", "sample_time": 0.01}, {"noise_std": 0.1, "seed": 7}
    names = ("plant_simulator", "fopid_controller")
    more = ({**plant, "process": PROCESS, "advance_until": 0.0}, {**GAINS, "setpoint.initial": SETPOINT})
    nodes = [graph.start(name, {**common, **one}) for name, one in zip(names, more, strict=True)]
    client = graph.client(Advance, "plant_simulator/advance")
    graph.until(lambda: graph.node.count_publishers("/control"), "the controller")
    graph.spin(SETTLE)
    began, resident = time.monotonic(), []
    for k in range(1, 11):
        reach = 0.01 * (samples * k // 10 - (10 if k == 10 else 0))
        answer = graph.result(client.call_async(Advance.Request(until=reach)), 3000.0)
        assert answer.success, answer.message
        resident.append([memory(node.pid)[0] for node in nodes])
    seconds = time.monotonic() - began
    heard = graph.listen_once(ScalarStamped, "measurement")
    graph.until(lambda: graph.node.count_publishers("/measurement"), "the plant")
    graph.spin(2 * SETTLE)
    assert graph.result(client.call_async(Advance.Request(until=0.01 * samples))).success
    graph.until(lambda: len(heard) >= 10, "the last samples")
    controller = FopidController(ControllerSettings(Fopid(**GAINS), sample_time=0.01))
    simulated = Plant(PlantSettings(read_process(PROCESS), sample_time=0.01, **plant))
    expected = simulate(controller, simulated, samples, lambda _: SETPOINT)
    assert [message.value for message in heard[-10:]] == list(expected.measurement[-10:])
    growth = [last - early for early, last in zip(resident[1], resident[-1], strict=True)]
    assert max(growth) < MEMORY_GATE
    figures("lockstep", samples=samples, per_second=samples / seconds, growth=dict(zip(names, growth, strict=True)))
