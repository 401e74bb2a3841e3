"""New gains for a learnt process: verified on all it may be, applied, watched, taken back if the loop got worse."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from fopid_core.design.acceptance import refusal
from fopid_core.design.identification.identify import IdentificationResult, IdentifiedModel
from fopid_core.design.robust_verification import RobustLimits, RobustTuning, tune_robustly
from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.watch import LoopFigures, LoopWatch, WatchSettings
from fopid_ros.tuner.controller_client import GAINS, ControllerClient
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, Stage

FEWEST_TICKS = 30
"""What lasts fewer ticks tells nothing."""
RESPONSES_WATCHED = 10.0
"""How long new gains are watched, in response times."""


@dataclass(frozen=True)
class Terms:
    """What new gains must fulfil.

    Attributes
    ----------
    tuning : TuningRequest
        Its process and sample time give way to those of the loop.
    limits : RobustLimits
        What must hold on every process that the record leaves possible.
    least_ticks : float
        Delay margin that they must leave, in ticks.
    """

    tuning: TuningRequest
    limits: RobustLimits
    least_ticks: float


@dataclass(frozen=True)
class Outcome:
    """What learning and tuning came to."""

    success: bool = False
    message: str = ""
    applied: bool = False
    rolled_back: bool = False
    model: IdentifiedModel | None = None
    tuned: RobustTuning | None = None
    previous: Fopid | None = None


@dataclass(frozen=True)
class Controller:
    """What the running controller says of itself.

    Attributes
    ----------
    gains : Fopid
    sample_time : float
        [s]
    control_min, control_max : float
    """

    gains: Fopid
    sample_time: float
    control_min: float
    control_max: float

    def saturated(self, control: float) -> bool:
        """Whether a control is at a limit."""
        return not self.control_min < control < self.control_max


def ask_controller(client: ControllerClient) -> Controller:
    """The running controller, which must be in automatic mode.

    Raises
    ------
    InputError
        If it does not answer, or is in manual mode.
    """
    *gains, sample_time, low, high, mode = client.get(*GAINS, "sample_time", "control_min", "control_max", "mode")
    if mode != "auto":
        raise InputError(f"mode = {mode!r} of the controller; allowed: auto, since the loop stays closed")
    return Controller(Fopid(*gains), sample_time, low, high)


class Handover:
    """Designs gains for the running loop and tries them out; ``take_back`` undoes it.

    Parameters
    ----------
    tap : LoopTap
    client : ControllerClient
    wait : LoopWait
    controller : Controller
    terms : Terms
    """

    def __init__(
        self, tap: LoopTap, client: ControllerClient, wait: LoopWait, controller: Controller, terms: Terms
    ) -> None:
        self._tap, self._client, self._wait = tap, client, wait
        self._controller, self._terms = controller, terms
        self._applied_over: Fopid | None = None

    def design(self, found: IdentificationResult) -> Outcome:
        """Gains for what was learnt, verified on all that the record leaves possible."""
        self._wait.tell(Stage("tuning", 0.65, fit_pct=found.best.fit_pct if found.best else 0.0, message=found.message))
        wanted = replace(self._terms.tuning, sample_time=self._controller.sample_time)
        tuned = tune_robustly(found, wanted, self._terms.limits)
        self._wait.tell(Stage("verifying", 0.7, message=tuned.message))
        outcome = Outcome(model=found.best, tuned=tuned)
        if not tuned.success or tuned.tuning is None:
            return replace(outcome, message=f"nothing was changed: {tuned.message}")
        # The limits on what the record leaves possible stand in for that on max |S| of the one design.
        refused = refusal(tuned.tuning, self._controller.sample_time, math.inf, self._terms.least_ticks)
        if refused:
            return replace(outcome, message=refused)
        return replace(outcome, success=True, message=tuned.message)

    def try_out(
        self, outcome: Outcome, before: LoopFigures, residue: float, error_factor: float,
        outside: Callable[[Tick], str] = lambda _: "",
    ) -> Outcome:  # fmt: skip
        """Apply a design and watch the loop; the gains from before come back if it gets worse.

        Parameters
        ----------
        outcome : Outcome
            Of ``design``, with success.
        before : LoopFigures
            What the loop did with the gains it has.
        residue : float
            Error that is not the new gains' fault: noise, and what dies out of before.
        error_factor : float
            By how much the mean square of the error may grow.
        outside : callable
            Says why a tick is not to be borne, or nothing.
        """
        design = outcome.tuned.tuning if outcome.tuned else None
        if design is None or design.controller is None or design.achieved is None:
            raise InputError("a tuning without gains; allowed: one that succeeded")
        self._wait.tell(Stage("applying", 0.75, message=str(design.controller)))
        self._applied_over = self._client.apply(design.controller)
        response_time = 2.0 / design.achieved.crossover
        window = max(RESPONSES_WATCHED * response_time, 2 * FEWEST_TICKS * self._controller.sample_time)
        settings = WatchSettings(window, response_time, error_factor=error_factor, noise=residue)
        watch = self._watch(LoopWatch(before, settings, self._controller.sample_time), outside)
        applied = replace(outcome, applied=True, previous=self._applied_over)
        if watch.verdict != "worse":
            return replace(applied, message=f"{outcome.message}; applied and watched: {watch.reason}")
        self.take_back()
        return replace(applied, success=False, applied=False, rolled_back=True,
                       message=f"the previous gains are back, since the loop got worse: {watch.reason}")  # fmt: skip

    def _watch(self, watch: LoopWatch, outside: Callable[[Tick], str]) -> LoopWatch:
        window = watch.settings.window

        def hook(tick: Tick) -> None:
            watch.step(tick.setpoint, tick.measurement, self._controller.saturated(tick.control))
            reason = outside(tick)
            if reason:
                watch.verdict, watch.reason = "worse", reason

        def stage() -> Stage:
            done, history = watch.figures.duration, self._tap.history
            deviation = history.newest("measurement") - history.newest("setpoint")
            return Stage("watching", 0.75 + 0.25 * min(done / window, 1.0), window - done, deviation,
                         message=watch.reason)  # fmt: skip

        self._tap.every_tick(hook)
        try:
            self._wait.until(lambda: watch.finished, stage)
        finally:
            self._tap.every_tick(None)
        return watch

    def take_back(self) -> None:
        """The gains from before, where others have been applied."""
        if self._applied_over is not None:
            self._client.apply(self._applied_over)
            self._applied_over = None
