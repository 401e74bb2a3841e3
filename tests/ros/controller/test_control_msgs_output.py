"""State messages of ros2_control's kind, tried on stand-ins with the fields of control_msgs' own definitions."""

from __future__ import annotations

import importlib.util
import math
import sys
import types
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from std_msgs.msg import Header

from fopid_core.errors import InputError
from fopid_core.runtime.controller import ControllerState
from fopid_ros.controller.control_msgs_output import ControlMsgsOutput

from ..conftest import Graph

# Of control_msgs 5 (Jazzy); release 6.1 took three fields of PidState away.
PID_STATE = ("error", "error_dot", "p_error", "i_error", "d_error", "p_term", "i_term", "d_term", "i_max", "i_min",
             "output")  # fmt: skip
LATER_PID_STATE = tuple(name for name in PID_STATE if name not in ("p_error", "i_error", "d_error"))
DOF_STATE = ("reference", "feedback", "feedback_dot", "error", "error_dot", "time_step", "output")

STATE = ControllerState(setpoint=2.0, measurement=0.5, error=1.5, proportional=3.0, integral=0.25, derivative=-0.5,
                        control_unlimited=2.75, control=2.5, saturated=True)  # fmt: skip


def message(fields: tuple[str, ...], **others: type) -> type:
    """A class as rclpy's: it knows its fields, and takes no other."""

    class Message:
        __slots__ = (*others, *fields)

        def __init__(self, **given: Any) -> None:
            for name, kind in others.items():
                setattr(self, name, given.get(name, kind()))
            for name in fields:
                setattr(self, name, 0.0)

        @staticmethod
        def get_fields_and_field_types() -> dict[str, str]:
            return dict.fromkeys((*others, *fields), "double")

    return Message


class Endpoints:
    """Keeps what is published, by topic."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}

    def publisher(self, _kind: type, topic: str, _qos: object) -> Any:
        sent = self.sent.setdefault(topic, [])
        return types.SimpleNamespace(publish=sent.append)


def output(monkeypatch: pytest.MonkeyPatch, pid_fields: tuple[str, ...] = PID_STATE, **asked: bool) -> tuple:
    package, module = types.ModuleType("control_msgs"), types.ModuleType("control_msgs.msg")
    module.PidState = message(pid_fields, header=Header, timestep=Duration)
    module.SingleDOFState = message(DOF_STATE, name=str)
    module.MultiDOFStateStamped = message((), header=Header, dof_states=list)
    monkeypatch.setitem(sys.modules, "control_msgs", package)
    monkeypatch.setitem(sys.modules, "control_msgs.msg", module)
    endpoints = Endpoints()
    values = {"pid_state.enabled": False, "controller_state.enabled": False} | {
        f"{name}.enabled": on for name, on in asked.items()
    }
    return ControlMsgsOutput(endpoints, values, "elbow"), endpoints.sent


@pytest.mark.parametrize("fields", [PID_STATE, LATER_PID_STATE], ids=["5", "6.1"])
def test_a_pid_state_tells_the_tick_in_the_fields_that_the_installed_release_has(
    monkeypatch: pytest.MonkeyPatch, fields: tuple[str, ...]
) -> None:
    made, sent = output(monkeypatch, fields, pid_state=True)
    made.publish(ControllerState(error=1.0), 1_000_000_000, 0.01)
    made.publish(STATE, 1_010_000_000, 0.01)
    (*_, told) = sent["~/pid_state"]
    assert (told.header.stamp.sec, told.header.stamp.nanosec) == (1, 10_000_000)
    assert (told.timestep.sec, told.timestep.nanosec) == (0, 10_000_000)
    assert (told.p_term, told.i_term, told.d_term, told.output) == (3.0, 0.25, -0.5, 2.5)
    assert (told.error, told.error_dot) == (1.5, pytest.approx(50.0))
    assert (told.i_min, told.i_max) == (-math.inf, math.inf)
    if "i_error" in fields:
        assert (told.p_error, told.d_error) == (1.5, pytest.approx(50.0))
        assert math.isnan(told.i_error)  # what a fractional integral has no single number for
    assert set(sent) == {"~/pid_state"}


def test_a_controller_state_tells_the_tick_as_pid_controller_does(monkeypatch: pytest.MonkeyPatch) -> None:
    made, sent = output(monkeypatch, controller_state=True)
    made.publish(STATE, 2_000_000_000, 0.02)
    ((told,),) = sent.values()
    (dof,) = told.dof_states
    assert (dof.name, dof.reference, dof.feedback, dof.error, dof.time_step, dof.output) == (
        "elbow", 2.0, 0.5, 1.5, 0.02, 2.5,
    )  # fmt: skip
    assert math.isnan(dof.feedback_dot)
    assert math.isnan(dof.error_dot)  # of the first tick nothing is known


def test_who_does_not_ask_does_not_need_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    made = ControlMsgsOutput(Endpoints(), {"pid_state.enabled": False, "controller_state.enabled": False}, "elbow")
    made.publish(STATE, 0, 0.01)
    with pytest.raises(InputError, match=r"pid_state.enabled = True: no control_msgs/msg/PidState is installed"):
        ControlMsgsOutput(Endpoints(), {"pid_state.enabled": True, "controller_state.enabled": False}, "elbow")


@pytest.mark.skipif(importlib.util.find_spec("control_msgs") is not None, reason="control_msgs is installed")
def test_a_node_that_is_asked_for_it_without_the_package_says_so_in_one_line(graph: Graph) -> None:
    process = graph.start("fopid_controller", {"controller_state.enabled": True})
    assert process.wait(30) == 2
    (line,) = [line for line in process.log.read_text().splitlines() if line.startswith("error:")]
    assert "no control_msgs/msg/MultiDOFStateStamped is installed (ros-jazzy-control-msgs); allowed: false" in line
