"""New gains for a learnt process: verified on all it may be, applied, watched, taken back if the loop got worse."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.flaw_trial import UNLIMITED
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.identification.noise import SensorNoise
from fopid_core.design.identification.record import Record
from fopid_core.design.improvement import Candidate, improve
from fopid_core.design.loop_judge import RunningGains
from fopid_core.design.response_verification import Judge, held_to_record, no_objection
from fopid_core.design.robust_verification import RobustLimits, RobustTuning, first_request
from fopid_core.design.slower import slower_design
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.two_degrees import WHOLE_SETPOINT
from fopid_core.runtime.performance_monitor import LoopPerformance, MonitorSettings, PerformanceMonitor
from fopid_core.runtime.settings import UNPACED, Pace
from fopid_ros.tuner.controller_client import ControllerClient, RunningDesign, UnconfirmedError
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, Stage
from fopid_ros.tuner.learning.running_controller import TICKS_MIN, RunningController

MONITORED_RESPONSES = 10.0
"""How long new gains are watched, in response times."""
WAKES = 1.0 / 3.0
"""Noise whose standard deviation at the control is that share of a dead band takes the actuator out of it often."""
SILENT = SensorNoise(0.0, 0.0)
PROOF_SECONDS = 30.0
"""What a proof for a region may take where there is no timeout."""


@dataclass(frozen=True)
class AcceptanceCriteria:
    """What new gains must fulfil.

    Attributes
    ----------
    tuning : TuningRequest
        Its process and sample time give way to those of the loop.
    limits : RobustLimits
        What must hold on every process that the record leaves possible.
    delay_margin_min : float
        Delay margin that they must leave, in ticks.
    certify : bool
        Whether stability and ``limits.ms_max`` must be proved for the learnt process.
    region : str
        For what more: ``ellipsoid`` or ``box``, all that the record leaves possible; ``samples``, for nothing.
    confidence : float
        That the true parameters are in that region.
    compare : bool
        Whether other methods than the one asked for are tried, and the best is taken.
    noise_share : float
        Share of the control's range that noise may move it by, as a standard deviation.
    """

    tuning: TuningRequest
    limits: RobustLimits
    delay_margin_min: float
    certify: bool = False
    compare: bool = False
    noise_share: float = 0.01
    region: str = "samples"
    confidence: float = 0.95


@dataclass(frozen=True)
class Outcome:
    """What learning and tuning came to."""

    success: bool = False
    message: str = ""
    applied: bool = False
    rolled_back: bool = False
    model: IdentifiedModel | None = None
    models: tuple[IdentifiedModel, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    tuned: RobustTuning | None = None
    previous: RunningDesign | None = None
    certificate: str = ""
    held_back: bool = False
    noise_gain_aim: float = math.inf
    pace: Pace = UNPACED
    deadband: float = 0.0

    @property
    def tuning(self) -> TuningResult | None:
        """The design."""
        return self.tuned.tuning if self.tuned else None

    def held(self, pace: Pace) -> Outcome:
        """With its gains held to a pace that was found after they were designed."""
        used = self.tuning.controller if self.tuning else None

        def is_used(one: Candidate) -> bool:
            return used is not None and one.tuned.tuning is not None and one.tuned.tuning.controller == used

        candidates = tuple(replace(one, pace=pace) if is_used(one) else one for one in self.candidates)
        return replace(self, pace=pace, candidates=candidates, message=f"{self.message}; {held_to(pace)}")


@dataclass(frozen=True)
class Trial:
    """A design that is tried on the running loop.

    Attributes
    ----------
    design : RunningDesign
    response_time : float
        Of the loop with them [s].
    proof : float
        About how long it takes to move the loop with them afterwards [s]; 0 where that is not done.
    then : str
        What else is done afterwards.
    """

    design: RunningDesign
    response_time: float
    proof: float = 0.0
    then: str = ""

    def watched(self, sample_time: float) -> float:
        """How long they are watched [s]."""
        return max(MONITORED_RESPONSES * self.response_time, 2 * TICKS_MIN * sample_time)


def held_to(pace: Pace, moves: str = "moves", now: str = " now") -> str:
    """What is said of a pace that the actuator can follow."""
    limits = {"control": (pace.control, "control_rate_max"), "setpoint": (pace.setpoint, "setpoint_rate_max")}
    told = [
        f"the {what} {moves} by no more than {most:.3g} a second{now} ({name})"
        for what, (most, name) in limits.items()
        if math.isfinite(most)
    ]
    return f"the actuator may be slow: {', '.join(told)}"


def wear_in_noise(used: Candidate, dead_band: Floats | float, noise: float) -> str:
    """What is said of gains whose noise takes an actuator out of its dead band again and again."""
    moved, band = noise * used.worth.noise_gain if used.worth else 0.0, float(np.max(dead_band))
    if not 0.0 < WAKES * band < moved:
        return ""
    rests = "keeps it at rest more of the time, for more error"
    return f"noise moves the control by {moved:.3g} and so the actuator for ever: a smaller verify.noise_share {rests}"


def counting_as_none(deadband: float, count: str = "count") -> str:
    """What is said of errors that the steps of the sensor hide."""
    return f"errors up to {deadband:.3g} {count} as none (deadband), half a step of the measurement"


def _first_objection(judges: Iterable[Judge], tuning: TuningResult) -> str:
    """Why one of them does not take a design; empty where all do."""
    return next(filter(None, (judge(tuning.controller, tuning.filter) for judge in judges)), "")


def response_time(outcome: Outcome) -> float:
    """Of the loop with the gains found [s]."""
    achieved = outcome.tuning.achieved if outcome.tuning else None
    return 2.0 / achieved.crossover if achieved else math.nan


class GainUpdate:
    """Designs gains for the running loop and tries them out; ``roll_back`` undoes it.

    Parameters
    ----------
    tap : LoopTap
    client : ControllerClient
    wait : LoopWait
    controller : RunningController
    criteria : AcceptanceCriteria
    noise_gain_aim : float
        What an earlier round aimed at of the noise gain; infinite where this is the first.

    Attributes
    ----------
    not_borne : tuple of float
        When gains that made the loop worse were tried, from and to [s]; infinite where that has not been.
    """

    def __init__(
        self,
        tap: LoopTap,
        client: ControllerClient,
        wait: LoopWait,
        controller: RunningController,
        criteria: AcceptanceCriteria,
        noise_gain_aim: float = math.inf,
    ) -> None:
        self._tap, self._client, self._wait, self._noise_gain_aim = tap, client, wait, noise_gain_aim
        wait.sample_time = controller.sample_time
        self._controller, self._criteria = controller, criteria
        self.not_borne = math.inf, math.inf
        self._previous: RunningDesign | None = None
        self._trial: RunningDesign | None = None

    def design(
        self, found: IdentificationResult, sensor: SensorNoise = SILENT, control_peak: float = math.inf,
        control_rate: float = math.inf, control: float = math.nan, *, every: bool = False, record: Record | None = None,
        smaller: Sequence[Record] = (), slower: tuple[TuningResult, float] | None = None,
    ) -> Outcome:  # fmt: skip
        """Gains for what was learnt that beat the running ones on it, verified on all that the record leaves possible.

        Parameters
        ----------
        found : IdentificationResult
        sensor : SensorNoise
            Of the measurement, where it was measured.
        control_peak : float
            How far a unit step of the setpoint may take the control; infinite where no limit says.
        control_rate : float
            How fast it may [1/s]; infinite where no limit says.
        control : float
            Where it rests; NaN where that is not known.
        every : bool
            Whether one of each structure and rule is made, for a person to choose from.
        record : Record, optional
            What it was learnt from: where that contradicts the model, gains are held to it as well.
        smaller : sequence of Record
            Of smaller moves, which were not learnt from: what they show is no actuator's that is slow.
        slower : TuningResult and float, optional
            A design that is to be made so many times as fast, and nothing else.
        """
        fit_pct = found.best.fit_pct if found.best else 0.0

        def tell(what: str) -> None:
            self._wait.report(Stage("tuning", 0.65, fit_pct=fit_pct, message=what))

        tell(found.message)
        wanted = replace(self._criteria.tuning, sample_time=self._controller.sample_time)
        contradicted: Judge = no_objection
        limits, doubt = self._criteria.limits, ""
        if record is not None and found.best is not None:
            behind = found.behind_actuator(record)
            doubt, contradicted = held_to_record(behind, found.best, limits.ms_max, wanted.sample_time)
            tell(doubt) if doubt else None
        in_small: list[Judge] = []
        if found.best is not None and math.isfinite(found.flaws.rate):
            in_small += [held_to_record(each, found.best, limits.ms_max, wanted.sample_time)[1] for each in smaller]
        movement = self._criteria.noise_share * self._controller.control_range
        now = self._controller
        running = RunningGains(
            now.gains,
            sensor.level,
            movement,
            control_peak,
            control_rate,
            now.filter,
            now.weights,
            sensor.spectrum,
            self._noise_gain_aim,
            now.room(control) if math.isfinite(control) else UNLIMITED,
            now.pace,
            now.antiwindup,
        )
        only = None
        if slower is not None and found.best is not None:
            wanted, only = slower_design(first_request(found, wanted), *slower)
        improved = improve(
            found, wanted, limits, running, self._criteria.compare,
            lambda tuning: self._refused(tuning) or _first_objection((contradicted, *in_small), tuning),
            every=every, only=only, tell=tell,
        )  # fmt: skip
        paced = held_to(improved.pace, "is to move", "") if every and improved.pace != UNPACED else ""
        wear = wear_in_noise(improved.candidates[0], found.flaws.dead_band, sensor.level) if improved.success else ""
        told = "; ".join(filter(None, (str(found.flaws), doubt, improved.message, wear, paced)))
        improved = replace(improved, message=told)
        self._wait.report(Stage("verifying", 0.7, message=improved.message))
        outcome = Outcome(
            improved.success, improved.message, model=found.best, models=found.models,
            candidates=improved.candidates, tuned=improved.tuned, held_back=improved.held_back,
            noise_gain_aim=improved.noise_gain_aim, pace=improved.pace,
        )  # fmt: skip
        if not improved.success or improved.tuned.tuning is None:
            return replace(outcome, success=False, message=f"nothing was changed: {improved.message}")
        certificate, refused = self._proof(wanted, found.best, improved.tuned.tuning)
        if refused:
            return replace(outcome, success=False, message=refused)
        return replace(outcome, certificate=certificate)

    def _proof(self, wanted: TuningRequest, best: IdentifiedModel | None, tuning: TuningResult) -> tuple[str, str]:
        """The certificate that the criteria ask for, or why there is none."""
        asked = self._criteria
        if best is None or not (asked.certify or asked.region != "samples"):
            return "", ""
        from fopid_core.design.certified_tuning import certificate_or_refusal

        learnt = replace(wanted, process=best.process)
        if asked.region == "samples":
            return certificate_or_refusal(learnt, tuning, asked.limits.ms_max)
        from fopid_core.design.certificate.ellipsoid import learnt_family

        try:
            family = learnt_family(best, asked.region, asked.confidence)
        except InputError as error:
            return "", f"not applied: {error}"
        seconds = wanted.timeout or PROOF_SECONDS
        return certificate_or_refusal(learnt, tuning, asked.limits.ms_max, family, seconds)

    def _refused(self, tuning: TuningResult) -> str:
        """The limits on what the record leaves possible stand in for that on max |S| of the one design."""
        return rejection_reason(tuning, self._controller.sample_time, math.inf, self._criteria.delay_margin_min)

    def apply_and_monitor(
        self, outcome: Outcome, before: LoopPerformance, residual_transient: float, error_factor: float,
        outside: Callable[[Tick], str] = lambda _: "", proof: float = 0.0, then: str = "",
    ) -> Outcome:  # fmt: skip
        """Apply a design on trial and watch the loop; the gains from before come back if it gets worse.

        It stays on trial until ``kept``.

        Parameters
        ----------
        outcome : Outcome
            Of ``design``, with success.
        before : LoopPerformance
            What the loop did with the gains it has.
        residual_transient : float
            Error that is not the new gains' fault: noise, and what dies out of before.
        error_factor : float
            By how much the mean square of the error may grow.
        outside : callable
            Says why a tick is not to be borne, or nothing.
        proof, then
            As of `Trial`.
        """
        design = outcome.tuning
        if design is None or design.controller is None or design.achieved is None:
            raise InputError("a tuning without gains; allowed: one that succeeded")
        chosen = None if design.filter.is_idle and design.weights == WHOLE_SETPOINT else design.weights
        pace = outcome.pace & self._controller.pace
        changed = pace if pace != self._controller.pace else None
        deadband = outcome.deadband if outcome.deadband > self._controller.deadband else None
        whole = RunningDesign(design.controller, design.filter, chosen, changed, deadband)  # as it was verified
        trial = Trial(whole, response_time(outcome), proof, then)
        return self.try_out(trial, outcome, before, residual_transient, error_factor, outside)

    def try_out(
        self, trial: Trial, outcome: Outcome, before: LoopPerformance, residual_transient: float, error_factor: float,
        outside: Callable[[Tick], str] = lambda _: "",
    ) -> Outcome:  # fmt: skip
        """As ``apply_and_monitor``, with these gains."""
        window = trial.watched(self._controller.sample_time)
        left = window + trial.proof
        told = f"about {left:.3g} s more to watch{' and to prove' if trial.proof else ''} them{trial.then}"
        self._wait.report(Stage("applying", 0.75, left, message=f"{trial.design.gains}; {told}"))
        self._trial, began = trial.design, self._tap.history.newest_time("control")
        try:
            self._previous = self._client.apply(self._trial, "trial", outcome.certificate)
        except UnconfirmedError as error:  # they may have been taken: taking back must not depend on it
            self._previous = error.previous
            raise
        settings = MonitorSettings(window, trial.response_time, error_factor=error_factor, noise=residual_transient)
        watch = self._watch(PerformanceMonitor(before, settings, self._controller.sample_time), outside)
        applied = replace(outcome, applied=True, previous=self._previous)
        if watch.verdict != "worse":
            told = f"{outcome.message}; applied with {trial.design.filter}, watched: {watch.reason}"
            told += f"; {held_to(trial.design.pace)}" if trial.design.pace else ""
            told += f"; {counting_as_none(trial.design.deadband)}" if trial.design.deadband else ""
            return replace(applied, message=told)
        self.roll_back_or_raise()
        self.not_borne = began, self._tap.history.newest_time("control")
        return replace(applied, success=False, applied=False, rolled_back=True,
                       message=f"the previous gains are back, since the loop got worse: {watch.reason}")  # fmt: skip

    def kept(self, outcome: Outcome) -> Outcome:
        """The design on trial is known to hold the loop, where it is still applied.

        Raises
        ------
        InputError
            If the controller does not answer, or other gains came meanwhile, which stay.
        """
        if outcome.applied and self._trial is not None:
            self._client.confirm(self._trial)
        return outcome

    def _watch(self, watch: PerformanceMonitor, outside: Callable[[Tick], str]) -> PerformanceMonitor:
        window = watch.settings.window

        def hook(tick: Tick) -> None:
            watch.step(tick.setpoint, tick.measurement, self._controller.saturated(tick.control))
            reason = outside(tick)
            if reason:
                watch.verdict, watch.reason = "worse", reason

        def stage() -> Stage:
            done, history = watch.figures.duration, self._tap.history
            deviation = history.newest("measurement") - history.newest("setpoint")
            return Stage("watching", 0.75 + 0.25 * min(done / window, 1.0), max(window - done, 0.0), deviation,
                         message=watch.reason)  # fmt: skip

        self._tap.set_tick_hook(hook)
        try:
            self._wait.until(lambda: watch.finished, stage)
        finally:
            self._tap.set_tick_hook(None)
        return watch

    def roll_back_or_raise(self) -> None:
        """As `roll_back`; an error where other gains came meanwhile.

        Raises
        ------
        InputError
            If other gains came meanwhile, which stay, or the controller does not take them.
        """
        if not self.roll_back():
            raise InputError("the gains were changed meanwhile; they stay")

    def roll_back(self) -> bool:
        """The gains from before, where those on trial are in force; others that came meanwhile stay.

        Returns
        -------
        bool
            Whether they had to be put back.

        Raises
        ------
        InputError
            If the controller does not take them.
        """
        if self._previous is None or self._trial is None:
            return False
        before = self._previous
        try:
            now = self._client.design()
            ours = now.is_same_loop(self._trial) or now.is_same_loop(before)  # those on trial may still be on their way
            if ours:
                self._client.apply(before)
        except InputError as error:
            raise InputError(f"the previous gains, {before.gains}, could not be put back: {error}") from None
        self._previous = None
        return ours
