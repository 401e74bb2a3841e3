"""The certificate of a tuning: what was asked for, proved for the design that came out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from fopid_core.design.certificate import require_ball_arithmetic
from fopid_core.design.defaults import MS_MAX
from fopid_core.design.specification import TuningRequest, TuningResult, require
from fopid_core.design.verification import EXACT

if TYPE_CHECKING:
    from fopid_core.design.certificate.family import Family
    from fopid_core.design.certificate.prover import Certification

MOST_PIECES = 400_000
"""Looked at, for a family, before the answer is that it is not known."""


def certify_tuning(
    request: TuningRequest, result: TuningResult, family: Family | None = None, seconds: float = math.inf
) -> Certification | None:
    """Prove that the loop of a design is stable and keeps the bounds that were asked for; None without a design.

    With a family it is proved for all its processes, in place of the one of the request; ``seconds`` is what that may
    take. A bound is proved with the error that a tuning is allowed to have (one part in a million). What is in force by
    default is proved as well: max |S| of a time-domain tuning.

    Examples
    --------
    >>> from fopid_core.design.tuner import tune
    >>> from fopid_core.model.process import read_process
    >>> request = TuningRequest(read_process("P1"), phase_margin=1.2, crossover=0.5)
    >>> certify_tuning(request, tune(request)).certified
    True
    """
    require_ball_arithmetic()
    from fopid_core.design.certificate.enclosure import Bounds
    from fopid_core.design.certificate.family import Family
    from fopid_core.design.certificate.prover import certify
    from fopid_core.design.certificate.subdivision import Effort

    if result.controller is None:
        return None
    asked = {name: getattr(request, name, None) for name in ("ms_max", "mt_max", "noise_max")}
    if request.method == "time" and request.ms_max is None:
        asked["ms_max"] = MS_MAX
    bounds = {name: x * (1.0 + EXACT) for name, x in asked.items() if x is not None and math.isfinite(x)}
    band = math.pi / request.sample_time if "noise_max" in bounds else None
    slow = result.filter.denominator
    known = band is None or result.filter.is_idle
    require(known, "noise_max", request.noise_max, "with a certificate none where the measurement is filtered")
    processes = Family.of(request.process) if family is None else family
    filtered = processes if result.filter.is_idle else processes.behind(slow)
    effort = Effort(MOST_PIECES if filtered.names else Effort.attempts, seconds)
    return certify(filtered, result.controller, Bounds(**bounds, noise_band=band), effort)


def certificate_or_refusal(
    request: TuningRequest, result: TuningResult, ms_max: float, family: Family | None = None,
    seconds: float = math.inf,
) -> tuple[str, str]:  # fmt: skip
    """The certificate of a design, with a bound on max |S| as well, or why it is not applied; the other is empty.

    With a family that bound is all that is proved of it, beside stability: what was asked for is asked of the design.
    """
    by_default = MS_MAX if request.method == "time" else math.inf
    tightest = min(ms_max, by_default if request.ms_max is None else request.ms_max)
    asked = replace(request, ms_max=tightest)
    if family is not None:
        asked = replace(request, ms_max=ms_max, mt_max=None, noise_max=None)
    found = certify_tuning(asked, result, family, seconds)
    if found is None:
        return "", "not applied: no design to certify"
    if found.certified is True and found.document is not None:
        return found.document, ""
    return "", f"not applied: no certificate: {found.reason}"
