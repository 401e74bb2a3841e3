"""What a browser sends, checked, before anybody else sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fopid_core.errors import InputError
from fopid_core.runtime.settings import LARGEST, LOWEST
from fopid_msgs.action import Autotune
from fopid_msgs.srv import Tune
from fopid_ros.common.design_parameters import DEADBAND, GAINS, PACE, TWO_DEGREES
from fopid_ros.common.inputs import is_number
from fopid_ros.common.parameters import shown

TUNING_NAMES = ("process", "method", "phase_margin", "crossover", "index", "ms_max", "u_max")
TUNER_DEFAULTS = (*TUNING_NAMES, "verify.ms_max")
"""Parameters of the tuner that are followed."""
TUNING_FIELDS = (*TUNING_NAMES, "phase_margin_deg", "apply")
AUTOTUNING_FIELDS = (
    "excitation", "amplitude", "deviation_max", "duration", "template_name", "method", "phase_margin_deg", "crossover",
    "index", "ms_max", "u_max", "propose_only", "plan_only", "gains", "two_degrees", "process",
    *PACE, DEADBAND,
)  # fmt: skip


def number(name: str, value: Any) -> float:
    """A number that the loop can work with.

    Examples
    --------
    >>> number("kp", "2")
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: kp = '2'; allowed: a number, -1e+100 to 1e+100
    """
    if type(value) not in (int, float) or not is_number(value):
        raise InputError(f"{name} = {shown(value)}; allowed: a number, {LOWEST:g} to {LARGEST:g}")
    return float(value)


def text(name: str, value: Any) -> str:
    """A text that a message can hold."""
    if not isinstance(value, str) or not value.isprintable():
        raise InputError(f"{name} = {shown(value)}; allowed: a text of printable characters")
    return value


def radians(name: str, value: Any) -> float:
    """An angle that was typed in degrees, and is spoken of in degrees when it cannot be used.

    Examples
    --------
    >>> round(radians("phase margin", 60), 4)
    1.0472
    >>> radians("phase margin", 200)
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: phase margin = 200 deg; allowed: up to 180, which is not included
    """
    degrees = number(name, value)
    if not 0.0 <= degrees < 180.0:
        raise InputError(f"{name} = {degrees:g} deg; allowed: up to 180, which is not included")
    return math.radians(degrees)


def tuning_request(fields: Mapping[str, Any]) -> Tune.Request:
    """A request to the tuner from named fields; angles in rad, as in the service, or named ``_deg``.

    Raises
    ------
    InputError
        For a field that the page does not have, or of the wrong kind.

    Examples
    --------
    >>> tuning_request({"method": "frequency", "crossover": 0.3}).crossover
    0.3
    """
    return _filled(Tune.Request(), fields, TUNING_FIELDS)


def autotuning_goal(fields: Mapping[str, Any]) -> Autotune.Goal:
    """A goal of the tuner's action from named fields.

    Examples
    --------
    >>> autotuning_goal({"plan_only": True, "phase_margin_deg": 60}).plan_only
    True
    """
    return _filled(Autotune.Goal(), fields, AUTOTUNING_FIELDS)


def _filled(request: Any, fields: Mapping[str, Any], allowed: tuple[str, ...]) -> Any:
    for name, value in fields.items():
        if name not in allowed:
            raise InputError(f"field = {shown(name)}; allowed: {', '.join(allowed)}")
        if name == "phase_margin_deg":
            request.phase_margin = radians("phase margin", value)
        elif name == "gains":
            _fill(request.gains, name, GAINS, value)
        elif name == "two_degrees":
            _fill(request.two_degrees, name, TWO_DEGREES, value)
            request.two_degrees_given = True
        else:
            setattr(request, name, _as(type(getattr(request, name)), name, value))
    return request


def _as(wanted: type, name: str, value: Any) -> Any:
    if wanted is float:
        return number(name, value)
    if wanted is str:
        return text(name, value)
    if type(value) is not wanted:
        raise InputError(f"{name} = {shown(value)}; allowed: true or false")
    return value


def _fill(message: Any, what: str, names: tuple[str, ...], value: Any) -> None:
    if not isinstance(value, dict) or set(value) != set(names):
        raise InputError(f"{what} = {shown(value)}; allowed: an object with {', '.join(names)}")
    for name in names:
        if name != "measurement_filter_order":
            setattr(message, name, number(name, value[name]))
        elif value[name] in (0, 1, 2):
            setattr(message, name, int(value[name]))
        else:
            raise InputError(f"{name} = {shown(value[name])}; allowed: 0, 1 or 2")
