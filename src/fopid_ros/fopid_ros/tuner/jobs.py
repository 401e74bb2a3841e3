"""One piece of long work at a time, that can be told to end and cannot be forgotten."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from fopid_ros.tuner.learning.loop_wait import CancelledError


class Job:
    """A piece of work under way.

    Parameters
    ----------
    name : str
    give_up : callable
        Answers whoever waits for it, when it does not end although it was told to.

    Attributes
    ----------
    why : str
        Why it is to end; empty while it may go on.
    """

    def __init__(self, name: str, give_up: Callable[[], None] = lambda: None) -> None:
        self.name, self.give_up = name, give_up
        self.why = ""

    @property
    def cancelled(self) -> bool:
        """Whether it is to end."""
        return bool(self.why)

    def go_on(self) -> None:
        """Raise CancelledError when it is to end."""
        if self.why:
            raise CancelledError(self.why)

    def clock(self) -> float:
        """Time [s]; infinite once it is to end, so that a search with a limit of time ends at once."""
        return math.inf if self.why else time.perf_counter()


class Jobs:
    """Room for one job."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.current: Job | None = None

    def begin(self, job: Job) -> bool:
        """Take the room, unless it is taken."""
        with self._changed:
            if self.current is not None:
                return False
            self.current = job
            return True

    def end(self) -> None:
        """Leave the room."""
        with self._changed:
            self.current = None
            self._changed.notify_all()

    def cancel(self, why: str) -> bool:
        """Tell the job to end; whether there is one."""
        with self._changed:
            if self.current is not None and not self.current.why:
                self.current.why = why
            return self.current is not None

    def wait(self, seconds: float) -> None:
        """Wait for the job to end; give it up when it does not."""
        with self._changed:
            ended = self._changed.wait_for(lambda: self.current is None, seconds)
            job = self.current
        if not ended and job is not None:
            job.give_up()
