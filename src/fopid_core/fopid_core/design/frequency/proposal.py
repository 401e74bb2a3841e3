"""From a tuning request to a frequency-domain design: defaults, the way via a reduced model, what is not met."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from fopid_core.design import defaults
from fopid_core.design.frequency.equation_solvers import optimise_constrained, solve_equations
from fopid_core.design.frequency.margin_alone import with_margin_alone
from fopid_core.design.frequency.tuning import FrequencyDesign, tune_frequency
from fopid_core.design.load_tail import LEFT_MAX, left_in_words
from fopid_core.design.reduction import reduce
from fopid_core.design.specification import (
    Bound,
    Bounds,
    Expired,
    FrequencySpecification,
    Progress,
    Proposal,
    TuningRequest,
)
from fopid_core.model.fopid import ORDER_RANGE, Fopid
from fopid_core.model.process import Process

BEST = {"peaks": "smallest peaks of |S| and |T|", "ms": "smallest ms", "flatness": "widest flat phase"}
SHARES = (1.0, 0.8, 0.64, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the natural crossover that are tried in turn when none is asked for."""
OTHER_MARGINS = tuple(sign * step for step in (1, 3, 6, 10, 15, 20, 30, 40, 50) for sign in (-1, 1))
"""Changes of the phase margin [deg] that are tried, nearest first, when there is no design for it."""
ROBUST = 2.0
"""Where something was left open, it is chosen so that neither |S| nor |T| is larger than this, if it can be."""
LOW_FREQUENCY_DB, LOW_FREQUENCY = -26.0, 1.0 / 30.0
"""A bound on |S|, at this share of the crossover, that is kept where possible when none is asked for: without it the
smallest ms is that of an integral so weak that the error takes very long to die out."""


def propose_frequency(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """The best design for a request, on the process itself or via a reduced model."""
    process, remark = _model(request, progress)
    phase_margin = request.phase_margin or defaults.PHASE_MARGIN
    crossover = request.crossover or defaults.natural_crossover(process, phase_margin)
    wished = FrequencySpecification(
        phase_margin, crossover, request.t_max, request.s_max, request.criterion,
        request.u_max or math.inf, request.sample_time,
    )  # fmt: skip
    bounds = Bounds(
        t_max=request.t_max, s_max=request.s_max, u_max=request.u_max or math.inf, sample_time=request.sample_time
    )
    progress(0.3, "searching the plane of orders")
    if request.solver in ("paper", "monje"):
        solve = solve_equations if request.solver == "paper" else optimise_constrained
        found = solve(process, wished)
        return Proposal(found.controller, found.unmet, remark + request.solver, math.nan, found.evaluations, bounds)
    specification, design = _first_met(process, request, wished, expired)
    message = remark + _chosen(request, specification)
    if design.controller is None:
        return _without_design(process, specification, message, design.evaluations)
    message += f"{BEST[specification.criterion]} of all designs that meet it" if design.met else "nearest to the bounds"
    message += left_in_words(request.process, design.controller, specification.crossover)
    cost = design.ms if specification.criterion == "ms" else max(design.ms, design.mt)
    return Proposal(
        design.controller,
        _unmet(specification, design),
        message,
        cost,
        design.evaluations,
        bounds,
        _at_edge(design.controller),
    )


def _model(request: TuningRequest, progress: Progress) -> tuple[Process, str]:
    if request.via == "none":
        return request.process, ""
    progress(0.05, f"reducing to {request.via}")
    reduced = reduce(request.process, request.via)
    return reduced.process, f"designed on {reduced.process} ({request.via}, H2 error {reduced.h2_error:.3g}); "


def _first_met(
    process: Process, request: TuningRequest, wished: FrequencySpecification, expired: Expired
) -> tuple[FrequencySpecification, FrequencyDesign]:
    """What was left open is chosen so that there is a robust design; without one, the design for the wish as it is."""
    plain = tune_frequency(process, wished) if _is_complete(request) else None
    if plain is not None and not plain.met:
        return wished, plain  # the default bounds below would only make it harder
    met = None
    for specification in _choices(process, request, wished):
        design = tune_frequency(process, specification)
        if design.met and max(design.ms, design.mt) <= ROBUST:
            return specification, design
        met = met or ((specification, design) if design.met else None)
        if expired():
            break
    return met or (wished, plain or tune_frequency(process, wished))


def _is_complete(request: TuningRequest) -> bool:
    """Whether nothing is left open and there are bounds that may be out of reach."""
    given = request.phase_margin is not None and request.crossover is not None
    return given and (request.t_max is not None or request.s_max is not None)


def _choices(
    process: Process, request: TuningRequest, wished: FrequencySpecification
) -> Iterator[FrequencySpecification]:
    """Specifications to be tried: at every crossover first with the default bounds, then with other margins."""
    turns = (0, *OTHER_MARGINS) if request.phase_margin is None else (0,)
    for turn in turns:
        margin = wished.phase_margin + math.radians(turn)
        if 0.0 < margin < math.pi:
            asked = [
                replace(wished, phase_margin=margin, crossover=w * wished.crossover) for w in _shares(request, turn)
            ]
            modest = [_modest(process, request, specification) for specification in asked]
            fair = [_fair(request, specification) for specification in modest]
            practical = [replace(each, practical=True) for each in fair]
            yield from dict.fromkeys([*practical, *fair, *modest, *asked])  # each once


def _fair(request: TuningRequest, specification: FrequencySpecification) -> FrequencySpecification:
    """With the bounds on a load's tail and on |S| at low frequencies that are kept where possible if not asked for."""
    fair = replace(specification, load_left_max=LEFT_MAX)
    if request.s_max is not None:
        return fair
    return replace(fair, s_max=Bound(LOW_FREQUENCY_DB, LOW_FREQUENCY * specification.crossover))


def _modest(process: Process, request: TuningRequest, specification: FrequencySpecification) -> FrequencySpecification:
    """With the bound on the control that is kept where possible when none is asked for, as in time-domain tuning."""
    if request.u_max is not None:
        return specification
    return replace(specification, u_max=defaults.U_MAX / abs(defaults.process_gain(process)))


def _shares(request: TuningRequest, turn: int) -> tuple[float, ...]:
    if request.crossover is not None:
        return (1.0,)
    return SHARES if turn == 0 else SHARES[::3]


def _chosen(request: TuningRequest, specification: FrequencySpecification) -> str:
    """What nobody asked for."""
    text = ""
    if request.crossover is None:
        text += f"crossover {specification.crossover:.4g} rad/s chosen from the process; "
    if request.phase_margin is None:
        text += f"phase margin {math.degrees(specification.phase_margin):g} deg by default; "
    if request.s_max is None and specification.s_max is not None:
        text += f"|S| <= {specification.s_max} by default; "
    if request.u_max is None and math.isfinite(specification.u_max):
        text += f"control peak <= {specification.u_max:.4g} at {specification.sample_time:g} s ticks by default; "
    return text


def _without_design(
    process: Process, specification: FrequencySpecification, message: str, evaluations: int
) -> Proposal:
    asked = (
        f"phase margin {math.degrees(specification.phase_margin):.4g} deg with a flat phase at the only crossover "
        f"{specification.crossover:.4g} rad/s"
    )
    if math.isfinite(specification.u_max):
        asked += f" and control peak <= {specification.u_max:g}"
    message += "no stable design with gains of one sign"
    if process.relative_degree <= 0.0:
        message += "; its gain does not fall at high frequencies, so any derivative leaves no margin for a delay"
    for turn in OTHER_MARGINS:
        margin = specification.phase_margin + math.radians(turn)
        if 0.0 < margin < math.pi:
            near = tune_frequency(
                process, replace(specification, phase_margin=margin, t_max=None, s_max=None, u_max=math.inf)
            )
            if near.controller is not None:
                unmet = f"{asked}: nearest possible {math.degrees(margin):.4g} deg"
                return Proposal(near.controller, (unmet,), message, near.ms, evaluations)
    alone = with_margin_alone(process, specification, ROBUST)
    if alone is None:
        return Proposal(None, (f"{asked}: none at any phase margin",), message, math.nan, evaluations)
    unmet = f"{asked}: at no phase margin is there a flat one; nearest is PID with this margin and crossover"
    message += (
        f"; with the flat phase given up, PID with the largest ki that keeps max |S| and max |T| about {ROBUST:g}"
    )
    return Proposal(alone[0], (unmet,), message, alone[1], evaluations)


def _at_edge(controller: Fopid) -> tuple[str, ...]:
    """Orders on the upper edge of the square; it is open at 0."""
    highest = ORDER_RANGE[1]
    return tuple(
        f"{name} = {highest:g} (range 0 to {highest:g})"
        for name in ("lam", "mu")
        if getattr(controller, name) >= highest
    )


def _unmet(specification: FrequencySpecification, design: FrequencyDesign) -> tuple[str, ...]:
    bounds = (
        ("|T|", specification.t_max, design.t_db, design.nearest_t_db),
        ("|S|", specification.s_max, design.s_db, design.nearest_s_db),
    )
    return tuple(
        f"{function} <= {bound}: {db:.2f} dB here, {_within_reach(bound, nearest)}"
        for function, bound, db, nearest in bounds
        if bound is not None and db > bound.db
    )


def _within_reach(bound: Bound, nearest: float) -> str:
    if nearest <= bound.db:
        return "possible when the other bound is let go"
    return f"{nearest:.2f} dB at best with this margin and crossover"
