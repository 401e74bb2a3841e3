"""A controller that the test feeds: a sensor in real time, or a plant in lockstep, played by the test's node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

from fopid_msgs.msg import FopidState, ScalarStamped

from ..conftest import Graph

NAME = "fopid_controller"
PERIOD = 0.01


def stamped(value: float, stamp_ns: int) -> ScalarStamped:
    message = ScalarStamped(value=value)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


class Diagnosed:
    """Listens to a controller that has been started."""

    def __init__(self, graph: Graph, parameters: Mapping[str, object], *more: str) -> None:
        self.graph = graph
        self.states: list[FopidState] = graph.listen(FopidState, f"{NAME}/state")
        self.controls: list[ScalarStamped] = graph.listen(ScalarStamped, "control")
        self.diagnostics: list[DiagnosticArray] = graph.listen(DiagnosticArray, "/diagnostics")
        self.process = graph.start(NAME, parameters, *more)

    def find(self, *publishers: Any) -> None:
        """Wait until the controller and these publishers know each other, and its topics are known here."""
        for publisher in publishers:
            self.graph.until(publisher.get_subscription_count, f"a reader of {publisher.topic_name}")
        for topic in (f"/{NAME}/state", "/control", "/diagnostics"):
            self.graph.until(lambda topic=topic: self.graph.node.count_publishers(topic), f"a writer of {topic}")

    @property
    def status(self) -> DiagnosticStatus:
        return self.diagnostics[-1].status[0] if self.diagnostics else DiagnosticStatus()

    @property
    def facts(self) -> dict[str, str]:
        return {fact.key: fact.value for fact in self.status.values}

    def diagnosed(self, level: bytes, text: str) -> None:
        """Wait for a report of this level with this text."""
        self.graph.until(
            lambda: self.status.level == level and text in self.status.message,
            f"level {level!r} with {text!r} (is {self.status.level!r} with {self.status.message!r})",
        )

    def recovered(self) -> None:
        """Wait for a report without trouble; ticks that are late on a busy machine are none."""

        def well() -> bool:
            told = [text for text in self.status.message.split("; ") if "ticks late or missing" not in text]
            return self.status.level != DiagnosticStatus.ERROR and told in ([], ["auto"])

        self.graph.until(well, f"a report without trouble (is {self.status.message!r})")


class FedController(Diagnosed):
    """A controller in real time and a sensor: what ``sensor`` and ``setpoint`` are set to is sent every 10 ms."""

    def __init__(self, graph: Graph, parameters: Mapping[str, object], *more: str) -> None:
        super().__init__(graph, parameters, *more)
        self.sensor: float | None = None
        self.setpoint: float | None = None
        self.publishers = {
            name: graph.node.create_publisher(ScalarStamped, name, QoSProfile(depth=1))
            for name in ("measurement", "setpoint", "manual_control")
        }
        graph.node.create_timer(PERIOD, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.find(*self.publishers.values())

    def _send(self) -> None:
        for name, value in (("setpoint", self.setpoint), ("measurement", self.sensor)):
            if value is not None:
                self.publishers[name].publish(ScalarStamped(value=value))

    def run(self, setpoint: float, sensor: float) -> None:
        """Feed both until the controller has taken them."""
        self.setpoint, self.sensor = setpoint, sensor
        self.wait(lambda state: (state.setpoint, state.measurement, state.stale) == (setpoint, sensor, False))

    def wait(self, ready: Callable[[FopidState], bool]) -> FopidState:
        """The first state from now on that is as asked."""
        begun = len(self.states)
        self.graph.until(lambda: any(map(ready, self.states[begun:])), "a state")
        return next(filter(ready, self.states[begun:]))


class LockstepByHand(Diagnosed):
    """A controller in lockstep whose plant is the test: ``tick`` sends a measurement and gives the answer."""

    def __init__(self, graph: Graph, parameters: Mapping[str, object], *more: str) -> None:
        super().__init__(graph, {"trigger": "lockstep", "sample_time": PERIOD, **parameters}, *more)
        # A publisher of depth 1 asks for the acknowledgement with every message, a deeper one once in seconds.
        self._publishers = {
            name: graph.node.create_publisher(ScalarStamped, name, QoSProfile(depth=1))
            for name in ("measurement", "setpoint", "manual_control")
        }
        self.find(*self._publishers.values())
        self.graph.spin(0.3)  # the controller may find the readers of its answers later than they find it

    def send(self, name: str, value: float) -> None:
        from rclpy.duration import Duration

        self._publishers[name].publish(ScalarStamped(value=value))
        assert self._publishers[name].wait_for_all_acked(Duration(seconds=5))

    def tick(self, sample: int, measurement: float) -> float:
        """The control that answers the measurement of a sample, and a state with it."""
        answers, states, stamp = len(self.controls), len(self.states), round(sample * PERIOD * 1e9)
        message = stamped(measurement, stamp)
        self._publishers["measurement"].publish(message)
        self.graph.until(lambda: len(self.controls) > answers and len(self.states) > states, f"answer to {sample}")
        assert self.controls[-1].header.stamp == message.header.stamp
        return self.controls[-1].value
