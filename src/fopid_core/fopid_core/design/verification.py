"""What a design does on the process itself, whatever it was made on."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.specification import Achieved, Bound
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins

DECADES = 4.0
"""How far beyond its edge the band of a bound is looked at."""


def achieved(loop: Loop, t_max: Bound | None = None, s_max: Bound | None = None) -> Achieved:
    """Margins and sensitivities of a loop, and what it does on the bands of the bounds.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> round(achieved(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0))).gain_margin_db, 3)
    12.041
    """
    found = margins(loop)
    return Achieved(
        phase_margin=found.phase_margin,
        crossover=found.crossover,
        phase_slope=found.phase_slope,
        gain_margin_db=20.0 * math.log10(found.gain_margin) if found.gain_margin > 0.0 else -math.inf,
        delay_margin=found.delay_margin,
        ms=found.ms,
        mt=found.mt,
        t_db=_largest_db(loop, t_max, DECADES, "T"),
        s_db=_largest_db(loop, s_max, -DECADES, "S"),
    )


def _largest_db(loop: Loop, bound: Bound | None, decades: float, function: str) -> float:
    if bound is None:
        return math.nan
    w = bound.frequency * np.logspace(0.0, decades, 2000)
    values = loop.complementary_sensitivity(1j * w) if function == "T" else loop.sensitivity(1j * w)
    return float(20.0 * np.log10(np.abs(values).max()))
