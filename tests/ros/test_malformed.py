"""Whoever can publish can send any bytes: what is no message is refused, counted and told in a line; nothing else."""

from __future__ import annotations

import re
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from fopid_msgs.msg import FopidState, ScalarStamped

from .conftest import MALFORMED, Graph
from .controller.fed import PERIOD, LockstepByHand

NODES = ("plant_simulator", "fopid_controller", "fopid_tuner", "dashboard")
INPUTS = ("measurement", "setpoint", "feedforward", "manual_control", "tracking")
STATE = "fopid_controller/state"
MALFORMED_TOLD = "malformed messages refused"


class Reports:
    """The newest report of each node on /diagnostics."""

    def __init__(self, graph: Graph) -> None:
        self._newest: dict[str, DiagnosticStatus] = {}
        graph.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, QoSProfile(depth=100))

    def _take(self, message: DiagnosticArray) -> None:
        self._newest |= {status.name.strip("/"): status for status in message.status}

    def fact(self, node: str, key: str) -> int:
        values = self._newest[node].values if node in self._newest else ()
        return next((int(value.value) for value in values if value.key == key), 0)


def publishers(graph: Graph, names: dict[str, type]) -> list[Any]:
    """Publishers that are heard, and keep what waits."""
    made = [graph.node.create_publisher(kind, name, 100) for name, kind in names.items()]
    for publisher in made:
        graph.until(publisher.get_subscription_count, f"a reader of {publisher.topic_name}")
    return made


@pytest.mark.slow
def test_malformed_bytes_on_every_topic_are_refused_by_every_node_and_the_loop_goes_on(graph: Graph) -> None:
    reports = Reports(graph)
    states: list[FopidState] = graph.listen(FopidState, STATE)
    graph.start("plant_simulator", {"process": "1/(s+1)"})
    graph.start("fopid_controller", {"kp": 0.5, "ki": 0.2, "setpoint.initial": 1.0, "tracking.enabled": True})
    graph.start("fopid_tuner", {"process": "1/(s+1)"})
    graph.start("dashboard", {}, "--", "--port", "0")
    graph.until(lambda: states and states[-1].control > 0.0, "a loop")
    made = publishers(graph, dict.fromkeys((*INPUTS, "control", "disturbance"), ScalarStamped) | {STATE: FopidState})
    refused = {("fopid_controller", f"refused of the {name}") for name in INPUTS} | {
        ("plant_simulator", "refused values"), ("fopid_tuner", MALFORMED_TOLD), ("dashboard", MALFORMED_TOLD)
    }  # fmt: skip

    def refused_by_all() -> bool:
        for data in MALFORMED:
            for publisher in made:
                publisher.publish(data)
            graph.spin(0.05)  # most readers keep the newest message only
        return all(reports.fact(*each) >= 2 for each in refused)

    def told_of(topic: str, kind: str) -> bool:
        return re.search(rf"{topic}: \d+ bytes that are no {kind}; refused \(\d+ so far\)", graph.logs()) is not None

    graph.until(refused_by_all, "refusals")
    graph.until(lambda: refused_by_all() and told_of("measurement", "ScalarStamped"), "lines of the log")
    graph.until(lambda: refused_by_all() and told_of(STATE, "FopidState"), "the dashboard's line")
    begun = len(states)
    assert states[-1].refused >= 2 * len(INPUTS)
    graph.until(lambda: len(states) > begun + 20 and not states[-1].stale, "the loop going on")
    assert {node: reports.fact(node, "internal errors") for node, _ in refused} == dict.fromkeys(NODES, 0)
    assert "Traceback" not in graph.logs()


@pytest.mark.slow
def test_in_lockstep_a_measurement_that_cannot_be_read_or_answered_is_no_tick(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"ki": 1.0, "setpoint.initial": 1.0, "safe_control": -5.0})
    assert loop.tick(1, 0.0) == pytest.approx(0.5 * PERIOD)  # the integral of an error of 1, by trapezoids
    (publisher,) = publishers(graph, {"measurement": ScalarStamped})
    late = ScalarStamped(value=0.0)
    late.header.stamp.sec, late.header.stamp.nanosec = 2**31 - 1, 10**9  # no answer can say the same

    def refused() -> bool:  # the first ones may be sent before the controller knows who sends them
        for message in (*MALFORMED, late):
            publisher.publish(message)
        graph.spin(0.3)
        return int(loop.facts.get("refused of the measurement", 0)) > len(MALFORMED)

    graph.until(refused, "refusals")
    assert len(loop.controls) == 1
    assert loop.tick(2, 0.0) == pytest.approx(1.5 * PERIOD)
    assert loop.states[-1].refused > len(MALFORMED)
    logs = graph.logs()
    assert "Traceback" not in logs
    assert re.search(r"measurement: \d+ bytes that are no ScalarStamped; refused \(\d+ so far\)", logs)


@pytest.mark.slow
def test_what_the_middleware_reads_itself_comes_whole_or_not_at_all(graph: Graph) -> None:
    """Types that are not read as bytes, since they hold more than numbers."""
    kind = {"control.type": "std_msgs/msg/Float64MultiArray", "control.field": "data[0]"}
    graph.start("plant_simulator", {"process": "1/(s+1)", **kind})
    measurements = graph.listen(ScalarStamped, "measurement")
    (publisher,) = publishers(graph, {"control": Float64MultiArray})
    for data in MALFORMED:
        publisher.publish(data)

    def goes_on() -> bool:
        publisher.publish(Float64MultiArray(data=[1.0]))
        return bool(measurements) and measurements[-1].value > 0.1

    graph.until(goes_on, "the plant going on")
    assert "internal error" not in graph.logs()
