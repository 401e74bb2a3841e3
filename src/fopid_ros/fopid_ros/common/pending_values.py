"""In lockstep a value may come ahead of its time: its stamp says from which sample on it counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

SIM_TIME_LIMIT_NS = 1_000_000_000 * 1_000_000_000
"""Stamps from 2001 on [ns] are of a wall clock, and no instants of a loop that counts from 0."""


class PendingValues:
    """Values that wait for their sample; a whole stretch of a profile can be sent before the loop runs through it."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, float]] = deque()
        self._now = -1

    def defer(self, stamp_ns: int | None, value: float) -> bool:
        """Keep a value for later, unless it counts at once: no stamp, a past one, or a wall clock's."""
        if not stamp_ns or not self._now < stamp_ns < SIM_TIME_LIMIT_NS:
            return False
        self._waiting.append((stamp_ns, value))
        return True

    def due(self, now_ns: int) -> Iterator[float]:
        """The values whose time has come, in the order in which they came."""
        self._now = now_ns
        while self._waiting and self._waiting[0][0] <= now_ns:
            yield self._waiting.popleft()[1]
