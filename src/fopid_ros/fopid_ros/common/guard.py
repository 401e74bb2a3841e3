"""No callback ends its node: what was not foreseen is logged with its traceback, counted, and answered."""

from __future__ import annotations

import functools
import inspect
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import DescribeParameters, GetParameters, GetParameterTypes, ListParameters
from rclpy.node import Node

from fopid_ros.common.cdr import fault_finder

INTERNAL_ERROR = "internal error; the node goes on, its log has the traceback"
"""What somebody is answered whose request ran into an error that was not foreseen."""
LOG_PERIOD = 10.0
"""One place in the sources logs no more than one traceback in this time [s]; all are counted."""
REFUSAL_PERIOD = 1.0
"""One topic's refused messages are told no more than once in this time [s]."""
MOST_ASKED = {
    ListParameters: ("prefixes", 100), GetParameters: ("names", 5_000), GetParameterTypes: ("names", 5_000),
    DescribeParameters: ("names", 5_000),
}  # fmt: skip
"""What a request for parameters may list at most, by its kind."""
FRAMES = -20
"""How much of a traceback is logged: its innermost frames."""


def do_nothing() -> None:
    """What follows an error where nothing else is said."""


class Guard:
    """Stands between the callbacks of a node and its executor.

    Parameters
    ----------
    log : callable
        Takes the text of an error.
    clock : callable, optional
        Time [s].

    Attributes
    ----------
    count : int
        Errors that were not foreseen, since the start.
    last : str
        What the newest was, in one line.
    malformed : int
        Messages whose bytes could not be read, and that no callback has seen.

    Examples
    --------
    >>> lines = []
    >>> guard = Guard(lines.append)
    >>> guard.wrap("timer", lambda: 1 / 0)()
    >>> guard.count, guard.last
    (1, 'timer: ZeroDivisionError: division by zero')
    """

    def __init__(self, log: Callable[[str], Any], clock: Callable[[], float] = time.monotonic) -> None:
        self.count = self.malformed = 0
        self.last = ""
        self._log, self._clock = log, clock
        self._lock = threading.Lock()
        self._logged: dict[tuple[str, ...], float] = {}
        self._told = self._malformed_told = 0

    def note(self, what: str, error: BaseException) -> None:
        """Count an error and log it."""
        line = " ".join(f"{what}: {type(error).__name__}: {error}".split())[:300]
        with self._lock:
            self.count += 1
            self.last = line
        if not self.is_due((what, type(error).__name__), LOG_PERIOD):
            return
        trace = "".join(traceback.format_exception(error, limit=FRAMES))
        self._log(f"internal error {self.count}, the node goes on: {line}\n{trace}")

    def is_due(self, place: tuple[str, ...], period: float) -> bool:
        """Whether something may be logged that is logged once in a period [s] at most; then it counts as logged."""
        with self._lock:
            now = self._clock()
            due = now - self._logged.get(place, -period) >= period
            if due:
                self._logged[place] = now
            return due

    def wrap(self, what: str, callback: Callable[..., Any], otherwise: Callable[[], Any] = do_nothing) -> Any:
        """The callback, but its errors are noted, and then what ``otherwise`` makes is returned."""

        @functools.wraps(callback)  # rclpy looks at the signature
        def guarded(*arguments: Any, **named: Any) -> Any:
            try:
                return callback(*arguments, **named)
            except Exception as error:  # noqa: BLE001  (this is the one place for what was not foreseen)
                self.note(what, error)
            try:
                return otherwise()
            except Exception as error:  # noqa: BLE001
                self.note(f"what follows an error of {what}", error)
                return None

        return guarded

    def health_problems(self) -> list[tuple[bytes, str]]:
        """For the diagnostics: an error since the last report, a warning for older ones and for messages refused."""
        before, self._told = self._told, self.count
        malformed, self._malformed_told = self.malformed - self._malformed_told, self.malformed
        found = []
        if self.count:
            level = DiagnosticStatus.ERROR if self.count > before else DiagnosticStatus.WARN
            found.append((level, f"{self.count} internal error{'s' * (self.count > 1)}, see the log"))
        if malformed:
            found.append((DiagnosticStatus.WARN, f"{malformed} malformed message{'s' * (malformed > 1)} refused"))
        return found

    def facts(self) -> dict[str, object]:
        """For the diagnostics."""
        return {
            "internal errors": self.count, "last internal error": self.last or "none",
            "malformed messages refused": self.malformed,
        }  # fmt: skip


class GuardedNode(Node):
    """A node of which each callback goes through ``guard``."""

    @functools.cached_property
    def guard(self) -> Guard:
        """The node's guard, there from its first callback on."""
        return Guard(lambda text: self.get_logger().error(text))

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *more: Any, raw: bool = False,
        otherwise: Callable[[], Any] = do_nothing, **named: Any,
    ) -> Any:  # fmt: skip
        if raw:  # others are read by the middleware, which drops what is malformed
            callback = self._whole_only(msg_type, topic, callback)
        if _wants_information(callback):
            callback = _taken_apart(callback)
        guarded = self.guard.wrap(f"subscription {topic}", callback, otherwise)
        return super().create_subscription(msg_type, topic, guarded, *more, raw=raw, **named)

    def _whole_only(self, msg_type: Any, topic: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """The callback, which then sees no bytes that are no message."""
        fault_of = fault_finder(msg_type)

        @functools.wraps(callback)
        def checked(data: bytes, *more: Any) -> None:
            fault = fault_of(data)
            if fault:
                self.guard.malformed += 1
                self.refuse_message(topic, f"{topic}: {fault}")
            else:
                callback(data, *more)

        return checked

    def refuse_message(self, topic: str, told: str) -> None:
        """A message on a topic cannot be used; a node that counts what it refuses does so here."""
        if self.guard.is_due((topic,), REFUSAL_PERIOD):
            self.get_logger().warning(f"{told}; refused ({self.guard.malformed} so far)")

    def create_timer(
        self, timer_period_sec: float, callback: Any, *more: Any, otherwise: Callable[[], Any] = do_nothing,
        **named: Any,
    ) -> Any:  # fmt: skip
        what = f"timer {getattr(callback, '__name__', '')}".strip()
        return super().create_timer(timer_period_sec, self.guard.wrap(what, callback, otherwise), *more, **named)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, *more: Any, **named: Any) -> Any:
        if srv_type in MOST_ASKED:
            callback = self._limited(callback, *MOST_ASKED[srv_type])
        guarded = self.guard.wrap(f"service {srv_name}", callback, lambda: internal_error(srv_type.Response()))
        return super().create_service(srv_type, srv_name, guarded, *more, **named)

    def _limited(self, answer: Callable[[Any, Any], Any], field: str, most: int) -> Callable[[Any, Any], Any]:
        """The answer, but to what lists more than any node has: that is as empty as the one to unknown names.

        rclpy compares each parameter with each prefix: a million of them held a controller up for half a minute.
        """

        def limited(request: Any, response: Any) -> Any:
            count = len(getattr(request, field))
            if count <= most:
                return answer(request, response)
            self.get_logger().warning(f"refused: {count} {field} of parameters; allowed: {most} at most")
            return response

        return limited


def _wants_information(callback: Callable[..., Any]) -> bool:
    """Whether rclpy hands a callback what is known of a message beside the message: where it takes two arguments."""
    try:
        inspect.signature(callback).bind(None, None)
    except TypeError:
        return False
    return True


def _taken_apart(callback: Callable[..., Any]) -> Callable[..., Any]:
    """A message and what is known of it as two arguments: EventsExecutor of rclpy 7.1 hands them over as one tuple."""

    @functools.wraps(callback)
    def called(*arguments: Any) -> Any:
        first = arguments[0]
        return callback(*first) if isinstance(first, tuple) else callback(*arguments)

    return called


def internal_error(response: Any) -> Any:
    """A response that says so, where it has a place for words."""
    for field in ("message", "reason"):
        if hasattr(response, field):
            setattr(response, field, INTERNAL_ERROR)
    return response
