"""The parameters of controller and plant by the names that their nodes give them, as settings of the runtime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_type_hints

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller import ControllerSettings
from fopid_core.runtime.filter_bank import Band
from fopid_core.runtime.plant import PlantSettings

GAINS = ("kp", "ki", "kd", "lam", "mu")
SIGNALS = ("setpoint", "measurement", "feedforward", "manual_control", "control", "tracking", "scheduling_variable")

_NOT_HERE = ("gains", "band", "on_trial")
_SETTINGS = tuple(field.name for field in fields(ControllerSettings) if field.name not in _NOT_HERE)
_BAND = {"band.low": float, "band.high": float, "band.poles": int}
_OF_THE_NODE = {
    **{f"{signal}_timeout": float for signal in SIGNALS if signal != "control"},
    "clock_skew_max": float, "on_stale": str, "on_several_publishers": str, "autostart": bool, "allow_zero_gains": bool,
    "state_rate": float, "trial_timeout": float, "directory": str, "gains_file": str, "retain": bool,
    "gains.status": str, "gains.origin": str, "gains.certificate": str,
    "tracking.enabled": bool, "tracking.required": bool, "back_calculation.enabled": bool,
    "pid_state.enabled": bool, "controller_state.enabled": bool, "setpoint.initial": float,
    "schedule_file": str, "schedule_by": str,
    **{f"{signal}.{part}": str for signal in SIGNALS for part in ("type", "field")},
    **{f"{signal}.{part}": float for signal in SIGNALS for part in ("scale", "offset")},
}  # fmt: skip
"""What the node does with its messages and with late ones: without messages it has no effect."""


def _hints(kind: type, names: tuple[str, ...]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {name: str if hints[name] not in (float, int, bool) else hints[name] for name in names}


GAIN_KEYS: Mapping[str, Any] = dict.fromkeys(GAINS, float)
SETTING_KEYS: Mapping[str, Any] = {
    **GAIN_KEYS,
    **_hints(ControllerSettings, tuple(name for name in _SETTINGS if name != "sample_time")),
    **_BAND,
    "mode": str,
}
"""Parameters of the controller that its numbers depend on, beside its sample time, and their kinds."""

CONTROLLER_KEYS: Mapping[str, Any] = {**SETTING_KEYS, **_OF_THE_NODE}
"""All parameters of the controller beside its sample time, and their kinds."""

PLANT_KEYS: Mapping[str, Any] = _hints(
    PlantSettings, tuple(f.name for f in fields(PlantSettings) if f.name not in ("process", "sample_time"))
)


def controller_settings(parameters: Mapping[str, Any], sample_time: float) -> ControllerSettings:
    """The controller's settings from its node's parameters, gains among them; what is not given is as in the node.

    Examples
    --------
    >>> controller_settings({"kp": 2.0, "control_max": 5.0}, sample_time=0.1).control_max
    5.0
    """
    gains = Fopid(**{"kp": 0.0, **{name: parameters[name] for name in GAINS if name in parameters}})
    given = {name: parameters[name] for name in _SETTINGS if name in parameters}
    edges = {name.removeprefix("band."): parameters[name] for name in _BAND if name in parameters}
    band = Band.for_sample_time(sample_time, parameters.get("horizon", 0.0), **edges)
    return ControllerSettings(gains, **{**given, "sample_time": sample_time, "band": band})


def plant_settings(process: Process, parameters: Mapping[str, Any], sample_time: float) -> PlantSettings:
    """The plant's settings from its node's parameters."""
    return PlantSettings(process, sample_time=sample_time, **parameters)
