"""State messages of ros2_control's kind, where the package control_msgs is there and somebody asks for them."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

from rclpy.qos import QoSProfile

from fopid_core.errors import InputError
from fopid_core.runtime.controller import ControllerState
from fopid_ros.common.endpoints import Endpoints
from fopid_ros.common.parameters import Spec
from fopid_ros.common.signals import header_stamp

CONTROL_MSGS_SPECS = (
    Spec("pid_state.enabled", False, "publish control_msgs/PidState on ~/pid_state, as control_toolbox does",
         at_configure=True),
    Spec("controller_state.enabled", False, "publish control_msgs/MultiDOFStateStamped on ~/controller_state, as "
         "ros2_controllers' pid_controller does", at_configure=True),
)  # fmt: skip


class ControlMsgsOutput:
    """Publishes what a tick did as control_msgs; without the package, only when nothing of it is asked for.

    Parameters
    ----------
    endpoints : Endpoints
    values : mapping
        The node's parameters.
    name : str
        Of the degree of freedom.

    Attributes
    ----------
    in_use : bool
        Whether anything of it is asked for.

    Raises
    ------
    InputError
        If it is asked for and the package is not installed.
    """

    def __init__(self, endpoints: Endpoints, values: Mapping[str, Any], name: str) -> None:
        self._pid = self._multi = None
        self._error = math.nan
        if values["pid_state.enabled"]:
            kind = _message("PidState", "pid_state.enabled")
            self._pid_state = kind()
            self._pid = endpoints.publisher(kind, "~/pid_state", QoSProfile(depth=10))
        if values["controller_state.enabled"]:
            kind = _message("MultiDOFStateStamped", "controller_state.enabled")
            self._controller_state = kind()
            self._controller_state.dof_states.append(_message("SingleDOFState", "controller_state.enabled")(name=name))
            self._multi = endpoints.publisher(kind, "~/controller_state", QoSProfile(depth=10))
        self.in_use = values["pid_state.enabled"] or values["controller_state.enabled"]

    def publish(self, state: ControllerState, stamp_ns: int, interval: float) -> None:
        """Send what a tick did.

        Parameters
        ----------
        state : ControllerState
        stamp_ns : int
        interval : float
            Time since the tick before [s].
        """
        error_dot = (state.error - self._error) / interval if interval > 0.0 else math.nan
        self._error = state.error
        if self._pid is not None:
            fill_pid_state(self._pid_state, state, stamp_ns, interval, error_dot)
            self._pid.publish(self._pid_state)
        if self._multi is not None:
            header_stamp(self._controller_state.header, stamp_ns)
            fill_dof_state(self._controller_state.dof_states[0], state, interval, error_dot)
            self._multi.publish(self._controller_state)


def fill_pid_state(message: Any, state: ControllerState, stamp_ns: int, interval: float, error_dot: float) -> None:
    """Fill a control_msgs/PidState; releases differ in its fields, and those it does not have are left out.

    The integral of the error is not a number that a fractional controller has, so ``i_error`` is NaN; the integral
    itself has no limits.
    """
    header_stamp(message.header, stamp_ns)
    message.timestep.sec, message.timestep.nanosec = divmod(round(interval * 1e9), 1_000_000_000)
    known = {
        "error": state.error, "error_dot": error_dot,
        "p_error": state.error, "i_error": math.nan, "d_error": error_dot,
        "p_term": state.proportional, "i_term": state.integral, "d_term": state.derivative,
        "i_max": math.inf, "i_min": -math.inf, "output": state.control,
    }  # fmt: skip
    for name in message.get_fields_and_field_types():
        if name in known:
            setattr(message, name, known[name])


def fill_dof_state(message: Any, state: ControllerState, interval: float, error_dot: float) -> None:
    """Fill a control_msgs/SingleDOFState, with the error's sign as pid_controller has it: setpoint less measurement."""
    message.reference, message.feedback = state.setpoint, state.measurement
    message.feedback_dot = math.nan  # not measured
    message.error, message.error_dot = state.error, error_dot
    message.time_step, message.output = interval, state.control


def _message(name: str, parameter: str) -> Any:
    try:
        return getattr(importlib.import_module("control_msgs.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(
            f"{parameter} = True: no control_msgs/msg/{name} is installed (ros-jazzy-control-msgs); allowed: false"
        ) from None
