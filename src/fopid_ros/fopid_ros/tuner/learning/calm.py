"""Has a loop come to rest: its measurement, noise averaged out, stays where it should."""

from __future__ import annotations

import math


class Calm:
    """For how long a deviation, noise averaged out, has been small.

    Parameters
    ----------
    near : float
        What is small.
    smoothing : float
        Time over which noise is averaged out [s].

    Attributes
    ----------
    lasted : float
        [s]; 0 while it is not calm.

    Examples
    --------
    >>> calm = Calm(near=1.0, smoothing=2.0)
    >>> for tick, deviation in enumerate([5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5, 0.0]):
    ...     calm.step(float(tick), deviation)
    >>> calm.lasted
    3.0
    """

    def __init__(self, near: float, smoothing: float) -> None:
        self._near, self._smoothing = near, smoothing
        self._level, self._since = math.nan, math.inf
        self._time = -math.inf

    @property
    def lasted(self) -> float:
        return max(self._time - self._since, 0.0) if math.isfinite(self._since) else 0.0

    def step(self, time: float, deviation: float) -> None:
        """One tick."""
        dt = time - self._time
        share = dt / (dt + self._smoothing) if math.isfinite(self._level) else 1.0
        self._level = deviation if share == 1.0 else self._level + share * (deviation - self._level)
        self._since = min(self._since, time) if abs(self._level) <= self._near else math.inf
        self._time = time
