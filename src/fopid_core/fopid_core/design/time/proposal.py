"""From a tuning request to a time-domain design: defaults, bounds in words, what is not met."""

from __future__ import annotations

import math

from fopid_core.design import defaults
from fopid_core.design.specification import Bounds, Expired, Progress, Proposal, TuningRequest, require
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.problem import TimeSpecification
from fopid_core.design.time.tuning import tune_time
from fopid_core.model.process import Process

TURNS = 40.0
"""Default horizon, in radians of the natural crossover."""
MOST_TURNS = 10_000.0
"""Longest horizon, in radians of the natural crossover: a search on a longer one would not see the process."""
DELAYS = 12.0
"""Or in delays of the process, if that is longer."""


SETTLED = 0.02
"""Of the setpoint step: an error at the horizon that is worth a word."""
IDLE = 0.99
"""A larger one: the bounds leave nothing but controllers that hardly act, and that is no success."""


def propose_time(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """The controller with the best index for a request."""
    specification = _specification(request)
    solver = request.solver or "gauss-newton"
    design = tune_time(request.process, specification, request.start, solver, request.seed, progress, expired)
    message = f"{request.index} over {specification.horizon:.4g} s, {solver}; {_assumptions(request, specification)}"
    bounds = Bounds(
        ms_max=specification.ms_max,
        noise_max=specification.noise_max,
        u_max=specification.u_max,
        sample_time=specification.sample_time,
        horizon=specification.horizon,
    )
    if design is None:
        unstable = ("stability: none of the controllers drawn is stable; a stable start may help",)
        return Proposal(None, unstable, message, math.nan, 0, bounds)
    left = f"{design.final_error:.3g} is left at the horizon"
    if abs(design.final_error) > SETTLED:
        message += f"; the error does not die out: {left}"
    if design.at_edge:
        message += f"; on the edge of its range: {', '.join(design.at_edge)}"
    unmet = _hopeless(request.process, specification)
    if abs(design.final_error) > IDLE:
        unmet = (*unmet, f"a controller that acts: of the setpoint step {left}")
    return Proposal(design.controller, unmet, message, design.cost, design.evaluations, bounds, design.at_edge)


def _specification(request: TuningRequest) -> TimeSpecification:
    process = request.process
    held = process.steady_state_gain != 0.0
    require(held, "process", process, "for this method one with a steady-state gain, since no control holds a setpoint")
    horizon = request.horizon
    if horizon is None:
        horizon = max(TURNS / defaults.natural_crossover(process, defaults.PHASE_MARGIN), DELAYS * process.delay)
    require(horizon > process.delay, "horizon", f"{horizon:g} s", f"longer than the delay {process.delay:g} s")
    speed = defaults.natural_crossover(process, defaults.PHASE_MARGIN)
    longest = MOST_TURNS / speed
    require(horizon <= longest, "horizon", f"{horizon:g} s", f"up to {longest:.3g} s for so fast a process")
    return TimeSpecification(
        objective=Objective.of(request.index, request.weights),
        horizon=horizon,
        ms_max=defaults.MS_MAX if request.ms_max is None else request.ms_max,
        u_max=defaults.U_MAX / abs(defaults.process_gain(process)) if request.u_max is None else request.u_max,
        noise_max=math.inf if request.noise_max is None else request.noise_max,
        sample_time=request.sample_time,
        fixed=request.fixed,
        bounds=request.bounds,
    )


def _assumptions(request: TuningRequest, specification: TimeSpecification) -> str:
    """The bounds in force, and which of them nobody asked for."""
    parts = [f"max |S| <= {specification.ms_max:g}" + (" by default" if request.ms_max is None else "")]
    by_default = " by default" if request.u_max is None else ""
    parts.append(f"control peak <= {specification.u_max:.4g} at {specification.sample_time:g} s ticks{by_default}")
    if math.isfinite(specification.noise_max):
        parts.append(f"noise gain <= {specification.noise_max:g}")
    if request.horizon is None:
        parts.append("horizon chosen from the process")
    return ", ".join(parts)


def _hopeless(process: Process, specification: TimeSpecification) -> tuple[str, ...]:
    """Bounds that no controller keeps."""
    at_rest = abs(1.0 / process.steady_state_gain) if process.steady_state_gain else math.inf
    if at_rest <= specification.u_max:
        return ()
    return (f"control peak <= {specification.u_max:g}: holding the setpoint alone takes {at_rest:.4g}",)
