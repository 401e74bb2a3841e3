"""From a tuning request to a frequency-domain design: defaults, the way via a reduced model, what is not met."""

from __future__ import annotations

import math
from dataclasses import replace

from fopid_core.design import defaults
from fopid_core.design.frequency_tuning import FrequencyDesign, tune_frequency
from fopid_core.design.specification import Bound, Expired, FrequencySpecification, Progress, Proposal, TuningRequest
from fopid_core.model.process import Process

SLOWER = tuple(0.8**k for k in range(16))
"""Shares of the natural crossover that are tried, fastest first, when none is asked for."""


def propose_frequency(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """The best design for a request, on the process itself or via a reduced model."""
    process, remark = _model(request, progress)
    progress(0.3, "searching the square of orders")
    specification, design = _design(process, request)
    evaluations = design.evaluations
    if request.crossover is None:
        remark += f"crossover {specification.crossover:.4g} rad/s chosen from the process; "
    if request.phase_margin is None:
        remark += f"phase margin {math.degrees(specification.phase_margin):g} deg by default; "
    if design.controller is None:
        nearest = _nearest_margin(process, specification)
        return Proposal(
            None if nearest is None else nearest[1].controller,
            (_no_design(specification, nearest),),
            remark + "no design with gains of one sign",
            math.nan,
            evaluations,
        )
    message = remark + _praise(specification, design)
    return Proposal(design.controller, _unmet(specification, design), message, design.ms, evaluations)


def _model(request: TuningRequest, progress: Progress) -> tuple[Process, str]:
    if request.via == "none":
        return request.process, ""
    from fopid_core.design.reduction import reduce

    progress(0.05, f"reducing to {request.via}")
    reduced = reduce(request.process, request.via)
    return reduced.process, f"designed on {reduced.process} ({request.via}, H2 error {reduced.h2_error:.3g}); "


def _design(process: Process, request: TuningRequest) -> tuple[FrequencySpecification, FrequencyDesign]:
    phase_margin = request.phase_margin or defaults.PHASE_MARGIN
    natural = request.crossover or defaults.natural_crossover(process, phase_margin)
    first = FrequencySpecification(phase_margin, natural, request.t_max, request.s_max, request.criterion)
    design = tune_frequency(process, first)
    if request.crossover is not None or design.met:
        return first, design
    for share in SLOWER[1:]:
        slower = replace(first, crossover=share * natural)
        other = tune_frequency(process, slower)
        if other.met:
            return slower, other
    return first, design


def _nearest_margin(
    process: Process, specification: FrequencySpecification
) -> tuple[float, FrequencyDesign] | None:
    """The phase margin nearest to the wished one, in whole degrees, for which there is a design."""
    wished = math.degrees(specification.phase_margin)
    margins = sorted((m for m in range(2, 179, 2)), key=lambda m: abs(m - wished))
    for margin in margins:
        near = replace(specification, phase_margin=math.radians(margin), t_max=None, s_max=None)
        design = tune_frequency(process, near)
        if design.controller is not None:
            return margin, design
    return None


def _no_design(specification: FrequencySpecification, nearest: tuple[float, FrequencyDesign] | None) -> str:
    asked = (
        f"phase margin {math.degrees(specification.phase_margin):.4g} deg with a flat phase at the only crossover "
        f"{specification.crossover:.4g} rad/s"
    )
    if nearest is None:
        return f"{asked}: no gains of one sign at any phase margin"
    return f"{asked}: nearest possible {nearest[0]:g} deg"


def _praise(specification: FrequencySpecification, design: FrequencyDesign) -> str:
    best = "smallest ms" if specification.criterion == "ms" else "widest flat phase"
    return f"{best} of all designs that meet it" if design.met else "nearest to the bounds"


def _unmet(specification: FrequencySpecification, design: FrequencyDesign) -> tuple[str, ...]:
    if design.met:
        return ()
    bounds = (
        ("|T|", specification.t_max, design.t_db, design.nearest_t_db),
        ("|S|", specification.s_max, design.s_db, design.nearest_s_db),
    )
    return tuple(_shortfall(*bound) for bound in bounds if _is_broken(bound[1], bound[2]))


def _is_broken(bound: Bound | None, db: float) -> bool:
    return bound is not None and db > bound.db


def _shortfall(function: str, bound: Bound | None, db: float, nearest: float) -> str:
    return f"{function} <= {bound}: {db:.2f} dB here, {nearest:.2f} dB at best with this margin and crossover"
