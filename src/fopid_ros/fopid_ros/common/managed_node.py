"""What the nodes have in common: a managed life, checked parameters, an orderly end."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future

from fopid_core.errors import InputError
from fopid_ros.common.endpoints import Endpoints
from fopid_ros.common.parameters import (
    Spec,
    check_changes,
    converted,
    current_values,
    declare,
    widen_sliders,
    without_idle,
)

FOREVER = 1e8  # [s]
LAST_DOMAIN = 232  # its UDP ports are the last below 65536
CLOCK_WATCH_PERIOD = 0.1  # how often the system clock is looked at, and by how much it may be set back unseen [s]
LOCKSTEP_DEPTH = 1000
"""Depth of the loop's publishers in lockstep: a recorder that falls behind loses nothing."""

TIMING = Spec(
    "trigger", "realtime", "realtime: a timer on a steady clock; lockstep: the plant owns /clock",
    choices=("realtime", "lockstep"), read_only=True,
)  # fmt: skip
AUTOSTART = Spec("autostart", True, "configure and activate without waiting for a lifecycle manager", read_only=True)


def loop_qos(*, lockstep: bool, reliable: bool = True) -> QoSProfile:
    """QoS of the loop's signals: depth 1, since only the newest value counts, except in lockstep."""
    best_effort = not reliable and not lockstep
    return QoSProfile(
        depth=LOCKSTEP_DEPTH if lockstep else 1,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
    )


def latched_qos(depth: int = 1) -> QoSProfile:
    """QoS of what late-comers should still see."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def take_pending_messages(subscription: Subscription) -> None:
    """Deliver the messages that have arrived but whose callback has not run yet."""
    take = subscription.handle.take_message
    while (taken := take(subscription.msg_type, False)) is not None:
        subscription.callback(taken[0])


class ManagedNode(LifecycleNode):
    """A lifecycle node whose parameters are a table and are checked as a whole.

    Subclasses name themselves and their parameters, and override ``check`` (would this set of values do?),
    ``apply`` (it is in force now) and ``open`` (make what lives from configure to cleanup).

    Attributes
    ----------
    endpoints : Endpoints
        Closed at cleanup and at shutdown.
    configured : bool
    last_rejected : str
        Why the last set of parameters that was refused was refused.
    """

    NAME: ClassVar[str]
    SPECS: ClassVar[tuple[Spec, ...]]

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(self.NAME, context=context)
        self._specs = {spec.name: spec for spec in (*self.SPECS, AUTOSTART)}
        self.endpoints = Endpoints(self)
        self.configured = False
        self.last_rejected = ""
        self._not_configured = ""
        self._tolerate_invalid_transitions()
        self._set_requests_whole()
        try:
            declare(self, self._specs)
            if self.get_parameter("autostart").value:
                self.check(self.values())
        except InputError:
            self.destroy_node()
            raise
        self.add_post_set_parameters_callback(self._after_set)

    def values(self, changes: Sequence[Parameter] = ()) -> dict[str, Any]:
        """All parameters by name, with ``changes`` made."""
        return current_values(self, self._specs, changes)

    def check(self, values: dict[str, Any]) -> None:
        """Raise InputError if the node cannot run with these values."""

    def apply(self, values: dict[str, Any]) -> None:
        """Take values that have passed ``check``."""

    def open(self, values: dict[str, Any]) -> None:
        """Make what the node needs from configure to cleanup; raises InputError if it cannot."""

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """All or none, and a refusal names the parameter, its value and what is allowed."""
        changes = without_idle(self, converted(self._specs, parameter_list))
        if not changes:
            return SetParametersResult(successful=True)
        try:
            check_changes(self, self._specs, changes, configured=self.configured)
            if self.configured:
                self.check(self.values(changes))
            widen_sliders(self, self._specs, changes)
            result = super().set_parameters_atomically(changes)
        except InputError as error:
            result = SetParametersResult(successful=False, reason=str(error))
        if not result.successful:
            self.last_rejected = result.reason
            self.get_logger().warning(f"parameters rejected, nothing changed: {result.reason}")
        return result

    def _set_requests_whole(self) -> None:
        """Take a request of ``~/set_parameters`` as one set, too: half of a file that is loaded would be no controller.

        Its answer has a result for each parameter, all of them the same.
        """
        (service,) = (one for one in self.services if one.srv_type is SetParameters)

        def answer(request: SetParameters.Request, response: SetParameters.Response) -> SetParameters.Response:
            changes = [Parameter.from_parameter_msg(change) for change in request.parameters]
            response.results = [self.set_parameters_atomically(changes)] * len(changes)
            return response

        service.callback = answer

    def _after_set(self, changes: list[Parameter]) -> None:
        if any(change.name in self._specs for change in changes):
            self.apply(self.values())

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        values = self.values()
        try:
            self.check(values)
            self.open(values)
        except InputError as error:
            self._not_configured = str(error)
            self.endpoints.close()
            return TransitionCallbackReturn.FAILURE
        self.configured = True
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._release()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._release()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A transition raised; rclpy does not say what."""
        self.get_logger().error(f"leaving the state {state.label} failed; the node is unconfigured now")
        self._release()
        return super().on_error(state)

    def _release(self) -> None:
        self.configured = False
        self.endpoints.close()

    def _tolerate_invalid_transitions(self) -> None:
        """A transition that the present state does not allow is answered with success = false."""
        answer = self._service_change_state.callback

        def guarded(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            self._not_configured = ""
            try:
                response = answer(request, response)
            except RCLError as error:
                self.get_logger().warning(f"transition refused: {' '.join(str(error).split())}")
                response.success = False
            if self._not_configured:
                self.get_logger().error(f"not configured: {self._not_configured}")
            return response

        self._service_change_state.callback = guarded

    def start(self) -> None:
        """Configure and activate, when ``autostart`` is set.

        Raises
        ------
        InputError
            If the node does not reach the active state.
        """
        if not self.get_parameter("autostart").value:
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise InputError(self._not_configured or f"{self.get_name()} could not be started")

    def restart_timers(self) -> None:
        """Let all timers begin a new period now."""
        self.get_logger().warning("the system clock was set back: timers begin a new period")
        for timer in self.timers:
            timer.reset()

    def finish(self) -> None:
        """Bring work in other threads to an end, while the node is still spun."""

    def stop(self) -> None:
        """Leave the active state in good order."""
        try:
            self.trigger_shutdown()
        except RCLError:
            self.get_logger().debug("already shut down")


def usage(node_class: type[ManagedNode]) -> str:
    """What ``--help`` prints: the parameters, their defaults and what they mean."""
    lines = [
        f"usage: {Path(sys.argv[0]).name} [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]",
        "",
        str(node_class.__doc__).splitlines()[0],
        "",
        "parameters (default):",
    ]
    lines += [f"  {spec.name} ({spec.default})  {spec.description}" for spec in (*node_class.SPECS, AUTOSTART)]
    return "\n".join(lines)


class StopSignal:
    """Ctrl-C and termination as an event that threads can wait for."""

    def __init__(self) -> None:
        self.event = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self.event.set())


def run(
    node_class: type[ManagedNode],
    args: Sequence[str] | None = None,
    make_executor: Callable[[], Executor] = EventsExecutor,
) -> int:
    """Run a node until it is told to stop; the exit code of its process.

    Bad input ends with one line on stderr and exit code 2.
    """
    if "--help" in (sys.argv[1:] if args is None else args):
        print(usage(node_class))
        return 0
    stop = StopSignal()
    try:
        check_domain()
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = node_class()
    except (InputError, InvalidNodeNameException, InvalidNamespaceException, RCLError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    try:
        node.start()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        node.destroy_node()
        rclpy.try_shutdown()
        return 2
    try:
        _spin_until(stop.event, node, make_executor())
    finally:
        node.stop()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def check_domain() -> None:
    """Raise InputError for a domain that the transport has no ports for: it would end the process outright."""
    text = os.environ.get("ROS_DOMAIN_ID", "0").strip()
    if text.isdecimal() and int(text) > LAST_DOMAIN:
        raise InputError(f"ROS_DOMAIN_ID = {text}; allowed: 0 to {LAST_DOMAIN}")


def _spin_until(stop: threading.Event, node: ManagedNode, executor: Executor) -> None:
    """Spin in a thread of its own, so that signals are seen at once; raise what a callback raised."""
    failure: list[BaseException] = []
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
    _wait(stop, lambda: executor.create_task(node.restart_timers))
    node.finish()
    stopped.set_result(None)
    executor.wake()
    thread.join(timeout=5.0)
    executor.shutdown()
    if failure:
        raise failure[0]


def _wait(stop: threading.Event, on_time_jump_back: Callable[[], object]) -> None:
    """Wait for ``stop``, with an eye on the system clock.

    The timers of rclpy's wheels sleep until an instant of the system clock, even those of a steady clock: when it
    is set back they would oversleep by as much. Of a change that is made over a longer time they see little.
    """
    offset = time.time() - time.monotonic()
    while not stop.wait(CLOCK_WATCH_PERIOD):
        before, offset = offset, time.time() - time.monotonic()
        if offset < before - CLOCK_WATCH_PERIOD:
            on_time_jump_back()
