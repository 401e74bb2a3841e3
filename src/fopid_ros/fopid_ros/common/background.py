"""Long work in threads of its own; whatever talks to ROS is done by the executor's thread.

rclpy's EventsExecutor is by far the cheapest, but it does not suffer clients that are called from other threads, and
a coroutine that waits keeps it busy. So a service may return a ``Later`` in place of its response.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.action import ActionServer
from rclpy.exceptions import InvalidHandle
from rclpy.service import Service
from rclpy.task import Future

from fopid_ros.common.guard import GuardedNode, internal_error


class Background:
    """Threads for a node's long work, and their way back to its executor.

    Parameters
    ----------
    node : GuardedNode
    """

    def __init__(self, node: GuardedNode) -> None:
        self._node = node

    def start(self, name: str, work: Callable[[], None]) -> None:
        """Do some work in a thread that does not keep the process alive."""
        threading.Thread(target=self._node.guard.wrap(name, work), name=name, daemon=True).start()

    def on_executor(self, call: Callable[[], Any]) -> None:
        """Have the executor's thread do something soon; from any thread, in the order of the calls."""
        executor = self._node.executor
        if executor is not None:
            executor.create_task(self._node.guard.wrap("task", call))

    def may_answer_later(self, service: Service) -> None:
        """Let a service's callback return a ``Later``."""
        send, tell = service.send_response, self._node.get_logger().debug

        def reply(response: Any, header: Any) -> None:
            try:
                send(response, header)
            except (RCLError, InvalidHandle) as error:
                tell(f"who asked {service.srv_name} is gone, or it was closed: {error}")

        def send_now_or_later(response: Any, header: Any) -> None:
            if isinstance(response, Later):
                response.sent_by(lambda given: reply(given, header))
            else:
                reply(response, header)

        service.send_response = send_now_or_later  # type: ignore[method-assign]  # rclpy calls the service's own

    def result(self, ask: Callable[[], Future], seconds: float) -> Any:
        """What a request to another node is answered, None if nothing; to be called from a thread of its own.

        Parameters
        ----------
        ask : callable
            Sends the request, on the executor's thread.
        seconds : float
            How long the answer may take.
        """
        done, answers, asked = threading.Event(), [], []

        def answered(future: Future) -> None:
            answers.append(future.result())
            done.set()

        def begin() -> None:
            asked.append(ask())
            asked[0].add_done_callback(answered)

        self.on_executor(begin)
        if done.wait(seconds):
            return answers[0]
        self.on_executor(lambda: asked and asked[0].cancel())  # or it would be waited for for ever
        return None

    def value(self, call: Callable[[], Any], seconds: float) -> Any:
        """What a function returns on the executor's thread, None if it does not come to it in time."""
        done, values = threading.Event(), []

        def work() -> None:
            try:
                values.append(call())
            finally:
                done.set()

        self.on_executor(work)
        return values[0] if done.wait(seconds) and values else None


class Later:
    """What a service's callback returns when its response comes later: ``give`` it from any thread, once."""

    def __init__(self, background: Background) -> None:
        self._background = background
        self._send: Callable[[Any], None] | None = None
        self._given = threading.Lock()

    def give(self, response: Any) -> None:
        """Send the response; only the first counts."""
        if self._given.acquire(blocking=False):
            self._background.on_executor(lambda: self._send and self._send(response))

    def sent_by(self, send: Callable[[Any], None]) -> None:
        """How it is sent; known when the callback has returned, which is before the executor does anything else."""
        self._send = send


class BackgroundActionServer(ActionServer):
    """Executes each goal in a thread of its own.

    Parameters
    ----------
    node : GuardedNode
    kind : type
        Of the action.
    name : str
    execute : callable
        Takes a goal's handle and a function ``give``, in a thread of its own. What is given to ``give``, once, sets
        the goal's end on the executor's thread and returns its result.
    background : Background
    more
        As for rclpy's.
    """

    def __init__(
        self, node: GuardedNode, kind: Any, name: str, execute: Callable[[Any, Any], None],
        background: Background, **more: Any,
    ) -> None:  # fmt: skip
        self._guard, self._background = node.guard, background
        super().__init__(node, kind, name, execute, **more)

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Instead of having the executor wait for the goal's end, tell it of the end."""
        execute, finish = execute_callback or self._execute_callback, super().notify_execute
        given = threading.Lock()

        def give(end: Callable[[], Any]) -> None:
            if given.acquire(blocking=False):
                finish(goal_handle, lambda _: end())

        def failed() -> Any:
            goal_handle.abort()
            return internal_error(self.action_type.Result())

        def work() -> None:
            self._guard.wrap("goal", execute)(goal_handle, give)
            give(failed)

        self._background.start("goal", work)

    async def execute(self, taken_data: Any) -> None:
        """Serve what came in."""
        try:
            await super().execute(taken_data)
        except Exception as error:  # noqa: BLE001  (no request ends the node)
            self._guard.note("action", error)
