"""The controller node's parameters, and the core's settings made from them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError
from fopid_core.model.fopid import ORDER_RANGE, Fopid
from fopid_core.runtime.filter_bank import Band
from fopid_core.runtime.settings import LARGEST, LOWEST, ControllerSettings
from fopid_ros.common.array_signals import ArraySignal
from fopid_ros.common.design_parameters import GAINS
from fopid_ros.common.inputs import is_number
from fopid_ros.common.managed_node import TIMING
from fopid_ros.common.parameters import Spec
from fopid_ros.common.signals import SignalType, signal_specs, signal_type
from fopid_ros.controller.cascade import CASCADE_SPECS
from fopid_ros.controller.control_msgs_output import CONTROL_MSGS_SPECS
from fopid_ros.controller.inputs import (
    AUTOMATIC,
    SHORTEST_FEEDFORWARD_TIMEOUT,
    SHORTEST_TIMEOUT,
    TICKS_MISSED,
    TICKS_WITHOUT_AUTHOR,
)
from fopid_ros.controller.scheduling import SCHEDULE_SPECS

SIGNALS = ("setpoint", "measurement", "feedforward", "manual_control", "tracking", "control")
LOOP_SIGNALS = (*SIGNALS, "scheduling_variable")
"""Of a node with one loop."""

_SIGNAL = f"-1 for {TICKS_MISSED} sample times, at least {SHORTEST_TIMEOUT} s; 0 for off"
_ADDED = (
    f"-1 for {TICKS_MISSED} sample times, at least {SHORTEST_FEEDFORWARD_TIMEOUT} s, "
    f"in lockstep {TICKS_WITHOUT_AUTHOR} sample times; 0 for off"
)

SPECS = (
    Spec("kp", 0.0, "proportional gain", -LARGEST, LARGEST, slides=True),
    Spec("ki", 0.0, "integral gain [1/s^lam]", -LARGEST, LARGEST, slides=True),
    Spec("kd", 0.0, "derivative gain [s^mu]", -LARGEST, LARGEST, slides=True),
    Spec("lam", 1.0, "order of the integral", *ORDER_RANGE),
    Spec("mu", 1.0, "order of the derivative", *ORDER_RANGE),
    Spec("sample_time", 0.01, "time between ticks [s]", 1e-6, 1e6, at_configure=True),
    Spec("band.low", 0.0, "lower edge of the band of the fractional powers [rad/s]; 0 chooses", 0.0, 1e9),
    Spec("band.high", 0.0, "upper edge of that band [rad/s]; 0 chooses the Nyquist frequency", 0.0, 1e9),
    Spec("band.poles", 0, "number of lags on that band; 0 chooses", 0, 60),
    Spec("horizon", 0.0, "longest time scale that matters [s]: the band reaches down to it; 0 chooses", 0.0, 1e9),
    Spec("variable_step", False, "integrate and differentiate over the intervals between samples as their stamps say, "
         "in place of sample_time", at_configure=True),
    Spec("setpoint.initial", math.inf, "setpoint until one comes; inf waits for one", at_configure=True),
    Spec("setpoint_rate_max", math.inf, "largest change of the setpoint per second; inf for none", 0.0),
    Spec("deadband", 0.0, "errors up to this size count as zero [measurement unit]", 0.0, LARGEST),
    Spec("angle_wraparound", False, "setpoint and measurement are angles [rad] that wrap around: the error is the "
         "shortest way, -pi to pi"),
    Spec("setpoint_weight", 1.0, "share of the setpoint in the proportional part", 0.0, 1.0),
    Spec("derivative_setpoint_weight", 1.0, "the same for the derivative; 0: of the measurement alone", 0.0, 1.0),
    Spec("derivative_filter_time", 0.0, "time constant of the lag before the derivative [s]", 0.0, 1e9),
    Spec("measurement_filter_order", 0, "order of the filter of the measurement; 0 for none", 0, 2),
    Spec("measurement_filter_time", 0.0, "its T [s], of 1/(1+Ts) or 1/(1+Ts+(Ts)^2/2); 0 for none", 0.0, 1e9),
    Spec("control_min", -math.inf, "lower limit of the control; -inf for none"),
    Spec("control_max", math.inf, "upper limit of the control; inf for none"),
    Spec("control_rate_max", math.inf, "largest change of the control per second; inf for none", 0.0),
    Spec("antiwindup", "back_calculation", "what keeps the integral from winding up",
         choices=("none", "back_calculation", "conditional_integration")),
    Spec("tracking_time", 0.0, "how fast back-calculation takes the integral back [s]; 0 chooses", 0.0, 1e9),
    Spec("tracking.enabled", False, "take what the actuator did from the topic tracking; it ages like the measurement",
         at_configure=True),
    *CASCADE_SPECS,
    *SCHEDULE_SPECS,
    *CONTROL_MSGS_SPECS,
    Spec("bumpless", True, "on new gains the integral takes up the step between old and new reading"),
    Spec("measurement_timeout", AUTOMATIC, f"age at which the measurement is stale [s]; {_SIGNAL}", AUTOMATIC, 1e9),
    Spec("setpoint_timeout", 0.0, "age at which the setpoint is stale [s]; 0 for off: once set it holds", 0.0, 1e9),
    Spec("manual_control_timeout", 0.0, "the same for manual_control in manual mode; 0 for off", 0.0, 1e9),
    Spec("feedforward_timeout", AUTOMATIC, "age at which the feedforward begins to fade, to 0 within as much again "
         f"[s]; {_ADDED}", AUTOMATIC, 1e9),
    Spec("tracking_timeout", AUTOMATIC, f"age at which tracking is no longer followed [s]; {_SIGNAL}", AUTOMATIC, 1e9),
    Spec("scheduling_variable_timeout", AUTOMATIC, f"age at which scheduling_variable is stale: the gains stay [s]; "
         f"{_SIGNAL}", AUTOMATIC, 1e9),
    Spec("on_stale", "hold", "the control while an input is stale: as it was, safe_control, or manual_control",
         choices=("hold", "safe", "manual")),
    Spec("clock_skew_max", 0.0, "how far beyond a tick a stamp may be ahead of this node's clock [s]", 0.0, 1e9),
    Spec("on_several_publishers", "tell",
         "when several nodes publish an input: tell it in /diagnostics, or also the safe control",
         choices=("tell", "safe")),
    Spec("state_rate", math.inf, "messages of ~/state per second at most; inf for one at each tick", 1e-3),
    Spec("safe_control", 0.0, "the control before the first tick and after the last", -LARGEST, LARGEST),
    Spec("allow_zero_gains", False, "start although all gains are 0, so that the control does not move",
         at_configure=True),
    Spec("mode", "auto", "auto, or manual: the control follows the topic manual_control", choices=("auto", "manual")),
    Spec("directory", "", "the folder of gains_file and of retained gains; empty: no file is written", read_only=True),
    Spec("gains_file", "", "the file in directory where ~/save_gains writes all parameters; a start with --params-file "
         "reads them"),
    Spec("retain", False, "keep each change of the gains in directory, and begin with the kept ones after a restart",
         read_only=True),
    Spec("gains.status", "set", "what is known of the gains: set by somebody, on trial (not kept), or verified",
         choices=("set", "trial", "verified")),
    Spec("trial_timeout", 3.0, "gains on trial go back to those before when gains.status = trial is not said again for "
         "so long [s]; 0 for never", 0.0, 1e9),
    Spec("gains.origin", "", "who set the gains, and why; set with them"),
    Spec("gains.certificate", "", "that the gains hold the loop, where there is one; set with them"),
    replace(TIMING, read_only=False, at_configure=True),
    *(spec for name in LOOP_SIGNALS for spec in signal_specs(name, at_configure=True)),
)  # fmt: skip

_SAME_IN_THE_CORE = (
    "sample_time", "setpoint_weight", "derivative_setpoint_weight", "derivative_filter_time", "control_rate_max",
    "antiwindup", "tracking_time", "bumpless", "safe_control", "horizon", "setpoint_rate_max", "deadband",
    "angle_wraparound",
    "measurement_filter_order", "measurement_filter_time", "variable_step",
)  # fmt: skip


def check_timeouts(values: dict[str, Any]) -> None:
    """Raise InputError for a timeout between automatic and off."""
    for name in ("measurement_timeout", "feedforward_timeout", "tracking_timeout", "scheduling_variable_timeout"):
        if AUTOMATIC < values.get(name, AUTOMATIC) < 0.0:
            raise InputError(f"{name} = {values[name]}; allowed: -1 for automatic, 0 for off, or above 0 [s]")


def check_file_name(values: dict[str, Any]) -> None:
    """Raise InputError for a gains_file that is not in the directory."""
    name = values["gains_file"]
    if name and (name != Path(name).name or name.startswith(".") or not name.isprintable()):
        raise InputError(f"gains_file = {name!r}; allowed: the name of a file in directory, no path")


def signal_types(values: dict[str, Any]) -> dict[str, SignalType]:
    """How each signal travels, by its name."""
    return {name: signal_type(values, name) for name in LOOP_SIGNALS}


def controller_settings(values: dict[str, Any], control_type: SignalType | ArraySignal) -> ControllerSettings:
    """The core's settings from the node's parameters.

    What the control's message can hold limits the control like an actuator.
    """
    band = {edge: values[f"band.{edge}"] for edge in ("low", "high", "poles")}
    return ControllerSettings(
        gains=Fopid(*(values[name] for name in GAINS)),
        band=Band.for_sample_time(values["sample_time"], values["horizon"], **band),
        control_min=max(values["control_min"], control_type.low),
        control_max=min(values["control_max"], control_type.high),
        on_trial=values["gains.status"] == "trial",
        **{name: values[name] for name in _SAME_IN_THE_CORE},
    )


def refuse_idle_gains(values: dict[str, Any]) -> None:
    """Raise InputError for a start without gains, unless that was asked for: nothing would control the plant."""
    if not (values["kp"] or values["ki"] or values["kd"] or values["allow_zero_gains"] or values["schedule_file"]):
        raise InputError("kp = ki = kd = 0; allowed: a gain that is not 0, or allow_zero_gains = true")


def initial_setpoint(values: dict[str, Any]) -> float:
    """The setpoint until one comes; NaN to wait for one."""
    initial = values["setpoint.initial"]
    if initial == math.inf:
        return math.nan
    if not is_number(initial):
        raise InputError(f"setpoint.initial = {initial}; allowed: {LOWEST:g} to {LARGEST:g}, inf to wait for one")
    return float(initial)
