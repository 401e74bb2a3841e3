"""How far apart the samples are that a controller takes, by their stamps: for ``variable_step``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fopid_core.errors import InputError
from fopid_core.runtime.variable_step import LONGEST, SHORTEST


def check_variable_step(values: Mapping[str, Any]) -> None:
    """Raise InputError for a table of gains beside measured intervals: what it goes between is of one sample time."""
    if values["variable_step"] and values["schedule_file"]:
        raise InputError("variable_step = True, schedule_file given; allowed: one of them")


class SampleIntervals:
    """Tells before each tick how long after the last sample the new one was taken.

    Parameters
    ----------
    sample_time : float
        Of the first sample, which has none before it [s].

    Examples
    --------
    >>> intervals = SampleIntervals(0.01)
    >>> [round(intervals.take(ns), 6) for ns in (5_000_000, 17_000_000, 17_000_000, 18_000_000, 45_000_000)]
    [0.01, 0.012, 0.0, 0.0, 0.028]
    """

    def __init__(self, sample_time: float) -> None:
        self._sample_time, self._last = sample_time, -1

    def begin(self) -> None:
        """The next sample is the first one."""
        self._last = -1

    def take(self, sampled_ns: int) -> float:
        """The interval to the newest sample [s]; 0 while there is none that is new and far enough from the last."""
        if self._last < 0 or sampled_ns < self._last:
            self._last = sampled_ns
            return self._sample_time
        interval = (sampled_ns - self._last) * 1e-9
        if interval < SHORTEST * self._sample_time:
            return 0.0
        self._last = sampled_ns
        return interval

    def longest(self, timeout_ns: float) -> float:
        """An interval above this is a measurement that was stale [s]."""
        return min(timeout_ns * 1e-9, LONGEST * self._sample_time)
