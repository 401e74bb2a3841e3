"""New gains for a running loop: the best of several methods on the learnt process, or none where none beats the old."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.loop_judge import LoopJudge, RunningGains, loop_of
from fopid_core.design.loop_worth import LoopWorth
from fopid_core.design.robust_verification import (
    UNSEEN,
    RobustLimits,
    RobustTuning,
    as_held,
    first_request,
    tune_robustly,
)
from fopid_core.design.setpoint_weights import calmest_weights
from fopid_core.design.slower import slower_design
from fopid_core.design.specification import Clock, TuningRequest, TuningResult
from fopid_core.design.textbook import NAMES as RULES
from fopid_core.design.textbook import textbook_loops
from fopid_core.design.time.proposal import settling_horizon
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.runtime.settings import UNPACED, Pace

LOAD_WEIGHTED = 10.0
"""Of the load in the search of a design in time, whose index is a sum, beside the setpoint's."""
MS_MAX = 1.8
"""Of the designs in time that are tried."""
STRUCTURES, FILTER_ORDER = ("pi", "pid", "fopid"), 2
"""Of those designs, and the order of their filter of the measurement, whose time is chosen with the gains."""
WHOLE_INTEGRAL = {"lam": 1.0}
"""Of all of them: it holds the plant's operating point, which one of another order reads out of the whole past anew, so
that the control jumps as it takes over."""
CLEAR = 0.95
"""Share of a bound on the noise gain that is aimed at where a design broke it."""
QUIETER = (0.5, 0.25, 0.125)
"""Shares of the control's movement from noise by the best of them, which are tried as well; not where friction may
hide the process's slow end, since a slow filter takes the phase that larger moves need."""
MOST_VERIFIED = 4
"""So many designs are verified on all that the record leaves possible, which takes longest."""
LOST = 2.0
"""Where only cautious ones of these may be used, and others promise to be so many times better, those are as well."""
LARGEST, LARGEST_STEP = 100.0, 10.0
"""Gains searched up to where the record does not show the process's slow end, in units of the process's gain about
where a controller would work, and of the gain that runs there: friction may hide that end, not so in larger moves."""
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
_POINTS, _DECADES = 600, (-7.0, 7.0)


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
    promising = _promising(identified, request, judge, tell) if compare or every else []
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
    parts = [tuned.message, judge.told(tuned, _name(wanted), _why(score, candidates, promising))]
    unseen = bool(_box(identified, judge))
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
        running.antiwindup,
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
        self.tell(f"{_name(wanted)}, on all that the record leaves possible")
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
        self.made.append(Candidate(_name(wanted), tuned, worth, reason, score))
        return not reason

    @property
    def is_done(self) -> bool:
        """Whether there is a design that may be used."""
        return self.judge.best is not None

    def make_promising(self, fit: Iterable[_Promise], lost: float = 1.0) -> None:
        """Make those that promise to be better than what there is, so many times, the best first."""
        for one in fit:
            if self.judge.best is not None and self.judge.best[0] <= lost * one.score:
                return
            self.make(one.wanted, one.tuning)

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
        calm = replace(loop, weights=calmest_weights(held, self.judge.horizon(loop)))
        worth = self.judge.worth(calm)
        if worth.setpoint > self.judge.worth(self.judge.runs).setpoint or self.judge.too_fast(calm):
            return chosen
        tuned = replace(chosen, tuning=replace(tuning, weights=calm.weights))
        self.made[:] = [replace(one, tuned=tuned, worth=worth) if one.tuned is chosen else one for one in self.made]
        return tuned

    def make_others(self, promising: Iterable[_Promise]) -> None:
        """Make the first of each structure and rule that has not been made, for comparison."""
        for one in promising:
            name = _name(one.wanted)
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


@dataclass(frozen=True)
class _Promise:
    """A design on the learnt process itself, its score there, and why it is not worth verifying, if it is not."""

    score: float
    wanted: TuningRequest
    tuning: TuningResult
    worth: LoopWorth
    refusal: str


def _name(wanted: TuningRequest) -> str:
    """Structure and method, as a person calls them."""
    return wanted.rule or f"{(wanted.structure or 'fopid').upper()} {wanted.method}"


def _one_of_each(found: Sequence[Candidate], chosen: RobustTuning | None) -> tuple[Candidate, ...]:
    """The best of each method, the chosen one first, then the best; the newest where none may be used."""
    by_name: dict[str, Candidate] = {}
    for one in found:
        if one.name not in by_name or one.score <= by_name[one.name].score:
            by_name[one.name] = one
    return tuple(sorted(by_name.values(), key=lambda one: (bool(one.refusal), one.tuned is not chosen, one.score)))


def _why(score: float, made: Sequence[Candidate], promising: Iterable[_Promise]) -> str:
    """What speaks for the first: the scores of the others beside its own, and which may not be used."""
    first, *others = made
    scores = {one.name: one.score for one in others}
    for one in (each for each in promising if _name(each.wanted) != first.name):
        scores.setdefault(_name(one.wanted), math.inf if one.refusal else one.score)
    ordered = sorted(scores.items(), key=lambda item: item[1])
    told = [f"{name} {each / score:.3g}" if each < math.inf else f"{name} not allowed" for name, each in ordered]
    return f"score of errors, movement and terms beside it: {', '.join(told)}" if told else ""


def _promising(
    identified: IdentificationResult, request: TuningRequest, judge: LoopJudge, tell: Callable[[str], object]
) -> list[_Promise]:
    """What to verify, the best on the learnt process itself first."""
    found: list[_Promise] = []

    def looked_at(wanted: TuningRequest) -> float:
        """Note what a request promises; how many times as far as allowed its control moves."""
        tell(f"{_name(wanted)}, on the learnt process")
        try:
            tuning = tune(first_request(identified, wanted))
        except InputError:  # the method is not for this process
            return 0.0
        if tuning.controller is None or not tuning.success:
            return _beside_noise_bound(wanted, tuning)
        loop = loop_of(judge.process, tuning)
        new = judge.worth(loop)
        unknown = "" if math.isfinite(new.load) else "its responses are not known"
        refusal = judge.too_noisy(new) or unknown or judge.too_fast(loop)
        found.append(_Promise(judge.score(new, tuning.controller), wanted, tuning, new, refusal))
        return new.noise_gain / judge.noise_gain_max

    _hold_to_textbook(identified, request, judge)
    usual = _in_time(request, judge, identified)
    for structure in STRUCTURES:
        in_time = replace(usual, structure=structure)
        excess = looked_at(in_time)
        if excess > 1.0 and in_time.noise_rms_max:  # by as much less as sampling and filters add to it
            looked_at(replace(in_time, noise_rms_max=CLEAR * in_time.noise_rms_max / excess))
    for further in _further(found, request, judge, identified):
        looked_at(further)
    fit = _fit(found)
    judge.note_reach(one.worth for one in fit)
    fit = [replace(one, score=judge.score(one.worth, one.tuning.controller)) for one in fit]
    if fit and usual.noise_rms_max is not None and not usual.bounds:
        best = min(fit, key=lambda one: one.score)
        for share in QUIETER:
            looked_at(replace(best.wanted, noise_rms_max=share * best.worth.noise_gain * judge.whiter))
    for rule in RULES:
        looked_at(replace(request, method="rule", rule=rule))
    found = [replace(one, score=judge.score(one.worth, one.tuning.controller)) for one in found]
    return sorted(found, key=lambda one: (bool(one.refusal), one.score))


def _fit(found: Iterable[_Promise]) -> list[_Promise]:
    """Those that may be used."""
    return [one for one in found if not one.refusal]


def _further(
    found: Sequence[_Promise], request: TuningRequest, judge: LoopJudge, identified: IdentificationResult
) -> Iterator[TuningRequest]:
    """Searches like the best in time, where rules leave less: as near to trouble as theirs, then in as much noise."""
    fit = _fit(found)
    if fit and request.ms_max is None and _is_beaten_by_a_lively_rule(judge, fit):
        best = min(fit, key=lambda one: one.score).wanted
        yield replace(best, ms_max=judge.textbook.ms if judge.textbook else None)
    fit = _fit(found)
    if fit and judge.allow_the_noise_of_rules(one.worth for one in fit):
        best = min(fit, key=lambda one: one.score).wanted
        yield replace(_in_time(request, judge, identified), structure=best.structure, ms_max=best.ms_max)


def _beside_noise_bound(wanted: TuningRequest, tuning: TuningResult) -> float:
    """The movement from noise of a design that is not handed out, beside its bound: a search knows it less well."""
    if wanted.noise_rms_max is None or tuning.achieved is None or not math.isfinite(tuning.achieved.noise_rms):
        return 0.0
    return tuning.achieved.noise_rms / wanted.noise_rms_max


def _is_beaten_by_a_lively_rule(judge: LoopJudge, fit: Sequence[_Promise]) -> bool:
    """Whether a rule leaves less after a load than all of them, and is nearer to trouble than they may be."""
    rule = judge.textbook
    return rule is not None and rule.ms > MS_MAX and rule.load < min(one.worth.load for one in fit)


def _hold_to_textbook(identified: IdentificationResult, request: TuningRequest, judge: LoopJudge) -> None:
    """Ask for less error after a load than rules leave on the learnt process, at no more movement than theirs."""
    if identified.best is None:
        return
    seen = as_held(judge.process, request.sample_time)
    for controller, slow in textbook_loops(seen, identified.best.crossover):
        judge.note_textbook(judge.worth(Loop(judge.process, controller, slow)))


def _in_time(request: TuningRequest, judge: LoopJudge, identified: IdentificationResult) -> TuningRequest:
    """A search for the least error after both steps, under what noise and limits allow.

    Of a process that runs away it begins with the gains that hold it: few others do.
    """
    held = identified.best is not None and identified.best.structure.runs_away
    return replace(
        _with_noise_bound(request, judge), method="time", index="iae", input="both",
        load_weight=LOAD_WEIGHTED * judge.load_scale, filter_order=FILTER_ORDER, two_degrees=True,
        ms_max=request.ms_max or MS_MAX, u_max=judge.control_peak, rate_max=judge.control_rate,
        phase_margin=None, crossover=None, t_max=None, s_max=None, rule=None, bounds=_box(identified, judge),
        fixed={**WHOLE_INTEGRAL, **request.fixed}, start=judge.running.gains if held else request.start,
    )  # fmt: skip


def _box(identified: IdentificationResult, judge: LoopJudge) -> dict[str, tuple[float, float]]:
    """Ranges of the gains where a steady-state gain that the record has not shown would give far too small ones."""
    best = identified.best
    if best is None or best.structure.runs_away:
        return {}
    w = best.crossover
    at_work = complex(best.process(1j * w))
    steady = best.process.steady_state_gain
    if abs(steady) < UNSEEN * abs(at_work):
        return {}
    sign, now = math.copysign(1.0, steady), abs(complex(judge.running.gains(1j * w)))
    gain = min(LARGEST / abs(at_work), LARGEST_STEP * now or math.inf)
    most = {"kp": gain, "ki": gain * w, "kd": gain / w}
    return {name: (min(0.0, sign * value), max(0.0, sign * value)) for name, value in most.items()}


def _with_noise_bound(request: TuningRequest, judge: LoopJudge) -> TuningRequest:
    """The request with the judge's bound on the noise gain: for white noise whose variance at the ticks is 1."""
    most = judge.noise_gain_aim * judge.whiter
    if math.isinf(most):
        return request
    horizon = request.horizon or _horizon(as_held(judge.process, request.sample_time), most)
    return replace(request, noise_density=request.sample_time, noise_rms_max=most, horizon=horizon)


def _horizon(process: Process, noise_gain_max: float) -> float:
    """The time [s] in which a loop settles whose controller has no more gain than a bound on the noise gain lets it.

    Its crossover is that of the bound itself, and where that does not reach 1, the process's own corner.
    """
    w = np.logspace(*_DECADES, _POINTS)
    gain = np.abs(process(1j * w))
    falls = (noise_gain_max * gain < 1.0) & (gain < abs(process.steady_state_gain) / math.sqrt(2.0))
    return settling_horizon(process, float(w[np.argmax(falls)]) if falls.any() else math.inf)
