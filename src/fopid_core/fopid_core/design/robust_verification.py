"""Tuning on a learnt process: verified on all that the record leaves possible, and more cautious where that fails."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from fopid_core.design.defaults import MS_MAX, PHASE_MARGIN, U_MAX, natural_crossover
from fopid_core.design.identification.identified_model import MOST_DEVIATION, IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.identification.refusal import LEAST_FIT
from fopid_core.design.sampled_loop import running as loop_as_it_runs
from fopid_core.design.specification import NUMBERS, Clock, TuningRequest, TuningResult, require
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.stability import process_stability, stability
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter

PLAUSIBLE = 1.5
"""Other templates count as possible while their held-back error is at most so many times the best one's, and their
residual is as white."""
NOISY, ALIKE = 90.0, 1.1
"""Below this fit [%] noise is so much of the record that the error of a wrong model is hardly larger: others count then
while theirs is at most so many times the best one's."""
DETUNING = (0.7, 0.5, 0.35, 0.2)
"""Shares of the first crossover that are tried in turn, or of what max |S| of the first design has above 1."""
UNSEEN = 10.0
"""A steady-state gain that is so many times the gain at the crossover is that of a process that integrates."""
FASTEST = 0.2
"""Largest crossover of a controller over its sample time [rad]."""


@dataclass(frozen=True)
class RobustLimits:
    """What must hold on every process that the record leaves possible.

    Attributes
    ----------
    ms_max : float
        Bound on max |S|.
    phase_margin_min : float
        [rad]
    samples : int
        How many processes are drawn from the covariance.
    seed : int
        Of the draw.
    """

    ms_max: float = 2.2
    phase_margin_min: float = math.radians(30.0)
    samples: int = 50
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.ms_max > 1.0, "ms_max", self.ms_max, "above 1")
        require(0 <= self.phase_margin_min < math.pi, "phase_margin_min", self.phase_margin_min, "0 to pi rad")
        require(self.samples >= 1, "samples", self.samples, "1 or more")


@dataclass(frozen=True)
class Robustness:
    """What a controller does on many processes.

    Attributes
    ----------
    met : bool
        Whether all are stable and within the limits.
    stable : int
        On how many of them the loop is stable.
    count : int
    ms, phase_margin : float
        The worst of the stable ones; [rad].
    worst : Process
        An unstable one, or else that with the largest max |S|.
    """

    met: bool
    stable: int
    count: int
    ms: float
    phase_margin: float
    worst: Process

    def __str__(self) -> str:
        if self.stable < self.count:
            return f"unstable on {self.count - self.stable} of {self.count} possible processes, such as {self.worst}"
        worst = f"worst max |S| {self.ms:.3g}, phase margin {math.degrees(self.phase_margin):.3g} deg"
        return f"stable on all {self.count} possible processes, {worst}"


@dataclass(frozen=True)
class RobustTuning:
    """The outcome of a tuning on a learnt process.

    Attributes
    ----------
    success : bool
        A design was found that is within the limits on every possible process.
    message : str
        One line: what was found and verified, or why nothing is handed out.
    tuning : TuningResult or None
        The last design that was tried; to be applied only with ``success``.
    robustness : Robustness or None
        Of that design.
    attempts : int
    elapsed : float
        [s]
    """

    success: bool
    message: str
    tuning: TuningResult | None
    robustness: Robustness | None
    attempts: int
    elapsed: float


def robustness(
    controller: Fopid, processes: Sequence[Process], limits: RobustLimits, slow: MeasurementFilter = NO_FILTER
) -> Robustness:
    """What a controller, with a filter of the measurement, does on many processes.

    Examples
    --------
    >>> pair = [Process.parse("1/(s+1)^3"), Process.parse("4/(s+1)^3")]
    >>> str(robustness(Fopid(kp=1.0), pair[:1], RobustLimits()))
    'stable on all 1 possible processes, worst max |S| 1.29, phase margin inf deg'
    >>> robustness(Fopid(kp=2.5), pair, RobustLimits()).stable
    1
    """
    loops = [Loop(process, controller, slow) for process in processes]
    unstable = [loop.process for loop in loops if not stability(loop).stable]
    found = [margins(loop) for loop in loops if loop.process not in unstable]
    ms = [margin.ms for margin in found]
    phase_margin = min((abs(margin.phase_margin) for margin in found), default=0.0)
    # One by one: the largest and the smallest of numbers pass over one that is not known (NaN).
    within = all(m.ms <= limits.ms_max and abs(m.phase_margin) >= limits.phase_margin_min for m in found)
    largest = max(ms, key=lambda value: math.inf if math.isnan(value) else value, default=math.inf)
    steady = [loop.process for loop in loops if loop.process not in unstable]
    worst = unstable[0] if unstable else steady[ms.index(largest)]
    return Robustness(bool(found) and not unstable and within, len(found), len(loops), largest, phase_margin, worst)


def plausible_processes(identified: IdentificationResult, limits: RobustLimits, hold: float) -> tuple[Process, ...]:
    """The best model, draws from its covariance, and the models of other templates that explain about as much.

    Each as a controller sees it that holds its signal for ``hold`` [s]: behind two quick lags, together half as long.
    """
    best = identified.best
    if best is None:
        raise InputError("identification without a model; allowed: one that succeeded")
    drawn = best.sample(limits.samples, limits.seed)
    return behind_hold((best.process, *drawn, *_of_other_templates(identified.models, best)), hold)


def _of_other_templates(models: Sequence[IdentifiedModel], best: IdentifiedModel) -> list[Process]:
    """Those that explain about as much as the best."""
    return [
        model.process
        for model in models
        if _explains_as_much(model, best)
        and model.deviation <= MOST_DEVIATION
        and model.structure.runs_away == best.structure.runs_away
        and (model.structure.runs_away or process_stability(model.process).stable)
    ]


def _explains_as_much(model: IdentifiedModel, best: IdentifiedModel) -> bool:
    if model.wanders and best.wanders:  # only what is about as likely is kept
        return True
    left, least = 100.0 - model.fit_pct, 100.0 - best.fit_pct
    as_white = model.whiteness.white or not best.whiteness.white
    if model.fit_pct >= LEAST_FIT and left <= PLAUSIBLE * least and as_white:
        return True
    # where noise has memory, only that of the best was made white
    return best.fit_pct < NOISY and left <= ALIKE * least and (as_white or best.in_coloured_noise)


def behind_hold(processes: Sequence[Process], hold: float) -> tuple[Process, ...]:
    """Each behind two quick lags, together half as long as a control is held [s]."""
    lag = QuasiPolynomial.polynomial([0.25 * hold, 1.0])
    held = Process(QuasiPolynomial.constant(1.0), lag**2)
    return tuple(process * held for process in processes)


def as_held(process: Process, hold: float) -> Process:
    """The process behind the delay, half as long, of a control that is held for ``hold`` [s].

    No design in continuous time is to act on what happens within a tick, such as a learnt delay of a millionth of it.

    References
    ----------
    Skogestad, J. Process Control 13 (2003) 291-309, section 2: half the sample time counts as delay.

    Examples
    --------
    >>> as_held(Process.parse("1/(s+1)"), 0.1).delay
    0.05
    """
    return process.delayed(0.5 * hold)


def tune_robustly(
    identified: IdentificationResult,
    request: TuningRequest | None = None,
    limits: RobustLimits | None = None,
    clock: Clock = time.perf_counter,
    first: TuningResult | None = None,
    refuse: Callable[[TuningResult], str] = lambda _: "",
    running: tuple[Fopid, MeasurementFilter] | None = None,
) -> RobustTuning:
    """A design on a learnt process that holds on all that the record leaves possible, or a refusal.

    Parameters
    ----------
    identified : IdentificationResult
    request : TuningRequest, optional
        What is asked for; its process gives way to the learnt one, for other methods than ``frequency`` as the
        controller sees it (`as_held`). By default a phase margin of 60 degrees, the crossover chosen from the process.
    limits : RobustLimits, optional
    clock : callable
        Gives the time [s].
    first : TuningResult, optional
        What `first_request` comes to, where that is known.
    refuse : callable
        Why a design may not be handed out, or nothing; a more cautious one is tried then, as for the limits.
    running : Fopid and MeasurementFilter, optional
        That are known to hold the loop; what they would not hold is not the process.
    """
    begun = clock()
    if not identified.success or identified.best is None:
        return RobustTuning(False, identified.message, None, None, 0, clock() - begun)
    limits = limits or RobustLimits()
    wished = first_request(identified, request or TuningRequest(identified.best.process))
    possible = plausible_processes(identified, limits, wished.sample_time)
    processes = _held(possible, running)
    best = identified.best.process
    templates = _held((best, *_of_other_templates(identified.models, identified.best)), running)
    others = [process for process in templates if process is not best]
    left_out = len(possible) - len(processes)
    but = f" ({left_out} that the gains that run would not hold left out)" if left_out else ""
    waiting, attempts, failed, held = [wished], 0, wished, None
    tuning, judged, reason = None, None, ""
    while waiting:
        careful = waiting.pop(0)
        tuning = first if first is not None and attempts == 0 else tune(careful)
        attempts += 1
        if attempts == 1:
            waiting = _detuned(careful, tuning, identified.best.crossover)
        if tuning.success and tuning.controller is not None:
            reason = refuse(tuning)
            if not reason:
                judged = robustness(tuning.controller, processes, limits, tuning.filter)
                reason = _rings_as_it_runs(tuning, others, careful.sample_time, limits) if judged.met else ""
                if judged.met and not reason:
                    waiting = _between(failed, careful) if held is None and attempts > 1 else []
                    message = f"{tuning.message}; {judged}{but}"
                    held = RobustTuning(True, message, tuning, judged, attempts, clock() - begun)
                    continue
        failed = careful
    if held is not None:
        return replace(held, attempts=attempts, elapsed=clock() - begun)
    message = reason or _refusal(tuning, judged, attempts, limits)
    return RobustTuning(False, message, tuning, judged, attempts, clock() - begun)


def _held(processes: Sequence[Process], running: tuple[Fopid, MeasurementFilter] | None) -> Sequence[Process]:
    """Without those that gains which hold the loop would not hold, for certain; all, where the first is one of these.

    A record without the slow end leaves steady-state gains of the other sign possible, which no integral action holds.
    """
    if running is None:
        return processes
    verdicts = [stability(Loop(process, *running)) for process in processes]
    held = [process for process, it in zip(processes, verdicts, strict=True) if it.stable or not it.decided]
    return held if held and held[0] is processes[0] else processes


def _between(failed: TuningRequest, held: TuningRequest) -> list[TuningRequest]:
    """A time-domain design halfway from the last that failed to the first that holds: shares of max |S| are coarse."""
    if held.method != "time" or failed.ms_max is None or held.ms_max is None:
        return []
    return [replace(held, ms_max=0.5 * (failed.ms_max + held.ms_max))]


def _rings_as_it_runs(tuning: TuningResult, others: Sequence[Process], sample_time: float, limits: RobustLimits) -> str:
    """Why the sampled, held loop is not to be had, which a design in continuous time does not know; or nothing.

    Nor with the process of another template, which may fall less beyond what a record shows. A loop that is not known
    to be stable there is not to be had either.
    """
    if tuning.running is None or tuning.controller is None:
        return ""
    each = [tuning.running]
    each += [
        loop_as_it_runs(other, tuning.controller, sample_time, tuning.filter, with_margins=False) for other in others
    ]
    unknown = next((loop.reason for loop in each[1:] if loop.stable is None), "")
    if any(loop.stable is False for loop in each):
        told = "it is unstable"
    elif unknown:
        told = f"on a model that explains about as much its stability is {unknown}"
    elif (worst := max((loop.ms for loop in each if not math.isnan(loop.ms)), default=0.0)) > limits.ms_max:
        told = f"its Ms is {worst:.3g}"
    else:
        return ""
    runs = f"as it runs, with ticks of {sample_time:g} s, {told}"
    return f"{runs}; allowed: {limits.ms_max:g} at most; a shorter sample time helps"


def first_request(identified: IdentificationResult, request: TuningRequest) -> TuningRequest:
    """A request for the learnt process, as `tune_robustly` tries it first.

    Raises
    ------
    InputError
        If nothing was learnt.
    """
    if identified.best is None:
        raise InputError("identification without a model; allowed: one that succeeded")
    learnt = identified.best.process
    # A crossover is kept below what the sample time allows; times and rules know that limit by the delay of the hold.
    seen = learnt if request.method == "frequency" else as_held(learnt, request.sample_time)
    return _within_reach(replace(request, process=seen, sampled=learnt), identified.best)


def _within_reach(request: TuningRequest, best: IdentifiedModel) -> TuningRequest:
    """The request, no faster than the sample time allows and the process is known."""
    request = _bounded(request, best)
    if request.method != "frequency":
        return request
    fastest = min(best.crossover, FASTEST / request.sample_time)
    if request.crossover is None:
        natural = natural_crossover(best.process, request.phase_margin or PHASE_MARGIN)
        return request if natural <= fastest else replace(request, crossover=fastest)
    return replace(request, crossover=min(request.crossover, FASTEST / request.sample_time))


def _bounded(request: TuningRequest, best: IdentifiedModel) -> TuningRequest:
    """With bounds on the control that do not rest on a steady-state gain which the record has not shown."""
    at_work = abs(complex(best.process(1j * best.crossover)))
    if abs(best.process.steady_state_gain) < UNSEEN * at_work:
        return request
    most = U_MAX / at_work
    unbounded = request.method == "time" and request.noise_max is None and request.noise_rms_max is None
    return replace(
        request,
        u_max=most if request.u_max is None else request.u_max,
        noise_max=most if unbounded else request.noise_max,
    )


def _detuned(request: TuningRequest, first: TuningResult, crossover: float) -> list[TuningRequest]:
    """The request with less crossover than the first design, or a tighter bound on max |S|; none where all is said."""
    if {*NUMBERS} <= {*request.fixed}:
        return []
    if request.method == "frequency":
        from_here = request.crossover or (first.achieved.crossover if first.achieved else crossover)
        margin = request.phase_margin or PHASE_MARGIN
        return [replace(request, phase_margin=margin, crossover=share * from_here) for share in DETUNING]
    if request.method == "time":
        most = request.ms_max or MS_MAX
        room = (min(most, first.achieved.ms) if first.achieved else most) - 1.0
        return [replace(request, ms_max=1.0 + share * room) for share in DETUNING]
    return []


def _refusal(tuning: TuningResult | None, judged: Robustness | None, attempts: int, limits: RobustLimits) -> str:
    if judged is None:
        why = "; ".join((*tuning.unmet, tuning.message)) if tuning else ""
        return f"no design in {attempts} attempts: {why}"
    asked = f"max |S| <= {limits.ms_max:g} and phase margin >= {math.degrees(limits.phase_margin_min):.3g} deg"
    return (
        f"no design in {attempts} attempts keeps {asked} on every process that the record leaves possible: {judged}; "
        "record longer or with larger moves of the control"
    )
