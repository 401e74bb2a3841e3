"""One joint of a robot is learnt and tuned while the others go on as they are; the robot knows standard messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_msgs.action import Autotune
from fopid_msgs.srv import Tune

from ...patience import FACTOR
from ..conftest import SETTLE, Graph

NAMES = ("kp", "ki", "kd", "lam", "mu")
JOINTS = {"shoulder": (1.0, 0.5, 0.1), "elbow": (2.0, 0.3, 0.08), "wrist": (0.5, 0.2, 0.05)}
"""Gain and two lags [s] of each."""
PERIOD, SUBSTEPS = 0.01, 5


class Robot:
    """Three joints that publish joint states, in another order each time, and hear an array of efforts."""

    def __init__(self, graph: Graph) -> None:
        node = graph.node
        self.positions, self._speeds = np.zeros(3), np.zeros(3)
        self._efforts, self._noise = np.zeros(3), np.random.default_rng(7)
        self._time = time.monotonic()
        self._states = node.create_publisher(JointState, "measurement", 1)
        node.create_subscription(Float64MultiArray, "control", self._heard, 1)
        node.create_timer(PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _heard(self, message: Float64MultiArray) -> None:
        self._efforts = np.array(message.data)

    def _tick(self) -> None:
        gains, slow, fast = np.array(list(JOINTS.values())).T
        step = PERIOD / SUBSTEPS
        while self._time < time.monotonic():  # a robot does not wait for a late timer
            self._time += step
            self._speeds += step * (gains * self._efforts - self._speeds) / fast
            self.positions += step * (self._speeds - self.positions) / slow
        measured = self.positions + 0.002 * self._noise.standard_normal(3)
        order = self._noise.permutation(3)
        names = list(JOINTS)
        self._states.publish(JointState(name=[names[k] for k in order], position=[float(measured[k]) for k in order]))


def _process(joint: str) -> str:
    gain, slow, fast = JOINTS[joint]
    return f"{gain}/(({slow}s+1)({fast}s+1))"


@pytest.fixture
def gains(graph: Graph) -> Callable[[str], list[float]]:
    """A robot under a hand-made PI for each joint and a tuner of the elbow; gives the gains of a joint."""
    robot = Robot(graph)
    pi = {f"gains.{joint}.{name}": value for joint in JOINTS for name, value in (("kp", 0.4), ("ki", 0.8))}
    graph.start("fopid_controller", {"dof_names": list(JOINTS), "sample_time": PERIOD, **pi})
    graph.start("fopid_tuner", {"dof": "elbow", "sample_time": PERIOD})
    setpoint = graph.node.create_publisher(JointState, "setpoint", 1)
    graph.until(setpoint.get_subscription_count, "the controller")
    graph.spin(SETTLE)
    setpoint.publish(JointState(name=list(JOINTS), position=[1.0] * 3))
    graph.until(lambda: np.abs(robot.positions - 1.0).max() < 0.02, "the robot at rest")
    return lambda joint: graph.get("fopid_controller", *(f"gains.{joint}.{name}" for name in NAMES))


def _accept(joint: str, gains: list[float]) -> None:
    """The gains hold the joint as it is, with room to spare."""
    loop = Loop(read_process(_process(joint)), Fopid(*gains))
    assert stability(loop).stable
    assert margins(loop).ms < 2.5


@pytest.mark.long
def test_a_joint_is_learnt_tuned_and_watched_by_itself(graph: Graph, gains: Callable[[str], list[float]]) -> None:
    before = {joint: gains(joint) for joint in JOINTS}
    client = ActionClient(graph.node, Autotune, "fopid_tuner/autotune")
    graph.until(client.server_is_ready, "the action")
    handle = graph.result(client.send_goal_async(Autotune.Goal(deviation_max=0.3)))
    assert handle.accepted
    result: Any = graph.result(handle.get_result_async(), 110.0 * FACTOR).result
    assert result.success, result.message
    assert result.applied
    tuned = gains("elbow")
    assert tuned != before["elbow"]
    assert tuned == [getattr(result.gains, name) for name in NAMES]
    _accept("elbow", tuned)
    assert {joint: gains(joint) for joint in ("shoulder", "wrist")} == {
        joint: before[joint] for joint in ("shoulder", "wrist")
    }
    learnt, known = read_process(result.model.process), read_process(_process("elbow"))
    at = np.array([2j * math.pi * 0.3])
    assert np.abs(learnt(at) / known(at) - 1.0).max() < 0.2
    (status, origin) = graph.get("fopid_controller", "gains.elbow.status", "gains.elbow.origin")
    assert (status, origin) == ("verified", "/fopid_tuner")


@pytest.mark.slow
def test_the_tuner_goes_from_joint_to_joint(graph: Graph, gains: Callable[[str], list[float]]) -> None:
    before = {joint: gains(joint) for joint in JOINTS}

    def tune(joint: str) -> Tune.Response:
        request = Tune.Request(process=_process(joint), method="frequency", phase_margin=1.2, crossover=2.0, apply=True)
        return graph.call(Tune, "fopid_tuner/tune", request)

    answer = tune("elbow")
    assert answer.applied, answer.message
    assert gains("elbow") == [getattr(answer.gains, name) for name in NAMES]
    _accept("elbow", gains("elbow"))
    refused = graph.set("fopid_tuner", dof="wrist")
    assert not refused.successful
    assert "dof = 'wrist'; allowed: 'elbow' until the node is cleaned up" in refused.reason
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        graph.call(ChangeState, "fopid_tuner/change_state", ChangeState.Request(transition=Transition(id=transition)))
    assert graph.set("fopid_tuner", dof="wrist").successful
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        graph.call(ChangeState, "fopid_tuner/change_state", ChangeState.Request(transition=Transition(id=transition)))
    answer = tune("wrist")
    assert answer.applied, answer.message
    _accept("wrist", gains("wrist"))
    assert gains("wrist") != before["wrist"]
    assert gains("shoulder") == before["shoulder"]
