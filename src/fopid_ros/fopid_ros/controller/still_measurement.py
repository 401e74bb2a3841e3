"""A sensor that repeats its last value: the messages are fresh, the value is not."""

from __future__ import annotations

import math

SEEN, STILL, LONGER = 60, 10, 3
"""So many looks show how long a measurement stands still; for so many it does, and for so many times as long as it ever
did, where its sensor is dead."""
MOVED, MOVED_OF_SEEN = 0.01, 0.1
"""Share of the control's range by which the control has moved meanwhile; where that has no end, of the range that the
control went through while the measurement moved."""


class StillMeasurement:
    """Looked at once a second: a measurement that used to change stands still, though the control moves.

    Parameters
    ----------
    name : str
        Of the measurement, in words.

    Examples
    --------
    >>> still = StillMeasurement()
    >>> for second in range(100):
    ...     told = still.look(20.0 + 0.1 * min(second % 7, 80), control=50.0, control_range=100.0)
    >>> for second in range(12):
    ...     told = still.look(20.0, control=50.0 + second, control_range=100.0)
    >>> told
    'the measurement has been 20 for 11 s, while the control went from 50 to 61: is the sensor dead?'
    """

    def __init__(self, name: str = "measurement") -> None:
        self._name = name
        self._value = self._control = math.nan
        self._low, self._high = math.inf, -math.inf  # of the control while the measurement moved
        self._looks = self._lasted = self._longest = 0
        self._told = False

    def look(self, value: float, control: float, control_range: float) -> str:
        """What is to be told, a second after the last look; or nothing."""
        self._looks += 1
        if value != self._value:
            if not self._told:  # what was dead says nothing of how long it usually stands still
                self._longest = max(self._longest, self._lasted)
            self._value, self._control, self._lasted, self._told = value, control, 0, False
            self._low, self._high = min(self._low, control), max(self._high, control)
            return ""
        self._lasted += 1
        usual = self._looks <= SEEN or self._lasted <= max(STILL, LONGER * self._longest)
        least = MOVED * control_range if math.isfinite(control_range) else MOVED_OF_SEEN * (self._high - self._low)
        if usual or not abs(control - self._control) > least:
            return ""
        self._told = True
        went = f"while the control went from {self._control:.4g} to {control:.4g}"
        return f"the {self._name} has been {value:.4g} for {self._lasted} s, {went}: is the sensor dead?"
