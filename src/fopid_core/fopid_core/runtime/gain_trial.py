"""What comes back with the gains from before a trial: the integral that they held the plant with."""

from __future__ import annotations

import math
from collections import deque

from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_core.runtime.settings import ControllerSettings

DEEPEST = 8
"""So many trials, each begun during the last, are remembered."""
FADES = 3.0
"""What a trial has been through counts less with this power of its age: of what was at half of its time, an eighth."""
FAR = 4.0
"""A level is elsewhere that is further from where the trial began than so many times what counts of how it has moved,
and of the proportional part: a ramp is three times as far, a swing at its end as well."""
FEWEST = 20
"""Ticks that tell of rest."""

_Loop = tuple[Fopid, MeasurementFilter]


class _Trial:
    """Begun by a loop whose level was such."""

    def __init__(self, loop: _Loop, level: float) -> None:
        self.loop, self.level = loop, level
        self._began, self._ticks, self._limited = math.nan, 0, 0.0
        self._low = self._high = self._proportional = 0.0

    def watch(self, level: float, proportional: float, *, limited: bool) -> None:
        self._ticks += 1
        if self._ticks == 1:
            self._began = self._low = self._high = level
        left = 1.0 - min(FADES / self._ticks, 1.0)
        self._low = min(level, level + left * (self._low - level))
        self._high = max(level, level + left * (self._high - level))
        self._proportional = max(abs(proportional), left * self._proportional)
        self._limited = 1.0 if limited else left * self._limited

    @property
    def is_calm_elsewhere(self) -> bool:
        """Whether it has found rest where it had not begun: the load has changed, or the setpoint."""
        if self._ticks < FEWEST or self._limited > 1.0 / FAR:
            return False
        away = max(self._low - self._began, self._began - self._high)
        return away > FAR * (self._high - self._low + self._proportional)


class GainTrial:
    """Where the loop was when gains were put on trial.

    Gains that are taken back have often driven the control to where it must not stay, and those from before may be too
    weak to bring it home in time: they go on as if the trial had never been. Where those on trial have found rest at
    another level, that is where the plant is held now, and they go on from there. A level is the control without an
    error.

    Examples
    --------
    >>> from dataclasses import replace
    >>> before = ControllerSettings(Fopid(0.1, 0.05))
    >>> on_trial, trial = replace(before, gains=Fopid(5.5, 80.0), on_trial=True), GainTrial()
    >>> trial.change(before, on_trial, level=0.12)
    >>> trial.change(on_trial, before, level=-2.6)
    0.12
    """

    def __init__(self) -> None:
        self._trials: deque[_Trial] = deque(maxlen=DEEPEST)

    def watch(self, level: float, proportional: float, *, limited: bool) -> None:
        """A tick on trial: the level, what the error adds to it at once, and whether the control was limited."""
        if self._trials:
            self._trials[-1].watch(level, proportional, limited=limited)

    def change(self, before: ControllerSettings, after: ControllerSettings, level: float) -> float | None:
        """Settings change: the level to go on from, if that takes a trial back that has not found another; else None.

        Parameters
        ----------
        before, after : ControllerSettings
        level : float
            Where it is.
        """
        target, loop = None, _loop(after)
        if loop != _loop(before):
            if before.on_trial and any(each.loop == loop for each in self._trials):
                target = self._back_to(loop)
            elif after.on_trial:
                self._trials.append(_Trial(_loop(before), level))
        if not after.on_trial:
            self._trials.clear()
        return target

    def _back_to(self, loop: _Loop) -> float | None:
        """Through all trials since then, as far as the level of one is to be believed."""
        target, ended, believed = None, None, False
        while ended is None or ended.loop != loop:
            ended = self._trials.pop()
            believed = believed or ended.is_calm_elsewhere
            target = target if believed else ended.level
        return target


def _loop(settings: ControllerSettings) -> _Loop:
    return settings.gains, settings.measurement_filter
