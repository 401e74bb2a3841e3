"""The discretised controller as a C header without dependencies, and a C program with its test vectors."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from importlib import metadata, resources
from string import Template

import numpy as np

from fopid_core.errors import InputError
from fopid_core.runtime.antiwindup import conditioning, direct_feedthrough, tracking_gain
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.filter_bank import integral_weights
from fopid_core.runtime.measurement_filter import FilterStep
from fopid_core.runtime.operators import Operators
from fopid_core.runtime.sampled_derivative import DIFFERENCES, derivative_weights
from fopid_core.runtime.settings import ControllerSettings

NO_LIMIT = 1e30
"""Stands for infinity in C, where float must hold it."""


def c_header(settings: ControllerSettings, name: str = "fopid_controller") -> str:
    """The controller in C99: a header that explains itself.

    Parameters
    ----------
    settings : ControllerSettings
        What they say is built in; the limits can be changed at run time.
    name : str
        Of the file and the beginning of every name in it.

    Raises
    ------
    InputError
        If ``name`` cannot be part of a name in C.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> header = c_header(ControllerSettings(Fopid(1.0, 0.5, 0.1, 0.9, 0.8)), name="heater")
    >>> "static inline heater_real heater_step(heater_state *c, heater_real setpoint" in header
    True
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(f"name {name!r}; allowed: letters, digits and _, a letter first")
    if settings.angle_wraparound:
        raise InputError("angle_wraparound = True; allowed in C: False")
    if settings.variable_step:
        raise InputError("variable_step = True; allowed in C: False, its numbers are those of one sample time")
    band, gains = settings.active_band, settings.gains
    numbers = {
        "sample_time": settings.sample_time, "low": f"{band.low:.3g}", "high": f"{band.high:.3g}",
        "control_min": settings.control_min, "control_max": settings.control_max,
        "control_rate_max": settings.control_rate_max, "safe_control": settings.safe_control,
        "setpoint_step": settings.setpoint_rate_max * settings.sample_time, "deadband": settings.deadband,
        "kp": gains.kp, "ki": gains.ki, "kd": gains.kd, "lam": gains.lam, "mu": gains.mu,
        "off_proportional": 1.0 - settings.setpoint_weight,
        "derivative_setpoint_weight": settings.derivative_setpoint_weight,
        "half_step": 0.5 * settings.sample_time,
        **_numbers_of_filter(settings),
        **_numbers_of_operators(settings),
    }  # fmt: skip
    words = {"name": name, "NAME": name.upper(), "antiwindup": settings.antiwindup.replace("_", " ")}
    return _filled("controller.h", words | {"version": metadata.version("fopid_core")} | numbers)


def c_test(settings: ControllerSettings, name: str = "fopid_controller", ticks: int = 400) -> str:
    """A C program that runs the header on signals with steps, noise, saturation, manual ticks, holds and a reset.

    Its exit status is 0 when every control is that of ``FopidController``.
    """
    rows, scale = _vectors(settings, ticks)
    text = ",\n".join(f"    {{{call}, {', '.join(map(_number, numbers))}}}" for call, *numbers in rows)
    return _filled("controller_test.c", {"name": name, "NAME": name.upper(), "rows": text, "scale": scale})


def _numbers_of_operators(settings: ControllerSettings) -> dict[str, object]:
    band, gains = settings.active_band, settings.gains
    operators = Operators(band, settings.sample_time, settings.derivative_filter_time)
    integral = integral_weights(band, gains.lam)
    derivative = derivative_weights(band, gains.mu, settings.sample_time, settings.derivative_filter_time)
    direct, slope, curvature, jerk = gains.kd * derivative.differences
    operators.set_weights(integral, derivative)
    conditioned = not settings.tracking_time and conditioning(operators, gains) is not None
    gain = direct_feedthrough(operators, gains)
    p = band.lag_poles()
    leak = np.expm1(-p * settings.sample_time)
    value = operators.integrated + len(p)  # the row of the filtered signal
    direction = f"{_number(math.copysign(1.0, gain if conditioned else gains.ki))} * c->last_error * excess < 0"
    return {
        "lags": str(len(p)), "leak": leak, "of_slope": -leak / p,
        "from_last": operators.matrix[: len(p), operators.integrated - 1], "from_new": operators.matrix[: len(p), -2],
        "integral_weights": gains.ki * integral.lags, "derivative_weights": gains.kd * derivative.washouts,
        "integral_area": gains.ki * integral.integrator, "integral_direct": gains.ki * integral.direct,
        "derivative_direct": direct, "derivative_slope": slope, "derivative_curvature": curvature,
        "derivative_jerk": jerk,
        "filter_decay": operators.matrix[value, value],
        "filter_from_last": operators.matrix[value, value + DIFFERENCES],
        "filter_from_new": operators.matrix[value, -1],
        "integrates": str(int(gains.integrates)),
        "conditioned": str(int(conditioned)), "error_per_excess": 1.0 / gain if conditioned else 0.0,
        "tracking_gain": tracking_gain(operators, gains, settings.tracking_time),
        "takes_in": {"none": "0", "back_calculation": "1"}.get(settings.antiwindup, direction),
    }  # fmt: skip


def _numbers_of_filter(settings: ControllerSettings) -> dict[str, object]:
    slow = settings.measurement_filter
    step = FilterStep(0j, 0j, 1.0 + 0j) if slow.is_idle else FilterStep.of(slow, settings.sample_time)
    parts = {"decay": step.decay, "from_last": step.from_last, "from_new": step.from_new}
    numbers: dict[str, object] = {"filtered": str(int(not slow.is_idle)), "measurement_filter": str(slow)}
    for name, value in parts.items():
        numbers |= {f"measurement_{name}_re": value.real, f"measurement_{name}_im": value.imag}
    return numbers


Row = tuple[str, float, float, float, float, float]


def _vectors(settings: ControllerSettings, ticks: int) -> tuple[list[Row], float]:
    """Calls with their arguments and the control afterwards, and the size of the control before its limits."""
    controller = FopidController(settings)
    random = np.random.default_rng(1)
    measurement, scale = 0.5, 1.0
    rows: list[Row] = []

    def record(call: str, *arguments: float) -> None:
        a, b, c, d = (*arguments, 0.0, 0.0, 0.0, 0.0)[:4]
        rows.append((call, a, b, c, d, controller.state.control))

    for k in range(ticks):
        if k == ticks // 2:
            reach = 0.3 * max(abs(row[-1] - settings.safe_control) for row in rows) or 1.0
            low, high = settings.safe_control - reach, settings.safe_control + 0.9 * reach
            narrow = replace(settings, control_min=low, control_max=high)
            controller.reconfigure(narrow)
            record("LIMITS", narrow.control_min, narrow.control_max, narrow.control_rate_max)
        if k in (ticks // 4, ticks // 4 + 20):
            controller.set_mode("manual" if k == ticks // 4 else "auto")
            record("MANUAL", float(k == ticks // 4))
        if k == ticks * 7 // 8:
            controller.reset()
            record("RESET")
        if k % 50 in (30, 31):
            wanted = controller.state.control + 0.1 * (k % 50 - 30)
            controller.hold(wanted)
            record("HOLD", wanted)
            continue
        setpoint = float(k // 40 % 3)
        measurement += 0.02 * (setpoint - measurement) + 0.002 * random.standard_normal()  # bounded for any gains
        inputs = (setpoint, measurement, 0.1 * math.sin(0.05 * k), 0.3)
        controller.step(*inputs)
        record("STEP", *inputs)
        scale = max(scale, abs(controller.state.control_unlimited))
    return rows, scale


def _filled(template: str, values: dict[str, object]) -> str:
    text = resources.files("fopid_core.data").joinpath(template).read_text(encoding="utf-8")
    return Template(text).substitute({name: _in_c(value) for name, value in values.items()})


def _in_c(value: object) -> str:
    if isinstance(value, np.ndarray):
        return _listed(map(_number, value))
    return value if isinstance(value, str) else _number(float(value))  # type: ignore[arg-type]


def _listed(numbers: Iterable[str]) -> str:
    """Three to a line."""
    numbers = list(numbers)
    lines = [", ".join(numbers[i : i + 3]) for i in range(0, len(numbers), 3)]
    return "\n    " + ",\n    ".join(lines) + "\n"


def _number(value: float) -> str:
    """With all its digits; infinities as the largest number C is given."""
    value = float(value)
    if math.isinf(value):
        return repr(math.copysign(NO_LIMIT, value))
    if abs(value) > NO_LIMIT:
        raise InputError(f"{value:g} in the controller; allowed in C: up to {NO_LIMIT:g}")
    return repr(value)
