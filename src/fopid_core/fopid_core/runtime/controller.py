"""The FOPID controller as it runs: ``control = controller.step(setpoint, measurement)``.

No clock, no ROS: time is the fixed sample time, one call of ``step`` per tick. Only numpy is imported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.filter_bank import Band, FilterBank, derivative_reading, integral_reading

AntiWindup = Literal["none", "back_calculation", "conditional_integration"]
Mode = Literal["auto", "manual"]


@dataclass(frozen=True)
class ControllerSettings:
    """Everything that can be set, validated as a whole.

    Attributes
    ----------
    gains : Fopid
        kp, ki, kd, lam, mu.
    sample_time : float
        Time between ticks [s].
    band : Band, optional
        Where the fractional powers are met; by default six decades below the Nyquist frequency.
    setpoint_weight : float
        Share of the setpoint that the proportional part sees, 0 to 1.
    derivative_setpoint_weight : float
        The same for the derivative part: 1 derivative of the error, 0 derivative of the measurement.
    derivative_filter_time : float
        Time constant of the lag before the derivative [s]; 0 for none.
    control_min, control_max : float
        Limits of the control signal; infinite for none.
    control_rate_max : float
        Largest change of the control signal per second; infinite for none.
    antiwindup : {"none", "back_calculation", "conditional_integration"}
    tracking_time : float
        How fast back-calculation takes the integral back [s]; 0 chooses (kp/ki)^(1/lam).
    bumpless : bool
        On a change of the gains, whether the integral takes up the step between old and new reading.
    safe_control : float
        The control signal before the first tick and while the controller is not running.
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

    def __post_init__(self) -> None:
        _require(self, "sample_time", 1e-6, 1e6)
        for name in ("setpoint_weight", "derivative_setpoint_weight"):
            _require(self, name, 0.0, 1.0)
        for name in ("derivative_filter_time", "tracking_time"):
            _require(self, name, 0.0, 1e9)
        _require(self, "safe_control", -1e300, 1e300)
        if not self.control_min < self.control_max:
            raise InputError(f"control_min = {self.control_min}, control_max = {self.control_max}; allowed: min < max")
        if not self.control_min <= self.safe_control <= self.control_max:
            limits = f"{self.control_min:g} to {self.control_max:g}"
            raise InputError(f"safe_control = {self.safe_control}; allowed: control_min to control_max, {limits}")
        if not self.control_rate_max > 0:
            raise InputError(f"control_rate_max = {self.control_rate_max}; allowed: above 0, inf for none")
        if self.antiwindup not in get_args(AntiWindup):
            raise InputError(f"antiwindup = {self.antiwindup!r}; allowed: {', '.join(get_args(AntiWindup))}")

    @property
    def active_band(self) -> Band:
        """The band in force."""
        return self.band or Band.for_sample_time(self.sample_time)


def _require(settings: ControllerSettings, name: str, low: float, high: float) -> None:
    value = getattr(settings, name)
    if not low <= value <= high:
        raise InputError(f"{name} = {value}; allowed: {low:g} to {high:g}")


@dataclass
class ControllerState:
    """What the controller did at its last tick (units of the signals)."""

    setpoint: float = 0.0
    measurement: float = 0.0
    error: float = 0.0
    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    feedforward: float = 0.0
    control_unlimited: float = 0.0
    control: float = 0.0
    saturated: bool = False
    mode: Mode = "auto"


class FopidController:
    """C(s) = kp + ki s^-lam + kd s^mu with limits, anti-windup and bumpless changes.

    Parameters
    ----------
    settings : ControllerSettings

    Examples
    --------
    >>> controller = FopidController(ControllerSettings(Fopid(kp=2.0, ki=1.0), sample_time=0.1))
    >>> controller.step(setpoint=1.0, measurement=0.0)
    2.05
    """

    def __init__(self, settings: ControllerSettings) -> None:
        self.state = ControllerState()
        self._install(settings)
        self.reset()

    @property
    def settings(self) -> ControllerSettings:
        """The settings in force."""
        return self._settings

    def reset(self) -> None:
        """Forget the past: as new, with the same settings and mode."""
        self._integral_bank.reset()
        self._derivative_bank.reset()
        self._bias = 0.0  # what bumpless changes have left behind; a constant, as an integrator would hold it
        self._origin: float | None = None  # the first measurement: signals count from there
        self._filtered = self._unfiltered = 0.0
        self._excess = 0.0  # limited less unlimited control at the last tick
        self.state = ControllerState(control=self._settings.safe_control, mode=self.state.mode)

    def reconfigure(self, settings: ControllerSettings) -> None:
        """Change any of the settings between two ticks.

        With ``bumpless`` the next control moves by what a controller with the new gains all along would
        have moved it by; without, it goes to where such a controller would have been.
        """
        before = self._reading()
        self._install(settings)
        if settings.bumpless and self._origin is not None:
            self._bias += before - self._reading()

    def set_mode(self, mode: Mode) -> None:
        """Switch between automatic and manual; the control signal does not jump."""
        if mode not in get_args(Mode):
            raise InputError(f"mode = {mode!r}; allowed: {', '.join(get_args(Mode))}")
        if mode == "auto" and self.state.mode == "manual":
            self._bias += self.state.control - self.state.feedforward - self._reading()
        self.state.mode = mode

    def step(self, setpoint: float, measurement: float, feedforward: float = 0.0, manual: float = 0.0) -> float:
        """One tick: take the signals at this instant, give the control until the next.

        Parameters
        ----------
        setpoint, measurement : float
            In the units of the measurement.
        feedforward : float
            Added to the control before the limits.
        manual : float
            The control in manual mode (limits apply as well).

        Raises
        ------
        InputError
            If a signal is not finite; the controller is then as it was before the call.
        """
        if not math.isfinite(setpoint + measurement + feedforward + manual):
            raise InputError(
                f"setpoint = {setpoint}, measurement = {measurement}, feedforward = {feedforward}, "
                f"manual = {manual}; allowed: finite numbers"
            )
        state = self.state
        self._take(setpoint, measurement)
        self._reading()
        state.setpoint, state.measurement, state.error = setpoint, measurement, setpoint - measurement
        state.feedforward = feedforward
        automatic = state.proportional + state.integral + state.derivative + feedforward
        state.control_unlimited = automatic if state.mode == "auto" else manual
        control = self._limit(state.control_unlimited, state.control)
        self._excess = control - state.control_unlimited
        state.saturated = self._excess != 0.0
        state.control = control
        return control

    def _install(self, settings: ControllerSettings) -> None:
        structure = (settings.sample_time, settings.active_band)
        if structure != getattr(self, "_structure", None):
            self._integral_bank = FilterBank(settings.active_band, settings.sample_time)
            self._derivative_bank = FilterBank(settings.active_band, settings.sample_time)
            self._structure = structure
        self._settings = settings
        self._gains = gains = settings.gains
        integral = integral_reading(settings.active_band, gains.lam)
        self._integral_reading = self._integral_bank.bound(integral)
        self._derivative_reading = self._derivative_bank.bound(derivative_reading(settings.active_band, gains.mu))
        after_one_tick = self._integral_bank.after_one_tick(integral)
        self._tracking_gain = _tracking_gain(settings, after_one_tick)

    def _take(self, setpoint: float, measurement: float) -> None:
        """Feed the operators' memories."""
        settings = self._settings
        if self._origin is None:
            self._origin = measurement
        moved = measurement - self._origin
        asked = setpoint - self._origin
        self._weighted_error = settings.setpoint_weight * asked - moved
        self._integral_bank.push(self._integral_input(setpoint - measurement))
        self._derivative_bank.push(self._filter(settings.derivative_setpoint_weight * asked - moved))

    def _integral_input(self, error: float) -> float:
        if self.state.mode == "manual":
            return 0.0
        if self._excess and self._settings.antiwindup == "conditional_integration":
            pushes_further = self._gains.ki * error * self._excess < 0.0
            return 0.0 if pushes_further else error
        return error + self._tracking_gain * self._excess

    def _filter(self, value: float) -> float:
        """First-order lag, exact for a signal that is linear between samples."""
        time_constant = self._settings.derivative_filter_time
        if time_constant > 0.0:
            ratio = self._settings.sample_time / time_constant
            decay = math.exp(-ratio)
            from_new = 1.0 + math.expm1(-ratio) / ratio
            value_out = decay * self._filtered + (1.0 - decay - from_new) * self._unfiltered + from_new * value
        else:
            value_out = value
        self._unfiltered, self._filtered = value, value_out
        return value_out

    def _reading(self) -> float:
        """The three parts from the memories as they are; the integral carries the bias."""
        state, gains = self.state, self._gains
        if self._origin is None:
            return 0.0
        state.proportional = gains.kp * self._weighted_error
        state.integral = gains.ki * self._integral_bank.read(self._integral_reading) + self._bias
        state.derivative = gains.kd * self._derivative_bank.read(self._derivative_reading)
        return state.proportional + state.integral + state.derivative

    def _limit(self, wanted: float, last: float) -> float:
        settings = self._settings
        limited = min(max(wanted, settings.control_min), settings.control_max)
        largest = settings.control_rate_max * settings.sample_time
        return min(max(limited, last - largest), last + largest)


def _tracking_gain(settings: ControllerSettings, after_one_tick: float) -> float:
    """What back-calculation adds to the integral's input per unit of excess control.

    1 / (ki tracking_time^lam), but no more than takes half of the excess back in one tick: beyond that the
    correction would overshoot from tick to tick. ``after_one_tick`` is the integral of a unit input then.
    """
    gains = settings.gains
    if settings.antiwindup != "back_calculation" or gains.ki == 0.0 or gains.lam == 0.0:
        return 0.0
    scale = settings.tracking_time**gains.lam if settings.tracking_time else abs(gains.kp / gains.ki) or 1.0
    per_excess = max(abs(gains.ki) * scale, 2.0 * abs(gains.ki) * after_one_tick)
    return math.copysign(1.0 / per_excess, gains.ki) if per_excess > 1e-300 else 0.0


def with_gains(settings: ControllerSettings, gains: Fopid) -> ControllerSettings:
    """The same settings with other gains."""
    return replace(settings, gains=gains)
