"""Gains held against what their loop shows while it is moved with them, which the record they came from may not show.

In small moves dry friction passes for damping: gains that look calm on what was learnt then swing in larger ones. A
loop with livelier gains moves further and faster, and may show the process without that.
"""

from __future__ import annotations

from collections.abc import Callable

from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.sampled_loop import running
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter


def near_instability(
    gains: Fopid, slow: MeasurementFilter, as_moved: IdentificationResult, second: Callable[[], IdentificationResult],
    sample_time: float, ms_max: float,
) -> str:  # fmt: skip
    """Why gains that hold a loop are not to be kept; empty where nothing speaks against them.

    A linear process that they would not hold does not: they do, so that it is another.

    Parameters
    ----------
    gains : Fopid
    slow : MeasurementFilter
        That runs with them.
    as_moved : IdentificationResult
        What was learnt from the moves.
    second : callable
        What was learnt from more than that. It is asked for where the moves speak against the gains, and counts where
        it shows a process without loads that wander: beside these any would do.
    sample_time : float
        Of the controller [s].
    ms_max : float
        Bound on max |S| of the loop as it runs.

    Examples
    --------
    >>> import numpy as np
    >>> from fopid_core.design.identification.identify import identify
    >>> from fopid_core.design.identification.record import Record
    >>> from fopid_core.model.two_degrees import NO_FILTER
    >>> time, lag = np.arange(0.0, 40.0, 0.1), np.zeros(400)
    >>> control = (time % 20.0 < 10.0).astype(float)
    >>> for k in range(399):
    ...     lag[k + 1] = np.exp(-0.1) * lag[k] - np.expm1(-0.1) * control[k]
    >>> shown = identify(Record(time, control, lag), "foptd")
    >>> near_instability(Fopid(kp=5.0, ki=5.0), NO_FILTER, shown, lambda: shown, 0.1, 2.5)
    ''
    >>> near_instability(Fopid(kp=15.0, ki=15.0), NO_FILTER, shown, lambda: shown, 0.1, 2.5)
    'moved with them, the loop shows a process of which they make a max |S| of 3.99 (2.5 is allowed)'
    """

    def objection(shown: IdentificationResult) -> str:
        if not shown.success or shown.best is None:
            return ""
        loop = running(shown.best.process, gains, sample_time, slow, with_margins=False)
        if loop.stable is False and shown.flaws.stick:
            return "a loop that only friction holds"
        if loop.stable and loop.ms > ms_max:
            return f"a max |S| of {loop.ms:.3g} ({ms_max:g} is allowed)"
        return ""

    told = objection(as_moved)
    if not told:
        return ""
    more = second()
    if more.success and more.best is not None and not more.best.wanders and not objection(more):
        return ""
    return f"moved with them, the loop shows a process of which they make {told}"
