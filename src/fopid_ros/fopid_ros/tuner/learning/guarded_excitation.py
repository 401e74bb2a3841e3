"""An excitation with a hand on the brake: it shrinks before the measurement or the control comes to a bound."""

from __future__ import annotations

import math
from dataclasses import replace

from fopid_core.runtime.excitation import Excitation
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.sensor_faults import DeadSensor, LoneSample

BRAKE_SHARE, GO_ON_SHARE = 0.8, 0.4
"""Shares of the allowed deviation where nothing is added any more, and where it goes on."""
SHRINK, SHRINKS_MAX = 0.5, 5
"""What is left of the excitation each time, and how often that may be."""
SMOOTHED, SMOOTHED_AHEAD = 0.05, 0.15
"""Shares of a hold, and of the foresight, over which the measurement is averaged, whichever is longer."""
OLDEST, OLDEST_TICKS = 0.5, 5.0
"""Samples older than this [s], or than so many ticks, are too old to judge by."""
LIMIT_ANSWERS, LIMIT_TICKS = 10.0, 20
"""A control does not come back that has been at a limit for so many times as long as the loop takes to answer, and for
so many ticks."""
EXCUSED_TICKS, EXCUSED_FILTERS, EXCUSED_MOST = 1.5, 3.0, 5.0
"""What the controller makes of a lone sample, by its derivative even after it, is no move of the plant: for so many
ticks and times of its filter, and so many ticks at most."""


class GuardedExcitation:
    """Runs an excitation tick by tick: ``added = guarded.step(tick)``.

    It ends at once when the setpoint is moved, a sample is too old to judge by, the measurement leaves its band (by
    more than a lone sample) or stands still while the control moves, or the control stays at a limit. It adds nothing
    while the measurement is on its way out of the band, judged by its place and speed, or the control is at a limit,
    and is smaller afterwards, unless the control only answered a lone sample.

    Parameters
    ----------
    excitation : Excitation
    loop : LoopBaseline
    foresight : float
        How far ahead the measurement is judged [s]: about the time in which the loop answers.
    enough : float
        Deviation at which the experiment has come to its end; infinite for none.

    Attributes
    ----------
    level, peak : float
        Deviation now, and the largest, noise averaged out.
    answer_time : float
        When half of that was reached [s]; NaN before.
    """

    def __init__(self, excitation: Excitation, loop: LoopBaseline, foresight: float, enough: float = math.inf) -> None:
        self.excitation, self._loop = excitation, loop
        self._smoothing = max(SMOOTHED * excitation.settings.hold, SMOOTHED_AHEAD * foresight)
        self._foresight = foresight + self._smoothing  # by which the average is late
        self._enough = enough
        self._oldest = max(OLDEST, OLDEST_TICKS * loop.controller.sample_time)
        self._scale, self._shrinks, self._braking, self._shrunk = 1.0, 0, False, False
        self.level = self._speed = 0.0
        self._last: Tick | None = None
        self._began = math.nan
        self._rise: list[tuple[float, float]] = []
        self.peak = 0.0
        self._sensor, self._excused_until = LoneSample.within(loop.deviation_max), -math.inf
        tick, slow = loop.controller.sample_time, loop.controller.filter.time
        self._excused = min(EXCUSED_TICKS * tick + EXCUSED_FILTERS * slow, EXCUSED_MOST * tick)
        self._dead_sensor, self._added = DeadSensor(loop.longest_still, foresight), 0.0
        self._limit_since = math.inf
        self._limit_most = max(LIMIT_ANSWERS * foresight, LIMIT_TICKS * loop.controller.sample_time)

    @property
    def answer_time(self) -> float:
        """When half of the peak was reached, after the beginning [s]."""
        return next((time for time, level in self._rise if level >= 0.5 * self.peak), math.nan)

    def peak_until(self, time: float) -> float:
        """The peak by so many seconds after the beginning."""
        return max((level for at, level in self._rise if at <= time), default=0.0)

    @property
    def finished(self) -> bool:
        """Whether it is over."""
        return self.excitation.finished

    @property
    def cornered(self) -> bool:
        """Whether even small moves came near the bounds."""
        return self._shrinks > SHRINKS_MAX

    def step(self, tick: Tick) -> float:
        """One tick; what to add to the control until the next."""
        if self.finished:
            return 0.0
        reason = self._reason_to_end(tick)
        tick = replace(tick, measurement=self._sensor.seen(tick.measurement))
        self._follow(tick)
        added = self.excitation.step(self._loop.setpoint, tick.measurement, tick.control, tick.time)
        self.end(reason)
        if not self.finished and self.peak >= self._enough:
            self.complete("moved far enough")
        if self._sensor.held_back:
            self._excused_until = tick.time + self._excused
        if tick.time > self._excused_until:
            self._brake(tick)
        self._added = 0.0 if self.finished or self._braking else self._scale * added
        return self._added

    def end(self, reason: str) -> None:
        """End it now, where there is a reason and it is not over."""
        if reason and not self.finished:
            self.excitation.cancel()
            self.excitation.reason = reason

    def complete(self, reason: str) -> None:
        """It has served its purpose before its time."""
        if not self.finished:
            self.excitation.cancel()
            self.excitation.completed, self.excitation.reason = True, reason

    def _follow(self, tick: Tick) -> None:
        """Place and speed of the measurement, noise averaged out."""
        deviation = tick.measurement - self._loop.setpoint - self._loop.offset
        if self._last is None:
            self._began, self._last = tick.time, tick
            return
        dt = tick.time - self._last.time
        self._last = tick
        if dt <= 0.0:
            return
        share = dt / (dt + self._smoothing)
        moved = share * (deviation - self.level)
        self.level += moved
        self._speed += share * (moved / dt - self._speed)
        if abs(self.level) > self.peak:
            self.peak = abs(self.level)
            self._rise.append((tick.time - self._began, self.peak))

    def _reason_to_end(self, tick: Tick) -> str:
        if tick.setpoint != self._loop.setpoint:
            return f"the setpoint was changed from {self._loop.setpoint:g} to {tick.setpoint:g}"
        if tick.age > self._oldest:
            return f"a sample was {tick.age:.2g} s old when it was heard ({self._oldest:.2g} s is too old to judge by)"
        if self.cornered:
            return "the measurement or the control came near its bounds again and again, with ever smaller moves"
        self._limit_since = min(self._limit_since, tick.time) if self._saturated(tick) else math.inf
        if tick.time - self._limit_since > self._limit_most:
            return f"the control has been at its limit, {tick.control:.4g}, for {tick.time - self._limit_since:.3g} s"
        return self._dead_sensor.look(tick.time, tick.measurement, self._added)

    def _saturated(self, tick: Tick) -> bool:
        return self._loop.controller.saturated(tick.control)

    def _brake(self, tick: Tick) -> None:
        most, ahead = self._loop.deviation_max, abs(self.level + self._speed * self._foresight)
        away, saturated = max(ahead, abs(self.level)), self._saturated(tick)
        if self._braking:
            self._braking = saturated or away > GO_ON_SHARE * most
        elif saturated or away > BRAKE_SHARE * most:
            self._braking, self._shrunk = True, False
        # A control that is at its limit for a tick or two has answered a lone sample.
        lasts = saturated and tick.time - self._limit_since > self._excused
        if self._braking and not self._shrunk and (lasts or away > BRAKE_SHARE * most):
            self._shrunk = True
            self._scale *= SHRINK
            self._shrinks += 1
