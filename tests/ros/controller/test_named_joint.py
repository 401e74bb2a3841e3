"""The controller on one joint of a robot's joint states, found by its name."""

from __future__ import annotations

import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fopid_msgs.msg import FopidState

from ..conftest import Graph
from .fed import NAME

PARAMETERS = {
    "kp": 2.0, "setpoint.initial": -3.0, "angle_wraparound": True, "measurement_timeout": 0.3,
    "measurement.type": "sensor_msgs/msg/JointState", "measurement.field": "position[elbow]",
    "measurement.scale": -1.0, "measurement.offset": 0.5,
    "control.type": "sensor_msgs/msg/JointState", "control.field": "effort[elbow]",
    "setpoint.type": "std_msgs/msg/Float64MultiArray", "setpoint.field": "data[1]",
}  # fmt: skip


def test_a_joint_by_name_with_scale_and_the_shortest_way(graph: Graph) -> None:
    states, controls = graph.listen(FopidState, f"{NAME}/state"), graph.listen(JointState, "control")
    diagnostics = graph.listen(DiagnosticArray, "/diagnostics")
    graph.start(NAME, PARAMETERS)
    sensor = graph.node.create_publisher(JointState, "measurement", QoSProfile(depth=1))
    setpoint = graph.node.create_publisher(Float64MultiArray, "setpoint", QoSProfile(depth=1))
    for publisher in (sensor, setpoint):
        graph.until(publisher.get_subscription_count, f"a reader of {publisher.topic_name}")
    for topic in (f"/{NAME}/state", "/control"):
        graph.until(lambda topic=topic: graph.node.count_publishers(topic), f"a writer of {topic}")

    def taken(**message: list) -> FopidState:
        """The state once this has been measured."""
        begun = len(states)

        def measured() -> bool:  # published until it is: a first message may find no reader yet
            sensor.publish(JointState(**message))
            return any(state.measurement == 3.0 for state in states[begun:])

        graph.until(measured, "3 measured")
        return states[-1]

    # 0.5 - (-2.5) = 3 rad; from there to -3 rad the shortest way is forward, 2 pi - 6.
    for names in (["shoulder", "elbow"], ["elbow", "shoulder"]):
        state = taken(name=names, position=[{"elbow": -2.5}.get(name, 9.0) for name in names])
        assert state.error == pytest.approx(2.0 * math.pi - 6.0)
        graph.until(lambda: controls, "a control")
        assert controls[-1].name == ["elbow"]
        assert controls[-1].effort[0] == pytest.approx(2.0 * (2.0 * math.pi - 6.0))

    def followed() -> bool:
        setpoint.publish(Float64MultiArray(data=[7.0, 1.0]))
        return bool(states[-1].setpoint == 1.0)

    graph.until(followed, "the setpoint in an array")

    sensor.publish(JointState(name=["shoulder", "wrist"], position=[1.0, 2.0]))
    told = "measurement.field = 'position[elbow]': no 'elbow' in name; allowed: shoulder, wrist; refused (1 so far)"
    graph.until(lambda: told in graph.logs(), told)
    told = "setpoint.field = 'data[1]': 1 elements in 'data[1]'; allowed: 2 and more"

    def refused() -> bool:  # one line a second
        setpoint.publish(Float64MultiArray(data=[7.0]))
        return told in graph.logs()

    graph.until(refused, told)
    graph.until(lambda: "measurement stale" in diagnostics[-1].status[0].message, "its diagnosis")
    assert diagnostics[-1].status[0].level == DiagnosticStatus.ERROR
    assert states[-1].setpoint == 1.0
    assert states[-1].stale


@pytest.mark.slow
def test_the_plant_too_takes_a_joint_by_name(graph: Graph) -> None:
    """Messages of both ends mean the same: what the controller scales, the plant scales back."""
    travels = {"type": "sensor_msgs/msg/JointState", "field": "effort[elbow]", "scale": 100.0, "offset": -7.0}
    both = {f"{signal}.{part}": value for signal in ("measurement", "control") for part, value in travels.items()}
    states, sent = graph.listen(FopidState, f"{NAME}/state"), graph.listen(JointState, "measurement")
    graph.start("plant_simulator", {"process": "1/(0.1s+1)", **both})
    graph.start(NAME, {"kp": 1.0, "ki": 10.0, "setpoint.initial": 2.0, **both})
    graph.until(lambda: states and abs(states[-1].measurement - 2.0) < 1e-3, "the loop at its setpoint")
    assert sent[-1].effort[0] == pytest.approx(0.09, abs=1e-3)
