"""The comparison of all methods on one process, and which of their designs to take."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from fopid_core.design import defaults
from fopid_core.design.comparison.candidates import candidates
from fopid_core.design.comparison.measures import Row, measured
from fopid_core.design.specification import (
    STRUCTURES,
    Bounds,
    Clock,
    Progress,
    TuningRequest,
    no_progress,
    one_of,
    require,
)
from fopid_core.design.time.proposal import bounds_of, time_specification
from fopid_core.model.process import Process

PREFERENCES = ("balanced", "load", "setpoint", "robust", "quiet")
"""What is best: the sum of both IAE, the load's against a unit at rest; one of them; the smallest Ms; the smallest
noise gain, the latter two among those whose balanced cost is within ``AFFORDABLE`` of the best."""
AFFORDABLE = 0.25
WORTH = 0.05
"""A structure with more numbers to look after must be better by more, relative."""
RUNNING = 1.1
"""How much larger Ms may be as the loop runs for a design to be recommended, where there is another."""


@dataclass(frozen=True)
class Comparison:
    """All designs side by side.

    Attributes
    ----------
    rows : tuple of Row
    recommended : int
        Which of them; -1 when none keeps the bounds.
    reason : str
        Why, in one sentence.
    bounds : Bounds
        What all of them shall keep.
    elapsed : float
        [s]
    """

    rows: tuple[Row, ...]
    recommended: int
    reason: str
    bounds: Bounds
    elapsed: float


def comparison_request(process: Process, **bounds: Any) -> TuningRequest:
    """What is asked of time tuning in a comparison: both steps, filter and setpoint weights chosen with the gains.

    Raises
    ------
    InputError
        For a bound that is not known or not allowed.
    """
    names = ("ms_max", "mt_max", "noise_max", "u_max", "sample_time", "horizon", "filter_order")
    for name in bounds:
        one_of("bound", name, names)
    return TuningRequest(process, "time", index="iae", input="both", two_degrees=True, **{"filter_order": 2, **bounds})


def compare(
    request: TuningRequest,
    preference: str = "balanced",
    worth: float = WORTH,
    progress: Progress = no_progress,
    clock: Clock = time.perf_counter,
) -> Comparison:
    """Every method and structure on the request's process under its bounds.

    Parameters
    ----------
    request : TuningRequest
        Of which the process, the bounds, the sample time, the horizon and the order of the filter count.
    preference : str
        One of ``PREFERENCES``.
    worth : float
        By how much, relative, a structure with more numbers must be better.
    progress, clock : callable, optional

    Raises
    ------
    InputError
        If the process cannot be controlled, or an argument is not allowed.
    """
    one_of("prefer", preference, PREFERENCES)
    require(0.0 <= worth < math.inf, "worth", worth, "0 or above")
    begun = clock()
    asked = time_specification(request)
    bounds = bounds_of(asked)
    speed = defaults.natural_crossover(request.process, defaults.PHASE_MARGIN)
    rows = tuple(measured(candidate, bounds, speed) for candidate in candidates(request, progress))
    gain = abs(defaults.process_gain(request.process))
    recommended, reason = _recommended(rows, gain, preference, worth)
    progress(1.0, "done")
    return Comparison(rows, recommended, reason, bounds, clock() - begun)


def _recommended(rows: tuple[Row, ...], gain: float, preference: str, worth: float) -> tuple[int, str]:
    """The row to take, and the sentence that says why."""
    known = [i for i, row in enumerate(rows) if row.is_within and math.isfinite(_cost(row, gain, preference))]
    good = [i for i in known if rows[i].running_ms <= RUNNING * rows[i].ms] or known
    if not good:
        return -1, "No design keeps every bound: loosen the one that most rows break."
    affordable = good
    if preference in ("robust", "quiet"):
        least = min(_cost(rows[i], gain, "balanced") for i in good)
        affordable = [i for i in good if _cost(rows[i], gain, "balanced") <= (1.0 + AFFORDABLE) * least]
    best = min(affordable, key=lambda i: _cost(rows[i], gain, preference))
    least = _cost(rows[best], gain, preference)
    near = [i for i in affordable if _cost(rows[i], gain, preference) <= (1.0 + worth) * least]
    taken = min(near, key=lambda i: (_numbers(rows[i]), _cost(rows[i], gain, preference)))
    return taken, _sentence(rows[taken], rows[best], gain, preference)


def _sentence(taken: Row, best: Row, gain: float, preference: str) -> str:
    what = {
        "balanced": "the sum of setpoint and load IAE", "load": "the IAE of the load step",
        "setpoint": "the IAE of the setpoint step", "robust": "Ms", "quiet": "the noise gain",
    }[preference]  # fmt: skip
    name = f"{taken.candidate.structure} by {taken.candidate.method}"
    if taken is best:
        return f"Take {name}: of all designs within the bounds it has the smallest {what.removeprefix('the ')}."
    dearer = 100.0 * (_cost(taken, gain, preference) / _cost(best, gain, preference) - 1.0)
    other = f"{best.candidate.structure} by {best.candidate.method}"
    return f"Take {name}: {what} is only {dearer:.2g} % above the best ({other}), with fewer numbers to look after."


def _cost(row: Row, gain: float, preference: str) -> float:
    costs = {
        "balanced": row.iae_setpoint + row.iae_load / gain, "load": row.iae_load, "setpoint": row.iae_setpoint,
        "robust": row.ms, "quiet": row.noise_gain,
    }  # fmt: skip
    return costs[preference]


def _numbers(row: Row) -> int:
    """How many of the five numbers are to be chosen."""
    return 5 - len(STRUCTURES[row.candidate.structure])
