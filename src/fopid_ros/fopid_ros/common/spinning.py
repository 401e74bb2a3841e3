"""Spinning a node until its process is told to stop, and an end that comes whatever the node does."""

from __future__ import annotations

import faulthandler
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Any

from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future

FOREVER = 1e8  # [s]
FINISH_TIME = 3.0
"""How long work in other threads may take to end when it is told to [s]."""
JOIN_TIME = 1.0  # how long the callback that runs just now may take to end [s]
HARD_STOP = 6.0
"""A process that was told to stop and has not ended after so long [s] is ended outright, with tracebacks on stderr."""
START_LIMIT = 120.0
"""A process whose nodes do not stand after so long [s] is ended outright: the transport may wait for ever, deaf to
signals, for shared memory whose maker was killed while he made it."""
CLOCK_WATCH_PERIOD = 0.1  # how often the system clock is looked at, and by how much it may be set back unseen [s]


class StopSignal:
    """Ctrl-C and termination, which can be waited for; from then on the process's time is limited.

    An event of ``threading`` will not do: the handler runs in the thread that waits for it, which may just then hold
    the event's own lock, and would wait for itself.
    """

    def __init__(self) -> None:
        self._told: SimpleQueue[None] = SimpleQueue()  # may be put into in the midst of a ``get``
        self.listen()

    @property
    def is_set(self) -> bool:
        """Whether it is to stop."""
        return not self._told.empty()

    def set(self) -> None:
        """It is to stop; from any thread, and from handlers of signals."""
        self._told.put(None)

    def wait(self, seconds: float) -> bool:
        """Whether it is to stop, within this time [s]; for one thread alone."""
        try:
            self._told.get(timeout=seconds)
        except Empty:
            return False
        self.set()
        return True

    def listen(self) -> None:
        """Take the signals, also from who took them in between."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)

    def _stop(self, *_: object) -> None:
        # A thread of C, which needs no lock of Python's: whatever hangs, and in whatever library, it ends.
        faulthandler.dump_traceback_later(HARD_STOP, exit=True)
        self.set()


@contextmanager
def start_limited(stop: StopSignal) -> Iterator[None]:
    """End the process when what is within takes longer than ``START_LIMIT``."""
    faulthandler.dump_traceback_later(START_LIMIT, exit=True)
    try:
        yield
    finally:
        if not stop.is_set:  # that has set a limit of its own
            faulthandler.cancel_dump_traceback_later()


def log_warnings(tell: Callable[[str], Any]) -> None:
    """Have Python's warnings told by the node's log, each once for its place in the sources."""

    def show(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any, **__: Any) -> None:
        tell(f"{category.__name__}: {' '.join(str(message).split())} ({filename}:{lineno})")

    warnings.showwarning = show


def spin_until(stop: StopSignal, *nodes: Any) -> None:
    """Spin nodes in a thread of its own, so that signals are seen at once; raise what a callback raised."""
    failure: list[BaseException] = []
    executor = EventsExecutor()
    stop.listen()  # the executor has taken the signals for itself
    for node in nodes:
        executor.add_node(node)
    stopped = Future()

    def spin() -> None:
        try:
            # Not spin(): without a time limit, EventsExecutor of rclpy 7.1 loops without waiting.
            executor.spin_until_future_complete(stopped, timeout_sec=FOREVER)
        except BaseException as error:  # noqa: BLE001  (handed to the main thread below)
            failure.append(error)
        finally:
            stop.set()

    thread = threading.Thread(target=spin, name="executor", daemon=True)
    thread.start()
    _wait(stop, lambda: [executor.create_task(node.restart_timers) for node in nodes])
    for node in [node for node in nodes if node.cancel_work("the node is told to stop")]:
        node.finish()
    stopped.set_result(None)
    executor.wake()
    thread.join(timeout=JOIN_TIME)
    executor.shutdown(timeout_sec=JOIN_TIME)
    if failure:
        raise failure[0]


def _wait(stop: StopSignal, on_time_jump_back: Callable[[], object]) -> None:
    """Wait for ``stop``, with an eye on the system clock.

    The timers of rclpy's wheels sleep until an instant of the system clock, even those of a steady clock: when it
    is set back they would oversleep by as much. Of a change that is made over a longer time they see little.
    """
    ahead = system_clock_ahead()
    while not stop.wait(CLOCK_WATCH_PERIOD):
        before, ahead = ahead, system_clock_ahead()
        if was_set_back(before, ahead):
            on_time_jump_back()


def system_clock_ahead() -> tuple[float, float]:
    """How far the system clock is ahead of the steady one [s], at least and at most.

    This thread may be held up between two readings of clocks, for as long as others compute.
    """
    earliest, now, latest = time.monotonic(), time.time(), time.monotonic()
    return now - latest, now - earliest


def was_set_back(before: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether the system clock has been set back for sure, by what it was ahead before and after.

    Examples
    --------
    >>> was_set_back((10.0, 10.0), (9.0, 9.0)), was_set_back((10.0, 10.0), (8.0, 10.0))  # set back; held up for 2 s
    (True, False)
    """
    return after[1] < before[0] - CLOCK_WATCH_PERIOD
