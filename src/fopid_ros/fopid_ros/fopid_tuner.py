"""The tuner node: works out the five numbers, proves the loop stable, hands them to the running controller."""

from __future__ import annotations

import math
import sys
import threading
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import Executor, MultiThreadedExecutor

from fopid_core.design.reduction import preferred, reduce, reduce_all
from fopid_core.design.specification import METHODS, VIA
from fopid_core.design.tuner import Bound, TuningRequest, TuningResult, tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_msgs.msg import Gains, LoopMeasures, ReducedModel
from fopid_msgs.msg import TuningResult as TuningResultMessage
from fopid_msgs.srv import Reduce, Tune
from fopid_ros.controller_client import GAINS, ControllerClient
from fopid_ros.node import ManagedNode, latched_qos, run
from fopid_ros.parameters import Spec
from fopid_ros.signals import header_stamp

LEAST_TICKS = 2
"""Delay margin that gains need to be applied: a held control is half a tick late, its messages up to another."""
_ZERO_CHOOSES = "; 0 leaves it to the method"

SPECS = (
    Spec("process", "", "P1 ... P4, a transfer function in s as text, or a YAML file; empty until known"),
    Spec("controller", "fopid_controller", "node name of the controller", read_only=True),
    Spec("method", "frequency", "what ~/tune does when not told", choices=METHODS),
    Spec("phase_margin", 0.0, f"phase margin to reach [rad]{_ZERO_CHOOSES}", 0.0, math.pi),
    Spec("crossover", 0.0, f"gain crossover to reach [rad/s]{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("t_max_db", 0.0, "bound on |T| from t_max_frequency on [dB]", -1e3, 1e3),
    Spec("t_max_frequency", 0.0, "where that bound begins [rad/s]; 0 for no bound", 0.0, 1e9),
    Spec("s_max_db", 0.0, "bound on |S| up to s_max_frequency [dB]", -1e3, 1e3),
    Spec("s_max_frequency", 0.0, "where that bound ends [rad/s]; 0 for no bound", 0.0, 1e9),
    Spec("via", "none", "template the process is reduced to before tuning by frequency", choices=VIA),
    Spec("index", "itae", "what tuning in time makes small: iae ise itae itse istes istse sum"),
    Spec("horizon", 0.0, f"time the index is integrated over [s]{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("ms_max", 0.0, f"bound on max |S|{_ZERO_CHOOSES}", 0.0, 1e3),
    Spec("u_max", 0.0, f"bound on the control's peak after a unit setpoint step{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("rule", "", "name of the tuning rule"),
    Spec("timeout", 30.0, "give the best found after this long, marked unsuccessful [s]", 1e-3, 1e6),
    Spec("sample_time", 0.01, "tick of the controller that will run the gains [s]", 1e-6, 1e6),
    Spec("verify.ms_max", 4.0, "gains with a larger max |S| are not applied", 1.0, 1e6),
)  # fmt: skip


@dataclass(frozen=True)
class Applied:
    """What handing over the gains came to."""

    done: bool
    message: str
    previous: Fopid | None = None


def _given(request: Tune.Request, defaults: dict[str, Any], name: str) -> Any:
    """The request's field, or the parameter of that name where the field is zero or empty; None if both are."""
    return getattr(request, name) or defaults[name] or None


def tuning_request(request: Tune.Request, defaults: dict[str, Any]) -> TuningRequest:
    """The core's request from a service request and the node's parameters.

    Raises
    ------
    InputError
        Naming the field that cannot be used.
    """
    process = request.process or defaults["process"]
    if not process:
        raise InputError("process = ''; allowed: P1 ... P4 or a transfer function, here or as the tuner's parameter")
    bounds = {}
    for name in ("t_max", "s_max"):
        frequency = _given(request, defaults, f"{name}_frequency")
        db = getattr(request, f"{name}_db") or defaults[f"{name}_db"]
        bounds[name] = Bound(db, frequency) if frequency is not None else None
        if frequency is None and getattr(request, f"{name}_db"):
            raise InputError(f"{name}_frequency = 0; allowed: above 0 rad/s, since {name}_db is given")
    numbers = {name: _given(request, defaults, name)
               for name in ("phase_margin", "crossover", "horizon", "ms_max", "u_max", "rule", "timeout")}  # fmt: skip
    words = {name: _given(request, defaults, name) for name in ("method", "via", "index")}
    return TuningRequest(read_process(process), sample_time=defaults["sample_time"], **bounds, **numbers, **words)


class TunerNode(ManagedNode):
    """Serves ~/tune and ~/reduce, publishes ~/result.

    Services run in threads of their own, so the node answers others while it works.
    """

    NAME = "fopid_tuner"
    SPECS = SPECS

    def __init__(self) -> None:
        super().__init__()
        concurrent = ReentrantCallbackGroup()
        self._busy = threading.Lock()
        self._results = self.create_publisher(TuningResultMessage, "~/result", latched_qos(depth=100))
        self._controller = ControllerClient(self, self.get_parameter("controller").value, concurrent)
        self.create_service(Tune, "~/tune", self._on_tune, callback_group=concurrent)
        self.create_service(Reduce, "~/reduce", self._on_reduce, callback_group=concurrent)

    def check(self, values: dict[str, Any]) -> None:
        if values["process"]:
            read_process(values["process"])
        tuning_request(Tune.Request(process="P1"), values)

    def _on_tune(self, request: Tune.Request, response: Tune.Response) -> Tune.Response:
        if not self._busy.acquire(blocking=False):
            response.message = "busy with another tuning; ask again when ~/result has it"
            return response
        try:
            self._tune(request, response)
        except InputError as error:
            response.message = str(error)
            self.get_logger().warning(f"tuning refused, nothing changed: {error}")
        finally:
            self._busy.release()
        return response

    def _tune(self, request: Tune.Request, response: Tune.Response) -> None:
        values = self.values()
        wanted = tuning_request(request, values)
        result = tune(wanted)
        applied = Applied(False, "")
        if request.apply:
            refusal = _refusal(result, values["verify.ms_max"], values["sample_time"])
            applied = Applied(False, refusal) if refusal else self._apply(result.controller)
        response.success = result.success and (applied.done or not request.apply)
        response.applied = applied.done
        response.message = "; ".join(text for text in (result.message, applied.message) if text)
        response.unmet = list(result.unmet)
        response.elapsed = result.elapsed
        if result.controller is not None:
            _fill_gains(response.gains, result.controller)
        _fill_measures(response.achieved, result)
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
            _fill_gains(message.previous_gains, applied.previous)
        header_stamp(message.header, self.get_clock().now().nanoseconds)
        self._results.publish(message)

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


def _refusal(result: TuningResult, ms_max: float, sample_time: float) -> str:
    """Why a design is not applied; empty when it may be."""
    if result.controller is None or not result.stable:
        return "not applied: no stable design"
    if not result.success:
        return "not applied: the specification is not met"
    if result.achieved is None or result.achieved.ms > ms_max:
        ms = math.nan if result.achieved is None else result.achieved.ms
        return f"not applied: Ms = {ms:.3g} is above verify.ms_max = {ms_max:g}"
    if result.achieved.delay_margin < LEAST_TICKS * sample_time:
        margin = f"delay margin {result.achieved.delay_margin:.3g} s"
        return f"not applied: {margin} is below {LEAST_TICKS} ticks of {sample_time:g} s; it may be unstable as it runs"
    return ""


def _fill_gains(message: Gains, controller: Fopid) -> None:
    for name, value in zip(GAINS, controller.gains, strict=True):
        setattr(message, name, value)


def _fill_measures(message: LoopMeasures, result: TuningResult) -> None:
    message.stable, message.unstable_poles, message.cost = result.stable, result.unstable_poles, result.cost
    if result.achieved is None:
        return
    for name in ("phase_margin", "crossover", "phase_slope", "gain_margin_db", "delay_margin", "ms", "mt",
                 "t_db", "s_db"):  # fmt: skip
        setattr(message, name, float(getattr(result.achieved, name)))


def _executor() -> Executor:
    return MultiThreadedExecutor(num_threads=4)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_tuner``."""
    return run(TunerNode, args, _executor)


if __name__ == "__main__":
    sys.exit(main())
