"""The nearest design where no controller has a flat phase: PID with the margin and the crossover all the same.

The integral is as large as the loop bears. Margin and crossover are two equations, C(j w) = c0 as in ``exact_gains``:
kp = Re c0, and each ki has its kd.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fopid_core.design.frequency.exact_gains import ControllerTarget, has_one_sign
from fopid_core.design.frequency.order_search import OrderSearch, frequency_grid
from fopid_core.design.specification import FrequencySpecification
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

SHARES = np.geomspace(1e-3, 10.0, 161)
"""Of |C| at the crossover that the integral takes there."""
DENSE = 120
"""Points per decade."""
LEAST_FACTOR = 1.05
"""Without a loop of modest peaks, integrals whose peaks are so near to the smallest are all the same."""


def with_margin_alone(
    process: Process, specification: FrequencySpecification, peak_max: float
) -> tuple[Fopid, float] | None:
    """PID with the margin at the only crossover, and its max |S|; None where the gains would differ in sign.

    Parameters
    ----------
    process : Process
    specification : FrequencySpecification
        Of which phase margin and crossover count.
    peak_max : float
        The largest ki is taken with which |S| and |T| stay below, or below their least where that is higher.

    Examples
    --------
    >>> asked = FrequencySpecification(math.radians(80.0), 1.0)
    >>> controller, ms = with_margin_alone(Process.parse("1/s^2"), asked, 2.0)
    >>> round(controller.kp, 4), controller.lam, controller.mu, ms < 2.0
    (0.1736, 1.0, 1.0, True)
    """
    alone = replace(specification, t_max=None, s_max=None, u_max=math.inf)
    w, c0 = (
        specification.crossover,
        ControllerTarget.of(process, specification.phase_margin, specification.crossover).c0,
    )
    ki = math.copysign(1.0, c0.real) * w * abs(c0) * SHARES
    one = np.ones_like(ki)
    rows = np.column_stack([c0.real * one, ki, (c0.imag + ki / w) / w, one, one])
    rows = rows[has_one_sign(rows)]
    rows = rows[stable_mask(process, rows)] if len(rows) else rows
    if not len(rows):
        return None
    designs = OrderSearch(process, alone, frequency_grid(alone, DENSE)).measure(rows)
    peaks = np.where(designs.inadmissible <= 0.0, np.maximum(designs.ms, designs.mt), math.inf)
    if math.isinf(peaks.min()):
        return None
    borne = max(peak_max, LEAST_FACTOR * float(peaks.min()))
    best = int(np.flatnonzero(peaks <= borne)[-1])
    return Fopid(*rows[best].tolist()), float(designs.ms[best])
