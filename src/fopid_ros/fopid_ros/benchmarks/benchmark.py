"""The ROS figures, each beside a baseline measured in the same run."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rich.console import Console
from rich.table import Table

from fopid_core.errors import InputError
from fopid_msgs.msg import ScalarStamped
from fopid_msgs.srv import Advance
from fopid_ros.benchmarks.cpu import BareNode, node_cost, serve
from fopid_ros.benchmarks.idle import LISTENERS, idle_costs
from fopid_ros.benchmarks.many import joint_costs, loop_costs
from fopid_ros.common.managed_node import loop_qos
from fopid_ros.common.middleware import prepare_middleware
from fopid_ros.controller.node import ControllerNode
from fopid_ros.experiment.child_processes import Children, command, ros_arguments
from fopid_ros.plant.node import PlantSimulator

SAMPLE_TIME = 0.01
GAINS = {"kp": 2.9692, "ki": 0.8028, "kd": 1.3394, "lam": 1.0138, "mu": 0.6074}
PATIENCE = 60.0
STARTS = 6
"""Of controller and bare node, on which the shares depend: the ratio of one start went from 0.81 to 1.24."""


class Echo(Node):
    """Sends every ``ping`` back as ``pong``."""

    def __init__(self) -> None:
        super().__init__("echo")
        qos = loop_qos(lockstep=True)
        publisher = self.create_publisher(ScalarStamped, "pong", qos)
        self.create_subscription(ScalarStamped, "ping", publisher.publish, qos)


class Pinger(Node):
    """Bounces one message a number of times and measures how long that takes."""

    def __init__(self, rounds: int) -> None:
        super().__init__("pinger")
        qos = loop_qos(lockstep=True)
        self.done = Future()
        self.left = rounds
        self.publisher = self.create_publisher(ScalarStamped, "ping", qos)
        self.create_subscription(ScalarStamped, "pong", self._on_pong, qos)

    def _on_pong(self, message: ScalarStamped) -> None:
        self.left -= 1
        if self.left > 0:
            self.publisher.publish(message)
        else:
            self.done.set_result(None)


def ping_pong(rounds: int) -> float:
    """Round trips per second of one message between two processes that do nothing else."""
    with Children() as children:
        children.start("echo", [sys.executable, "-m", "fopid_ros.benchmarks.benchmark", "--echo"])
        node, executor = Pinger(rounds), EventsExecutor()
        executor.add_node(node)
        _until(executor, lambda: node.publisher.get_subscription_count() > 0, "the echo process")
        begun = time.perf_counter()
        node.publisher.publish(ScalarStamped(value=1.0))
        executor.spin_until_future_complete(node.done, timeout_sec=PATIENCE)
        elapsed = time.perf_counter() - begun
        node.destroy_node()
    return rounds / elapsed


def lockstep_two_processes(samples: int) -> float:
    """Samples per second of the lockstep loop with plant and controller in two processes."""
    node, executor = Node("bench"), EventsExecutor()
    executor.add_node(node)
    advance = node.create_client(Advance, "plant_simulator/advance")
    setpoint = node.create_publisher(ScalarStamped, "setpoint", 1)
    common = {"trigger": "lockstep", "sample_time": SAMPLE_TIME}
    with Children() as children:
        for name, more in (("plant_simulator", {"process": "P1", "advance_until": 0.0}), ("fopid_controller", GAINS)):
            arguments = ros_arguments({**common, **more})
            children.start(name, [command(name), *arguments, "--log-level", "warn"])
        ready = lambda: advance.service_is_ready() and setpoint.get_subscription_count() > 0  # noqa: E731
        _until(executor, ready, "plant and controller")
        setpoint.publish(ScalarStamped(value=1.0))
        _advance(executor, advance, 10 * SAMPLE_TIME)
        begun = time.perf_counter()
        _advance(executor, advance, (samples + 10) * SAMPLE_TIME)
        elapsed = time.perf_counter() - begun
    node.destroy_node()
    return samples / elapsed


def _advance(executor: Executor, client: Any, until: float) -> None:
    """Let the loop run until then; it is asked at long intervals so that asking costs it nothing."""
    while True:
        future = client.call_async(Advance.Request(until=until))
        executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        if future.result().success:
            return
        executor.spin_until_future_complete(Future(), timeout_sec=0.01)


def lockstep_one_process(samples: int) -> float:
    """Samples per second with both nodes in one process, on one executor."""
    arguments = ["--ros-args", "-p", "trigger:=lockstep", "-p", f"sample_time:={SAMPLE_TIME}"]
    arguments += [item for name, value in GAINS.items() for item in ("-p", f"fopid_controller:{name}:={value}")]
    context = rclpy.Context()
    rclpy.init(args=arguments, context=context)
    plant, controller = PlantSimulator(context=context), ControllerNode(context=context)
    plant.set_parameters([Parameter("advance_until", value=0.0)])
    executor = EventsExecutor(context=context)
    for node in (plant, controller):
        node.start()
        executor.add_node(node)
    setpoint = plant.create_publisher(ScalarStamped, "setpoint", 1)
    _until(executor, lambda: setpoint.get_subscription_count() > 0, "the controller")
    setpoint.publish(ScalarStamped(value=1.0))
    begun = time.perf_counter()
    plant.set_parameters([Parameter("advance_until", value=samples * SAMPLE_TIME)])
    while plant.time < samples * SAMPLE_TIME - SAMPLE_TIME / 2:
        executor.spin_until_future_complete(Future(), timeout_sec=0.005)
    elapsed = time.perf_counter() - begun
    for node in (plant, controller):
        node.destroy_node()
    rclpy.shutdown(context=context)
    return samples / elapsed


def jitter(make_node: Callable[[list[int]], Node], seconds: float) -> list[float]:
    """Distances of the ticks at 100 Hz from an even grid [us]."""
    stamps: list[int] = []
    node, executor = make_node(stamps), EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), timeout_sec=seconds)
    node.destroy_node()
    times = np.array(stamps[10:], dtype=float)
    grid = times[0] + 1e7 * np.arange(len(times))
    late = times - grid
    return list(np.abs(late - np.median(late)) / 1e3)


def bare_timer(stamps: list[int]) -> Node:
    """A node whose timer does nothing but note the time."""
    node = Node("bare_timer")
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    node.create_timer(0.01, lambda: stamps.append(time.monotonic_ns()), clock=clock)
    return node


def ticking_controller(stamps: list[int]) -> Node:
    """The controller in real time; its control messages are noted as they are published."""
    node = ControllerNode()
    publish = node.publish_control

    def noted(control: float, stamp_ns: int) -> None:
        stamps.append(time.monotonic_ns())
        publish(control, stamp_ns)

    node.publish_control = noted  # type: ignore[method-assign]  # in front of the real one
    node.set_parameters([Parameter("allow_zero_gains", value=True)])
    node.start()
    return node


def _until(executor: Executor, ready: Callable[[], bool], who: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not ready():
        if time.monotonic() > deadline:
            raise InputError(f"{who} did not appear within {PATIENCE:g} s")
        executor.spin_until_future_complete(Future(), timeout_sec=0.05)
    executor.spin_until_future_complete(Future(), timeout_sec=0.3)


def machine() -> str:
    """What the figures were measured on."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, {platform.system()}"


def measure(samples: int, seconds: float, console: Console) -> Table:
    """Take all figures, alternating with their baselines, and put them into a table."""
    table = Table(title=f"ROS figures ({machine()})")
    for column in ("figure", "value", "baseline", "ratio"):
        table.add_column(column)
    with console.status("measuring the loop"):
        bounces, two = [], []
        for _ in range(3):
            bounces.append(ping_pong(samples))
            two.append(lockstep_two_processes(samples))
        base, pair, one = statistics.median(bounces), statistics.median(two), lockstep_one_process(samples)
    table.add_row("ping-pong, two processes", f"{base:,.0f} /s", "-", "1")
    for name, rate in (("lockstep loop, two processes", pair), ("lockstep loop, one process", one)):
        table.add_row(name, f"{rate:,.0f} samples/s", f"{base:,.0f} /s (ping-pong)", f"{rate / base:.2f}")
    table.add_row("50 s at 10 ms, two processes", f"{5000 / pair:.2f} s", "50 s (real time)", f"{5000 / pair / 50:.3f}")
    with console.status("measuring the timers"):
        bare, ours = jitter(bare_timer, seconds), jitter(ticking_controller, seconds)
    for share in (50, 99):
        ours_us, bare_us = float(np.percentile(ours, share)), float(np.percentile(bare, share))
        name = f"controller at 100 Hz, jitter, {share} % below"
        table.add_row(name, f"{ours_us:.0f} us", f"{bare_us:.0f} us (bare timer)", f"{ours_us / bare_us:.2f}")
    with console.status("measuring the processor's time"):
        starts = [node_cost(GAINS, seconds, _until) for _ in range(STARTS)]
    ratios = sorted(ours / bare for ours, bare in starts)
    cost, base = (statistics.fmean(shares) for shares in zip(*starts, strict=True))
    name = "controller at 200 Hz, share of a core"
    value = f"{cost:.1%}; of {STARTS} starts, whose ratios go from {ratios[0]:.2f} to {ratios[-1]:.2f}"
    table.add_row(name, value, f"{base:.1%} (bare node with its traffic)", f"{cost / base:.2f}")
    with console.status("measuring many joints and many loops"):
        joints, loops = (costs(GAINS, 2.0 * seconds, _until) for costs in (joint_costs, loop_costs))
    for key, what in (("one", "1 joint, one node"), ("single", "single loop")):
        name, ratio = "7 joints at 200 Hz, one node, share of a core", f"{joints['seven'] / joints[key]:.2f}"
        table.add_row(name, f"{joints['seven']:.1%}", f"{joints[key]:.1%} ({what})", ratio)
    name, ratio = "20 loops at 50 Hz, one process, share of a core", f"{loops['loops'] / loops['bare']:.2f}"
    table.add_row(name, f"{loops['loops']:.1%}", f"{loops['bare']:.1%} (20 bare nodes, one process)", ratio)
    with console.status("measuring the nodes that listen"):
        costs = idle_costs(GAINS, max(4.0 * seconds, 20.0), _until)
    for name, option in LISTENERS.items():
        used, least = costs[name].share, costs[option].share
        name = f"idle {name} beside a loop at 100 Hz, share of a core"
        table.add_row(name, f"{used:.1%}", f"{least:.1%} (bare listener)", f"{used / least:.2f}")
    listener = costs["bare_listener"]
    for name, taken in costs.items():
        if name in LISTENERS.values():
            continue
        value, base_value = (f"{c.resident:.0f} MB, private {c.private:.0f} MB" for c in (taken, listener))
        ratio = f"{taken.resident / listener.resident:.2f}"
        table.add_row(f"memory of {name}", value, f"{base_value} (bare node)", ratio)
    return table


OTHERS: dict[str, Callable[[], Node]] = {"echo": Echo, "bare": BareNode}
"""What another process of a measurement can be."""


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the command ``fopid_ros_benchmark``."""
    parser = argparse.ArgumentParser(prog="fopid_ros_benchmark", description="Measure the ROS loop.")
    parser.add_argument("--samples", type=int, default=5000, help="samples of each run (5000)")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, nothing else")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the jitter measurements [s] (5)")
    for option in OTHERS:
        parser.add_argument(f"--{option}", dest="other", action="store_const", const=option, help=argparse.SUPPRESS)
    options = parser.parse_args(args)
    if options.other:
        return serve(OTHERS[options.other])
    console = Console(stderr=options.json)
    prepare_middleware()  # for the nodes that are no more than a baseline, too
    rclpy.init()
    try:
        table = measure(options.samples, options.seconds, console)
        if options.json:
            cells = zip(*(column.cells for column in table.columns), strict=True)
            names = [str(column.header) for column in table.columns]
            print(json.dumps({"machine": machine(), "figures": [dict(zip(names, row, strict=True)) for row in cells]}))
        else:
            console.print(table)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
