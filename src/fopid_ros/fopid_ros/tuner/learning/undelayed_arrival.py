"""When a message would have come if nothing had held it up, neither on its way nor in a process that was stopped."""

from __future__ import annotations

import math
from collections.abc import Mapping

REMEMBERED = 5_000_000_000
"""For so long at least counts how late a message was [ns], and for twice as long at most: clocks drift, and are set."""


class UndelayedArrival:
    """Tells when messages of one topic would have come: when they were sent, and as late as the least late one came.

    The clocks of who sends and who hears may differ. A process that was stopped hears all at once what was sent
    meanwhile, and its middleware says of all of it that it came just now.

    Examples
    --------
    >>> arrival = UndelayedArrival()
    >>> [arrival.time_ns({"source_timestamp": sent, "received_timestamp": came}) for sent, came in ((1, 101), (3, 190))]
    [101, 103]
    """

    def __init__(self) -> None:
        self._least = self._least_before = math.inf
        self._since = 0

    def time_ns(self, info: Mapping[str, int]) -> int:
        """By the clock of who hears [ns], from what the middleware says of a message."""
        sent, came = info["source_timestamp"], info["received_timestamp"]
        if sent <= 0:  # not every middleware knows
            return came
        if came - self._since > REMEMBERED:
            self._least_before, self._least, self._since = self._least, math.inf, came
        self._least = min(self._least, came - sent)
        return sent + int(min(self._least, self._least_before))
