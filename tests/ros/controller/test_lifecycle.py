"""The controller's life: any transition at any time is answered, and what is opened is closed."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from std_srvs.srv import Trigger

from fopid_msgs.msg import ScalarStamped
from fopid_ros.controller.node import ControllerNode

from ..conftest import BIN, Graph, only_line
from .fed import FedController

NAME = "fopid_controller"
UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = "unconfigured", "inactive", "active", "finalized"
ALLOWED = {
    (UNCONFIGURED, Transition.TRANSITION_CONFIGURE): INACTIVE,
    (INACTIVE, Transition.TRANSITION_CLEANUP): UNCONFIGURED,
    (INACTIVE, Transition.TRANSITION_ACTIVATE): ACTIVE,
    (ACTIVE, Transition.TRANSITION_DEACTIVATE): INACTIVE,
    (UNCONFIGURED, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN): FINALIZED,
    (INACTIVE, Transition.TRANSITION_INACTIVE_SHUTDOWN): FINALIZED,
    (ACTIVE, Transition.TRANSITION_ACTIVE_SHUTDOWN): FINALIZED,
}
"""The transitions of a managed node (design.ros2.org/articles/node_lifecycle.html); there are no others."""
SHUTDOWNS = (
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    Transition.TRANSITION_INACTIVE_SHUTDOWN,
    Transition.TRANSITION_ACTIVE_SHUTDOWN,
)
ANY = (
    *{transition for _, transition in ALLOWED},
    Transition.TRANSITION_CREATE,
    Transition.TRANSITION_DESTROY,
    Transition.TRANSITION_ON_CONFIGURE_SUCCESS,
    Transition.TRANSITION_CALLBACK_SUCCESS,
    200,
)


def change(graph: Graph, transition: int, label: str = "") -> bool:
    request = ChangeState.Request(transition=Transition(id=transition, label=label))
    return bool(graph.call(ChangeState, f"{NAME}/change_state", request).success)


def state(graph: Graph) -> str:
    return str(graph.call(GetState, f"{NAME}/get_state").current_state.label)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_any_sequence_of_transitions_is_answered_as_the_state_allows(graph: Graph, seed: int) -> None:
    draw = random.Random(seed)
    graph.start(NAME, {"kp": 1.0})
    expected = ACTIVE
    graph.until(lambda: state(graph) == expected, "an active node")
    for step in range(60):
        last = step >= 50  # by then shutdowns, too; behind one nothing is allowed
        transition = draw.choice([one for one in ANY if last or one not in SHUTDOWNS])
        allowed = ALLOWED.get((expected, transition))
        assert change(graph, transition) == (allowed is not None), (expected, transition)
        expected = allowed or expected
        assert state(graph) == expected
    assert not change(graph, 0, "no such label")
    assert "Traceback" not in graph.logs()


def test_transitions_are_told_to_standard_tools(graph: Graph) -> None:
    events = graph.listen(TransitionEvent, f"{NAME}/transition_event")
    graph.start(NAME, {})
    graph.until(lambda: state(graph) == ACTIVE, "an active node")
    graph.until(lambda: graph.node.count_publishers(f"/{NAME}/transition_event"), "transition events")
    graph.spin(0.3)
    assert change(graph, Transition.TRANSITION_DEACTIVATE)

    def told() -> bool:
        return any((e.start_state.label, e.goal_state.label) == ("deactivating", INACTIVE) for e in events)

    graph.until(told, "a transition event")


def open_files(process: subprocess.Popen[str]) -> int:
    return len(list(Path(f"/proc/{process.pid}/fd").iterdir()))


def endpoints(graph: Graph) -> tuple[object, ...]:
    node = graph.node
    return (
        node.get_publisher_names_and_types_by_node(NAME, "/"),
        node.get_subscriber_names_and_types_by_node(NAME, "/"),
        node.get_service_names_and_types_by_node(NAME, "/"),
        [node.count_publishers(f"/{topic}") for topic in ("control", "diagnostics", f"{NAME}/state")],
        [node.count_subscribers(f"/{topic}") for topic in ("measurement", "setpoint", "manual_control")],
    )


def test_cycles_of_configure_and_cleanup_under_traffic_leave_nothing_open(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0})
    fed.run(setpoint=1.0, sensor=0.5)
    graph.client(Trigger, f"{NAME}/reset")
    graph.until(lambda: NAME in graph.node.get_node_names(), "the controller's name")
    before = endpoints(graph)
    files = open_files(fed.process)
    down = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    for cycle in range(12):
        for transition in down:
            assert change(graph, transition)
        if cycle in (0, 11):
            graph.until(lambda: not graph.node.count_subscribers("/measurement"), "an unconfigured node")
            graph.until(lambda: not graph.node.count_publishers("/control"), "the same of what it publishes")
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert change(graph, transition)
    fed.wait(lambda told: told.control == 0.5)
    graph.until(lambda: endpoints(graph) == before, "the same endpoints as before")
    assert open_files(fed.process) <= files + 2


def test_a_tick_that_was_due_when_the_controller_came_to_rest_does_nothing() -> None:
    resting: Any = SimpleNamespace(_active=False)  # whatever else it asked of the node would raise
    ControllerNode._tick_on_timer(resting)


def test_the_safe_control_is_the_last_thing_sent_before_a_controller_rests_or_ends(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0, "safe_control": 0.25})
    fed.run(setpoint=1.0, sensor=0.5)
    fed.wait(lambda told: told.control == 0.5)
    assert change(graph, Transition.TRANSITION_DEACTIVATE)
    graph.until(lambda: fed.controls[-1].value == 0.25, "the safe control")
    sent = len(fed.controls)
    fed.diagnosed(b"\0", "inactive")
    assert len(fed.controls) == sent
    assert change(graph, Transition.TRANSITION_ACTIVATE)
    fed.wait(lambda told: told.control == 0.5)
    fed.process.terminate()
    assert fed.process.wait(10) == 0
    graph.until(lambda: fed.controls[-1].value == 0.25, "the safe control")


BROKEN = """
import sys
from fopid_ros.controller.node import ControllerNode
from fopid_ros.common.managed_node import run

class Broken(ControllerNode):
    def _step(self, now_ns):
        raise ZeroDivisionError("a mistake in the program")

sys.exit(run(Broken))
"""


def test_a_mistake_in_the_program_gives_the_safe_control_and_is_told(graph: Graph, tmp_path: Path) -> None:
    controls = graph.listen(ScalarStamped, "control")
    told = graph.listen(DiagnosticArray, "/diagnostics")
    arguments = ["--ros-args", "-p", "kp:=1.0", "-p", "safe_control:=0.25", "-p", "setpoint.initial:=1.0"]
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen([sys.executable, "-c", BROKEN, *arguments], env=graph.environment, stderr=log)
    measurement = graph.node.create_publisher(ScalarStamped, "measurement", 1)
    graph.until(lambda: controls and measurement.get_subscription_count(), "the controller")
    graph.node.create_timer(0.01, lambda: measurement.publish(ScalarStamped(value=0.5)))
    graph.until(lambda: controls[-1].value == 0.25, "the safe control")
    graph.until(lambda: told and "internal errors" in told[-1].status[0].message, "a report")
    process.terminate()
    assert process.wait(10) == 0
    log_text = (tmp_path / "log").read_text()
    assert "ZeroDivisionError: a mistake in the program" in log_text
    assert log_text.count("Traceback") == 1  # not one for each tick


@pytest.mark.parametrize(
    ("parameter", "told"),
    [
        ("measurement.type:=senser_msgs/msg/Temperature", "did you mean 'sensor_msgs'"),
        ("control.field:=valu", "control.field = 'valu'"),
        ("setpoint.initial:=-.inf", "setpoint.initial = -inf; allowed: -1e+100 to 1e+100, inf to wait for one"),
        ("qos_overrides./control.publisher.reliability:=relaible", "'relaible'; allowed: reliable, best_effort"),
        ("qos_overrides./control.publisher.depth:=0", "depth = 0; allowed: a whole number above 0"),
        ("qos_overrides./contrl.publisher.depth:=3", "did you mean 'qos_overrides./control.publisher.depth'"),
    ],
)
def test_a_start_that_cannot_be_configured_ends_with_one_line(graph: Graph, parameter: str, told: str) -> None:
    command = [BIN / NAME, "--ros-args", "-p", parameter]
    ended = subprocess.run(command, env=graph.environment, timeout=100, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    line = only_line(ended.stderr)
    assert line.startswith("error: ")
    assert told in line


def test_a_node_that_waits_for_a_manager_can_be_mended_where_it_stands(graph: Graph) -> None:
    graph.start(NAME, {"kp": 2.0, "autostart": False, "measurement.type": "std_msgs/msg/Float46"})
    graph.until(lambda: state(graph) == UNCONFIGURED, "the node")
    assert not change(graph, Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: "no message 'Float46'; did you mean 'Float64'" in graph.logs(), "the reason")
    assert graph.set(NAME, measurement__type="fopid_msgs/msg/ScalarStamped").successful
    assert change(graph, Transition.TRANSITION_CONFIGURE), graph.logs()
    answer = graph.set(NAME, measurement__type="std_msgs/msg/Float64")
    assert not answer.successful
    assert "until the node is cleaned up" in answer.reason
    assert change(graph, Transition.TRANSITION_CLEANUP)
    assert graph.set(NAME, measurement__type="std_msgs/msg/Float64", measurement__field="data").successful
    assert change(graph, Transition.TRANSITION_CONFIGURE)

    def subscribed() -> list[str] | None:
        return dict(graph.node.get_subscriber_names_and_types_by_node(NAME, "/")).get("/measurement")

    graph.until(lambda: subscribed() == ["std_msgs/msg/Float64"], "the new type")


def test_starting_the_controller_loads_neither_scipy_nor_control() -> None:
    code = "import sys, fopid_ros.controller.node; print({'scipy', 'control', 'lark'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"
