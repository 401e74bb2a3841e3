"""The command ``autotune``: has the running loop learnt and tuned, shows how it goes; Ctrl-C undoes it."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from fopid_core.errors import InputError
from fopid_msgs.action import Autotune
from fopid_ros.common.middleware import prepare_middleware, use_profile

FOUND_TIME = 10.0
"""How long the tuner may take to be found [s]."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="autotune", description="Excite the running loop, learn its process, tune, verify, apply and watch."
    )
    add = parser.add_argument
    add("--excitation", default="", choices=("prbs", "relay", "step"), help="how the loop is moved (prbs)")
    add("--amplitude", type=float, default=0.0, metavar="U", help="how far the control is moved (found out)")
    add("--deviation-max", type=float, default=0.0, metavar="Y", help="ends it (from noise and limits)")
    add("--duration", type=float, default=0.0, metavar="S", help="of the experiment (20 integral times)")
    add("--template", dest="template_name", default="", metavar="NAME", help="of the model (the best of all)")
    add("--method", default="", choices=("frequency", "time"), help="of tuning (the tuner's parameter)")
    add("--phase-margin", type=float, default=0.0, metavar="DEG", help="to reach [deg]")
    add("--crossover", type=float, default=0.0, metavar="RAD_S", help="to reach [rad/s]")
    add("--ms-max", type=float, default=0.0, metavar="X", help="bound on max |S|")
    add("--plan", dest="plan_only", action="store_true", help="tell what would be done and how long it takes; no more")
    add("--propose-only", action="store_true", help="tell the gains, do not apply them")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``autotune``; 0 done, 2 bad input, 3 nothing that could be applied."""
    given = list(sys.argv[1:] if args is None else args)
    options = vars(_parser().parse_args(remove_ros_args(["autotune", *given])[1:]))
    try:
        options["phase_margin"] = _radians(options["phase_margin"])
        prepare_middleware()
        use_profile()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        return _run(Autotune.Goal(**options))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()


def _radians(degrees: float) -> float:
    if not 0.0 <= degrees < 180.0:
        raise InputError(f"phase-margin = {degrees:g} deg; allowed: up to 180, which is not included")
    return math.radians(degrees)


def _run(goal: Autotune.Goal) -> int:
    node = Node("autotune")
    client = ActionClient(node, Autotune, "fopid_tuner/autotune")
    if not client.wait_for_server(timeout_sec=FOUND_TIME):
        raise InputError(f"no action fopid_tuner/autotune within {FOUND_TIME:g} s; allowed: a running fopid_tuner")
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

        handle = _wait(node, client.send_goal_async(goal, feedback_callback=told))
        if not handle.accepted:
            raise InputError("the tuner rejected the goal: it is busy with another request, or not active")
        answer = handle.get_result_async()
        try:
            result = _wait(node, answer).result
        except KeyboardInterrupt:
            progress.update(task, description="cancelling", said="")
            _wait(node, handle.cancel_goal_async())
            result = _wait(node, answer).result
    _show(result)
    return 0 if result.success else 3


class _Lines:
    """Progress for a log: a line on each new phase or message, and whenever a tenth of the whole is done."""

    def __init__(self) -> None:
        self._last: tuple[str, str, int] | None = None
        self._announced = False

    def tell(self, stage: Autotune.Feedback) -> None:
        """Write a line on stderr when there is something new."""
        now = (stage.phase, stage.message, int(10.0 * stage.progress))
        if now == self._last:
            return
        if stage.remaining > 0.0 and not self._announced:
            self._announced = True
            print(f"the experiment takes {stage.remaining:.0f} s", file=sys.stderr, flush=True)
        self._last = now
        left = f", {stage.remaining:.0f} s to go" if stage.remaining > 0.0 else ""
        said = f": {stage.message}" if stage.message else ""
        print(f"{stage.progress:4.0%} {stage.phase}{said}{left}", file=sys.stderr, flush=True)


def _wait(node: Node, future: Future) -> Any:
    while not future.done():
        rclpy.spin_until_future_complete(node, future, timeout_sec=0.2)  # and see a Ctrl-C in between
    return future.result()


def _show(result: Autotune.Result) -> None:
    print(result.message)
    if not result.model.process and not math.isfinite(result.gains.kp):
        print("\n".join(result.plan))
    if result.model.process:
        print(f"model     {result.model.process}  (fit {result.model.fit_pct:.1f} %)")
    if math.isfinite(result.gains.kp):
        gains = result.gains
        state = "running" if result.applied else "not applied"
        print(f"gains     kp {gains.kp:.6g}  ki {gains.ki:.6g}  kd {gains.kd:.6g}  lam {gains.lam:.6g}  "
              f"mu {gains.mu:.6g}  ({state})")  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
