"""What the controller node costs at 200 Hz, beside a node with the same traffic and no control law."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.common.managed_node import loop_qos
from fopid_ros.common.middleware import use_profile
from fopid_ros.experiment.child_processes import Children, command, ros_arguments

PERIOD = 0.005
SWEEP = 1e-3
"""By so much of a period the bare node's clock is fast and the sensor's slow: in 5 s at 200 Hz ticks and samples meet
at every phase. Who wakes while another process is awake needs much less time for it."""
LONGEST = 600.0  # [s] what another process of a measurement may run


class BareNode(Node):
    """Subscribes and publishes what the controller does, at the same rate, and works nothing out."""

    def __init__(self, namespace: str | None = None, period: float = (1.0 - SWEEP) * PERIOD) -> None:
        super().__init__("bare", namespace=namespace)
        for name in ("setpoint", "measurement", "feedforward", "manual_control"):
            qos = loop_qos(lockstep=False, reliable=name != "measurement")
            self.create_subscription(ScalarStamped, name, self._ignore, qos)
        self._control, self._state = ScalarStamped(), FopidState()
        self._control_publisher = self.create_publisher(ScalarStamped, "~/control", loop_qos(lockstep=False))
        self._state_publisher = self.create_publisher(FopidState, "~/state", QoSProfile(depth=10))
        self.create_timer(period, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _ignore(self, message: ScalarStamped) -> None:
        pass

    def _tick(self) -> None:
        self._control_publisher.publish(self._control)
        self._state_publisher.publish(self._state)


class Sensor(Node):
    """Sends measurements and a setpoint; reads what both nodes publish, as a plant and a plot do."""

    def __init__(self) -> None:
        super().__init__("sensor")
        self._measurement = self.create_publisher(ScalarStamped, "measurement", 1)
        self._setpoint = self.create_publisher(ScalarStamped, "setpoint", 1)
        self._sent = 0
        self.received = dict.fromkeys(("control", "bare/control", "fopid_controller/state", "bare/state"), 0)
        for topic in self.received:
            kind = FopidState if topic.endswith("state") else ScalarStamped
            self.create_subscription(kind, topic, partial(self._count, topic), 10)
        self.create_timer((1.0 + SWEEP) * PERIOD, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _count(self, topic: str, message: ScalarStamped | FopidState) -> None:
        self.received[topic] += 1

    def _send(self) -> None:
        self._sent += 1
        self._measurement.publish(ScalarStamped(value=0.01 * (self._sent % 100)))
        if self._sent % 200 == 0:
            self._setpoint.publish(ScalarStamped(value=1.0))


def cpu_seconds(process_id: int) -> float:
    """Processor time that a process has used, of all its threads [s], as the scheduler counts it.

    ``/proc/PID/stat`` counts in hundredths of a second: too coarse for a ratio of two nodes that use a tenth of a core.
    """
    threads = Path(f"/proc/{process_id}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) * 1e-9


def serve(*makers: Callable[[], Node]) -> int:
    """Be another process of a measurement, on the transport that the nodes use; its parent ends it."""
    use_profile()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor()
    nodes = [make() for make in makers]
    for node in nodes:
        executor.add_node(node)
    executor.spin_until_future_complete(Future(), timeout_sec=LONGEST)
    return 0


def node_cost(
    gains: dict[str, float], seconds: float, until: Callable[[Executor, Callable[[], bool], str], None]
) -> tuple[float, float]:
    """Shares of a core that the controller and the bare node use, measured at the same time.

    ``until`` spins an executor until a condition holds.
    """
    sensor, executor = Sensor(), EventsExecutor()
    executor.add_node(sensor)
    controller = [command("fopid_controller"), *ros_arguments({**gains, "sample_time": PERIOD}), "--log-level", "warn"]
    with Children() as children:
        children.start("bare", [sys.executable, "-m", "fopid_ros.benchmarks.benchmark", "--bare"])
        children.start("fopid_controller", controller)
        until(executor, lambda: min(sensor.received.values()) > 200, "controller and bare node")
        before = {name: cpu_seconds(process_id) for name, process_id in children.process_ids().items()}
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)
        used = {name: cpu_seconds(process_id) - before[name] for name, process_id in children.process_ids().items()}
    sensor.destroy_node()
    return used["fopid_controller"] / seconds, used["bare"] / seconds
