"""New gains for a running loop: the best of several methods on the learnt process, or none where none beats the old."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.loop_judge import LoopJudge, RunningGains, loop_of
from fopid_core.design.loop_worth import LoopWorth
from fopid_core.design.promising import CLEAR, Promise, box_of, name_of, promising_designs
from fopid_core.design.robust_verification import (
    RobustLimits,
    RobustTuning,
    as_held,
    first_request,
    tune_robustly,
)
from fopid_core.design.setpoint_weights import calmest_weights
from fopid_core.design.slower import slower_design
from fopid_core.design.specification import Clock, TuningRequest, TuningResult
from fopid_core.errors import InputError
from fopid_core.runtime.settings import UNPACED, Pace

MOST_VERIFIED = 4
"""So many designs are verified on all that the record leaves possible, which takes longest."""
LOST = 2.0
"""Where only cautious ones of these may be used, and others promise to be so many times better, those are as well."""
UNSEEN_END = (
    "the record does not show the slow end of the process, which dry friction may hide in small moves: watch the first "
    "large step of the setpoint"
)
"""What is said where such ranges were searched."""
RUNS_AWAY = "learnt as a process that runs away without a controller"
"""Of such a process."""
SLOWED, MOST_SLOWED = ((0.7, 0.85), (0.5, 0.6)), 2
"""Where the record forbids all designs: so many of them, those that it forbids by least, are made so much slower, and
where one is allowed then, half as much slower."""
SLOWER = (0.5, 0.25)
"""Shares of a crossover that are tried where noise moves the control too much."""
_UNSTABLE = 1e3
"""A process that a design does not hold is further from what must hold than any max |S|."""


@dataclass(frozen=True)
class Candidate:
    """What one method found.

    Attributes
    ----------
    name : str
        Structure and method.
    tuned : RobustTuning
    worth : LoopWorth or None
        On the learnt process; None without gains.
    refusal : str
        Why it may not be used; empty when it may.
    score : float
        Beside what runs: the less the better.
    pace : Pace
        That the controller is to be held to with it, where the actuator is slow.
    """

    name: str
    tuned: RobustTuning
    worth: LoopWorth | None
    refusal: str
    score: float = math.inf
    pace: Pace = UNPACED


@dataclass(frozen=True)
class Improvement:
    """The outcome of a search for better gains.

    Attributes
    ----------
    success : bool
        Gains were found that beat the running ones on the learnt process.
    message : str
    tuned : RobustTuning
        The best, or what came nearest.
    candidates : tuple of Candidate
        One of each method that was tried, the best first, those that may not be used last.
    held_back : bool
        The record does not show the process's slow end, and gains were searched in ranges for that.
    noise_gain_aim : float
        What was aimed at of the noise gain; infinite where nothing bounds it.
    pace : Pace
        That the controller is to be held to with these gains, where the actuator is slow.
    """

    success: bool
    message: str
    tuned: RobustTuning
    candidates: tuple[Candidate, ...] = ()
    held_back: bool = False
    noise_gain_aim: float = math.inf
    pace: Pace = UNPACED


def improve(
    identified: IdentificationResult,
    request: TuningRequest,
    limits: RobustLimits,
    running: RunningGains,
    compare: bool = True,
    refuse: Callable[[TuningResult], str] = lambda _: "",
    clock: Clock = time.perf_counter,
    every: bool = False,
    only: TuningResult | None = None,
    tell: Callable[[str], object] = lambda _: None,
) -> Improvement:
    """The best design on a learnt process, if it beats the gains that run.

    Behind an actuator that is slow it is to run with a control that moves no faster, and a setpoint that it follows.

    Parameters
    ----------
    identified : IdentificationResult
    request : TuningRequest
        The method asked for, and the sample time.
    limits : RobustLimits
        On every process that the record leaves possible. Running gains beyond its Ms are beaten by any design within.
    running : RunningGains
    compare : bool
        Whether other methods are tried as well.
    refuse : callable
        Why a design may not be used, or nothing; a more cautious one is tried then.
    clock : callable
        Gives the time [s].
    every : bool
        Whether one of each structure and rule is made, also when a better one is known; without ``compare`` what was
        asked for stays the first of them.
    only : TuningResult, optional
        What the request comes to, where that is known and nothing else is to be tried.
    tell : callable
        Told what is being looked at, before each design.
    """
    if not identified.success or identified.best is None:
        return Improvement(False, identified.message, tune_robustly(identified, request, limits, clock))
    judge = LoopJudge(identified.best.process, request.sample_time, running, limits.ms_max)
    flawed = _flaw_trial(identified, judge)
    if flawed is not None:
        judge.see_flaws(flawed)

    def refused(tuning: TuningResult) -> str:
        loop = loop_of(judge.process, tuning)
        return refuse(tuning) or (flawed.refusal(loop, flawed.pace(loop)) if flawed else "")

    trial = _Trial(identified, limits, refused, clock, judge, tell, [])
    compare, every = compare and only is None, every and only is None
    promising = promising_designs(identified, request, judge, tell) if compare or every else []
    fit = [one for one in promising if not one.refusal] if compare else []
    trial.make_promising(fit[:MOST_VERIFIED])
    if compare and not trial.is_done:
        trial.make_slower(request)
    trial.make_promising(fit[MOST_VERIFIED:], LOST)
    if not trial.is_done:
        asked_for = len(trial.made)
        trial.make_as_asked(request, only)
        if compare:
            trial.make_slower(request, asked_for)
    asked = judge.best
    if every:
        trial.make_others(promising)
    best = judge.best if compare or asked is None else asked
    if best is not None and compare:
        best = best[0], trial.calmed(best[1]), best[2]
    each = _one_of_each(trial.made, best[1] if best else None)
    candidates = tuple(one if one.refusal else replace(one, pace=_pace(flawed, judge, one.tuned)) for one in each)
    if best is None:
        first = trial.made[0]
        told = f"{first.refusal}; none of {len(trial.made)} designs holds all that is possible and beats what runs"
        return Improvement(False, told, first.tuned, candidates)
    score, tuned, wanted = best
    parts = [tuned.message, judge.told(tuned, name_of(wanted), _why(score, candidates, promising))]
    unseen = bool(box_of(identified, judge))
    parts += [UNSEEN_END] * unseen + [RUNS_AWAY] * identified.best.structure.runs_away
    held_back, pace = unseen and compare, candidates[0].pace
    return Improvement(True, "; ".join(parts), tuned, candidates, held_back, judge.noise_gain_aim, pace)


def _pace(flawed: FlawTrial | None, judge: LoopJudge, tuned: RobustTuning) -> Pace:
    """That the controller is to be held to with a design."""
    return flawed.pace(loop_of(judge.process, tuned.tuning)) if flawed and tuned.tuning else UNPACED


def _flaw_trial(identified: IdentificationResult, judge: LoopJudge) -> FlawTrial | None:
    """The loop behind a dead band, a slow actuator or dry friction, where there is one."""
    if not identified.flaws.come_before or identified.best is None:
        return None
    running, process = judge.running, identified.best.process
    return FlawTrial(
        process, identified.flaws, judge.sample_time, running.noise, judge.runs, running.control_room, running.pace,
        running.antiwindup, to_be_kept=not judge.runs_near_instability,
    )  # fmt: skip


@dataclass(frozen=True)
class _Trial:
    """Designs, verified on all that the record leaves possible; those refused, with the reason."""

    identified: IdentificationResult
    limits: RobustLimits
    refuse: Callable[[TuningResult], str]
    clock: Clock
    judge: LoopJudge
    tell: Callable[[str], object]
    made: list[Candidate]

    def make(self, wanted: TuningRequest, first: TuningResult | None = None) -> bool:
        """Make a design, from what the request first comes to where that is known; the judge keeps it if the best.

        Whether it may be used.
        """
        self.tell(f"{name_of(wanted)}, on all that the record leaves possible")
        try:
            runs = self.judge.running.gains, self.judge.running.filter
            tuned = tune_robustly(self.identified, wanted, self.limits, self.clock, first, self.refuse, runs)
        except InputError:  # a rule that is not for this process
            if wanted.rule is None:
                raise
            return False
        reason = self.judge.reason(tuned) if tuned.success else tuned.message
        if not reason:
            self.judge.take(tuned, wanted)
        tuning, worth, score = tuned.tuning, None, math.inf
        if tuning is not None and tuning.controller is not None:
            worth = self.judge.worth(loop_of(self.judge.process, tuning))
            score = math.inf if reason else self.judge.score(worth, tuning.controller)
        self.made.append(Candidate(name_of(wanted), tuned, worth, reason, score))
        return not reason

    @property
    def is_done(self) -> bool:
        """Whether there is a design that may be used."""
        return self.judge.best is not None

    def make_promising(self, fit: Iterable[Promise], lost: float = 1.0) -> None:
        """Make those that promise to be better than what there is, so many times, the best first."""
        for one in fit:
            if self.judge.best is not None and self.judge.best[0] <= lost * one.score:
                return
            before = len(self.made)
            self.make(one.wanted, one.tuning)
            if len(self.made) > before and (quieter := self._quieter(one.wanted)):
                self.make(quieter)

    def _quieter(self, wanted: TuningRequest) -> TuningRequest | None:
        """For the last design, where its control alone moves too far in noise: cautious ones have quicker filters."""
        last = self.made[-1].tuned
        measured = last.tuning.achieved if last.success and last.tuning else None
        if measured is None or wanted.noise_rms_max is None or self.judge.noise_excess <= 1.0:
            return None
        return replace(wanted, noise_rms_max=CLEAR * measured.noise_rms / self.judge.noise_excess)

    def make_as_asked(self, request: TuningRequest, first: TuningResult | None) -> None:
        """Make the design that was asked for, with less crossover where noise would move the control too much."""
        self.make(request, first)
        if request.method == "frequency" and self.judge.crossover and self.judge.noise_excess > 1.0:
            for share in SLOWER:
                self.make(replace(request, crossover=share * self.judge.crossover))

    def make_slower(self, request: TuningRequest, first: int = 0) -> None:
        """Of the designs made, from that one on, make those slower that the record forbids by least, until one fits."""
        asked = first_request(self.identified, request)
        forbidden = sorted((_distance(one.tuned), i) for i, one in enumerate(self.made[first:], first))
        for distance, i in forbidden[:MOST_SLOWED]:
            design = self.made[i].tuned.tuning
            if design is None or math.isinf(distance):
                return
            for slower, between in SLOWED:
                if not self.is_done and self.make(*slower_design(asked, design, slower)):
                    self.make(*slower_design(asked, design, between))

    def calmed(self, chosen: RobustTuning) -> RobustTuning:
        """A design that was made, with weights that overshoot less where a step leaves no more error than what runs."""
        tuning = chosen.tuning
        if tuning is None:
            return chosen
        loop = loop_of(self.judge.process, tuning)
        held = replace(loop, process=as_held(loop.process, self.judge.sample_time))
        calm = replace(loop, weights=calmest_weights(held, self.judge.horizon(loop), self.judge.sample_time))
        worth = self.judge.worth(calm)
        if worth.setpoint > self.judge.worth(self.judge.runs).setpoint or self.judge.too_fast(calm):
            return chosen
        tuned = replace(chosen, tuning=replace(tuning, weights=calm.weights))
        self.made[:] = [replace(one, tuned=tuned, worth=worth) if one.tuned is chosen else one for one in self.made]
        return tuned

    def make_others(self, promising: Iterable[Promise]) -> None:
        """Make the first of each structure and rule that has not been made, for comparison."""
        for one in promising:
            name = name_of(one.wanted)
            if name in {made.name for made in self.made}:
                continue
            if one.refusal:
                tuned = RobustTuning(False, one.refusal, one.tuning, None, 1, one.tuning.elapsed)
                self.made.append(Candidate(name, tuned, one.worth, one.refusal))
            else:
                self.make(one.wanted, one.tuning)


def _distance(tuned: RobustTuning) -> float:
    """How far a design is from what must hold on every possible process; infinite where that is not what forbids it."""
    judged = tuned.robustness
    if tuned.success or judged is None or tuned.tuning is None or tuned.tuning.controller is None:
        return math.inf
    return judged.ms if judged.stable == judged.count else _UNSTABLE * (judged.count - judged.stable)


def _one_of_each(found: Sequence[Candidate], chosen: RobustTuning | None) -> tuple[Candidate, ...]:
    """The best of each method, the chosen one first, then the best; the newest where none may be used."""
    by_name: dict[str, Candidate] = {}
    for one in found:
        if one.name not in by_name or one.score <= by_name[one.name].score:
            by_name[one.name] = one
    return tuple(sorted(by_name.values(), key=lambda one: (bool(one.refusal), one.tuned is not chosen, one.score)))


def _why(score: float, made: Sequence[Candidate], promising: Iterable[Promise]) -> str:
    """What speaks for the first: the scores of the others beside its own, and which may not be used."""
    first, *others = made
    scores = {one.name: one.score for one in others}
    for one in (each for each in promising if name_of(each.wanted) != first.name):
        scores.setdefault(name_of(one.wanted), math.inf if one.refusal else one.score)
    ordered = sorted(scores.items(), key=lambda item: item[1])
    told = [f"{name} {each / score:.3g}" if each < math.inf else f"{name} not allowed" for name, each in ordered]
    return f"score of errors, movement and terms beside it: {', '.join(told)}" if told else ""
