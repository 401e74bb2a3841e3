"""Who has asked a lockstep loop to run to some time, and is answered when it is there."""

from __future__ import annotations

import math

from fopid_msgs.srv import Advance
from fopid_ros.common.background import Background, Later


class Advances:
    """Requests of ``~/advance`` that are on the way.

    Parameters
    ----------
    background : Background
        By which they are answered later.

    Attributes
    ----------
    next_time : float
        The earliest time that is waited for [s]; infinite for none.
    """

    def __init__(self, background: Background) -> None:
        self._background = background
        self._waiting: list[tuple[float, Later, Advance.Response]] = []
        self.next_time = math.inf

    def add(self, until: float, response: Advance.Response) -> Later:
        """Keep a request; what its service returns."""
        later = Later(self._background)
        self._waiting.append((until, later, response))
        self.next_time = min(self.next_time, until)
        return later

    def limit(self, now: float, until: float) -> None:
        """The loop runs no further than ``until`` from now on: who waits for more is told so."""
        for asked, later, response in self._waiting:
            if asked > until:
                response.time, response.message = now, f"another request has the loop stop at {until:g} s"
                later.give(response)
        self._waiting = [one for one in self._waiting if one[0] <= until]
        self.next_time = min((asked for asked, _, _ in self._waiting), default=math.inf)

    def answer(self, now: float, reached: float, reason: str = "") -> None:
        """Answer who asked for a time up to ``reached`` that it is ``now``, and with a reason everybody else, too."""
        waiting, self._waiting = self._waiting, []
        for until, later, response in waiting:
            if until > reached and not reason:
                self._waiting.append((until, later, response))
                continue
            response.success, response.time = until <= reached, now
            response.message = "reached" if response.success else reason
            later.give(response)
        self.next_time = min((until for until, _, _ in self._waiting), default=math.inf)
