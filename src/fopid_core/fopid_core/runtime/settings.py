"""Everything that can be set in the running controller, validated as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.filter_bank import Band

AntiWindup = Literal["none", "back_calculation", "conditional_integration"]

LARGEST, LOWEST = 1e100, -1e100
"""Of signals and gains: no product, difference or sum over any number of ticks can then overflow."""


@dataclass(frozen=True)
class Pace:
    """How fast a controller's control moves, and what it takes for the setpoint.

    Attributes
    ----------
    control, setpoint : float
        At most [1/s]; infinite for none.
    """

    control: float = math.inf
    setpoint: float = math.inf

    def __and__(self, other: Pace) -> Pace:
        """No faster than either."""
        return Pace(min(self.control, other.control), min(self.setpoint, other.setpoint))


UNPACED = Pace()
"""Without limits."""


@dataclass(frozen=True)
class ControllerSettings:
    """What the controller needs to know.

    Not there, although other controllers have it: the direction of action (a process that falls when the control
    rises takes negative gains), and limits on the integral (anti-windup acts on the true limits of the control).

    Attributes
    ----------
    gains : Fopid
        kp, ki, kd, lam, mu.
    sample_time : float
        Time between ticks [s].
    band : Band, optional
        Where the fractional powers are met; by default from the Nyquist frequency down to 1/horizon.
    horizon : float
        Longest time scale that matters [s]; 0 for six decades below the Nyquist frequency.
    setpoint_weight : float
        Share of the setpoint that the proportional part sees, 0 to 1.
    derivative_setpoint_weight : float
        The same for the derivative part: 1 derivative of the error, 0 derivative of the measurement.
    derivative_filter_time : float
        Time constant of the lag before the derivative [s]; 0 for none.
    measurement_filter_order : int
        Of the filter of the whole measurement: 0 for none, 1, or 2 (of damping 0.71).
    measurement_filter_time : float
        Its time [s]; 0 for none.
    setpoint_rate_max : float
        Largest change of the setpoint per second: a step becomes a ramp, which spares the actuator the kick of the
        proportional and derivative parts and does not saturate it; infinite for none.
    deadband : float
        Errors up to this size count as zero, larger ones from there: a valve that sticks is then not driven back and
        forth for ever, and noise does not wear it.
    control_min, control_max : float
        Limits of the control signal; infinite for none.
    control_rate_max : float
        Largest change of the control signal per second; infinite for none.
    antiwindup : {"none", "back_calculation", "conditional_integration"}
        While the control is limited, the controller remembers in place of the error the one its control could have
        followed (see ``antiwindup``): always, or under conditional integration only of errors that push further.
    tracking_time : float
        0: anti-windup as ``antiwindup`` says. Otherwise the integral alone gives way, with this time constant [s], for
        actuators that follow slowly. The tracking input always acts on the integral alone; for it 0 stands for
        (kp/ki)^(1/lam).
    bumpless : bool
        On a change of the gains, whether the integral takes up the step between old and new reading.
    safe_control : float
        The control signal before the first tick and while the controller is not running.
    angle_wraparound : bool
        Setpoint and measurement are angles [rad] of something that turns without end, so that a turn more is the same
        place: the error is the shortest way, -pi to pi.
    variable_step : bool
        Whether the controller is told before each step how long the last sample is ago (``set_interval``).
    on_trial : bool
        Whether the gains are not known to hold the loop. Where those from before come back, ``bumpless``, the integral
        goes on from where they left it, unless the loop has found rest elsewhere (see ``GainTrial``).
    """

    gains: Fopid
    sample_time: float = 0.01
    band: Band | None = None
    setpoint_weight: float = 1.0
    derivative_setpoint_weight: float = 1.0
    derivative_filter_time: float = 0.0
    control_min: float = -math.inf
    control_max: float = math.inf
    control_rate_max: float = math.inf
    antiwindup: AntiWindup = "back_calculation"
    tracking_time: float = 0.0
    bumpless: bool = True
    safe_control: float = 0.0
    horizon: float = 0.0
    setpoint_rate_max: float = math.inf
    deadband: float = 0.0
    angle_wraparound: bool = False
    measurement_filter_order: int = 0
    measurement_filter_time: float = 0.0
    variable_step: bool = False
    on_trial: bool = False

    def __post_init__(self) -> None:
        for name in ("kp", "ki", "kd"):
            _require(self.gains, name, -LARGEST, LARGEST)
        _require(self, "sample_time", 1e-6, 1e6)
        for name in ("setpoint_weight", "derivative_setpoint_weight"):
            _require(self, name, 0.0, 1.0)
        for name in ("derivative_filter_time", "tracking_time"):
            _require(self, name, 0.0, 1e9)
        _require(self, "deadband", 0.0, LARGEST)
        _require(self, "safe_control", -LARGEST, LARGEST)
        if not self.control_min < self.control_max:
            raise InputError(f"control_min = {self.control_min}, control_max = {self.control_max}; allowed: min < max")
        if not self.control_min <= self.safe_control <= self.control_max:
            limits = f"{self.control_min:g} to {self.control_max:g}"
            raise InputError(f"safe_control = {self.safe_control}; allowed: control_min to control_max, {limits}")
        for name in ("control_rate_max", "setpoint_rate_max"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: above 0, inf for none")
        if self.antiwindup not in get_args(AntiWindup):
            raise InputError(f"antiwindup = {self.antiwindup!r}; allowed: {', '.join(get_args(AntiWindup))}")
        _ = self.active_band, self.measurement_filter

    @property
    def measurement_filter(self) -> MeasurementFilter:
        """The filter of the measurement."""
        return MeasurementFilter(self.measurement_filter_order, self.measurement_filter_time)

    @property
    def active_band(self) -> Band:
        """The band in force."""
        return self.band or Band.for_sample_time(self.sample_time, self.horizon)


def _require(holder: object, name: str, low: float, high: float) -> None:
    value = getattr(holder, name)
    if not low <= value <= high:
        raise InputError(f"{name} = {value}; allowed: {low:g} to {high:g}")


def as_designed(
    gains: Fopid, sample_time: float, measurement_filter: MeasurementFilter, weights: SetpointWeights,
    pace: Pace = UNPACED,
) -> ControllerSettings:  # fmt: skip
    """The settings that run a design as it was designed."""
    return ControllerSettings(
        gains,
        sample_time,
        setpoint_weight=weights.proportional,
        derivative_setpoint_weight=weights.derivative,
        measurement_filter_order=measurement_filter.order,
        measurement_filter_time=measurement_filter.time,
        control_rate_max=pace.control,
        setpoint_rate_max=pace.setpoint,
    )


def with_gains(settings: ControllerSettings, gains: Fopid) -> ControllerSettings:
    """The same settings with other gains."""
    return replace(settings, gains=gains)


def refused(**signals: float) -> InputError:
    """The error for signals of which one is not finite, or beyond what is computed with."""
    given = ", ".join(f"{name} = {value}" for name, value in signals.items())
    return InputError(f"{given}; allowed: finite numbers, {LOWEST:g} to {LARGEST:g}")
