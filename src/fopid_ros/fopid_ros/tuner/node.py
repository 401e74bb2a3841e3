"""The tuner node: works out the five numbers, proves the loop stable, hands them to the running controller."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, MultiThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.identification.identify import IdentifiedModel, identify
from fopid_core.design.reduction import preferred, reduce, reduce_all
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_msgs.action import Autotune
from fopid_msgs.msg import ReducedModel
from fopid_msgs.msg import TuningResult as TuningResultMessage
from fopid_msgs.srv import Identify, Reduce, Tune
from fopid_ros.common.diagnostics import diagnostic_array, diagnostic_status
from fopid_ros.common.managed_node import ManagedNode, latched_qos, run
from fopid_ros.common.signals import header_stamp
from fopid_ros.tuner.controller_client import ControllerClient
from fopid_ros.tuner.learning.adaptation import Adaptation
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.gain_update import Outcome
from fopid_ros.tuner.learning.loop_tap import LoopTap
from fopid_ros.tuner.learning.loop_wait import CancelledError, LoopWait, Stage
from fopid_ros.tuner.messages import (
    autotune_request,
    criteria,
    fill_autotune_result,
    fill_gains,
    fill_measures,
    identified_message,
    tuning_request,
)
from fopid_ros.tuner.parameters import SPECS

PERIOD = 1.0
"""Of the diagnostics, and between two questions whether a look at the loop is due [s, on a steady clock]."""
FINISH_TIME = 5.0
"""How long a request may take to end when the node is told to stop [s]."""


@dataclass(frozen=True)
class Applied:
    """What handing over the gains came to."""

    done: bool
    message: str
    previous: Fopid | None = None


class TunerNode(ManagedNode):
    """Serves ~/tune, ~/reduce, ~/identify and ~/autotune, adapts when it may, publishes ~/result.

    Each works in a thread of its own, so the node answers others meanwhile.
    """

    NAME = "fopid_tuner"
    SPECS = SPECS

    def __init__(self) -> None:
        super().__init__()
        self._concurrent = concurrent = ReentrantCallbackGroup()
        self._busy = threading.Lock()
        self._stopping = threading.Event()
        self._results = self.create_publisher(TuningResultMessage, "~/result", latched_qos(depth=100))
        self._controller = ControllerClient(self, self.get_parameter("controller").value, concurrent)
        self.create_service(Tune, "~/tune", self._on_tune, callback_group=concurrent)
        self.create_service(Reduce, "~/reduce", self._on_reduce, callback_group=concurrent)
        self.create_service(Identify, "~/identify", self._on_identify, callback_group=concurrent)
        self._action = ActionServer(
            self, Autotune, "~/autotune", self._on_autotune, callback_group=concurrent,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self._stage = "idle"
        self._last = ""

    def open(self, values: dict[str, Any]) -> None:
        self._tap = LoopTap(self, values)
        self._adaptation = Adaptation(self._tap, self._controller)
        self._diagnostics = self.endpoints.publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.endpoints.timer(PERIOD, self._publish_diagnostics, steady)
        self.endpoints.timer(PERIOD, self._adapt, steady, self._concurrent)

    def check(self, values: dict[str, Any]) -> None:
        if values["process"]:
            read_process(values["process"])
        tuning_request(Tune.Request(process="P1"), values)
        if values["adapt"] != "off" and not values["history"]:
            raise InputError("history = 0; allowed: above 0 s, since adapt needs the loop's signals")

    def _on_tune(self, request: Tune.Request, response: Tune.Response) -> Tune.Response:
        return self._alone(lambda: self._tune(request, response), response)

    def _on_identify(self, request: Identify.Request, response: Identify.Response) -> Identify.Response:
        return self._alone(lambda: self._identify(request, response), response)

    def _alone(self, work: Callable[[], None], response: Any) -> Any:
        """Do what only one request at a time may do; say what is wrong with it in the response's message."""
        if not self._busy.acquire(blocking=False):
            response.message = "busy with another request; ask again when it is answered"
            return response
        try:
            work()
        except InputError as error:
            response.message = str(error)
            self.get_logger().warning(f"refused, nothing changed: {error}")
        finally:
            self._busy.release()
        return response

    def _tune(self, request: Tune.Request, response: Tune.Response) -> None:
        values = self.values()
        wanted = tuning_request(request, values)
        result = tune(wanted)
        applied = Applied(False, "")
        if request.apply:
            refused = rejection_reason(result, values["sample_time"], values["verify.ms_max"], values["verify.ticks"])
            applied = Applied(False, refused) if refused else self._apply(result.controller)
        response.success = result.success and (applied.done or not request.apply)
        response.applied = applied.done
        response.message = "; ".join(text for text in (result.message, applied.message) if text)
        response.unmet = list(result.unmet)
        response.elapsed = result.elapsed
        if result.controller is not None:
            fill_gains(response.gains, result.controller)
        fill_measures(response.achieved, result)
        self._publish_result(response, wanted, applied)
        self.get_logger().info(f"{wanted.method}: {response.message}")

    def _apply(self, gains: Fopid) -> Applied:
        try:
            return Applied(True, "applied", self._controller.apply(gains))
        except InputError as error:
            return Applied(False, f"not applied: {error}")

    def _publish_result(self, response: Tune.Response, wanted: TuningRequest, applied: Applied) -> None:
        message = TuningResultMessage(
            method=wanted.method, process=str(wanted.process), success=response.success, applied=response.applied,
            message=response.message, gains=response.gains, achieved=response.achieved, unmet=response.unmet,
            elapsed=response.elapsed,
        )  # fmt: skip
        if applied.previous is not None:
            fill_gains(message.previous_gains, applied.previous)
        self._publish(message)

    def _publish(self, message: TuningResultMessage) -> None:
        header_stamp(message.header, self.get_clock().now().nanoseconds)
        self._last = message.message
        self._results.publish(message)

    def _publish_diagnostics(self) -> None:
        facts = {
            "process": self.get_parameter("process").value or "not known",
            "controller": self._controller.name,
            "last result": self._last or "none",
            "adaptation": self._adaptation.message or self.get_parameter("adapt").value,
            "last rejected parameter set": self.last_rejected or "none",
        }
        state = "tuning" if self._stage == "idle" and self._busy.locked() else self._stage
        status = diagnostic_status(self.get_fully_qualified_name(), state, [], facts)
        self._diagnostics.publish(diagnostic_array(status, self))

    def finish(self) -> None:
        """An autotuning under way is cancelled and puts back what it changed."""
        self._stopping.set()
        if self._busy.acquire(timeout=FINISH_TIME):
            self._busy.release()

    def _on_autotune(self, goal: ServerGoalHandle) -> Autotune.Result:
        result = Autotune.Result()
        began = time.monotonic()
        self._alone(lambda: self._autotune(goal, result), result)
        result.elapsed = time.monotonic() - began
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.success:
            goal.succeed()
        else:
            goal.abort()
        return result

    def _autotune(self, goal: ServerGoalHandle, result: Autotune.Result) -> None:
        def report(stage: Stage) -> None:
            self._stage = stage.phase
            goal.publish_feedback(Autotune.Feedback(**asdict(stage)))

        def ended() -> bool:
            return bool(goal.is_cancel_requested or self._stopping.is_set())

        request = autotune_request(goal.request, self.values())
        try:
            outcome = Autotuner(self._tap, self._controller, request, LoopWait(self._tap, report, ended)).run()
        except CancelledError:
            result.message = "cancelled; gains and control are as they were"
            return
        finally:
            self._stage = "idle"
        fill_autotune_result(result, outcome)
        self._publish_learnt("autotune", result, outcome)
        if outcome.success and outcome.model is not None:
            self._adopt(outcome.model)

    def _publish_learnt(self, method: str, result: Autotune.Result, outcome: Outcome) -> None:
        tuning = outcome.tuned.tuning if outcome.tuned else None
        message = TuningResultMessage(
            method=f"{method} {tuning.method}" if tuning else method, process=result.model.process,
            success=result.success, applied=result.applied, message=result.message, gains=result.gains,
            previous_gains=result.previous_gains, achieved=result.achieved, unmet=list(tuning.unmet) if tuning else [],
            elapsed=outcome.tuned.elapsed if outcome.tuned else 0.0,
        )  # fmt: skip
        self._publish(message)

    def _adapt(self) -> None:
        """Look at the loop, when that is wanted and nothing else is under way."""
        values = self.values()
        if values["adapt"] == "off" or math.isnan(self._tap.history.newest("control")):
            return
        if not self._busy.acquire(blocking=False):
            return
        try:
            self._update_adaptation(values)
        except InputError as error:
            self._adaptation.message = str(error)
        except CancelledError:
            self.get_logger().info("stopped while new gains were watched: the previous ones are back")
        finally:
            self._stage = "idle"
            self._busy.release()

    def _update_adaptation(self, values: dict[str, Any]) -> None:
        def report(stage: Stage) -> None:
            self._stage = f"adapting: {stage.phase}"

        wanted = criteria(tuning_request(Tune.Request(process="P1"), values), values)
        wait = LoopWait(self._tap, report, self._stopping.is_set)
        outcome = self._adaptation.update(values["adapt_window"], values["adapt"] == "apply", wanted, wait)
        if outcome is None:
            return
        result = Autotune.Result()
        fill_autotune_result(result, outcome)
        self._publish_learnt("adapt", result, outcome)
        self.get_logger().info(f"adapt: {outcome.message}")
        if self._adaptation.model is not None:
            self._take_for(self._adaptation.model)

    def _identify(self, request: Identify.Request, response: Identify.Response) -> None:
        now = self.get_clock().now().nanoseconds * 1e-9
        since = now - request.duration if request.duration else -math.inf
        found = identify(self._tap.history.record(since), request.template_name or "all")
        if found.success and request.adopt:
            self._adopt(found.best)
        models = sorted(found.models, key=lambda model: (model is not found.best, -model.fit_pct))
        response.models = [identified_message(model) for model in models]
        response.success, response.message, response.elapsed = found.success, found.message, found.elapsed

    def _adopt(self, model: IdentifiedModel) -> None:
        self._adaptation.set_model(model)
        self._take_for(model)

    def _take_for(self, model: IdentifiedModel) -> None:
        self.set_parameters_atomically([Parameter("process", value=str(model.process))])

    def _on_reduce(self, request: Reduce.Request, response: Reduce.Response) -> Reduce.Response:
        try:
            process = self._process(request.process)
            if request.template_name in ("", "all"):
                models = reduce_all(process, keep_gain=request.keep_steady_state_gain)
            else:
                models = (reduce(process, request.template_name, keep_gain=request.keep_steady_state_gain),)
            choice = preferred(models)
        except InputError as error:
            response.message = str(error)
            return response
        response.models = [
            ReducedModel(template_name=m.template, process=str(m.process), names=list(m.parameters),
                         values=list(m.parameters.values()), h2_error=m.h2_error, elapsed=m.elapsed)
            for m in models
        ]  # fmt: skip
        response.success, response.preferred, response.message = True, choice.model.template, choice.reason
        return response

    def _process(self, text: str) -> Process:
        known = text or self.get_parameter("process").value
        if not known:
            raise InputError("process = ''; allowed: P1 ... P4 or a transfer function in s")
        return read_process(known)


def _executor() -> Executor:
    return MultiThreadedExecutor(num_threads=4)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_tuner``."""
    return run(TunerNode, args, _executor)


if __name__ == "__main__":
    sys.exit(main())
