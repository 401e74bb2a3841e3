"""What seven joints in one node cost beside one, and twenty loops in one process beside twenty bare nodes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.benchmarks.cpu import PERIOD, BareNode, cpu_seconds, serve
from fopid_ros.experiment.child_processes import Children, command, ros_arguments

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
LOOPS = tuple(f"loop{k}" for k in range(1, 21))
LOOP_PERIOD = 0.02
WARM_UP = 3.0  # [s]

Until = Callable[[Executor, Callable[[], bool], str], None]


class Robot(Node):
    """Joint states and setpoints at the rate of the controllers, for one joint and for seven; hears their controls."""

    def __init__(self) -> None:
        super().__init__("robot")
        self.received = dict.fromkeys(("seven", "one", "single"), 0)
        self._states = [(self.create_publisher(JointState, f"{space}/measurement", 1),
                         self.create_publisher(JointState, f"{space}/setpoint", 1), names)
                        for space, names in (("seven", JOINTS), ("one", JOINTS[:1]))]  # fmt: skip
        self._single = [
            self.create_publisher(ScalarStamped, f"single/{name}", 1) for name in ("measurement", "setpoint")
        ]
        for space in self.received:
            kind = ScalarStamped if space == "single" else Float64MultiArray
            self.create_subscription(kind, f"{space}/control", partial(self._count, space), 10)
        self._sent = 0
        self.create_timer(PERIOD, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _count(self, space: str, message: object) -> None:
        self.received[space] += 1

    def _send(self) -> None:
        self._sent += 1
        position = 0.01 * (self._sent % 100)
        asks = self._sent % 200 == 0
        for measurement, setpoint, names in self._states:
            message = JointState(name=names, position=[position] * len(names))
            measurement.publish(message)
            if asks:
                setpoint.publish(message)
        for publisher in self._single[: 1 + asks]:
            publisher.publish(ScalarStamped(value=position))


class Sensors(Node):
    """Measurements and setpoints of twenty loops; hears what loops and bare nodes publish."""

    def __init__(self) -> None:
        super().__init__("sensors")
        self._senders = [[self.create_publisher(ScalarStamped, f"{loop}/{name}", 1) for loop in LOOPS]
                            for name in ("measurement", "setpoint")]  # fmt: skip
        self.received: dict[str, int] = {}
        for loop in LOOPS:
            for control, state in (("control", "fopid_controller/state"), ("bare/control", "bare/state")):
                for topic, kind in ((control, ScalarStamped), (state, FopidState)):
                    self.received[f"{loop}/{topic}"] = 0
                    self.create_subscription(kind, f"{loop}/{topic}", partial(self._count, f"{loop}/{topic}"), 10)
        self._sent = 0
        self.create_timer(LOOP_PERIOD, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _count(self, topic: str, message: object) -> None:
        self.received[topic] += 1

    def _send(self) -> None:
        self._sent += 1
        message = ScalarStamped(value=0.01 * (self._sent % 100))
        for publishers in self._senders[: 1 + (self._sent % 50 == 0)]:
            for publisher in publishers:
                publisher.publish(message)


def shares(
    feeder: Robot | Sensors, processes: Mapping[str, Sequence[str]], seconds: float, until: Until
) -> dict[str, float]:
    """Shares of a core of processes that a node feeds, all at the same time."""
    executor = EventsExecutor()
    executor.add_node(feeder)
    with Children() as children:
        for name, arguments in processes.items():
            children.start(name, arguments)
        until(executor, lambda: min(feeder.received.values()) > 50, " and ".join(processes))
        executor.spin_until_future_complete(Future(), timeout_sec=WARM_UP)
        ids = children.process_ids()
        before = {name: cpu_seconds(process_id) for name, process_id in ids.items()}
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)
        used = {name: cpu_seconds(process_id) - before[name] for name, process_id in ids.items()}
    feeder.destroy_node()
    return {name: time / seconds for name, time in used.items()}


def joint_costs(gains: Mapping[str, float], seconds: float, until: Until) -> dict[str, float]:
    """Shares of a core at 200 Hz of a controller of seven joints, of one joint, and of a single loop."""
    controller = command("fopid_controller")

    def of(names: Sequence[str], space: str) -> list[str]:
        own = {f"gains.{joint}.{name}": value for joint in names for name, value in gains.items()}
        parameters = {"dof_names": list(names), "sample_time": PERIOD, **own}
        return [controller, *ros_arguments(parameters, space), "--log-level", "fatal"]

    single = [controller, *ros_arguments({**gains, "sample_time": PERIOD}, "single"), "--log-level", "fatal"]
    return shares(
        Robot(), {"seven": of(JOINTS, "seven"), "one": of(JOINTS[:1], "one"), "single": single}, seconds, until
    )


def loop_costs(gains: Mapping[str, float], seconds: float, until: Until) -> dict[str, float]:
    """Shares of a core of twenty loops at 50 Hz in one process, and of twenty bare nodes with the same traffic."""
    parameters = {**gains, "sample_time": LOOP_PERIOD}
    loops = [command("fopid_loops"), *LOOPS, *ros_arguments(parameters), "--log-level", "fatal"]
    bare = [sys.executable, "-m", "fopid_ros.benchmarks.many"]
    return shares(Sensors(), {"loops": loops, "bare": bare}, seconds, until)


if __name__ == "__main__":
    sys.exit(serve(*(partial(BareNode, loop, LOOP_PERIOD) for loop in LOOPS)))
