"""A setpoint that is sent once arrives, and one that its publisher keeps outlives the controller."""

from __future__ import annotations

import subprocess
import time

import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from fopid_msgs.msg import FopidState, ScalarStamped

from ..conftest import BIN, PATIENCE, Graph, stamp

NAME = "fopid_controller"
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def publish_once(graph: Graph, value: float) -> None:
    """As ``ros2 topic pub --once``: a node of its own, gone soon after the first reader was found and served."""
    context = Context()
    rclpy.init(context=context, domain_id=graph.domain)
    node = Node("once", context=context)
    publisher = node.create_publisher(ScalarStamped, "setpoint", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.1)
    publisher.publish(ScalarStamped(value=value))
    # `ros2 topic pub --once` gives it 0.1 s, in which a busy machine may not deliver it.
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize("times", [2, pytest.param(10, marks=[pytest.mark.slow, pytest.mark.timeout(600)])])
def test_a_setpoint_published_once_reaches_the_controller_beside_a_tuner(graph: Graph, times: int) -> None:
    graph.start("plant_simulator", {})
    graph.start(NAME, {"kp": 1.0})
    graph.start("fopid_tuner", {"process": "P1"})
    states = graph.listen(FopidState, f"{NAME}/state")
    graph.until(lambda: graph.node.count_publishers("/fopid_tuner/result"), "the tuner")
    graph.until(lambda: graph.node.count_subscribers("/measurement") == 2, "a tuner that listens")
    assert graph.node.count_subscribers("/setpoint") == 1
    for k in range(1, times + 1):
        publish_once(graph, float(k))
        graph.until(lambda k=k: states and states[-1].setpoint == k, f"setpoint {k} of {times}")


@pytest.mark.slow
def test_a_controller_that_is_started_again_goes_on_with_the_setpoint_that_is_kept(graph: Graph) -> None:
    graph.start("plant_simulator", {})
    states = graph.listen(FopidState, f"{NAME}/state")
    older, newer = (graph.node.create_publisher(ScalarStamped, "setpoint", KEPT) for _ in range(2))
    older.publish(ScalarStamped(value=1.0))
    newer.publish(ScalarStamped(value=2.5))
    for _ in range(2):
        began = time.time()  # the one before is heard of for a while after its end
        controller = graph.start(NAME, {"kp": 1.0, "setpoint.initial": 0.5})
        graph.until(
            lambda began=began: any(stamp(state) > began and state.setpoint == 2.5 for state in states[-1:]),
            "the newest setpoint that is kept",
        )
        controller.terminate()
        assert controller.wait(10) == 0
        graph.until(lambda: not graph.node.count_publishers(f"/{NAME}/state"), "its end")


def test_what_is_kept_gives_way_to_what_is_sent_now(graph: Graph) -> None:
    """By a publisher that keeps nothing, whether the kept value is found before it or after it."""
    graph.start("plant_simulator", {})
    graph.start(NAME, {"kp": 1.0})
    states = graph.listen(FopidState, f"{NAME}/state")
    plain = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
    graph.until(plain.get_subscription_count, "the controller")
    plain.publish(ScalarStamped(value=3.0))
    graph.until(lambda: states and states[-1].setpoint == 3.0, "the setpoint")
    kept = graph.node.create_publisher(ScalarStamped, "setpoint", KEPT)
    graph.spin(0.5)
    assert states[-1].setpoint == 3.0
    kept.publish(ScalarStamped(value=4.0))
    graph.until(lambda: states[-1].setpoint == 4.0, "the setpoint of the other")
    plain.publish(ScalarStamped(value=5.0))
    graph.until(lambda: states[-1].setpoint == 5.0, "the setpoint of the first again")
    assert "incompatible QoS" not in graph.logs()


def test_a_controller_without_gains_does_not_start_unless_told_to(graph: Graph) -> None:
    command = [BIN / NAME, "--ros-args", "-p", "lam:=1.2"]
    ended = subprocess.run(command, env=graph.environment, timeout=100, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (
        2, "error: kp = ki = kd = 0; allowed: a gain that is not 0, or allow_zero_gains = true\n"
    )  # fmt: skip
    graph.start(NAME, {"allow_zero_gains": True})
    assert graph.get(NAME, "kp") == [0.0]
