"""Moves a running controller along a table of gains: without a bump, at any speed of the scheduling variable.

The bank of lags is the same for all gains; gains and orders are only how it is read. The readings of the operating
points, and of further ones in between, are worked out beforehand, and at each tick the controller
reads by the straight line between two of them. The step that a new reading would make is taken up by the integral, so
the control moves as that of a controller with the gains of the instant: each gain weighs what the error does while it
is in force (the velocity algorithm of Kaminer, Pascoal, Khargonekar and Coleman, Automatica 31, 1995).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from fopid_core.errors import InputError
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.reading import Reading
from fopid_core.runtime.schedule import GainSchedule, between
from fopid_core.runtime.settings import ControllerSettings, with_gains

_FINER = 32
"""Readings per interval: where orders change, a straight line between two is then closer than the bank is (0.04 dB)."""
_FADING = 50
"""Ticks in which a step that no integral will take back fades, where the filter of the variable is not slower."""

_READ_BY = ("sample_time", "active_band", "derivative_filter_time", "tracking_time")
"""Settings that a reading depends on."""


@dataclass(frozen=True)
class _Knot:
    at: float
    reading: Reading


class GainScheduler:
    """A controller's gains, as a table and a measured variable say.

    Parameters
    ----------
    schedule : GainSchedule
    controller : FopidController
        Its gains are those of the table's first point until the variable is known.

    Attributes
    ----------
    gains : Fopid
        The five numbers now.
    value : float
        Where in the table the controller is: the variable behind its filter and its hysteresis; NaN before the first.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.runtime.schedule import OperatingPoint
    >>> table = GainSchedule((OperatingPoint(0.0, Fopid(1.0)), OperatingPoint(1.0, Fopid(3.0))))
    >>> controller = FopidController(ControllerSettings(Fopid(1.0)))
    >>> scheduler = GainScheduler(table, controller)
    >>> scheduler.follow(0.5)
    >>> controller.step(1.0, 0.0)
    2.0
    """

    def __init__(self, schedule: GainSchedule, controller: FopidController) -> None:
        self._schedule, self._controller = schedule, controller
        self.value = self._filtered = math.nan
        self.gains = schedule.points[0].gains
        self._knots: list[_Knot] = []
        self.configure(controller.settings)

    def configure(self, settings: ControllerSettings) -> None:
        """Change the controller's settings other than the gains, between two ticks."""
        sample_time, filter_time = settings.sample_time, self._schedule.filter_time
        self._filter_share = -math.expm1(-sample_time / filter_time) if filter_time else 1.0
        self._fading = -math.expm1(-1.0 / max(_FADING, filter_time / sample_time))
        before = self._controller.settings
        self._controller.reconfigure(with_gains(settings, self.gains))
        if not self._knots or any(getattr(settings, name) != getattr(before, name) for name in _READ_BY):
            self._knots = _knots(self._schedule, self._controller.settings)
            self._values = [knot.at for knot in self._knots]
            self._conditioned = all(knot.reading.conditioned for knot in self._knots)
        if not math.isnan(self.value):
            self._read_at(self.value)

    def reset(self) -> None:
        """Forget where the variable was: the next value counts at once."""
        self.value = self._filtered = math.nan

    def follow(self, value: float | None) -> None:
        """Before each tick: go where the scheduling variable is; None to stay, since it is not known."""
        if value is not None:
            now = self._settled(value)
            if now != self.value:
                self.value = now
                self._read_at(now)
        if not self.gains.integrates:
            self._controller.fade_bias(self._fading)

    def _settled(self, value: float) -> float:
        """The variable behind its filter and its hysteresis (a play), within the table."""
        if not math.isfinite(value):
            raise InputError(f"scheduling variable = {value}; allowed: finite numbers")
        if math.isnan(self._filtered):
            self._filtered = now = value
        else:
            self._filtered += self._filter_share * (value - self._filtered)
            play = self._schedule.hysteresis
            now = min(max(self.value, self._filtered - play), self._filtered + play)
        return min(max(now, self._values[0]), self._values[-1])

    def _read_at(self, value: float) -> None:
        k = min(max(bisect_right(self._values, value) - 1, 0), len(self._values) - 2)
        first, second = self._knots[k], self._knots[k + 1]
        share = (value - first.at) / (second.at - first.at)
        self.gains = self._schedule.gains_at(value)
        self._controller.read_as(first.reading.towards(second.reading, share), conditioned=self._conditioned)


def _knots(schedule: GainSchedule, settings: ControllerSettings) -> list[_Knot]:
    """The readings of all points, and of enough between them."""
    points, knots = schedule.points, []
    for first, second in pairwise(points):
        shares = [k / _FINER for k in range(_FINER + (second is points[-1]))]
        for share in shares:
            gains = between(first.gains, second.gains, share)
            at = (1.0 - share) * first.at + share * second.at
            knots.append(_Knot(at, FopidController(with_gains(settings, gains)).reading))
    return knots
