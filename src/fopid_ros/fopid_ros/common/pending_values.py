"""In lockstep a value may come ahead of its time: its stamp says from which sample on it counts."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import count

from fopid_core.errors import InputError

SIM_TIME_LIMIT_NS = 1_000_000_000 * 1_000_000_000
"""Stamps from 2001 on [ns] are of a wall clock, and no instants of a loop that counts from 0."""
MOST = 100_000
"""So many values may wait."""


class PendingValues:
    """Values that wait for their sample; a whole stretch of a profile can be sent before the loop runs through it."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, float]] = []
        self._came = count()
        self._now = -1

    def defer(self, stamp_ns: int | None, value: float) -> bool:
        """Keep a value for later, unless it counts at once: no stamp, a past one, or a wall clock's.

        Raises
        ------
        InputError
            If too many wait already.
        """
        if not stamp_ns or not self._now < stamp_ns < SIM_TIME_LIMIT_NS:
            return False
        if len(self._waiting) >= MOST:
            raise InputError(f"a value stamped ahead while {MOST} wait for their time; allowed: one that counts now")
        heapq.heappush(self._waiting, (stamp_ns, next(self._came), value))
        return True

    def begin_anew(self, now_ns: int) -> None:
        """Forget what waits for a run that has ended, where time has run backwards."""
        if now_ns < self._now:
            self._waiting.clear()
            self._now = -1

    def due(self, now_ns: int) -> Iterator[float]:
        """The values whose time has come, by their stamps, those alike in the order in which they came."""
        self._now = now_ns
        while self._waiting and self._waiting[0][0] <= now_ns:
            yield heapq.heappop(self._waiting)[-1]
