"""What a tuner changes of a running controller comes back whole."""

from __future__ import annotations

import math
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.controller_client import DEADBAND, PACE, ControllerClient, RunningDesign

from ..conftest import Graph

CONTROLLER = "fopid_controller"


def client_of(graph: Graph) -> ControllerClient:
    """That of a tuner, in the thread that spins."""
    background: Any = SimpleNamespace(
        result=lambda ask, _: graph.result(ask()),
        value=lambda call, _: call(),
        on_executor=graph.executor.create_task,
        start=lambda _, work: threading.Thread(target=work, daemon=True).start(),
    )
    return ControllerClient(graph.node, CONTROLLER, background)


def test_gains_filter_weights_pace_and_deadband_are_taken_and_put_back_all_at_once(graph: Graph) -> None:
    graph.start(CONTROLLER, {"kp": 1.0, "ki": 0.5, "control_rate_max": 9.0, "deadband": 0.01})
    graph.until(lambda: CONTROLLER in graph.node.get_node_names(), "the controller")
    client, changes = client_of(graph), graph.changes(CONTROLLER)
    new = RunningDesign(Fopid(2.0, 1.0), MeasurementFilter(2, 0.1), SetpointWeights(0.5, 0.0), Pace(5.0, 2.0), 0.02)
    before = client.apply(new, "trial")
    assert (before.pace, before.deadband) == (Pace(9.0, math.inf), 0.01)
    assert client.design() == new
    client.confirm(new)
    client.apply(before)
    assert client.design() == before
    graph.until(lambda: sum("kp" in change for change in changes) == 2, "both changes")
    both = [change for change in changes if "kp" in change]
    assert [tuple(change[name] for name in PACE) for change in both] == [(5.0, 2.0), (9.0, math.inf)]
    assert [change[DEADBAND] for change in both] == [0.02, 0.01]


def test_gains_without_a_pace_leave_it_and_a_pace_leaves_the_gains(graph: Graph) -> None:
    graph.start(CONTROLLER, {"kp": 1.0, "ki": 0.5, "control_rate_max": 9.0})
    graph.until(lambda: CONTROLLER in graph.node.get_node_names(), "the controller")
    client = client_of(graph)
    client.apply(RunningDesign(Fopid(2.0, 1.0)), "verified")
    assert (client.design().pace, client.design().deadband) == (Pace(9.0, math.inf), 0.0)
    client.hold(Pace(3.0, 1.0))
    assert client.design().gains == Fopid(2.0, 1.0)
    assert graph.get(CONTROLLER, *PACE) == [3.0, 1.0]


@pytest.mark.slow
def test_gains_are_on_trial_until_they_are_confirmed_whatever_their_author_is_busy_with(graph: Graph) -> None:
    """It spends longer than trial_timeout on other things, tries others on top, and takes these back."""
    graph.start(CONTROLLER, {"kp": 1.0, "ki": 0.5, "trial_timeout": 1.5})
    graph.until(lambda: CONTROLLER in graph.node.get_node_names(), "the controller")
    client = client_of(graph)
    first, second = RunningDesign(Fopid(2.0, 1.0)), RunningDesign(Fopid(3.0, 1.0))
    given = client.apply(first, "trial")
    graph.spin(2.5)
    assert graph.get(CONTROLLER, "kp", "gains.status") == [2.0, "trial"]
    before = client.apply(second, "trial")
    client.apply(before)
    graph.spin(2.5)
    assert graph.get(CONTROLLER, "kp", "gains.status") == [2.0, "trial"]
    client.confirm(first)
    graph.spin(2.5)
    assert graph.get(CONTROLLER, "kp", "gains.status") == [2.0, "verified"]
    client.apply(second, "trial")
    client.end_trial()
    graph.until(lambda: graph.get(CONTROLLER, "kp", "gains.status") == [2.0, "verified"], "those that are known", 5.0)
    client.apply(given)
    assert graph.get(CONTROLLER, "kp") == [1.0]
