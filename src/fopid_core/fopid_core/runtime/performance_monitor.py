"""Is the loop better or worse since its gains changed: error, oscillation and saturation beside what they were.

Oscillation is judged as by Forsman and Stattin (1999): in a loop that oscillates, successive swings of the error to the
same side have like areas and like lengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fopid_core.errors import InputError

Verdict = Literal["undecided", "better", "worse"]

_LIKE_AREA, _LIKE_LENGTH = 0.6, 0.7
_FEWEST_SWINGS = 6


@dataclass(frozen=True)
class LoopPerformance:
    """What a loop did over a stretch of time.

    Attributes
    ----------
    duration : float
        [s]
    mean_square : float
        Of the error, setpoint less measurement.
    travel : float
        Sum of the squares of the setpoint's moves.
    oscillation : float
        Share of the error's swings that are like the one before to the same side, 0 to 1; 0 with too few of them.
    saturated : float
        Share of the time in which the control was at a limit, 0 to 1.
    """

    duration: float
    mean_square: float
    travel: float
    oscillation: float
    saturated: float


class PerformanceMeter:
    """Figures of a running loop, tick by tick, in constant memory.

    Parameters
    ----------
    sample_time : float
        [s]

    Examples
    --------
    >>> meter = PerformanceMeter(0.1)
    >>> for k in range(400):
    ...     meter.step(0.0, math.sin(0.3 * k), saturated=False)
    >>> meter.figures.oscillation, round(meter.figures.mean_square, 2)
    (1.0, 0.5)
    """

    def __init__(self, sample_time: float) -> None:
        if not 0.0 < sample_time < math.inf:
            raise InputError(f"sample_time = {sample_time}; allowed: above 0 s")
        self._h = sample_time
        self._ticks = self._saturated = self._swings = self._alike = 0
        self._squares = self._travel = 0.0
        self._setpoint: float | None = None
        self._area = self._length = 0.0
        self._before: list[tuple[float, float]] = []  # area and length of the last two swings

    def step(self, setpoint: float, measurement: float, saturated: bool) -> None:
        """Take one tick."""
        error = setpoint - measurement
        if not math.isfinite(error):
            raise InputError(f"setpoint = {setpoint}, measurement = {measurement}; allowed: finite numbers")
        moved = 0.0 if self._setpoint is None else setpoint - self._setpoint
        self._setpoint = setpoint
        self._ticks += 1
        self._saturated += saturated
        self._squares += error * error
        self._travel += moved * moved
        if error * self._area < 0.0:
            self._end_swing()
        self._area += error * self._h
        self._length += self._h

    def _end_swing(self) -> None:
        self._swings += 1
        if len(self._before) == 2:
            area, length = self._before[0]
            alike = _LIKE_AREA < self._area / area < 1.0 / _LIKE_AREA
            self._alike += alike and _LIKE_LENGTH < self._length / length < 1.0 / _LIKE_LENGTH
        self._before = [*self._before[-1:], (self._area, self._length)]
        self._area = self._length = 0.0

    @property
    def figures(self) -> LoopPerformance:
        """What the loop did so far."""
        ticks = max(self._ticks, 1)
        oscillation = self._alike / (self._swings - 2) if self._swings >= _FEWEST_SWINGS else 0.0
        return LoopPerformance(
            duration=self._ticks * self._h,
            mean_square=self._squares / ticks,
            travel=self._travel,
            oscillation=oscillation,
            saturated=self._saturated / ticks,
        )


@dataclass(frozen=True)
class MonitorSettings:
    """What counts as worse.

    Attributes
    ----------
    window : float
        How long the loop is watched [s].
    response_time : float
        About how long a good loop takes to follow a step [s]: 2 over its crossover.
    error_factor : float
        By how much the mean square of the error may grow, beyond what the setpoint's moves explain.
    oscillation : float
        Share of like swings above which the loop oscillates.
    saturation : float
        By how much the share of the time at a limit may grow.
    noise : float
        Standard deviation of the measurement's noise: swings of that size do not count as oscillation.
    """

    window: float
    response_time: float
    error_factor: float = 2.0
    oscillation: float = 0.7
    saturation: float = 0.3
    noise: float = 0.0

    def __post_init__(self) -> None:
        for name, least in (("window", 0.0), ("response_time", 0.0), ("error_factor", 1.0)):
            value = getattr(self, name)
            if not least < value < math.inf:
                raise InputError(f"{name} = {value}; allowed: a finite number above {least:g}")


class PerformanceMonitor:
    """Watches a loop after a change: ``verdict = watch.step(setpoint, measurement, saturated)``.

    ``worse`` may come at any tick, and stays; ``better`` or, with an error between as large and the factor larger,
    ``undecided`` at the end of the window.

    Parameters
    ----------
    before : LoopPerformance
        Of the loop before the change.
    settings : MonitorSettings
    sample_time : float
        [s]

    Attributes
    ----------
    verdict : {"undecided", "better", "worse"}
    reason : str
        What the verdict rests on.
    """

    def __init__(self, before: LoopPerformance, settings: MonitorSettings, sample_time: float) -> None:
        self.before, self.settings = before, settings
        self.verdict: Verdict = "undecided"
        self.reason = ""
        self._meter = PerformanceMeter(sample_time)

    @property
    def figures(self) -> LoopPerformance:
        """Of the loop since the change."""
        return self._meter.figures

    @property
    def finished(self) -> bool:
        """Whether the verdict is final."""
        return self.verdict == "worse" or self.figures.duration >= self.settings.window

    def step(self, setpoint: float, measurement: float, saturated: bool) -> Verdict:
        """Take one tick."""
        if self.finished:
            return self.verdict
        self._meter.step(setpoint, measurement, saturated)
        found = self.figures
        tests: tuple[Callable[[LoopPerformance], str], ...] = (self._error, self._oscillation, self._saturation)
        self.reason = next((reason for test in tests if (reason := test(found))), "")
        if self.reason:
            self.verdict = "worse"
        elif found.duration >= self.settings.window:
            self._conclude(found)
        return self.verdict

    def _explained(self, found: LoopPerformance) -> float:
        """Integral of the squared error that the old loop, and the setpoint's moves, would have over the window."""
        settings = self.settings
        floor = self.before.mean_square + settings.noise**2
        return settings.error_factor * floor * settings.window + found.travel * settings.response_time

    def _error(self, found: LoopPerformance) -> str:
        if found.mean_square * found.duration <= self._explained(found):
            return ""
        was, now = math.sqrt(self.before.mean_square), math.sqrt(found.mean_square)
        return f"the error's root mean square went from {was:.3g} to {now:.3g}"

    def _oscillation(self, found: LoopPerformance) -> str:
        settings = self.settings
        grown = found.mean_square > max(self.before.mean_square, 4.0 * settings.noise**2)
        if not grown or found.oscillation <= max(settings.oscillation, self.before.oscillation):
            return ""
        return f"the loop oscillates: {found.oscillation:.0%} of the error's swings are like the one before"

    def _saturation(self, found: LoopPerformance) -> str:
        more = found.saturated - self.before.saturated
        if more <= self.settings.saturation or found.duration < 0.5 * self.settings.window:
            return ""
        return f"the control is at a limit {found.saturated:.0%} of the time, {self.before.saturated:.0%} before"

    def _conclude(self, found: LoopPerformance) -> None:
        allowed = self.before.mean_square + self.settings.noise**2
        allowed += found.travel * self.settings.response_time / self.settings.window
        if found.mean_square <= allowed:
            self.verdict = "better"
        was, now = math.sqrt(self.before.mean_square), math.sqrt(found.mean_square)
        self.reason = f"the error's root mean square went from {was:.3g} to {now:.3g}"
