"""The command ``autotune``: has the running loop learnt and tuned, and shows how it goes.

Ctrl-C undoes it, and so does whoever ends the command by SIGTERM, or closes its terminal.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from fopid_core.errors import InputError
from fopid_msgs.action import Autotune
from fopid_msgs.msg import Proposal
from fopid_ros.common.arguments import parse
from fopid_ros.common.design_parameters import DEADBAND, PACE
from fopid_ros.common.middleware import prepare_middleware, use_profile

ACTION = "fopid_tuner/autotune"
FOUND_TIME = 10.0
"""How long the tuner may take to be found [s]."""
NOT_FOUND = f"no action {ACTION} within {FOUND_TIME:g} s; allowed: a running fopid_tuner"
RUNNING, STATUS_TIME = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING), 1.0
"""Of a goal that has not ended; and how long it is waited for what goals there are [s]."""
ASKED_EVERY, GONE = 10.0, 10.0
"""So often a tuner is asked whether it still knows of the goal; and so long none may be there [s]."""
TOLD_EVERY = 30.0
"""A log gets a line at least so often [s]."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="autotune",
        description="Excite the running loop, learn its process, tune, verify, apply and watch.",
        epilog="The tuner of a namespace: autotune --ros-args -r __ns:=/NAME",
    )
    add = parser.add_argument
    add("--excitation", default="", choices=("prbs", "relay", "step"), help="how the loop is moved (prbs)")
    add("--amplitude", type=float, default=0.0, metavar="U", help="how far the control is moved (found out)")
    add("--deviation-max", type=float, default=0.0, metavar="Y", help="ends it (from noise and limits)")
    add("--duration", type=float, default=0.0, metavar="S", help="of the experiment (18 integral times)")
    add("--template", dest="template_name", default="", metavar="NAME", help="of the model (the best of all)")
    add("--method", default="", choices=("frequency", "time"), help="of tuning (the tuner's parameter)")
    add("--phase-margin", type=float, default=0.0, metavar="DEG", help="to reach [deg]")
    add("--crossover", type=float, default=0.0, metavar="RAD_S", help="to reach [rad/s]")
    add("--ms-max", type=float, default=0.0, metavar="X", help="bound on max |S|")
    add("--plan", dest="plan_only", action="store_true", help="tell what would be done and how long it takes; no more")
    add("--propose-only", action="store_true", help="tell the gains, do not apply them")
    add("--cancel", action="store_true", help="end the autotuning that is under way, whoever has asked for it; no more")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``autotune``; 0 done, 2 bad input, 3 nothing that could be applied."""
    given = list(sys.argv[1:] if args is None else args)
    options = vars(parse(_parser(), given))
    try:
        options["phase_margin"] = _radians(options["phase_margin"])
        prepare_middleware()
        use_profile()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        for ending in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(ending, signal.default_int_handler)
        return _cancel() if options.pop("cancel") else _run(Autotune.Goal(**options))
    except KeyboardInterrupt:
        print("ended; the tuner was not waited for", file=sys.stderr)
        return 3
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()


def _radians(degrees: float) -> float:
    if not 0.0 <= degrees < 180.0:
        raise InputError(f"phase-margin = {degrees:g} deg; allowed: up to 180, which is not included")
    return math.radians(degrees)


def _cancel() -> int:
    """Ask for the end of all that is under way; 3 where nothing is."""
    node = Node("autotune")
    client = node.create_client(CancelGoal, f"{ACTION}/_action/cancel_goal")
    if not client.wait_for_service(timeout_sec=FOUND_TIME):
        raise InputError(NOT_FOUND)
    asked = client.call_async(CancelGoal.Request())  # without an id: every goal
    rclpy.spin_until_future_complete(node, asked, timeout_sec=FOUND_TIME)
    if not asked.done():
        raise InputError(_gone(f"it has not answered within {FOUND_TIME:g} s"))
    ending = len(asked.result().goals_canceling)
    print("the autotuning under way was asked to end" if ending else "no autotuning is under way")
    return 0 if ending else 3


def _run(goal: Autotune.Goal) -> int:
    node = Node("autotune")
    client = ActionClient(node, Autotune, ACTION)
    under_way: list[GoalStatusArray] = []
    node.create_subscription(
        GoalStatusArray, f"{ACTION}/_action/status", under_way.append, qos_profile_action_status_default
    )
    if not client.wait_for_server(timeout_sec=FOUND_TIME):
        raise InputError(NOT_FOUND)
    columns = (TextColumn("{task.description:12}"), BarColumn(), TextColumn("{task.fields[said]}"))
    console = Console(stderr=True)
    lines = None if console.is_terminal else _Lines()
    with Progress(*columns, console=console, disable=lines is not None) as progress:
        task = progress.add_task("asking", total=1.0, said="")

        def told(message: Any) -> None:
            stage = message.feedback
            said = stage.message or f"{stage.remaining:.0f} s, off the setpoint by {stage.deviation:+.3g}"
            if lines:
                lines.tell(stage)
            progress.update(task, completed=stage.progress, description=stage.phase, said=said[:90])

        handle = _accepted(node, client.send_goal_async(goal, feedback_callback=told), under_way)
        ours = _UnderWay(node, client, handle)
        try:
            result = ours.result()
        except KeyboardInterrupt:
            progress.update(task, description="cancelling", said="")
            handle.cancel_goal_async()
            result = ours.result()
    _show(result)
    return 0 if result.success else 3


def _accepted(node: Node, sent: Future, under_way: Sequence[GoalStatusArray]) -> ClientGoalHandle:
    rclpy.spin_until_future_complete(node, sent, timeout_sec=FOUND_TIME)
    if not sent.done():
        raise InputError(_gone(f"it has not answered within {FOUND_TIME:g} s"))
    handle: ClientGoalHandle = sent.result()
    if handle.accepted:
        return handle
    rclpy.spin_once(node, timeout_sec=STATUS_TIME)
    if any(one.status in RUNNING for told in under_way[-1:] for one in told.status_list):
        raise InputError("the tuner rejected the goal: another autotuning is under way, which autotune --cancel ends")
    raise InputError("the tuner rejected the goal: it is busy with another request, or not active; its log says which")


class _UnderWay:
    """A goal that the tuner has accepted.

    A tuner that dies says nothing, and one that takes its name knows nothing of the goal; so where none is there for
    long it is gone, and one that is there is asked now and then.
    """

    def __init__(self, node: Node, client: ActionClient, handle: ClientGoalHandle) -> None:
        self._node, self._client, self._handle = node, client, handle
        self._asked: list[Future] = [handle.get_result_async()]

    def result(self) -> Autotune.Result:
        """What comes of it.

        Raises
        ------
        InputError
            If the tuner is gone.
        """
        asked = seen = time.monotonic()
        while True:
            rclpy.spin_once(self._node, timeout_sec=0.2)  # and see a Ctrl-C in between
            for answer in self._asked:
                if answer.done():
                    return self._known(answer.result())
            now = time.monotonic()
            if self._client.server_is_ready():
                seen = now
            elif now - seen > GONE:
                raise InputError(_gone("none is there any more"))
            if now - asked > ASKED_EVERY:
                asked = now
                self._asked.append(self._handle.get_result_async())

    def _known(self, answer: Any) -> Autotune.Result:
        if answer.status == GoalStatus.STATUS_UNKNOWN:
            raise InputError(_gone("the one that is there knows nothing of this"))
        return answer.result


def _gone(why: str) -> str:
    return f"the tuner is gone, {why}: what it added to the control fades, the loop runs on with the gains it has"


class _Lines:
    """Progress for a log: a line on each new phase or message, at each tenth of the whole, and every half minute."""

    def __init__(self) -> None:
        self._last: tuple[str, str, int] | None = None
        self._announced = False
        self._told_at = time.monotonic()

    def tell(self, stage: Autotune.Feedback) -> None:
        """Write a line on stderr when there is something new."""
        now = (stage.phase, stage.message, int(10.0 * stage.progress))
        if now == self._last and time.monotonic() - self._told_at < TOLD_EVERY:
            return
        self._told_at = time.monotonic()
        if stage.remaining > 0.0 and stage.phase == "measuring" and not self._announced:  # later it is that of a phase
            self._announced = True
            print(f"it takes about {stage.remaining:.0f} s in all", file=sys.stderr, flush=True)
        self._last = now
        left = f", {stage.remaining:.0f} s to go" if stage.remaining > 0.0 else ""
        said = f": {stage.message}" if stage.message else ""
        print(f"{stage.progress:4.0%} {stage.phase}{said}{left}", file=sys.stderr, flush=True)


def _clauses(message: str) -> list[str]:
    """What a message says, one thing after the other.

    Examples
    --------
    >>> _clauses("PI was best (PID 1.2; FOPID 1.3); applied; watch it")
    ['PI was best (PID 1.2; FOPID 1.3)', 'applied', 'watch it']
    """
    parts: list[str] = []
    for part in message.split("; "):
        inside = bool(parts) and parts[-1].count("(") > parts[-1].count(")")
        parts[-1:] = [f"{parts[-1]}; {part}"] if inside else [*parts[-1:], part]
    return parts


def _show(result: Autotune.Result) -> None:
    print("\n  ".join(["new gains run"] * result.applied + _clauses(result.message)))
    if result.success and not result.model.process and not math.isfinite(result.gains.kp):
        print("\n".join(result.plan))
    if result.model.process:
        print(f"model     {result.model.process}  (fit {result.model.fit_pct:.1f} %)")
    if math.isfinite(result.gains.kp):
        gains = result.gains
        state = "running" if result.applied else "not applied"
        print(f"gains     kp {gains.kp:.6g}  ki {gains.ki:.6g}  kd {gains.kd:.6g}  lam {gains.lam:.6g}  "
              f"mu {gains.mu:.6g}  ({state})")  # fmt: skip
        for proposal in result.proposals:
            if proposal.gains == gains:
                print("\n".join(_with_them(proposal)))
                break


def _with_them(proposal: Proposal) -> list[str]:
    """What belongs to gains, under the names of the controller's parameters."""
    two = proposal.two_degrees
    order, filtered = two.measurement_filter_order, two.measurement_filter_time
    lines = [f"with      measurement_filter_order {order}  measurement_filter_time {filtered:.6g}"]
    weights = two.setpoint_weight, two.derivative_setpoint_weight
    if all(math.isfinite(weight) for weight in weights):
        lines.append("          setpoint_weight {:.6g}  derivative_setpoint_weight {:.6g}".format(*weights))
    held = [f"{name} {most:.6g}" for name in (*PACE, DEADBAND) if (most := getattr(proposal, name))]
    lines += [f"          {'  '.join(held)}"] if held else []
    return lines


if __name__ == "__main__":
    sys.exit(main())
