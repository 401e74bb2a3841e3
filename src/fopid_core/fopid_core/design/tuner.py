"""The one door to every tuning method: a request in, a result out that was verified on the process itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

from fopid_core.design.sampled_loop import running
from fopid_core.design.specification import (
    Achieved,
    Bound,
    Bounds,
    Clock,
    Expired,
    Progress,
    Proposal,
    TuningRequest,
    TuningResult,
    no_progress,
)
from fopid_core.design.verification import achieved, checks
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights

__all__ = ["Achieved", "Bound", "TuningRequest", "TuningResult", "tune", "verify"]

WORSE, CALMER, TIGHTER = 1.1, ((1.0, False), (0.5, False), (0.5, True), (0.5, True)), ((1.0, True), (1.0, True))
"""A design whose Ms is so many times as large as it runs is told to be so; beyond so many times its bound another is
sought, and it is no success where there is none. In time, where it need not be stable as it runs, the other keeps its
bound on the sampled loop itself, and a tighter one then. Else it is sought behind half a tick, with so much of the
control's peak, then with a bound tighter by what running has added; of a process behind that hold already, only the
bound is tightened."""


def tune(request: TuningRequest, progress: Progress | None = None, clock: Clock = time.perf_counter) -> TuningResult:
    """Choose the five numbers and verify the loop.

    Parameters
    ----------
    request : TuningRequest
    progress : callable, optional
        Called with the share of the work done, 0 to 1, and what is being done.
    clock : callable
        Gives the time [s]; for ``elapsed`` and the timeout.

    Returns
    -------
    TuningResult
        ``success`` only when every specification is met and the loop with the process itself is stable for certain,
        and not known to be unstable as it runs, sampled and held.

    Raises
    ------
    InputError
        If the request contradicts itself or the process cannot be tuned by this method.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> result = tune(TuningRequest(read_process("P1"), phase_margin=1.2, crossover=0.5))
    >>> result.success, round(result.achieved.crossover, 6)
    (True, 0.5)
    """
    propose = _method(request.method)  # loads scipy the first time, which is no part of the work
    begun = clock()
    report = progress or no_progress
    deadline = begun + (math.inf if request.timeout is None else request.timeout)
    proposal = propose(request, report, lambda: clock() >= deadline)
    report(0.95, "verifying on the process itself")
    result = _verified(request, proposal)
    ms_max = proposal.bounds.ms_max
    result = _calmer_as_it_runs(request, proposal, result, propose, report, lambda: clock() >= deadline)
    if result.success and result.running and _is_nearer_as_it_runs(result, ms_max):
        asked = f"max |S| <= {ms_max:g} with ticks of {request.sample_time:g} s"
        result = replace(result, success=False, unmet=(*result.unmet, f"{asked}: {result.running.ms:.4g}"))
    report(1.0, "done")
    elapsed = clock() - begun
    if clock() >= deadline:
        late = f"stopped after {elapsed:.3g} s (timeout {request.timeout:g} s); {result.message}"
        return replace(result, success=False, message=late, elapsed=elapsed)
    return replace(result, elapsed=elapsed)


def verify(
    request: TuningRequest, controller: Fopid, slow: MeasurementFilter = NO_FILTER,
    weights: SetpointWeights = WHOLE_SETPOINT, said: str = "gains as they were said",
) -> TuningResult:  # fmt: skip
    """Gains that are known, with their filter and weights, as `tune` verifies what it has found; without bounds.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> verify(TuningRequest(read_process("P1")), Fopid(kp=1.0, ki=0.4)).success
    True
    """
    found = Proposal(controller, (), said, math.nan, 0, Bounds(), (), slow, weights)
    return _verified(request, found)


def _is_nearer_as_it_runs(result: TuningResult, ms_max: float) -> bool:
    """Whether a design is far beyond its bound on max |S| as it runs, sampled and held."""
    return result.running is not None and result.running.ms > WORSE * ms_max


def _is_to_be_calmer(result: TuningResult, ms_max: float) -> bool:
    """Whether another is sought for how a design runs: it is far beyond its bound then, or not stable."""
    if result.running is None:
        return False
    sought = result.method == "time" and result.running.stable is False
    return sought or (result.success and _is_nearer_as_it_runs(result, ms_max))


def _calmer_as_it_runs(
    request: TuningRequest,
    proposal: Proposal,
    result: TuningResult,
    propose: Method,
    report: Progress,
    expired: Expired,
) -> TuningResult:
    """The first result that keeps its bound on max |S| as it runs too, or the one that comes nearest to it."""
    bounds, ms_max = proposal.bounds, proposal.bounds.ms_max
    itself, behind, searched, sought = request.sampled or request.process, request, ms_max, [result]
    for rung, (calmer, is_tighter) in enumerate(TIGHTER if request.sampled else CALMER):
        if not _is_to_be_calmer(result, ms_max) or expired():
            break
        report(0.5, "once more, behind the hold of the control")
        told = ""
        if not rung and (request.method == "time" or not request.sampled):
            behind = _behind_the_hold(request, bounds)
        elif is_tighter or behind.as_it_runs:
            searched = _tightened(searched, ms_max, result, behind)
            behind, told = replace(behind, ms_max=searched), f"; for max |S| <= {ms_max:g} as it runs"
        if not behind.as_it_runs and calmer < 1.0 and math.isfinite(bounds.u_max):
            behind = replace(behind, u_max=calmer * bounds.u_max)
        found = propose(replace(behind, sampled=itself), report, expired)
        result = _verified(request, replace(found, message=f"{found.message}{told}", bounds=bounds))
        sought.append(result)
    return min(sought, key=_as_it_runs) if _is_to_be_calmer(result, ms_max) or not result.success else result


def _as_it_runs(result: TuningResult) -> float:
    """Its max |S| then; infinite where it is not stable, or not known."""
    runs = result.running is not None and result.running.stable
    return result.running.ms if result.running is not None and runs else math.inf


def _behind_the_hold(request: TuningRequest, bounds: Bounds) -> TuningRequest:
    """The request for the process as a controller sees it; in time with what was chosen for it without the hold."""
    behind = request
    if not request.sampled:
        process = request.process.delayed(0.5 * request.sample_time)
        behind = replace(request, process=process, sampled=request.process)
    if request.method != "time":
        return behind
    noise_max = bounds.noise_max if math.isfinite(bounds.noise_max) else request.noise_max
    return replace(behind, as_it_runs=True, horizon=bounds.horizon, u_max=bounds.u_max, noise_max=noise_max)


def _tightened(searched: float, ms_max: float, result: TuningResult, behind: TuningRequest) -> float:
    """The bound on max |S| to search with, for a design to keep to `ms_max` as it runs where it did not by `searched`.

    Where a delay turns the loop, max |S| is 1 / (1 - |L|), and running makes |L| larger by some factor.
    """
    assert result.running is not None
    assert result.achieved is not None
    has = searched if behind.as_it_runs else min(searched, result.achieved.ms)
    if result.running.stable is False or not has > 1.0:
        return 1.0 + 0.5 * (searched - 1.0)
    allowed, gain, ran = (1.0 - 1.0 / ms for ms in (has, ms_max, result.running.ms))
    return 1.0 / (1.0 - allowed * gain / ran)


Method = Callable[[TuningRequest, Progress, Expired], Proposal]


def _method(name: str) -> Method:
    if name == "frequency":
        from fopid_core.design.frequency.proposal import propose_frequency

        return propose_frequency
    if name == "time":
        from fopid_core.design.time.proposal import propose_time

        return propose_time
    from fopid_core.design.rules import propose_rule

    return propose_rule


def _verified(request: TuningRequest, proposal: Proposal) -> TuningResult:
    failed = TuningResult(
        success=False,
        message=proposal.message,
        method=request.method,
        controller=None,
        achieved=None,
        stable=False,
        unstable_poles=0,
        unmet=proposal.unmet,
        cost=proposal.cost,
        evaluations=proposal.evaluations,
        elapsed=0.0,
        at_edge=proposal.at_edge,
        filter=proposal.filter,
        weights=proposal.weights,
        structure=proposal.structure,
    )
    if proposal.controller is None:
        return failed
    loop = Loop(request.process, proposal.controller, proposal.filter, proposal.weights)
    verdict = stability(loop)
    found = replace(failed, stable=verdict.stable, unstable_poles=verdict.unstable_poles)
    if not verdict.stable:
        unmet = (*proposal.unmet, f"stability on the process itself: {verdict.reason}")
        return replace(found, unmet=unmet, message=f"{proposal.message}; no design is handed out")
    broken = [check for check in checks(loop, proposal.bounds) if not check.holds]
    named = [check for check in broken if not any(text.startswith(check.asked) for text in proposal.unmet)]
    unmet = (*proposal.unmet, *(str(check) for check in named))
    measured = achieved(loop, request.t_max, request.s_max, request.sample_time, request.noise_density or 0.0)
    as_it_runs = running(request.sampled or request.process, proposal.controller, request.sample_time, proposal.filter)
    message, every = proposal.message, f"as it runs, with ticks of {request.sample_time:g} s"
    if as_it_runs.stable is False:
        unmet = (*unmet, f"stability {every}: {as_it_runs.reason}")
    elif as_it_runs.ms > WORSE * measured.ms:
        message = f"{message}; {every}, its Ms is {as_it_runs.ms:.4g}"
    return replace(
        found, success=not unmet, message=message, controller=proposal.controller, achieved=measured, unmet=unmet,
        running=as_it_runs,
    )  # fmt: skip
