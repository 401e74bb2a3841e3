"""One autotuning of a running loop: excite, identify, tune, verify, apply, watch; and undo it all when told to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from fopid_core.design.identification import IdentificationResult, IdentifiedModel, identify
from fopid_core.design.robust_verification import RobustLimits, RobustTuning, tune_robustly
from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.watch import LoopWatch, WatchSettings
from fopid_ros.controller_client import GAINS, ControllerClient
from fopid_ros.live_experiment import FEWEST_TICKS, LiveExperiment, RunningLoop, WantedExperiment
from fopid_ros.loop_tap import LoopTap, Tick
from fopid_ros.loop_wait import LoopWait, Stage

EXPERIMENTS = 3
"""How often the experiment is made while its record says too little."""
RESPONSES_WATCHED, MOVED_SHARE = 10.0, 0.5
"""How long new gains are watched, in response times, and the share of the allowed deviation that they may cause."""


@dataclass(frozen=True)
class AutotuneRequest:
    """What is asked.

    Attributes
    ----------
    experiment : WantedExperiment
    template : str
        Of the model.
    tuning : TuningRequest
        Its process and sample time give way to those of the loop.
    limits : RobustLimits
        What must hold on every process that the record leaves possible.
    least_ticks : float
        Delay margin that new gains must leave, in ticks.
    propose_only : bool
    """

    experiment: WantedExperiment
    template: str
    tuning: TuningRequest
    limits: RobustLimits
    least_ticks: float
    propose_only: bool


@dataclass(frozen=True)
class AutotuneOutcome:
    """What an autotuning came to."""

    success: bool = False
    message: str = ""
    applied: bool = False
    rolled_back: bool = False
    model: IdentifiedModel | None = None
    tuned: RobustTuning | None = None
    previous: Fopid | None = None


class Autotuner:
    """Runs one autotuning in the calling thread, while others spin the node.

    Parameters
    ----------
    tap : LoopTap
    controller : ControllerClient
    request : AutotuneRequest
    tell : callable
        Called with a ``Stage`` all along.
    cancelled : callable
        Whether an end has been asked for.
    """

    def __init__(
        self, tap: LoopTap, controller: ControllerClient, request: AutotuneRequest, tell: Callable[[Stage], None],
        cancelled: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._tap, self._controller, self._request = tap, controller, request
        self._wait = LoopWait(tap, tell, cancelled)
        self._applied_over: Fopid | None = None

    def run(self) -> AutotuneOutcome:
        """Do it; however it ends, the loop is left with gains that are known to hold it.

        Raises
        ------
        InputError
            If it cannot be begun: no controller, no loop, or something in the request.
        CancelledError
            After everything has been put back.
        """
        self._tap.require_free_addend()
        experiment = LiveExperiment(self._tap, self._wait, self._look(), self._request.experiment)
        try:
            return self._run(experiment)
        except BaseException:
            self._take_back()
            raise
        finally:
            self._tap.every_tick(None)
            self._tap.add(0.0)

    def _run(self, experiment: LiveExperiment) -> AutotuneOutcome:
        experiment.measure()
        began, outcome = self._tap.history.newest_time("control"), AutotuneOutcome()
        for _ in range(EXPERIMENTS):
            ended = experiment.excite()
            if ended:
                return AutotuneOutcome(message=f"the experiment was stopped, nothing was changed: {ended}")
            outcome = self._learn(experiment.loop, began)
            if outcome.success:
                break
        if not outcome.success or self._request.propose_only:
            return outcome
        return self._apply_and_watch(experiment, outcome)

    def _learn(self, loop: RunningLoop, began: float) -> AutotuneOutcome:
        """A model of all that was heard since ``began``, and gains for it."""
        self._wait.tell(Stage("identifying", 0.6))
        found = identify(self._tap.history.record(began), self._request.template)
        if not found.success or found.best is None:
            return AutotuneOutcome(message=f"nothing was changed: {found.message}", model=found.best)
        tuned, refusal = self._design(loop, found)
        return AutotuneOutcome(not refusal, refusal or tuned.message, model=found.best, tuned=tuned)

    def _look(self) -> RunningLoop:
        """What the controller says of itself."""
        *gains, sample_time, low, high, mode = self._controller.get(
            *GAINS, "sample_time", "control_min", "control_max", "mode"
        )
        if mode != "auto":
            raise InputError(f"mode = {mode!r} of the controller; allowed: auto, since the loop stays closed")
        return RunningLoop(Fopid(*gains), sample_time, low, high)

    # Design and hand-over.

    def _design(self, loop: RunningLoop, found: IdentificationResult) -> tuple[RobustTuning, str]:
        """New gains, verified on all that the record leaves possible; and why they must not be used."""
        self._wait.tell(Stage("tuning", 0.65, fit_pct=found.best.fit_pct if found.best else 0.0, message=found.message))
        wanted = replace(self._request.tuning, sample_time=loop.sample_time)
        tuned = tune_robustly(found, wanted, self._request.limits)
        self._wait.tell(Stage("verifying", 0.7, message=tuned.message))
        if not tuned.success or tuned.tuning is None or tuned.tuning.achieved is None:
            return tuned, f"nothing was changed: {tuned.message}"
        margin, least = tuned.tuning.achieved.delay_margin, self._request.least_ticks * loop.sample_time
        if margin < least:
            return tuned, f"nothing was changed: delay margin {margin:.3g} s; wanted: {least:.3g} s at least"
        return tuned, ""

    def _apply_and_watch(self, experiment: LiveExperiment, outcome: AutotuneOutcome) -> AutotuneOutcome:
        self._settle(experiment)
        design = outcome.tuned.tuning if outcome.tuned else None
        if design is None or design.controller is None or design.achieved is None:
            raise InputError("a tuning without gains; allowed: one that succeeded")
        self._wait.tell(Stage("applying", 0.75, message=str(design.controller)))
        self._applied_over = self._controller.apply(design.controller)
        watch = self._watch(experiment, 2.0 / design.achieved.crossover)
        applied = replace(outcome, applied=True, previous=self._applied_over)
        if watch.verdict != "worse":
            return replace(applied, message=f"{outcome.message}; applied and watched: {watch.reason}")
        self._take_back()
        return replace(applied, success=False, applied=False, rolled_back=True,
                       message=f"the previous gains are back, since the loop got worse: {watch.reason}")  # fmt: skip

    def _settle(self, experiment: LiveExperiment) -> None:
        """Wait until the experiment has died out, or for the length of it at most."""
        near, newest = experiment.residue(), Tick(-math.inf, 0.0, 0.0, 0.0)
        limit, calm_since, setpoint = experiment.duration, [math.inf], experiment.loop.setpoint
        began: list[float] = []

        def hook(tick: Tick) -> None:
            nonlocal newest
            newest = tick
            began.append(tick.time) if not began else None
            calm = abs(tick.measurement - setpoint) <= near
            calm_since[0] = min(calm_since[0], tick.time) if calm else math.inf

        self._tap.every_tick(hook)
        calm_for = 0.1 * limit
        self._wait.until(
            lambda: bool(began) and (newest.time - calm_since[0] >= calm_for or newest.time - began[0] >= limit),
            lambda: Stage("applying", 0.72, deviation=newest.measurement - setpoint, message="letting it settle"),
        )

    def _watch(self, experiment: LiveExperiment, response_time: float) -> LoopWatch:
        loop = experiment.loop
        window = max(RESPONSES_WATCHED * response_time, 2 * FEWEST_TICKS * loop.sample_time)
        before, residue = loop.figures, experiment.residue()
        # New gains read the memory of the past anew, which moves the loop a little: that much is allowed.
        allowed = (MOVED_SHARE * loop.deviation_max) ** 2 / (before.mean_square + residue**2)
        settings = WatchSettings(window, response_time, error_factor=max(allowed, 2.0), noise=residue)
        watch = LoopWatch(before, settings, loop.sample_time)

        def hook(tick: Tick) -> None:
            watch.step(tick.setpoint, tick.measurement, loop.saturated(tick.control))
            if tick.setpoint == loop.setpoint and abs(tick.measurement - tick.setpoint) > loop.deviation_max:
                watch.verdict = "worse"
                watch.reason = f"measurement {tick.measurement:.4g} left the band of {loop.deviation_max:.4g}"

        self._tap.every_tick(hook)
        self._wait.until(lambda: watch.finished, lambda: Stage(
            "watching", 0.75 + 0.25 * min(watch.figures.duration / window, 1.0), window - watch.figures.duration,
            self._tap.history.newest("measurement") - loop.setpoint, message=watch.reason,
        ))  # fmt: skip
        return watch

    def _take_back(self) -> None:
        """The gains from before, where others have been applied."""
        if self._applied_over is not None:
            self._controller.apply(self._applied_over)
            self._applied_over = None
