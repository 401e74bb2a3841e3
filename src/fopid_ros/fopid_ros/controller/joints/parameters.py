"""Parameters of a controller of many joints: those of a joint stand under ``gains.<its name>.``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from fopid_core.errors import InputError
from fopid_core.runtime.settings import ControllerSettings
from fopid_ros.common.array_signals import ArraySignal, array_signal
from fopid_ros.common.design_parameters import DESIGN, PROVENANCE
from fopid_ros.common.parameters import Spec, Value
from fopid_ros.controller.parameters import SIGNALS, SPECS, controller_settings
from fopid_ros.controller.retained import check_provenance

OF_A_JOINT = (
    *DESIGN, "angle_wraparound", "derivative_filter_time", "control_min", "control_max", "antiwindup",
    "tracking_time", "bumpless", "safe_control",
)  # fmt: skip
OF_ALL = (
    "sample_time", "band.low", "band.high", "band.poles", "horizon", "measurement_timeout", "setpoint_timeout",
    "manual_control_timeout", "feedforward_timeout", "tracking_timeout", "tracking.enabled", "on_stale",
    "clock_skew_max", "on_several_publishers", "state_rate", "allow_zero_gains", "mode", "trigger", "directory",
    "gains_file", "retain", "trial_timeout",
)  # fmt: skip
TRAVELS = {
    **dict.fromkeys(("setpoint", "measurement"), ("sensor_msgs/msg/JointState", "position")),
    **dict.fromkeys(("feedforward", "manual_control", "tracking"), ("sensor_msgs/msg/JointState", "effort")),
    "control": ("std_msgs/msg/Float64MultiArray", "data"),
}
"""Message type and array of each signal, unless told otherwise."""

_SINGLE = {spec.name: spec for spec in SPECS}


def check_dof_names(names: Sequence[str], parameter: str = "dof_names") -> None:
    """Raise InputError for names that no topic can have, or that stand there twice."""
    if not names:
        raise InputError(f"{parameter} = []; allowed: one name and more")
    for k, name in enumerate(names):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            allowed = "letters, digits and _, a letter first; names of other kinds: reference_and_state_dof_names"
            raise InputError(f"{parameter}[{k}] = {name!r}; allowed: {allowed}")
        if name in names[:k]:
            raise InputError(f"{parameter}[{k}] = {name!r}; allowed: each name once")


def joint_parameter(dof: str, name: str) -> str:
    """What a parameter of the single controller is called here.

    >>> [joint_parameter("elbow", name) for name in ("kp", "gains.status", "mode")]
    ['gains.elbow.kp', 'gains.elbow.status', 'mode']
    """
    own = name in OF_A_JOINT or name in PROVENANCE
    return f"gains.{dof}.{name.removeprefix('gains.')}" if own else name


def joint_specs(names: Sequence[str]) -> tuple[Spec, ...]:
    """The parameters of a controller of these joints."""
    signals: list[Spec] = []
    for signal in SIGNALS:
        kind, field = TRAVELS[signal]
        defaults: dict[str, Value] = {"type": kind, "field": field, "scale": 1.0, "offset": 0.0}
        signals += [replace(_SINGLE[f"{signal}.{part}"], default=default) for part, default in defaults.items()]
    of_joints = [
        replace(_SINGLE[name], name=joint_parameter(dof, name)) for dof in names for name in (*OF_A_JOINT, *PROVENANCE)
    ]
    return (
        Spec("dof_names", list(names), "the joints, in the order of messages without names", read_only=True),
        Spec("reference_and_state_dof_names", list(names), "their names in the messages that are heard, where those "
             "are others", read_only=True),
        *(_SINGLE[name] for name in OF_ALL), *of_joints, *signals,
    )  # fmt: skip


def signal_types(values: dict[str, Any]) -> dict[str, ArraySignal]:
    """How each signal travels, by its name."""
    heard, sent = values["reference_and_state_dof_names"], values["dof_names"]
    if len(heard) != len(sent):
        raise InputError(f"reference_and_state_dof_names has {len(heard)} names; allowed: {len(sent)}, as in dof_names")
    if len(set(heard)) < len(heard):
        raise InputError(f"reference_and_state_dof_names = {heard}; allowed: each name once")
    return {name: array_signal(values, name, sent if name == "control" else heard) for name in SIGNALS}


def joint_settings(values: dict[str, Any], control: ArraySignal) -> list[ControllerSettings]:
    """The core's settings of each joint."""
    defaults = {name: spec.default for name, spec in _SINGLE.items()}
    common = {name: values[name] for name in OF_ALL}
    found = []
    for dof in values["dof_names"]:
        own = {name: values[joint_parameter(dof, name)] for name in (*OF_A_JOINT, *PROVENANCE)}
        try:
            check_provenance(own)
            found.append(controller_settings({**defaults, **common, **own}, control))
        except InputError as error:
            raise InputError(f"gains.{dof}: {error}") from None
    return found


def refuse_idle_joints(values: dict[str, Any]) -> None:
    """Raise InputError for a joint without gains, unless that was asked for."""
    for dof in values["dof_names"]:
        if not (any(values[f"gains.{dof}.{name}"] for name in ("kp", "ki", "kd")) or values["allow_zero_gains"]):
            allowed = "a gain that is not 0, or allow_zero_gains = true"
            raise InputError(f"gains.{dof}: kp = ki = kd = 0; allowed: {allowed}")
