"""The tuner node: works out the five numbers, proves the loop stable, hands them to the running controller."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_msgs.action import Autotune
from fopid_msgs.msg import ReducedModel
from fopid_msgs.msg import TuningResult as TuningResultMessage
from fopid_msgs.srv import Compare, Identify, Reduce, Tune
from fopid_ros.common.background import BackgroundActionServer, Later
from fopid_ros.common.guard import internal_error
from fopid_ros.common.managed_node import ManagedNode, latched_qos, run
from fopid_ros.common.parameters import brief
from fopid_ros.common.signals import header_stamp
from fopid_ros.common.spinning import FINISH_TIME
from fopid_ros.tuner.controller_client import ANSWER_TIME, ControllerClient, RunningDesign
from fopid_ros.tuner.handover import proof, refusal
from fopid_ros.tuner.heard import Heard, hear
from fopid_ros.tuner.jobs import Job, Jobs
from fopid_ros.tuner.learning.loop_tap import LoopTap
from fopid_ros.tuner.learning.loop_wait import CancelledError, LoopWait, OpenLoopError, Stage
from fopid_ros.tuner.learning.reach import NOT_MOVED
from fopid_ros.tuner.messages import (
    autotune_request,
    comparison_arguments,
    criteria,
    fill_autotune_result,
    fill_comparison,
    fill_gains,
    fill_measures,
    fill_previous,
    fill_two_degrees,
    identified_message,
    nothing_known,
    process_of,
    tuning_request,
)
from fopid_ros.tuner.parameters import SPECS

if TYPE_CHECKING:  # what learns needs scipy: it is loaded by the first request, see ``_adaptation`` and below
    from fopid_core.design.identification.identified_model import IdentifiedModel
    from fopid_core.design.specification import TuningResult
    from fopid_ros.tuner.learning.adaptation import Adaptation
    from fopid_ros.tuner.learning.gain_update import Outcome, Trial

PERIOD = 1.0
"""Between two questions whether a look at the loop is due [s, on a steady clock]."""
QUIETER = 2
"""How often a time-domain design is made anew since noise would move the control too far."""
BUSY = "busy with another request; ask again when it is answered"


@dataclass(frozen=True)
class Applied:
    """What handing over a design came to."""

    done: bool
    message: str
    previous: RunningDesign | None = None


class TunerNode(ManagedNode):
    """Serves ~/tune, ~/compare, ~/reduce, ~/identify and ~/autotune, adapts when it may, publishes ~/result.

    Each works in a thread of its own, so the node answers others meanwhile; only while the node is active.
    """

    NAME = "fopid_tuner"
    SPECS = SPECS

    def __init__(self) -> None:
        super().__init__()
        self._active = False
        self._jobs, self._reductions, self._plans = Jobs(), Jobs(), Jobs()
        self._results = self.create_publisher(TuningResultMessage, "~/result", latched_qos(depth=100))
        self._controller = ControllerClient(self, self.get_parameter("controller").value, self.background)
        for kind, name, jobs, work in (
            (Tune, "tune", self._jobs, self._tune), (Identify, "identify", self._jobs, self._identify),
            (Compare, "compare", self._jobs, self._compare), (Reduce, "reduce", self._reductions, self._reduce),
        ):  # fmt: skip
            self.background.may_answer_later(self.create_service(kind, f"~/{name}", self._answering(name, jobs, work)))
        self._action = BackgroundActionServer(
            self, Autotune, "~/autotune", self._on_autotune, self.background,
            goal_callback=self._on_goal, handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel,
        )  # fmt: skip
        self._open_tap: LoopTap | None = None
        self._adaptation: Adaptation | None = None
        self._reach = NOT_MOVED  # of what the running gains were learnt by
        self._stage = "idle"
        self._last = ""

    # Life.

    def check(self, values: dict[str, Any]) -> None:
        if values["process"]:
            process_of(values["process"])
        tuning_request(Tune.Request(process="P1"), values)
        if values["adapt"] != "off" and not values["history"]:
            raise InputError("history = 0; allowed: above 0 s, since adapt needs the loop's signals")

    def open(self, values: dict[str, Any]) -> None:
        self._controller.dof = values["dof"]
        self._open_tap = LoopTap(self, values)
        self._adaptation, self._reach = None, NOT_MOVED
        self.open_diagnostics()
        self.endpoints.timer(PERIOD, self._adapt, Clock(clock_type=ClockType.STEADY_TIME))

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._leave_active()
        return super().on_deactivate(state)

    def _release(self) -> None:
        self._leave_active()
        if self._open_tap is not None:
            self._open_tap.close()
        super()._release()

    @property
    def _tap(self) -> LoopTap:
        """The loop's signals, which are heard from configure to cleanup."""
        if self._open_tap is None:
            raise RuntimeError("the node is not configured")
        return self._open_tap

    def _leave_active(self) -> None:
        """Work has ended by now; if it did not in time, the loop is at least left alone."""
        self._active = False
        self.cancel_work("the node is not active any more")
        if self._open_tap is not None:
            self._open_tap.end_injection_now()

    def cancel_work(self, why: str) -> bool:
        told = [jobs.cancel(why) for jobs in (self._jobs, self._reductions, self._plans)]
        return any(told)

    def finish(self) -> None:
        for jobs in (self._jobs, self._reductions, self._plans):
            jobs.wait(FINISH_TIME)

    def health(self) -> tuple[str, list[tuple[bytes, str]], dict[str, object]]:
        job = self._jobs.current
        state = self._stage if self._stage != "idle" or job is None else job.name
        seen = self._adaptation.message if self._adaptation else ""
        problems = [(one.level, one.text) for one in self._open_tap.rivalries()] if self._open_tap else []
        return state, problems, {
            "process": self.get_parameter("process").value or "not known",
            "controller": self._controller.name,
            **({"joint": self._controller.dof} if self._controller.dof else {}),
            "last result": self._last or "none",
            "adaptation": seen or self.get_parameter("adapt").value,
            "last rejected parameter set": self.last_rejected or "none",
        }  # fmt: skip

    # Requests: answered from a thread of their own, whatever happens in it.

    def _answering(self, name: str, jobs: Jobs, work: Callable[[Any, Any, Job], None]) -> Callable[[Any, Any], Any]:
        """The callback of a service that does some work."""

        def asked(request: Any, response: Any) -> Any:
            later = Later(self.background)
            given_up = nothing_known(type(response)())

            def give_up() -> None:
                given_up.message = f"{name} was cancelled: {job.why}"
                later.give(given_up)

            job = Job(name, give_up)
            nothing_known(response)
            refused = self._no_room(jobs)
            if refused:
                response.message = refused
                return response
            jobs.begin(job)

            def thread() -> None:
                self._work(job, jobs, lambda: work(request, response, job), response)
                later.give(response)

            self.background.start(name, thread)
            return later

        return asked

    def _no_room(self, jobs: Jobs) -> str:
        """Why there is no room for a job; empty where there is, until the executor's thread gives it to one."""
        if not self._active:
            return "the node is not active; allowed: requests to an active node"
        return BUSY if jobs.current else ""

    def _work(self, job: Job, jobs: Jobs, work: Callable[[], None], response: Any) -> None:
        """Do a job that has room; what is wrong with it is said in the response's message."""
        try:
            work()
        except (InputError, OpenLoopError) as error:
            response.message = brief(str(error))
            if job.name != "adapt" or response.message != self._learner().message:  # it asks each second
                self.get_logger().warning(f"refused: {response.message}")
        except CancelledError:
            response.message = f"{job.name} was cancelled: {job.why or 'as asked'}; gains and control are as they were"
        except Exception as error:  # noqa: BLE001  (no request ends the node)
            self.guard.note(job.name, error)
            internal_error(response)
        finally:
            if jobs is self._jobs:
                self._stage = "idle"
            jobs.end()

    def _tune(self, request: Tune.Request, response: Tune.Response, job: Job) -> None:
        values = self.values()
        wanted = tuning_request(request, values)
        own = request.apply or not request.process  # else it is about another process than the loop's
        heard = hear(self._tap.history, self._controller, wanted) if own else Heard()
        wanted, result, told = self._tuned(heard.bounded(wanted), heard, job)
        applied = self._apply(wanted, result, values, job) if request.apply else Applied(False, "")
        response.success = result.success and (applied.done or not request.apply)
        response.applied = applied.done
        response.message = "; ".join(text for text in (result.message, told, applied.message) if text)
        response.unmet = list(result.unmet)
        response.elapsed = result.elapsed
        if result.controller is not None:
            fill_gains(response.gains, result.controller)
            fill_two_degrees(response.two_degrees, result.filter, result.weights)
        response.structure = result.structure
        fill_measures(response.achieved, result)
        self._publish_result(response, wanted, applied)
        self.get_logger().info(f"{wanted.method}: {response.message}")

    def _tuned(self, wanted: TuningRequest, heard: Heard, job: Job) -> tuple[TuningRequest, TuningResult, str]:
        """A design; a quieter one where noise would move the control too far and nobody has said what decides that."""
        from fopid_core.design.tuner import tune

        result = tune(wanted, clock=job.clock)
        for _ in range(QUIETER):
            job.go_on()
            excess = heard.excess(wanted, result)
            quieter = heard.quieter(wanted, excess) if excess > 1.0 else None
            if quieter is None:
                break
            wanted, result = quieter, tune(quieter, clock=job.clock)
        job.go_on()
        return wanted, result, heard.told_with(heard.excess(wanted, result))

    def _apply(self, wanted: TuningRequest, result: TuningResult, values: dict[str, Any], job: Job) -> Applied:
        """Hand over a design with its filter, if it is fit for the controller's own ticks and proved where asked.

        Its setpoint weights too where they were part of the tuning.
        """
        weights = result.weights if result.method == "time" else None
        refused = refusal(wanted, result, wanted.sample_time, values)
        if refused:
            return Applied(False, refused)
        try:
            sample_time, lag = self._controller.get("sample_time", "derivative_filter_time")
            refused = refusal(wanted, result, sample_time, values)
            certificate, refused = ("", refused) if refused else proof(wanted, result, values)
            if refused or result.controller is None:
                return Applied(False, refused)
            job.go_on()  # a proof takes long
            previous = self._controller.apply(RunningDesign(result.controller, result.filter, weights), "verified",
                                              certificate)  # fmt: skip
        except InputError as error:
            return Applied(False, f"not applied: {error}")
        said = ["applied"]
        if not previous.is_same_loop(replace(previous, filter=result.filter)):
            said.append(f"the measurement now passes {result.filter}, before {previous.filter}")
        if lag:
            said.append(f"derivative_filter_time = {lag:g} s of the controller is not part of what was verified")
        return Applied(True, "; ".join(said), previous)

    def _compare(self, request: Compare.Request, response: Compare.Response, job: Job) -> None:
        from fopid_core.design.comparison.compare import WORTH, compare

        asked, prefer, worth = comparison_arguments(request, self.values())
        found = compare(asked, prefer, WORTH if worth is None else worth, lambda share, what: job.go_on())
        fill_comparison(response, found)
        self.get_logger().info(f"compare: {response.message}")

    def _reduce(self, request: Reduce.Request, response: Reduce.Response, job: Job) -> None:
        from fopid_core.design.reduction import preferred, reduce, reduce_all

        process = process_of(request.process or self.get_parameter("process").value)
        if request.template_name in ("", "all"):
            models = reduce_all(process, keep_gain=request.keep_steady_state_gain)
        else:
            models = (reduce(process, request.template_name, keep_gain=request.keep_steady_state_gain),)
        choice = preferred(models)
        response.models = [
            ReducedModel(template_name=m.template, process=str(m.process), names=list(m.parameters),
                         values=list(m.parameters.values()), h2_error=m.h2_error, elapsed=m.elapsed)
            for m in models
        ]  # fmt: skip
        response.success, response.preferred, response.message = True, choice.model.template, choice.reason

    def _identify(self, request: Identify.Request, response: Identify.Response, job: Job) -> None:
        from fopid_core.design.identification.identify import identify
        from fopid_core.design.response_verification import checked

        history = self._tap.history  # its time is that of the signals' stamps
        since = history.newest_time("control") - request.duration if request.duration else -math.inf
        record, template = history.record(since), request.template_name or "all"
        found = checked(record, identify(record, template), template)
        job.go_on()
        if found.success and found.best is not None and request.adopt:
            self._adopt(found.best)
        models = sorted(found.models, key=lambda model: (model is not found.best, -model.fit_pct))
        response.models = [identified_message(model) for model in models]
        response.success, response.message, response.elapsed = found.success, found.message, found.elapsed

    def _on_goal(self, goal: Autotune.Goal) -> GoalResponse:
        """A goal for which there is no room is rejected."""
        refused = self._no_room(self._room(goal))
        if refused:
            self.get_logger().warning(f"autotune: goal rejected: {refused}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        """One that is accepted has it, and begins; one whose client cannot be told is dropped before this."""
        self._room(goal.request).begin(Job("autotune"))
        goal.execute()

    def _room(self, goal: Autotune.Goal) -> Jobs:
        """A plan keeps nobody from working: it leaves the loop alone."""
        return self._plans if goal.plan_only else self._jobs

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        self.get_logger().info(f"autotune: asked to cancel while {self._stage}")
        return CancelResponse.ACCEPT

    def _on_autotune(self, goal: ServerGoalHandle, give: Callable[[Callable[[], Any]], None]) -> None:
        result, began, room = nothing_known(Autotune.Result()), time.monotonic(), self._room(goal.request)
        job = room.current or Job("autotune")  # it has had the room since it was accepted

        def end() -> Autotune.Result:
            result.elapsed = time.monotonic() - began
            if goal.is_cancel_requested:
                goal.canceled()
            elif result.success:
                goal.succeed()
            else:
                goal.abort()
            self.get_logger().info(f"autotune ended after {result.elapsed:.3g} s: {result.message}")
            return result

        def give_up() -> None:
            result.message = f"autotune was cancelled: {job.why}"
            give(end)

        job.give_up = give_up
        self._work(job, room, lambda: self._autotune(goal, result, job), result)
        give(end)

    def _autotune(self, goal: ServerGoalHandle, result: Autotune.Result, job: Job) -> None:
        from fopid_ros.tuner.learning.autotune import Autotuner

        def ended() -> bool:
            return bool(goal.is_cancel_requested or job.cancelled)

        def report(stage: Stage) -> None:
            if ended():
                raise CancelledError
            if stage.phase != self._stage:
                self.get_logger().info(f"autotune: {stage.phase}{': ' if stage.message else ''}{stage.message}")
            self._stage = stage.phase
            self.background.on_executor(lambda: goal.publish_feedback(Autotune.Feedback(**asdict(stage))))

        request = autotune_request(goal.request, self.values())
        autotuner = Autotuner(self._tap, self._controller, request, LoopWait(self._tap, report, ended), self._reach)
        result.plan, result.expected_duration = autotuner.plan()
        if goal.request.plan_only:
            result.success, result.message = True, "only planned; nothing was done"
            return
        outcome = autotuner.run()
        if outcome.applied and request.trial is None:
            self._reach = autotuner.reach
        fill_autotune_result(result, outcome)
        if request.trial is not None:
            fill_gains(result.gains, request.trial.design.gains)
        self._publish_learnt("autotune" if request.trial is None else "trial", result, outcome, request.trial)
        if outcome.applied and outcome.model is not None:  # what is only proposed changes nothing here
            self._adopt(outcome.model)
        elif outcome.applied and goal.request.process:
            self._take_for(process_of(goal.request.process))

    # Adaptation.

    def _adapt(self) -> None:
        """Look at the loop, when that is wanted and nothing else is under way."""
        if self.get_parameter("adapt").value == "off" or math.isnan(self._tap.history.newest("control")):
            return
        job = Job("adapt")
        if self._no_room(self._jobs):
            return
        self._jobs.begin(job)
        said = Autotune.Result()

        def thread() -> None:
            self._work(job, self._jobs, lambda: self._update_adaptation(self.values(), job), said)
            if said.message:
                self._learner().message = said.message

        self.background.start("adapt", thread)

    def _learner(self) -> Adaptation:
        if self._adaptation is None:
            from fopid_ros.tuner.learning.adaptation import Adaptation

            self._adaptation = Adaptation(self._tap, self._controller)
        return self._adaptation

    def _update_adaptation(self, values: dict[str, Any], job: Job) -> None:
        def report(stage: Stage) -> None:
            job.go_on()
            self._stage = f"adapting: {stage.phase}"

        wanted = criteria(tuning_request(Tune.Request(process="P1"), values), values)
        wait, learner = LoopWait(self._tap, report, lambda: job.cancelled), self._learner()
        outcome = learner.update(values["adapt_window"], values["adapt"] == "apply", wanted, wait)
        if outcome is None:
            return
        result = nothing_known(Autotune.Result())
        fill_autotune_result(result, outcome)
        self._publish_learnt("adapt", result, outcome)
        self.get_logger().info(f"adapt: {outcome.message}")
        if learner.model is not None and values["adapt"] == "apply":  # what is only proposed changes nothing here
            self._take_for(learner.model.process)

    def _adopt(self, model: IdentifiedModel) -> None:
        self._learner().set_model(model)
        self._take_for(model.process)

    def _take_for(self, process: Process) -> None:
        taken = [Parameter("process", value=str(process))]
        self.background.value(lambda: self.set_parameters_atomically(taken), ANSWER_TIME)

    # What is published.

    def _publish_result(self, response: Tune.Response, wanted: TuningRequest, applied: Applied) -> None:
        message = TuningResultMessage(
            method=wanted.method, process=str(wanted.process), success=response.success, applied=response.applied,
            message=response.message, gains=response.gains, achieved=response.achieved, unmet=response.unmet,
            elapsed=response.elapsed, two_degrees=response.two_degrees,
        )  # fmt: skip
        unknown = nothing_known(TuningResultMessage())
        message.previous_gains, message.previous_two_degrees = unknown.previous_gains, unknown.previous_two_degrees
        if applied.previous is not None:
            fill_previous(message, applied.previous)
        self._publish(message)

    def _publish_learnt(
        self, method: str, result: Autotune.Result, outcome: Outcome, trial: Trial | None = None
    ) -> None:
        tuning = outcome.tuning
        message = nothing_known(TuningResultMessage(
            method=f"{method} {tuning.method}" if tuning else method, process=result.model.process,
            success=result.success, applied=result.applied, message=result.message,
            unmet=list(tuning.unmet) if tuning else [], elapsed=outcome.tuned.elapsed if outcome.tuned else 0.0,
        ))  # fmt: skip
        message.gains, message.achieved = result.gains, result.achieved
        if tuning is not None and tuning.controller is not None:
            fill_two_degrees(message.two_degrees, tuning.filter, tuning.weights)
        if trial is not None:
            fill_two_degrees(message.two_degrees, trial.design.filter, trial.design.weights)
        if outcome.previous is not None:
            fill_previous(message, outcome.previous)
        self._publish(message)

    def _publish(self, message: TuningResultMessage) -> None:
        header_stamp(message.header, self.get_clock().now().nanoseconds)
        self._last = message.message
        self.background.on_executor(lambda: self._results.publish(message))


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_tuner``."""
    return run(TunerNode, args)


if __name__ == "__main__":
    sys.exit(main())
