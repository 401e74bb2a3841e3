"""The FOPID controller as it runs: ``control = controller.step(setpoint, measurement)``.

No clock, no ROS: time is the sample time, or what ``step`` is told; one call of ``step`` per tick. Only numpy is
imported.
"""

from __future__ import annotations

import math
from typing import get_args

from fopid_core.errors import InputError
from fopid_core.runtime.angles import nearest_turn
from fopid_core.runtime.antiwindup import (
    conditioning,
    direct_feedthrough,
    feedthroughs,
    setpoint_feedthrough,
    tracking_gain,
)
from fopid_core.runtime.controller_state import ControllerState, Mode
from fopid_core.runtime.filter_bank import Band, integral_weights
from fopid_core.runtime.gain_trial import GainTrial
from fopid_core.runtime.instalments import Instalments
from fopid_core.runtime.measurement_filter import RunningFilter
from fopid_core.runtime.operators import Operators
from fopid_core.runtime.reading import Reading, reading_of
from fopid_core.runtime.sampled_derivative import derivative_weights
from fopid_core.runtime.settings import LARGEST, LOWEST, AntiWindup, ControllerSettings, refused, with_gains
from fopid_core.runtime.variable_step import VariableOperators, check_interval

__all__ = ["AntiWindup", "ControllerSettings", "ControllerState", "FopidController", "Mode", "with_gains"]


class FopidController:
    """C(s) = kp + ki s^-lam + kd s^mu with limits, anti-windup and bumpless changes.

    Parameters
    ----------
    settings : ControllerSettings

    Attributes
    ----------
    state : ControllerState
    setpoint_feedthrough : float
        Control per unit of setpoint at the same tick.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> controller = FopidController(ControllerSettings(Fopid(kp=2.0, ki=1.0), sample_time=0.1))
    >>> controller.step(setpoint=1.0, measurement=0.0)
    2.05
    """

    def __init__(self, settings: ControllerSettings) -> None:
        self.state = ControllerState()
        self._arguments: tuple[Band, float, float, bool] | None = None
        self._filter: RunningFilter | None = None
        self._filtered = 0.0  # the measurement behind its filter
        self._interval_ratio = 1.0  # the sample time over the last interval, at most 1
        self._operators: Operators
        self._install(settings)
        self.reset()

    @property
    def operators(self) -> Operators:
        """What integrates and differentiates."""
        return self._operators

    @property
    def settings(self) -> ControllerSettings:
        """The settings in force."""
        return self._settings

    @property
    def holds(self) -> bool:
        """Whether the last tick was without usable inputs."""
        return self._held

    def reset(self) -> None:
        """Forget the past: as new, with the same settings and mode."""
        self._operators.reset()
        self._bias = 0.0  # what bumpless changes have left behind; a constant, as an integrator would hold it
        self._started = False
        self._last = self._manual = self._before = 0.0  # from ``begin`` to ``finish``
        self._origin = 0.0  # the first measurement: signals count from there
        self._differentiated = 0.0  # the differentiated signal
        self._shift = 0.0  # what bumpless changes have taken out of it
        self._implied_control = self._settings.safe_control  # the control that what is remembered stands for
        self._held = False  # whether the last tick was a hold
        self._joins = False  # whether a filter takes over at the next tick
        self._owed = Instalments()  # the part of the bias that holds left
        self._trial, self._way_back = GainTrial(), Instalments()
        self.state = ControllerState(control=self._settings.safe_control, mode=self.state.mode)

    def reconfigure(self, settings: ControllerSettings) -> None:
        """Change any of the settings between two ticks.

        With ``bumpless`` the next control moves by what a controller with the new gains all along would
        have moved it by; without, it goes to where such a controller would have been. The past holds noise that a
        slower filter of the measurement would not have let in: the derivative forgets it before it is read for the
        last time, so that no integral takes it up, and integral and setpoint alone move the next control. Gains that
        come back from before a trial take the control with them (``GainTrial``), as fast as its rate allows.
        """
        state, before, level = self.state, self._settings, self._level
        old = self._settle() if settings.gains != before.gains else self._parts
        slower = settings.measurement_filter.lag > before.measurement_filter.lag
        if slower and settings.bumpless and self._started:
            self._operators.forget_faster(settings.measurement_filter_time)
            self._read(*self._operators.read())
            old, self._joins = self._parts, True
        self._install(settings)
        # A new weight must not look like a jump of the differentiated signal.
        new_weight = settings.derivative_setpoint_weight - before.derivative_setpoint_weight
        self._shift += new_weight * (state.setpoint - self._origin)
        target = self._trial.change(before, settings, level)
        self._go_on_from(old)
        if target is not None and settings.bumpless:
            self._owed.forget()
            self._implied_control, way = state.control, self._way_back
            way.left = target - self._level
            way.ticks = max(math.ceil(abs(way.left) / self._control_move_max), 1)

    @property
    def reading(self) -> Reading:
        """What the gains in force come to, for a schedule."""
        return reading_of(self._operators, self._settings.gains, self._tracking_gain, self._conditioned)

    def read_as(self, reading: Reading, *, conditioned: bool) -> None:
        """Go on with other gains, given as a reading of the same bank; as ``reconfigure``, without its work.

        Parameters
        ----------
        reading : Reading
        conditioned : bool
            Whether all that is remembered takes in what was limited, or the integral alone.
        """
        old = self._settle()
        operators = self._operators
        operators.set_reading(reading.weights)
        if conditioned:
            operators.set_correction(operators.of_error / reading.feedthrough)
        self._kp, self._ki, self._kd = reading.parts[0], 1.0, 1.0
        self._integrates = reading.integrates
        self.setpoint_feedthrough = setpoint_feedthrough(reading.parts, self._settings)
        self._tracking_gain = reading.tracking_gain
        self._conditioned, self._direction = conditioned, reading.feedthrough if conditioned else reading.ki
        self._go_on_from(old)

    def fade_bias(self, share: float) -> None:
        """Give up a share of what bumpless changes have left behind: without an integral nothing else takes it back."""
        self._shift_bias(-share * (self._bias - self._owed.left))

    def set_mode(self, mode: Mode) -> None:
        """Switch between automatic and manual; the control signal does not jump."""
        if mode not in get_args(Mode):
            raise InputError(f"mode = {mode!r}; allowed: {', '.join(get_args(Mode))}")
        state = self.state
        if mode == "auto" and state.mode == "manual":
            parts = state.proportional + state.integral + state.derivative + state.feedforward
            self._shift_bias(state.control - parts)
            self._owed.forget()  # it stays in the bias
        if mode != state.mode:
            self._trial, self._way_back = GainTrial(), Instalments()
        state.mode = mode

    def step(
        self,
        setpoint: float,
        measurement: float,
        feedforward: float = 0.0,
        manual: float = 0.0,
        tracking: float | None = None,
    ) -> float:
        """One tick: take the signals at this instant, give the control until the next.

        Parameters
        ----------
        setpoint, measurement : float
            In the units of the measurement.
        feedforward : float
            Added to the control before the limits, no more of it than the range between them: the rest would only
            drive the integral away.
        manual : float
            The control in manual mode (limits apply as well).
        tracking : float, optional
            The tracking input TR of the ISA form: what the actuator did with the last control, or what another
            controller drives it with. It takes the place of the controller's own limited control: the integral
            follows it within ``tracking_time``, and the rate limit counts from it. An actuator that lags is thus
            followed with the integral alone, so that the lag is not taken for a limit by the other parts.

        Raises
        ------
        InputError
            If a signal is not finite, or beyond 1e100; the controller is then as it was before the call.
        """
        integrated, changing, correction = self.begin(setpoint, measurement, feedforward, manual, tracking)
        integral, derivative = self._operators.push(integrated, changing, correction)
        return self.finish(integral, derivative)

    def begin(
        self, setpoint: float, measurement: float, feedforward: float, manual: float, tracking: float | None
    ) -> tuple[float, float, float]:
        """The first half of ``step``: what the operators are to push.

        Returns
        -------
        integrated, differentiated, correction : float
        """
        if not (LOWEST <= setpoint <= LARGEST and LOWEST <= measurement <= LARGEST
                and LOWEST <= feedforward <= LARGEST and LOWEST <= manual <= LARGEST):  # fmt: skip
            raise refused(setpoint=setpoint, measurement=measurement, feedforward=feedforward, manual=manual)
        state = self.state
        self._last = last = state.control
        if tracking is not None:
            if not LOWEST <= tracking <= LARGEST:
                raise refused(tracking=tracking)
            self._last = last = tracking
        if self._wraps:
            if self._started:
                measurement = nearest_turn(measurement, state.measurement)
            setpoint = nearest_turn(setpoint, measurement)
        if not self._started:
            self._start(measurement, last)
        move_max = self._setpoint_move_max
        if move_max < math.inf:
            setpoint = _limited(setpoint, state.setpoint - move_max, state.setpoint + move_max)
        if self._held:
            self._before = state.proportional + state.derivative + state.feedforward
        elif self._joins:
            self._before = state.proportional + state.derivative
            self._before += self.setpoint_feedthrough * (setpoint - state.setpoint)
        state.setpoint, state.measurement = setpoint, measurement
        state.feedforward = _limited(feedforward, self._low - self._high, self._high - self._low)
        self._manual = manual
        self._filtered = measurement if self._filter is None else self._behind_filter(self._filter, measurement)
        return self._advance(setpoint, self._filtered, last - self._implied_control, tracking is not None)

    def finish(self, integral: float, derivative: float) -> float:
        """The second half of ``step``: the control from what the operators have become."""
        state, last = self.state, self._last
        self._read(integral, derivative)
        if self._held:
            self._owe(self._before - state.proportional - state.derivative - state.feedforward)
            self._held = self._joins = False
        elif self._joins:
            self._shift_bias(self._before - state.proportional - state.derivative)
            self._joins = False
        if self._owed.ticks and self._integrates:  # an integral, where there is one, pays it back by itself
            self._owed.forget()
        elif self._owed.ticks:
            self._shift_bias(-self._owed.pay())
        if self._way_back.ticks:
            self._shift_bias(self._way_back.pay())
        automatic = state.mode == "auto"
        parts = state.proportional + state.integral + state.derivative + state.feedforward
        unlimited = parts if automatic else self._manual
        free = (self._low <= unlimited <= self._high
                and -self._control_move_max <= unlimited - last <= self._control_move_max)  # fmt: skip
        control = unlimited if free else self._limit(unlimited, last)
        state.control_unlimited, state.control, state.saturated = unlimited, control, control != unlimited
        self._implied_control = unlimited if automatic else control
        if self._settings.on_trial:
            self._trial.watch(self._level, self._kp * state.error, limited=state.saturated)
        return control

    def set_interval(self, interval: float) -> None:
        """The next sample comes so long after the last one [s]; with ``variable_step``, said before each ``step``.

        Raises
        ------
        InputError
            If it is too short or too long for the sample time, or the controller is one of fixed steps.
        """
        operators, settings = self._variable, self._settings
        if operators is None:
            raise InputError(f"interval = {interval}; allowed: none, without variable_step")
        check_interval(interval, settings.sample_time)
        limited = self._conditioned and self.state.control != self._implied_control
        if limited:  # at the last tick, after its interval
            self._direction = direct_feedthrough(operators, settings.gains)
            realisable = operators.of_error / self._direction
        operators.set_interval(interval)
        if limited:
            operators.set_correction(realisable)
        self.setpoint_feedthrough = setpoint_feedthrough(feedthroughs(operators, settings.gains), settings)
        self._setpoint_move_max = settings.setpoint_rate_max * interval
        # By hand the control moves at each tick, also in ``wait``.
        moving = interval if self.state.mode == "auto" else settings.sample_time
        self._control_move_max = settings.control_rate_max * moving
        self._interval_ratio = min(1.0, settings.sample_time / interval)
        if self._filter is not None:
            self._filter.set_interval(interval)

    def wait(self, manual: float) -> float:
        """One tick without a new sample, with ``variable_step``: the control stays; in manual mode it follows.

        Raises
        ------
        InputError
            If ``manual`` is not finite, or beyond 1e100.
        """
        state = self.state
        if state.mode == "manual":
            if not LOWEST <= manual <= LARGEST:
                raise refused(manual=manual)
            self._control_move_max = self._settings.control_rate_max * self._settings.sample_time
            control = self._limit(manual, state.control)
            state.control_unlimited, state.control, state.saturated = manual, control, control != manual
            self._implied_control = control
        return state.control

    def hold(self, control: float | None = None) -> float:
        """One tick without usable inputs.

        What is remembered of the signals stands still. The integral takes up the difference, so that the next
        ``step`` goes on from the held control: proportional, derivative and feedforward begin there without a
        jump, and only the integral moves it. A controller without one gives the difference back in as many ticks.

        Parameters
        ----------
        control : float, optional
            Where the control goes, within limits and rate; by default it stays.

        Returns
        -------
        float
            The control until the next tick.

        Raises
        ------
        InputError
            If ``control`` is not finite, or beyond 1e100.
        """
        state = self.state
        wanted = state.control if control is None else control
        if not LOWEST <= wanted <= LARGEST:
            raise refused(control=wanted)
        held = self._limit(wanted, state.control)
        state.control_unlimited, state.control, state.saturated = wanted, held, held != wanted
        self._owe(held - state.proportional - state.integral - state.derivative - state.feedforward)
        self._implied_control, self._held = held, True
        self._owed.ticks += 1
        return held

    @property
    def _parts(self) -> float:
        """The control without the feedforward."""
        return self.state.proportional + self.state.integral + self.state.derivative

    @property
    def _level(self) -> float:
        """The control without an error, and without what holds have left."""
        state = self.state
        return state.integral - self._owed.left - self._kp * self._off_proportional * (state.setpoint - self._origin)

    def _settle(self) -> float:
        """Before other gains: take in what was limited by the old ones; give the parts of the realisable error."""
        if self._conditioned:
            taken = self._windup_excess(self.state.control - self._implied_control)
            self._operators.correct(taken)
            self.state.error += taken / self._direction
            self._implied_control = self.state.control
            self._read(*self._operators.read())
        return self._parts

    def _go_on_from(self, old: float) -> None:
        """Read anew; where changes are bumpless, the integral takes up the step."""
        self._read(*self._operators.read())
        if self._settings.bumpless:
            self._shift_bias(old - self._parts)

    def _install(self, settings: ControllerSettings) -> None:
        """Work out what every tick needs."""
        self._settings, gains, band = settings, settings.gains, settings.active_band
        self._provide_operators(settings)
        operators = self._operators
        self._variable = operators if isinstance(operators, VariableOperators) else None
        if self._variable is not None:
            self._variable.set_orders(integral_weights(band, gains.lam), gains.mu)
        else:
            derivative = derivative_weights(band, gains.mu, settings.sample_time, settings.derivative_filter_time)
            operators.set_weights(integral_weights(band, gains.lam), derivative)
        self._kp, self._ki, self._kd = gains.kp, gains.ki, gains.kd
        self._integrates = gains.integrates
        self._off_proportional = 1.0 - settings.setpoint_weight
        self._setpoint_move_max = settings.setpoint_rate_max * settings.sample_time
        self._low, self._high = settings.control_min, settings.control_max
        self._control_move_max = settings.control_rate_max * settings.sample_time
        self._provide_filter(settings)
        self._deadband, self._derivative_weight = settings.deadband, settings.derivative_setpoint_weight
        self._wraps = settings.angle_wraparound
        self.setpoint_feedthrough = setpoint_feedthrough(feedthroughs(operators, settings.gains), settings)
        correction = None if settings.tracking_time else conditioning(operators, gains)
        self._conditioned = correction is not None
        if correction is not None:
            operators.set_correction(correction)
        self._tracking_gain = tracking_gain(operators, gains, settings.tracking_time)
        self._direction = direct_feedthrough(operators, gains) if self._conditioned else gains.ki

    def _provide_operators(self, settings: ControllerSettings) -> None:
        structure = (settings.active_band, settings.sample_time)
        arguments = (*structure, settings.derivative_filter_time, settings.variable_step)
        if arguments == self._arguments:
            return
        operators = (VariableOperators if settings.variable_step else Operators)(*arguments[:3])
        if self._arguments and structure == self._arguments[:2]:
            step = operators.copy_state(self._operators)
            self._shift += step
            self._differentiated -= step
        elif self._arguments:  # they know nothing of the past, so that where the signal is now is no jump from zero
            self._shift += self._differentiated
            self._differentiated = 0.0
        self._operators, self._arguments = operators, arguments

    def _provide_filter(self, settings: ControllerSettings) -> None:
        wanted, kept = settings.measurement_filter, self._filter
        if kept is not None and self._started and wanted.lag < kept.wanted[0].lag:
            self._catch_up()
        if wanted.is_idle:
            self._filter = None
        elif kept is None or kept.wanted != (wanted, settings.sample_time):
            self._filter = RunningFilter(wanted, settings.sample_time)
            self._filter.rest_at(self._filtered)

    def _catch_up(self) -> None:
        """Bring the filtered measurement up to the measurement, without a step of the error or of the derivative."""
        state = self.state
        state.error += self._error(state.setpoint, state.measurement) - self._error(state.setpoint, self._filtered)
        self._shift -= state.measurement - self._filtered
        self._filtered = state.measurement

    def _error(self, setpoint: float, measurement: float) -> float:
        error = setpoint - measurement
        return error - _limited(error, -self._deadband, self._deadband) if self._deadband else error

    def _behind_filter(self, slow: RunningFilter, measurement: float) -> float:
        """The measurement behind its filter, which begins anew after a hold."""
        if self._held:
            slow.rest_at(measurement)
        return slow.push(measurement)

    def _start(self, measurement: float, control: float) -> None:
        self._started = True
        if self._filter is not None:
            self._filter.rest_at(measurement)
        self._origin = self.state.setpoint = measurement
        self._implied_control = control

    def _advance(self, setpoint: float, measurement: float, excess: float, tracks: bool) -> tuple[float, float, float]:
        """What is to be integrated, differentiated and corrected at this tick."""
        correction = self._windup_excess(excess) if excess else 0.0
        self.state.error = error = self._error(setpoint, measurement)
        asked = setpoint - self._origin
        changing = self._derivative_weight * asked - (measurement - self._origin) - self._shift
        if self._held:
            self._shift += changing - self._differentiated
            changing = self._differentiated
        self._differentiated = changing
        integrated = error
        if self.state.mode == "manual":
            integrated = correction = 0.0
        elif correction and (tracks or not self._conditioned):
            integrated, correction = error + self._interval_ratio * self._tracking_gain * correction, 0.0
        return integrated, changing, correction

    def _windup_excess(self, excess: float) -> float:
        """How much of the excess of the last tick what is remembered has to take in."""
        antiwindup = self._settings.antiwindup
        if antiwindup == "back_calculation":
            return excess
        pushes_further = self._direction * self.state.error * excess < 0.0
        return excess if antiwindup == "conditional_integration" and pushes_further else 0.0

    def _read(self, integral: float, derivative: float) -> None:
        state, weighted = self.state, self.state.error
        if self._off_proportional:
            weighted -= self._off_proportional * (state.setpoint - self._origin)
        state.proportional = self._kp * weighted
        state.integral = self._ki * integral + self._bias
        state.derivative = self._kd * derivative

    def _shift_bias(self, step: float) -> None:
        """The integral goes on from ``step`` higher."""
        self._bias += step
        self.state.integral += step

    def _owe(self, step: float) -> None:
        """The same for a hold, which leaves no constant behind."""
        self._shift_bias(step)
        self._owed.left += step

    def _limit(self, wanted: float, last: float) -> float:
        limited = _limited(wanted, self._low, self._high)
        return _limited(limited, last - self._control_move_max, last + self._control_move_max)


def _limited(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value
