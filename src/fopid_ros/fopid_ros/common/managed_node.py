"""What the nodes have in common: a managed life, checked parameters, an orderly end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakSet

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from fopid_core.errors import InputError
from fopid_ros.common.arguments import refuse_other_arguments
from fopid_ros.common.background import Background, Later
from fopid_ros.common.diagnostics import diagnostic_array, diagnostic_status
from fopid_ros.common.endpoints import Endpoints
from fopid_ros.common.guard import INTERNAL_ERROR, GuardedNode
from fopid_ros.common.middleware import prepare_middleware, use_profile
from fopid_ros.common.parameters import (
    Spec,
    brief,
    changes_of,
    check_changes,
    converted,
    current_values,
    declare,
    widen_sliders,
    without_idle,
)
from fopid_ros.common.spinning import StopSignal, log_warnings, spin_until, start_limited

DIAGNOSTICS_PERIOD = 1.0
"""[s, on a steady clock]"""
LEAVING_ACTIVE = {
    Transition.TRANSITION_DEACTIVATE: "deactivate", Transition.TRANSITION_ACTIVE_SHUTDOWN: "shutdown",
}  # fmt: skip
"""Transitions out of the active state, by number and by label."""
LOCKSTEP_DEPTH = 1000
"""Depth of the loop's publishers in lockstep: a recorder that falls behind loses nothing."""

TIMING = Spec(
    "trigger", "realtime", "realtime: a timer on a steady clock; lockstep: the plant owns /clock",
    choices=("realtime", "lockstep"), read_only=True,
)  # fmt: skip
AUTOSTART = Spec("autostart", True, "configure and activate without waiting for a lifecycle manager", read_only=True)


def loop_qos(*, lockstep: bool, reliable: bool = True, depth: int = 1) -> QoSProfile:
    """QoS of the loop's signals: depth 1, since only the newest value counts, unless told otherwise or in lockstep."""
    best_effort = not reliable and not lockstep
    return QoSProfile(
        depth=LOCKSTEP_DEPTH if lockstep else depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
    )


def latched_qos(depth: int = 1) -> QoSProfile:
    """QoS of what late-comers should still see."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def take_pending_messages(subscription: Subscription, *, informed: bool = False, most: int = LOCKSTEP_DEPTH) -> None:
    """Deliver the messages that have arrived but whose callback has not run yet; with what is known of each.

    So many at most: they may come faster than they are read.
    """
    take, callback = subscription.handle.take_message, subscription.callback
    for _ in range(most):
        taken = take(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        callback(*taken if informed else taken[:1])


class ManagedNode(GuardedNode, LifecycleNode):
    """A lifecycle node whose parameters are a table and are checked as a whole, and that no callback ends.

    Subclasses name themselves and their parameters, and override ``check`` (would this set of values do?),
    ``apply`` (it is in force now), ``open`` (make what lives from configure to cleanup) and ``health``. One that works
    in other threads overrides ``cancel_work`` and ``finish``.

    Attributes
    ----------
    endpoints : Endpoints
        Closed at cleanup and at shutdown.
    configured : bool
    taken_by_hand : WeakSet of Subscription
        Subscriptions that wake no executor: their messages wait for ``take_pending_messages``.
    last_rejected : str
        Why the last set of parameters that was refused was refused.
    """

    NAME: ClassVar[str]
    SPECS: tuple[Spec, ...]

    def __init__(self, context: Context | None = None, namespace: str | None = None) -> None:
        super().__init__(self.NAME, namespace=namespace, context=context)
        self._specs = {spec.name: spec for spec in (*self.SPECS, AUTOSTART)}
        self.endpoints = Endpoints(self)
        self.background = Background(self)
        self.configured = False
        self.taken_by_hand: WeakSet[Subscription] = WeakSet()
        self.last_rejected = ""
        self._not_configured = ""
        self._guard_lifecycle()
        self._set_requests_whole()
        try:
            declare(self, self._specs)
            if self.get_parameter("autostart").value:
                self.check(self.values())
        except InputError:
            self.destroy_node()
            raise
        self.add_post_set_parameters_callback(self._after_set)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor serves."""
        return (each for each in super().subscriptions if each not in self.taken_by_hand)

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
        before: list[Parameter] = []
        if not changes:
            return SetParametersResult(successful=True)
        try:
            check_changes(self, self._specs, changes, configured=self.configured)
            if self.configured:
                self.check(self.values(changes))
            widen_sliders(self, self._specs, changes)
            before = [self.get_parameter(change.name) for change in changes]
            result = super().set_parameters_atomically(changes)
        except InputError as error:
            result = SetParametersResult(successful=False, reason=brief(str(error)))
        except Exception as error:  # noqa: BLE001  (no parameter ends the node)
            self.guard.note("parameters", error)
            self.guard.wrap("putting parameters back", super().set_parameters_atomically)(before)
            result = SetParametersResult(successful=False, reason=INTERNAL_ERROR)
        if not result.successful:
            self.last_rejected = result.reason
            self.get_logger().warning(f"parameters rejected, nothing changed: {result.reason}")
        return result

    def _set_requests_whole(self) -> None:
        """Take a request of ``~/set_parameters`` as one set, too: half of a file that is loaded would be no controller.

        Its answer has a result for each parameter, all of them the same.
        """

        def result(messages: Sequence[ParameterMessage]) -> SetParametersResult:
            try:
                return self.set_parameters_atomically(changes_of(messages))
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))

        def answer_each(request: SetParameters.Request, response: SetParameters.Response) -> SetParameters.Response:
            response.results = [result(request.parameters)] * len(request.parameters)
            return response

        def answer(request: Any, response: SetParametersAtomically.Response) -> SetParametersAtomically.Response:
            response.result = result(request.parameters)
            return response

        answers = {SetParameters: answer_each, SetParametersAtomically: answer}
        for service in self.services:
            if service.srv_type in answers:
                kind: Any = service.srv_type
                service.callback = self.guard.wrap(kind.__name__, answers[kind], kind.Response)

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

    def _guard_lifecycle(self) -> None:
        """What a transition raises is noted; one that the present state does not allow is answered: no success."""
        error = TransitionCallbackReturn.ERROR
        for state, callback in self._callbacks.items():
            self._callbacks[state] = self.guard.wrap(callback.__name__, callback, lambda: error)
        change = self._service_change_state
        self._answer_change = change.callback
        failed = lambda: ChangeState.Response(success=False)  # noqa: E731
        change.callback = self.guard.wrap("change_state", self._on_change_state, failed)
        self.background.may_answer_later(change)

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> Any:
        """Work that is under way ends first when the active state is left, and puts back what it changed."""
        asked = request.transition.label or LEAVING_ACTIVE.get(request.transition.id)
        if asked not in LEAVING_ACTIVE.values() or not self.cancel_work(f"the node is told to {asked}"):
            return self._change_state(request, response)
        later = Later(self.background)

        def leave() -> None:
            self.finish()
            self.background.on_executor(lambda: later.give(self._change_state(request, response)))

        self.background.start("transition", leave)
        return later

    def _change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        self._not_configured = ""
        try:
            response = self._answer_change(request, response)
        except RCLError as error:
            self.get_logger().warning(f"transition refused: {' '.join(str(error).split())}")
            response.success = False
        if self._not_configured:
            self.get_logger().error(f"not configured: {self._not_configured}")
        return response

    def open_diagnostics(self) -> None:
        """Publish ``health`` once a second from now to cleanup."""
        publisher = self.endpoints.publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))

        def publish() -> None:
            state, problems, facts = self.health()
            status = diagnostic_status(
                self.get_fully_qualified_name(), state, [*self.guard.health_problems(), *problems],
                {**facts, **self.guard.facts()},
            )  # fmt: skip
            publisher.publish(diagnostic_array(status, self))

        self.endpoints.timer(DIAGNOSTICS_PERIOD, publish, Clock(clock_type=ClockType.STEADY_TIME))

    def health(self) -> tuple[str, list[tuple[bytes, str]], dict[str, object]]:
        """For the diagnostics: a word on the state, the problems with their levels, and facts."""
        return "running", [], {}

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

    def cancel_work(self, why: str) -> bool:
        """Tell work in other threads to end; whether there is any."""
        return False

    def finish(self) -> None:
        """Wait for work in other threads to end, ``FINISH_TIME`` at most, while the node is still spun."""

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


def run(
    node_class: type[ManagedNode], args: Sequence[str] | None = None, make: Callable[[], ManagedNode] | None = None
) -> int:
    """Run a node until it is told to stop; the exit code of its process.

    ``make`` makes it where its class depends on what the process was given. Bad input ends with one line on stderr and
    exit code 2.
    """
    if {"-h", "--help"} & set(sys.argv[1:] if args is None else args):
        print(usage(node_class))
        return 0
    return run_all([make or node_class], args)


def run_all(
    makers: Sequence[Callable[[], ManagedNode]], args: Sequence[str] | None = None, own: Sequence[str] = ()
) -> int:
    """Run several nodes in one process, on one executor, as ``run`` does one; ``own`` are arguments of the command."""
    stop = StopSignal()
    nodes: list[ManagedNode] = []
    at = ""
    try:
        refuse_other_arguments(sys.argv[1:] if args is None else args, own)
        prepare_middleware()
        use_profile()
        with start_limited(stop):
            rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
            for make in makers:
                nodes.append(make())
                if len(nodes) == 1:
                    log_warnings(nodes[0].get_logger().warning)
            for node in nodes:
                at = f"{node.get_fully_qualified_name()}: " if len(makers) > 1 else ""
                node.start()
    except (InputError, InvalidNodeNameException, InvalidNamespaceException, RCLError) as error:
        hint = "; allowed: a folder that can be written, as HOME or as ROS_LOG_DIR" if "logging" in str(error) else ""
        print(f"error: {at}{' '.join(str(error).split())}{hint}", file=sys.stderr)
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        return 2
    try:
        spin_until(stop, *nodes)
    finally:
        for node in nodes:
            node.stop()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
