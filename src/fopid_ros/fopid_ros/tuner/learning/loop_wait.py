"""Waiting on a running loop: told how far it is, ended by a request to cancel or by a loop that does not run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from fopid_ros.tuner.learning.loop_tap import LoopTap

STALL_TIME, STALL_TICKS = 3.0, 5.0
"""A loop without a tick for so long [s of the wall clock], and for so many ticks, stands still."""
OPEN_TIME = 1.0
"""So long a controller may go without a fresh measurement or setpoint, or in manual mode [s of the wall clock]."""
REPORT_PERIOD = 0.2
"""How often the one who asked is told [s]."""


class OpenLoopError(Exception):
    """The loop stands still, or its controller does not close it: nothing is known any more of gains on trial in it."""


class CancelledError(Exception):
    """Somebody asked for an end."""


@dataclass(frozen=True)
class Stage:
    """Where an autotuning is."""

    phase: str
    progress: float
    remaining: float = 0.0
    deviation: float = 0.0
    fit_pct: float = 0.0
    message: str = ""


class LoopWait:
    """Waits in the calling thread, while others spin the node.

    Parameters
    ----------
    tap : LoopTap
    report : callable
        Called with a ``Stage`` all along.
    cancelled : callable
        Whether an end has been asked for.

    Attributes
    ----------
    sample_time : float
        Of the controller, as far as it is known [s].
    """

    def __init__(self, tap: LoopTap, report: Callable[[Stage], None], cancelled: Callable[[], bool]) -> None:
        self._tap, self._report, self._cancelled = tap, report, cancelled
        self._round, self._from, self._to = "", 0.0, 1.0
        self.sample_time = 0.0

    def begin_round(self, name: str, share: tuple[float, float]) -> None:
        """From now on it is about a share of the whole, and stages are named so; the first needs no name."""
        self._round, (self._from, self._to) = name, share

    def report(self, stage: Stage) -> None:
        """Tell how far the round is, as a part of the whole."""
        message = ": ".join(filter(None, (self._round, stage.message)))
        progress = self._from + (self._to - self._from) * stage.progress
        self._report(replace(stage, progress=progress, message=message))

    def until(self, done: Callable[[], bool], stage: Callable[[], Stage]) -> None:
        """Wait until it is done.

        Raises
        ------
        CancelledError
            If an end has been asked for.
        OpenLoopError
            If the loop stands still, or its controller does not close it.
        """
        begun = last_tick = last_report = time.monotonic()
        stalled = max(STALL_TIME, STALL_TICKS * self.sample_time)
        while not done():
            if self._cancelled():
                raise CancelledError
            if self._tap.wait_for_tick(0.1):
                last_tick = time.monotonic()
            elif time.monotonic() - last_tick > stalled:
                unheard = f"no {self._tap.unheard} heard for {stalled:g} s"
                raise OpenLoopError(
                    f"{unheard}; allowed: a loop that runs (/diagnostics says what its controller waits for)"
                )
            been_open, because = self._tap.open_loop(begun)
            if been_open > OPEN_TIME:
                raise OpenLoopError(f"the controller {because}; allowed: a loop that runs")
            if time.monotonic() - last_report > REPORT_PERIOD:
                last_report = time.monotonic()
                self.report(stage())
