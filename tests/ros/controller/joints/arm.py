"""A controller of many joints that the test feeds with joint states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fopid_msgs.msg import FopidState

from ...conftest import Graph

NAME = "fopid_controller"
JOINTS = ("shoulder", "elbow", "wrist")
PERIOD = 0.01


def joint_state(values: Mapping[str, float], stamp_ns: int = 0, field: str = "position") -> JointState:
    message = JointState(name=list(values), **{field: list(values.values())})
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


class Arm:
    """The controller of three joints; its answers are kept."""

    def __init__(self, graph: Graph, parameters: Mapping[str, object], joints: Sequence[str] = JOINTS) -> None:
        self.graph = graph
        self.controls: list[Float64MultiArray] = graph.listen(Float64MultiArray, "control")
        self.diagnostics: list[DiagnosticArray] = graph.listen(DiagnosticArray, "/diagnostics")
        self.states: dict[str, list[FopidState]] = {
            joint: graph.listen(FopidState, f"{NAME}/{joint}/state") for joint in joints
        }
        self._publishers: dict[str, Any] = {
            name: graph.node.create_publisher(JointState, name, QoSProfile(depth=1))
            for name in ("measurement", "setpoint", "feedforward", "manual_control")
        }
        graph.start(NAME, {"dof_names": list(joints), "sample_time": PERIOD, **parameters})
        for publisher in self._publishers.values():
            graph.until(publisher.get_subscription_count, f"a reader of {publisher.topic_name}")
        for topic in ("/control", "/diagnostics", *(f"/{NAME}/{joint}/state" for joint in joints)):
            graph.until(lambda topic=topic: graph.node.count_publishers(topic), f"a writer of {topic}")
        graph.spin(0.5)  # the controller looks for readers of its states five times a second

    def send(self, name: str, message: JointState) -> None:
        self._publishers[name].publish(message)
        assert name == "measurement" or self._publishers[name].wait_for_all_acked(Duration(seconds=5))

    def tick(self, sample: int, measured: Mapping[str, float]) -> list[float]:
        """In lockstep: the controls that answer a measurement."""
        answers = len(self.controls)
        self.send("measurement", joint_state(measured, round(sample * PERIOD * 1e9)))
        self.graph.until(lambda: len(self.controls) > answers, f"an answer to sample {sample}")
        return list(self.controls[-1].data)

    @property
    def told(self) -> str:
        return self.diagnostics[-1].status[0].message if self.diagnostics else ""
