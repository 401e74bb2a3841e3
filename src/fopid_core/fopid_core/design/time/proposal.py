"""From a tuning request to a time-domain design: defaults, bounds in words, what is not met."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fopid_core.design import defaults
from fopid_core.design.load_tail import LEFT_MAX, TURNS, fading_time, left_in_words, slowest_crossover
from fopid_core.design.specification import (
    STRUCTURES,
    Bounds,
    Expired,
    Progress,
    Proposal,
    TuningRequest,
    no_progress,
    require,
)
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.preference import preferred
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import TimeDesign, tune_time
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process

MOST_TURNS = 10_000.0
"""Longest horizon, in radians of the natural crossover: a search on a longer one would not see the process."""
DELAYS = 12.0
"""Or in delays of the process, if that is longer."""

_POINTS, _DECADES = 600, (-7.0, 7.0)
_INPUT_WORDS = {"setpoint": "setpoint step", "load": "load step", "both": "setpoint and the load step"}

SETTLED = 0.02
"""Of the setpoint step: an error at the horizon that is worth a word."""
IDLE = 0.99
"""A larger one: the bounds leave nothing but controllers that hardly act, and that is no success."""
FILTERED = 2
"""Order of the filter that is tried where nothing else keeps the bounds."""
SLACK, _FAR = 0.01, 0.01
"""Nor is one that acts so little at rest, beside what it does at the crossover: a load takes the process anywhere."""


def propose_time(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """The controller with the best index for a request.

    Where none keeps the bounds without a filter of the measurement, or holds a load, and nobody has said how, one with
    a filter is sought, for which a load's step counts as well.
    """
    found, is_met = _proposed(request, progress, expired)
    is_said = request.filter_order is not None or {*request.fixed, *request.bounds} or request.structure
    objective = Objective.of(request.index, request.weights)
    if is_met or is_said or not objective.is_integral or objective.needs_control or expired():
        return found
    for source in dict.fromkeys((request.input, "both")):
        other, is_met = _proposed(replace(request, filter_order=FILTERED, input=source), progress, expired)
        if is_met:
            why = f"behind a filter of order {FILTERED} (--filter-order), without which no design keeps the bounds"
            return replace(other, message=f"{other.message}; {why}")
    return found


def _proposed(request: TuningRequest, progress: Progress, expired: Expired) -> tuple[Proposal, bool]:
    """The best as a request says, and whether it is to be had."""
    specification = time_specification(request)
    solver = request.solver or "gauss-newton"

    def search(wanted: TimeSpecification, tell: Progress = no_progress) -> TimeDesign | None:
        return tune_time(request.process, wanted, request.start, solver, request.seed, tell, expired)

    design = search(specification, progress)
    if not (design and design.met) and math.isfinite(specification.load_left_max):  # kept where possible
        specification = replace(specification, load_left_max=math.inf)
        design = search(specification, progress)
    what = f"{request.index} of the {_INPUT_WORDS[request.input]} over {specification.horizon:.4g} s"
    message = f"{what}, {solver}; {_assumptions(request, specification)}"
    bounds = bounds_of(specification)
    if design is None:
        unstable = ("stability: none of the controllers drawn is stable; a stable start may help",)
        return Proposal(None, unstable, message, math.nan, 0, bounds), False
    structure = request.structure or ""
    if not structure and solver == "gauss-newton" and not expired():
        progress(0.9, "looking at simpler controllers")
        chosen = preferred(specification, design, defaults.process_gain(request.process), search)
        design, structure = chosen.design, chosen.structure
        message += f"; {chosen.words}" if chosen.words else ""
    slowest = slowest_crossover(request.process, specification.horizon, specification.u_max)
    message += left_in_words(request.process, design.controller, slowest)
    left = f"{design.final_error:.3g} is left at the horizon"
    if abs(design.final_error) > SETTLED:
        message += f"; the error does not die out: {left}"
    if design.at_edge:
        message += f"; on the edge of its range: {', '.join(design.at_edge)}"
    unmet = _hopeless(request.process, specification)
    if abs(design.final_error) > IDLE:
        unmet = (*unmet, f"a controller that acts: of the step {left}")
    if not {"kp", "ki"} <= {*specification.fixed} and _slack(request.process, design.controller, specification.horizon):
        unmet = (*unmet, "a controller that holds a load: it hardly acts at rest; input both counts a load's step too")
    found = Proposal(
        design.controller, unmet, message, design.cost, design.evaluations, bounds, design.at_edge, design.filter,
        design.weights, structure,
    )  # fmt: skip
    return found, design.met and not unmet


def bounds_of(specification: TimeSpecification) -> Bounds:
    """What a design must keep."""
    names = ("ms_max", "mt_max", "noise_max", "u_max", "sample_time", "horizon", "rate_max", "noise_density",
             "noise_rms_max")  # fmt: skip
    return Bounds(**{name: getattr(specification, name) for name in names})


def time_specification(request: TuningRequest) -> TimeSpecification:
    """What a request asks, and what is chosen where it asks nothing.

    Raises
    ------
    InputError
        Naming what this method cannot do for the process.
    """
    process = request.process
    held = process.steady_state_gain != 0.0
    require(held, "process", process, "for this method one with a steady-state gain, since no control holds a setpoint")
    fastest = _fastest(request)
    horizon = settling_horizon(process, fastest) if request.horizon is None else request.horizon
    require(horizon > process.delay, "horizon", f"{horizon:g} s", f"longer than the delay {process.delay:g} s")
    longest = MOST_TURNS / defaults.natural_crossover(process, defaults.PHASE_MARGIN)
    require(horizon <= longest, "horizon", f"{horizon:g} s", f"up to {longest:.3g} s for so fast a process")
    objective = Objective.of(request.index, request.weights)
    by_setpoint = objective.is_integral and not objective.needs_control
    require(by_setpoint or request.input == "setpoint", "input", request.input, f"setpoint with {request.index}")
    usual = defaults.U_MAX * max(1.0 / abs(defaults.process_gain(process)), 1.0 / abs(process.steady_state_gain))
    order = request.filter_order or 0
    free = order > 0 or request.input != "setpoint"
    return TimeSpecification(
        objective=objective,
        horizon=horizon,
        ms_max=defaults.MS_MAX if request.ms_max is None else request.ms_max,
        u_max=usual if request.u_max is None else request.u_max,
        noise_max=_noise_max(request, usual, free if request.two_degrees is None else request.two_degrees),
        sample_time=request.sample_time,
        fixed=_fixed(request),
        bounds=request.bounds,
        mt_max=_or_none(request.mt_max),
        input=request.input,  # type: ignore[arg-type]
        load_weight=request.load_weight,
        filter_order=order,
        two_degrees=free if request.two_degrees is None else request.two_degrees,
        noise_density=request.noise_density or 0.0,
        noise_rms_max=_or_none(request.noise_rms_max),
        rate_max=_or_none(request.rate_max),
        load_left_max=_load_left_max(request),
        sampled=request.sampled if request.as_it_runs else None,
        fastest=fastest,
    )


def settling_horizon(process: Process, crossover: float = math.inf) -> float:
    """The time [s] in which a loop with the natural crossover, or a lower one, settles; no longer than can be searched.

    Examples
    --------
    >>> process = Process.parse("1/(s+1)^3")
    >>> round(settling_horizon(process, 0.1) * 0.1), settling_horizon(process, 9.0) == settling_horizon(process)
    (40, True)
    """
    natural = defaults.natural_crossover(process, defaults.PHASE_MARGIN)
    settled = max(TURNS / min(crossover, natural), DELAYS * process.delay)
    return min(settled, MOST_TURNS / natural)


def quiet_crossover(process: Process, noise_gain_max: float) -> float:
    """The crossover [rad/s] of a loop whose controller has no more gain than a bound on the noise gain lets it.

    It is that of the bound itself, and where that does not reach 1, the process's own corner; infinite where the
    process never falls below it.

    Examples
    --------
    >>> round(quiet_crossover(Process.parse("1/(s+1)"), 5.0))  # sqrt(24)
    5
    """
    w = np.logspace(*_DECADES, _POINTS)
    gain = np.abs(process(1j * w))
    falls = (noise_gain_max * gain < 1.0) & (gain < abs(process.steady_state_gain) / math.sqrt(2.0))
    return float(w[np.argmax(falls)]) if falls.any() else math.inf


def _fastest(request: TuningRequest) -> float:
    """About the crossover that the bound on the control from noise allows, where no horizon says what matters."""
    if request.horizon is not None or not (request.noise_rms_max and request.noise_density):
        return math.inf
    level = math.sqrt(request.noise_density / request.sample_time)
    return quiet_crossover(request.process, request.noise_rms_max / level)


def _noise_max(request: TuningRequest, usual: float, two_degrees: bool) -> float:
    """A filter whose time is to be chosen needs a bound that asks for it; without the setpoint's kick the gain does."""
    needed = ((request.filter_order or 0) > 0 or two_degrees) and request.noise_rms_max is None
    return (usual if needed else math.inf) if request.noise_max is None else request.noise_max


def _load_left_max(request: TuningRequest) -> float:
    """Whoever names the integral, or does without, has chosen how a load fades."""
    named = {*request.fixed, *request.bounds}
    chosen = "lam" in named or "ki" in {*named, *STRUCTURES[request.structure or "fopid"]}
    return math.inf if chosen else LEFT_MAX


def _fixed(request: TuningRequest) -> Mapping[str, float]:
    """The numbers that keep a value, by name or by structure."""
    of_structure = STRUCTURES[request.structure or "fopid"]
    for name, value in of_structure.items():
        other = request.fixed.get(name, value)
        require(other == value, f"fixed {name}", other, f"{value:g}, as structure {request.structure} says")
    return {**of_structure, **request.fixed}


def _or_none(bound: float | None) -> float:
    return math.inf if bound is None else bound


def _assumptions(request: TuningRequest, specification: TimeSpecification) -> str:
    """The bounds in force, and which of them nobody asked for."""
    parts = [f"max |S| <= {specification.ms_max:g}" + (" by default" if request.ms_max is None else "")]
    by_default = " by default" if request.u_max is None else ""
    parts.append(f"control peak <= {specification.u_max:.4g} at {specification.sample_time:g} s ticks{by_default}")
    if math.isfinite(specification.mt_max):
        parts.append(f"max |T| <= {specification.mt_max:g}")
    if math.isfinite(specification.noise_max):
        by_default = " by default" if request.noise_max is None else ""
        parts.append(f"noise gain <= {specification.noise_max:.4g}{by_default}")
    if specification.bounds_noise_rms:
        parts.append(f"control from noise <= {specification.noise_rms_max:g}")
    if math.isfinite(specification.rate_max):
        parts.append(f"control rate <= {specification.rate_max:g}/s")
    if math.isfinite(specification.load_left_max):
        slowest = slowest_crossover(request.process, specification.horizon, specification.u_max)
        fading = fading_time(request.process, slowest)
        parts.append(f"at most {specification.load_left_max:.0%} of a load left after {fading:.3g} s")
    if request.horizon is None:
        parts.append("horizon chosen from the process")
    return ", ".join(parts)


def _slack(process: Process, controller: Fopid, horizon: float) -> bool:
    """Whether a controller hardly acts at rest: a setpoint asks no more where an integrator runs away."""
    crossover = defaults.natural_crossover(process, defaults.PHASE_MARGIN)
    at_rest, there = np.abs(controller(1j * np.array([_FAR / horizon, crossover])))
    return bool(at_rest < SLACK * there)


def _hopeless(process: Process, specification: TimeSpecification) -> tuple[str, ...]:
    """Bounds that no controller keeps."""
    at_rest = abs(1.0 / process.steady_state_gain) if process.steady_state_gain else math.inf
    if at_rest <= specification.u_max:
        return ()
    return (f"control peak <= {specification.u_max:g}: holding the setpoint alone takes {at_rest:.4g}",)
