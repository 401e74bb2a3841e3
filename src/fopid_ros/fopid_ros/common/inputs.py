"""An input of the controller: its newest good value, when that came, and what was refused."""

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
    received_ns : int
        When its newest value came, on the clock of the ticks.
    timeout_ns : float
        Age at which it is too old; infinite for never.
    came : bool
        Whether a value has come from outside.
    refused : int
        How many values were refused, whatever for.
    without : str
        What happens while it is too old, for people.

    Examples
    --------
    >>> level = Input("measurement")
    >>> level.timeout_ns = 100
    >>> level.take(2.0, now_ns=50), level.take(float("nan"), now_ns=90)
    (True, False)
    >>> level.usable(150), level.usable(151)
    (True, False)
    >>> level.faded(200), level.faded(250)  # half of another timeout later, and the whole of it
    (1.0, 0.0)
    """

    def __init__(self, name: str, value: float = math.nan) -> None:
        self.name, self.value = name, value
        self.received_ns = 0
        self.timeout_ns = math.inf
        self.came = False
        self.without = "the loop goes on without it"
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
        self.value, self.received_ns, self.came = value, now_ns, True
        return True

    def usable(self, now_ns: int) -> bool:
        """Whether there is a value that is not too old."""
        return now_ns - self.received_ns <= self.timeout_ns and self.value == self.value  # not NaN, without a call

    def stale(self, now_ns: int) -> bool:
        """Whether a value came, and is too old now."""
        return self.came and now_ns - self.received_ns > self.timeout_ns

    def faded(self, now_ns: int) -> float:
        """The value while it is not too old; then it goes to 0 in a straight line, within another timeout."""
        too_old = now_ns - self.received_ns - self.timeout_ns
        if too_old <= 0:
            return self.value
        return self.value * max(0.0, 1.0 - too_old / self.timeout_ns)

    def age(self, now_ns: int) -> float:
        """Time since the newest good value came [s]; NaN before the first."""
        return (now_ns - self.received_ns) * 1e-9 if self.came else math.nan
