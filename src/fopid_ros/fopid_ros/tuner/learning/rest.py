"""Of a loop at rest: what was heard of it before anybody asked, and how far from its setpoint it may be."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from fopid_core.errors import InputError
from fopid_ros.tuner.learning.history import History
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_tap import Tick

LIVE_SHARE, LOOKS = 0.25, 10
"""Share of the time over which rest is judged that is waited for where the loop was heard before, and how often it is
looked at meanwhile."""
TICKS_LEAST = 20
"""So many ticks tell whether the loop rests; a busy machine may lose some."""
TICKS_HEARD = 100
"""So many ticks at rest are waited for, those before it included: fewer tell no spectrum of the noise."""


class RestlessError(InputError):
    """The loop does not come to rest."""


def heard_before(history: History, window: float, gap: float) -> list[Tick]:
    """The newest ticks of a loop that nothing has moved or changed since.

    Parameters
    ----------
    history : History
    window : float
        Of so many seconds at most.
    gap : float
        Whatever came before a silence of so long is left out [s].
    """
    newest, setpoint = history.newest_time("control"), history.newest("setpoint")
    try:
        heard = history.record(max(history.unmoved_since, history.changed, newest - window))
    except InputError:  # nothing yet
        return []
    times = newest - heard.span + heard.time
    silences = np.flatnonzero(np.diff(times) > gap)
    first = int(silences[-1]) + 1 if silences.size else 0
    values = zip(times[first:], heard.measurement[first:], heard.control[first:], strict=True)
    return [Tick(float(time), setpoint, float(measured), float(control)) for time, measured, control in values]


def bear(ticks: Sequence[Tick], borne: float) -> None:
    """End a wait for rest where the measurement is too far from a setpoint at rest.

    Raises
    ------
    RestlessError
    """
    first, newest = ticks[0], ticks[-1]
    off = newest.measurement - newest.setpoint
    if abs(off) > borne and newest.setpoint == first.setpoint:
        raise RestlessError(f"the measurement went {off:+.4g} off the setpoint ({borne:.4g} is borne)")


class RestingLoop:
    """Hears a loop until it rests.

    Parameters
    ----------
    loop : LoopBaseline
        Takes what is heard.
    history : History
        What was heard before, and is kept from now on.
    window : float
        Over which rest is judged [s].
    longest : float
        After which it is over, whether it rests or not [s].
    deviation_max : float
        As it was asked for; 0 chooses it.

    Attributes
    ----------
    began, newest : float
        When it was heard first, and last [s]; NaN before.
    """

    def __init__(
        self, loop: LoopBaseline, history: History, window: float, longest: float, deviation_max: float
    ) -> None:
        self._loop, self._history, self._window, self._longest = loop, history, window, longest
        self._deviation_max = deviation_max
        self._ticks = deque(_heard_of(loop, history, window))
        self.began = self.newest = self._rests_since = math.nan
        self._looked = -math.inf

    def hear(self, tick: Tick) -> None:
        """Take a tick."""
        if math.isnan(self.began):
            self.began = tick.time
            self._rests_since = self._ticks[0].time if self._ticks else tick.time
            heard_since = tick.time - TICKS_HEARD * self._loop.controller.sample_time  # slow ticks take long
            self._history.whole_since = min(self._history.whole_since, heard_since)
        self.newest = tick.time
        self._ticks.append(tick)
        while tick.time - self._ticks[0].time > self._window:
            self._ticks.popleft()

    @property
    def since(self) -> float:
        """When what it is judged by began [s]."""
        return self._ticks[0].time

    def is_over(self, borne: float) -> bool:
        """Whether it rests, and enough was heard, or it has been waited for long enough.

        Raises
        ------
        RestlessError
            If it goes further than is borne.
        InputError
            If hardly anything is heard.
        """
        if math.isnan(self.began):
            return False
        bear(self._ticks, borne)
        waited, window = self.newest - self.began, self._window
        is_early = waited < LIVE_SHARE * window or self.newest - self._rests_since < window
        if is_early or self.newest - self._looked < window / LOOKS:
            return False
        if len(self._ticks) < TICKS_LEAST:
            if waited > self._longest:
                heard = f"{len(self._ticks)} ticks of the controller heard in {window:.3g} s"
                raise InputError(f"{heard}; allowed: {TICKS_LEAST} or more")
            return False
        self._looked = self.newest
        self._loop.measure(list(self._ticks), self._deviation_max, self._history.travel("setpoint"))
        heard_enough = self._history.unmoved(TICKS_HEARD).size >= TICKS_HEARD
        return (self._loop.at_steady_state and heard_enough) or waited > self._longest


def usual_rest(loop: LoopBaseline, history: History, window: float) -> float:
    """How long it is waited for at least, with what was heard before [s]."""
    heard = _heard_of(loop, history, window)
    missing = TICKS_HEARD - history.unmoved(TICKS_HEARD).size
    still = window - (heard[-1].time - heard[0].time if heard else 0.0)
    return max(LIVE_SHARE * window, still, missing * loop.controller.sample_time)


def _heard_of(loop: LoopBaseline, history: History, window: float) -> list[Tick]:
    return heard_before(history, window, TICKS_LEAST * loop.controller.sample_time)
