"""What a sensor does that is no move of the plant: a sample that is far off, a value that comes again and again."""

from __future__ import annotations

import math

JUMP = 0.5
"""A sample that is further from the one before than this share of the allowed deviation counts once the next one is
there as well."""
STILL_TICKS, STILL_RUNS, STILL_ANSWERS = 20, 20, 3.0
"""A measurement that moved at rest is dead where it stands still for so many ticks, so many times as long as at rest,
and so many times as long as the loop takes to answer a move of the control that came meanwhile."""


class LoneSample:
    """Holds back a sample that jumps, until the next is there as well: a sensor that drops out for a tick is no move.

    Parameters
    ----------
    most : float
        How far a measurement may go from one tick to the next.

    Attributes
    ----------
    held_back : bool
        Whether the last sample was.

    Examples
    --------
    >>> sensor = LoneSample(1.0)
    >>> [sensor.seen(value) for value in (5.0, 5.2, 0.0, 5.1, 9.0, 9.0)]
    [5.0, 5.2, 5.2, 5.1, 5.1, 9.0]
    """

    def __init__(self, most: float) -> None:
        self._most, self._last, self.held_back = most, math.nan, False

    @classmethod
    def within(cls, deviation_max: float) -> LoneSample:
        """Of a loop whose measurement may go so far."""
        return cls(JUMP * deviation_max)

    def seen(self, measurement: float) -> float:
        """What to take for the measurement."""
        jumps = abs(measurement - self._last) > self._most
        self.held_back = jumps and not self.held_back
        if not self.held_back:
            self._last = measurement
        return self._last


class DeadSensor:
    """Sees a measurement that stands still while the control moves, though it did not at rest.

    Parameters
    ----------
    longest_still : int
        For so many ticks in a row it stood still at rest; 0 where it did for so long that this tells nothing.
    answer : float
        In which the loop answers a move of the control [s].

    Examples
    --------
    >>> sensor = DeadSensor(longest_still=1, answer=0.5)
    >>> told = [sensor.look(0.1 * tick, 3.0, added=0.2 * (tick > 10)) for tick in range(30)]
    >>> told[20], told[28]
    ('', 'the measurement has stood still at 3 for 2.8 s while the control was moved: is the sensor dead?')
    """

    def __init__(self, longest_still: int, answer: float) -> None:
        self._ticks_most = max(STILL_TICKS, STILL_RUNS * longest_still) if longest_still else math.inf
        self._answered = STILL_ANSWERS * answer
        self._value = self._since = self._moved_since = math.nan
        self._added, self._ticks = 0.0, 0

    def look(self, time: float, measurement: float, added: float) -> str:
        """Why it is dead, at a tick at which so much is added to the control; empty while it lives."""
        if measurement != self._value:
            self._value, self._since, self._moved_since, self._ticks = measurement, time, math.nan, 0
        if added != self._added and math.isnan(self._moved_since):
            self._moved_since = time
        self._added, self._ticks = added, self._ticks + 1
        if not (self._ticks > self._ticks_most and time - self._moved_since > self._answered):
            return ""
        told = f"the measurement has stood still at {measurement:.4g} for {time - self._since:.3g} s"
        return f"{told} while the control was moved: is the sensor dead?"
