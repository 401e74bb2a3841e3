"""What ~/state tells of a tick: what is known as it is, however large, and NaN for what is not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from fopid_core.runtime.controller import ControllerState
from fopid_msgs.msg import FopidState
from fopid_ros.common.cdr import Layout

if TYPE_CHECKING:
    from fopid_ros.controller.inputs import LoopInputs
    from fopid_ros.controller.joints.joint import Joint

STATE = Layout(FopidState)


def fill_signals(message: Any, state: ControllerState, inputs: LoopInputs | Joint, now_ns: int, *, known: bool) -> None:
    """Fill in signals and parts.

    Parameters
    ----------
    message : object
        With the fields of FopidState: ``STATE.record()``.
    state : ControllerState
        Of the controller's last tick.
    inputs : LoopInputs or Joint
    now_ns : int
        On the clock of the ticks.
    known : bool
        Whether the controller has worked a control out since it was as new; its parts mean something only then.
    """
    message.control_unlimited, message.control = state.control_unlimited, state.control
    message.saturated = state.saturated
    message.mode = FopidState.AUTO if state.mode == "auto" else FopidState.MANUAL
    message.tracking, message.measurement_age = inputs.tracking.value, inputs.measurement.age(now_ns)
    if known:
        message.setpoint, message.measurement, message.error = state.setpoint, state.measurement, state.error
        message.proportional, message.integral = state.proportional, state.integral
        message.derivative, message.feedforward = state.derivative, state.feedforward
        return
    message.setpoint, message.measurement = inputs.setpoint.value, inputs.measurement.value
    message.error = message.setpoint - message.measurement
    message.proportional = message.integral = message.derivative = math.nan
    message.feedforward = inputs.feedforward.faded(now_ns)
