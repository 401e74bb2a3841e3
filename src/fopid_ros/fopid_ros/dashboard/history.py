"""What the page draws: the newest stretch of the loop's signals, thinned where it is too dense to see."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

SIGNALS = ("setpoint", "measurement", "control", "proportional", "integral", "derivative")
"""What a row holds after its time."""

Row = tuple[float, ...]
"""Time [s] and the signals; NaN where there is none."""

SETBACK = 1.0
"""A time that falls back further than this [s] begins a new record; what comes a little late is left out."""

MOST_WAITING = 100_000


def thinned(rows: Sequence[Row]) -> list[Row]:
    """The first and the last row and those where some signal is at its least or greatest.

    What is drawn from them covers the same points of the screen, as long as all rows fall on one column of it.

    Examples
    --------
    >>> thinned([(0.0, 1.0), (0.1, 1.1), (0.2, 7.0), (0.3, 1.2), (0.4, 1.3)])
    [(0.0, 1.0), (0.2, 7.0), (0.4, 1.3)]
    """
    kept = {0, len(rows) - 1} if rows else set()
    for column in zip(*rows, strict=True):
        there = [index for index, value in enumerate(column) if not math.isnan(value)]
        if there:
            kept |= {min(there, key=column.__getitem__), max(there, key=column.__getitem__)}
    return [rows[index] for index in sorted(kept)]


@dataclass(frozen=True)
class Cursor:
    """How far a reader has read.

    Attributes
    ----------
    record : int
        Number of the record; each begins when time falls back.
    rows : int
        Rows of it that were read.
    """

    record: int = -1
    rows: int = 0


class History:
    """The newest rows of one record.

    Parameters
    ----------
    size : int
        Rows kept.
    """

    def __init__(self, size: int) -> None:
        self._rows: deque[Row] = deque(maxlen=size)
        self._waiting: deque[Row] = deque(maxlen=MOST_WAITING)
        self._record = self._settled = 0
        self._origin, self._last = 0.0, -math.inf

    def add(self, stamp_ns: int, values: Sequence[float]) -> float:
        """Take the signals at an instant; its time since the record began [s].

        Told twice of an instant, it keeps what it was told last.
        """
        time = stamp_ns * 1e-9
        if self._last == -math.inf or time < self._last - SETBACK:
            self._begin(time)
        again = time == self._last and bool(self._waiting)
        if again:
            self._waiting.pop()
        if again or time > self._last:
            self._waiting.append((time - self._origin, *values))
            self._last = time
        return time - self._origin

    def _begin(self, time: float) -> None:
        self._rows.clear()
        self._waiting.clear()
        self._record += 1
        self._settled = 0
        self._origin, self._last = time, -math.inf

    def settle(self) -> None:
        """Thin out what came since the last call and keep it."""
        rows = thinned(self._waiting)
        self._waiting.clear()
        self._rows.extend(rows)
        self._settled += len(rows)

    def since(self, place: Cursor) -> tuple[list[Row], Cursor]:
        """The rows that a reader has not read and are still kept, and where it stands then."""
        read = place.rows if place.record == self._record else 0
        first_kept = self._settled - len(self._rows)
        rows = list(islice(self._rows, max(0, read - first_kept), None))
        return rows, Cursor(self._record, self._settled)
