"""What designs promise on the learnt process itself: those worth verifying on all that its record leaves possible."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.loop_judge import LoopJudge, loop_of
from fopid_core.design.loop_worth import LoopWorth
from fopid_core.design.robust_verification import UNSEEN, as_held, first_request
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.design.textbook import NAMES as RULES
from fopid_core.design.textbook import textbook_loops
from fopid_core.design.time.proposal import quiet_crossover, settling_horizon
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.loop import Loop

LOAD_WEIGHTED = 10.0
"""Of the load in the search of a time-domain design, whose index is a sum, beside the setpoint's."""
MS_MAX = 1.8
"""Of the time-domain designs that are tried."""
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
LARGEST, LARGEST_STEP = 100.0, 10.0
"""Gains searched up to where the record does not show the process's slow end, in units of the process's gain about
where a controller would work, and of the gain that runs there: friction may hide that end, not so in larger moves."""


@dataclass(frozen=True)
class Promise:
    """A design on the learnt process itself, its score there, and why it is not worth verifying, if it is not."""

    score: float
    wanted: TuningRequest
    tuning: TuningResult
    worth: LoopWorth
    refusal: str


def name_of(wanted: TuningRequest) -> str:
    """Structure and method of a design, as a person calls them."""
    return wanted.rule or f"{(wanted.structure or 'fopid').upper()} {wanted.method}"


def promising_designs(
    identified: IdentificationResult, request: TuningRequest, judge: LoopJudge, tell: Callable[[str], object]
) -> list[Promise]:
    """What to verify, the best on the learnt process itself first."""
    found: list[Promise] = []

    def looked_at(wanted: TuningRequest) -> float:
        """Note what a request promises; how many times as far as allowed its control moves."""
        tell(f"{name_of(wanted)}, on the learnt process")
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
        found.append(Promise(judge.score(new, tuning.controller), wanted, tuning, new, refusal))
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


def _fit(found: Iterable[Promise]) -> list[Promise]:
    """Those that may be used."""
    return [one for one in found if not one.refusal]


def _further(
    found: Sequence[Promise], request: TuningRequest, judge: LoopJudge, identified: IdentificationResult
) -> Iterator[TuningRequest]:
    """Searches like the best in time, where rules leave less: as near to trouble as theirs, then in as much noise."""
    fit = _fit(found)
    if fit and request.ms_max is None and is_beaten_by_a_lively_rule(judge, fit):
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


def is_beaten_by_a_lively_rule(judge: LoopJudge, fit: Sequence[Promise]) -> bool:
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
        phase_margin=None, crossover=None, t_max=None, s_max=None, rule=None, bounds=box_of(identified, judge),
        fixed={**WHOLE_INTEGRAL, **request.fixed}, start=judge.running.gains if held else request.start,
    )  # fmt: skip


def box_of(identified: IdentificationResult, judge: LoopJudge) -> dict[str, tuple[float, float]]:
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
    held = as_held(judge.process, request.sample_time)
    horizon = request.horizon or settling_horizon(held, quiet_crossover(held, most))
    return replace(request, noise_density=request.sample_time, noise_rms_max=most, horizon=horizon)
