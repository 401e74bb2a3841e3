"""An input of the controller: its newest good value and when that came."""

from __future__ import annotations

import math

from fopid_core.runtime.settings import LARGEST


def is_number(value: float) -> bool:
    """Whether a signal can be reckoned with: neither NaN nor infinite, nor so large that sums of it would be."""
    return -LARGEST <= value <= LARGEST


class Input:
    """The newest good value of a signal.

    Parameters
    ----------
    name : str
    value : float
        Until one comes; NaN for none.

    Attributes
    ----------
    value : float
    arrived_ns : int
        When its newest value came, on the clock of the ticks.
    timeout_ns : float
        Age at which it is too old; infinite for never.
    refused : int
        How many values were refused.
    """

    def __init__(self, name: str, value: float = math.nan) -> None:
        self.name, self.value = name, value
        self.arrived_ns = 0
        self.timeout_ns = math.inf
        self.refused = 0

    @property
    def missing(self) -> bool:
        """Whether no good value has come yet."""
        return math.isnan(self.value)

    def take(self, value: float, now_ns: int) -> bool:
        """Keep a value; one that is not finite is counted and refused."""
        if not is_number(value):
            self.refused += 1
            return False
        self.value, self.arrived_ns = value, now_ns
        return True

    def usable(self, now_ns: int) -> bool:
        """Whether there is a value that is not too old."""
        return now_ns - self.arrived_ns <= self.timeout_ns and not math.isnan(self.value)

    def age(self, now_ns: int) -> float:
        """Time since the newest good value came [s]; NaN before the first."""
        return math.nan if self.missing else (now_ns - self.arrived_ns) * 1e-9
