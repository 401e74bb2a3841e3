"""Frequency-domain tuning, eqs. (1) to (5), with the whole plane of orders in view.

Every (lam, mu) has exactly one design that meets phase margin, crossover and flat phase, so what is left
is a search in two dimensions: among the admissible designs the best one by a stated criterion.

A design is admissible when its gains have one sign (all positive for a process of positive gain; a
controller whose parts pull against each other is not robust), the loop is stable, w_gc is its only
crossover, the control right after a setpoint step is within its bound, and the bounds (4) and (5) hold on their
whole bands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fopid_core.design.frequency.order_search import Designs, Merit, OrderSearch, Real, frequency_grid
from fopid_core.design.specification import FrequencySpecification
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.winding import right_half_plane_zeros

EXCHANGES = 3
"""Most rounds in which frequencies where the design is worse than on the grid are added to the grid."""
DENSE = 120
"""Points per decade on which the last design is looked at again."""
AS_GOOD_PEAK, AS_GOOD_DB = 1.003, 1e-3
"""By how much a design may be worse there: a factor on ms and mt, and dB on the bounds."""
NARROWINGS = 6
"""How often a peak of the process is closed in on, four times narrower each time."""
SLIGHTLY = 0.5
"""Up to so much short of admissible there [dB], an admissible design is sought nearby."""
FAR = 1e6
"""Merit of a design that breaks a bound."""


@dataclass(frozen=True)
class FrequencyDesign:
    """The outcome of a search over the plane of orders.

    Attributes
    ----------
    controller : Fopid or None
        The best admissible design, else the one nearest to the bounds, else None.
    met : bool
        Whether the bounds are met.
    ms, mt, t_db, s_db : float
        Of the controller (``t_db`` and ``s_db``: -inf without a bound) [-], [-], [dB], [dB].
    nearest_t_db, nearest_s_db : float
        Of a bound that is not met: the lowest it can be when the other is let go, or something low enough to meet
        it [dB]; nan for a bound that is met.
    evaluations : int
        Number of designs looked at.
    """

    controller: Fopid | None
    met: bool
    ms: float
    mt: float
    t_db: float
    s_db: float
    nearest_t_db: float
    nearest_s_db: float
    evaluations: int


def tune_frequency(process: Process, specification: FrequencySpecification) -> FrequencyDesign:
    """The best admissible design of the whole plane 0 < lam, mu <= 2.

    Parameters
    ----------
    process : Process
        What the design is made on: the process itself or a reduced model of it.
    specification : FrequencySpecification

    Returns
    -------
    FrequencyDesign

    Raises
    ------
    InputError
        If the process is zero or infinite at the crossover.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> design = tune_frequency(read_process("P1"), FrequencySpecification(phase_margin=1.2, crossover=0.5))
    >>> design.met
    True
    """
    resonances = _resonances(process, specification)
    dense = OrderSearch(process, specification, np.union1d(frequency_grid(specification, DENSE), resonances))
    search = OrderSearch(process, specification, np.union1d(frequency_grid(specification), resonances))
    merit = _merit(specification)
    best = search.best(merit)
    for _ in range(EXCHANGES):
        if best is None:
            break
        truth = dense.measure(best.gains)
        if _is_as_good(truth, best):
            break
        search = search.refined(dense.worst_frequencies(best))
        is_near = truth.inadmissible[0] <= SLIGHTLY
        best = search.best_near(best, merit) if is_near else search.best(merit)
    return _answer(search, None if best is None else dense.measure(best.gains))


def _resonances(process: Process, specification: FrequencySpecification) -> Real:
    """Where the process has a peak, however narrow, and frequencies ever nearer to it on both sides [rad/s]."""
    w = frequency_grid(specification, DENSE)
    near_axis = np.exp(right_half_plane_zeros(process.denominator).log_frequency)
    w = np.union1d(w, near_axis[(near_axis > w[0]) & (near_axis < w[-1])])
    gain = np.abs(process(1j * w))
    found = []
    for i in 1 + np.flatnonzero((gain[1:-1] > gain[:-2]) & (gain[1:-1] >= gain[2:])):
        low, high = w[i - 1], w[i + 1]
        for _ in range(NARROWINGS):
            inner = np.linspace(low, high, 9)
            peak = int(np.clip(np.argmax(np.abs(process(1j * inner))), 1, 7))
            low, high = inner[peak - 1], inner[peak + 1]
        sides = (w[i + 1] - w[i - 1]) * 0.5 ** np.arange(2 * NARROWINGS)
        middle = 0.5 * (low + high)
        found.append(np.concatenate([middle - sides[1:], [middle], middle + sides[1:]]))
    return np.concatenate(found) if found else np.zeros(0)


def _is_as_good(truth: Designs, design: Designs) -> bool:
    """Whether a design is, on a dense grid, what it was taken to be."""
    peaks = truth.ms[0] <= design.ms[0] * AS_GOOD_PEAK and truth.mt[0] <= design.mt[0] * AS_GOOD_PEAK
    bounds = truth.t_db[0] <= design.t_db[0] + AS_GOOD_DB and truth.s_db[0] <= design.s_db[0] + AS_GOOD_DB
    return bool(peaks and bounds and truth.inadmissible[0] <= 0.0)


def _answer(search: OrderSearch, best: Designs | None) -> FrequencyDesign:
    if best is None or best.inadmissible[0] > AS_GOOD_DB:
        nothing = math.nan
        return FrequencyDesign(None, False, nothing, nothing, nothing, nothing, nothing, nothing, search.evaluations)
    met = bool(best.violation(search.specification)[0] <= AS_GOOD_DB)
    return FrequencyDesign(
        controller=Fopid(*best.gains[0]),
        met=met,
        ms=float(best.ms[0]),
        mt=float(best.mt[0]),
        t_db=float(best.t_db[0]),
        s_db=float(best.s_db[0]),
        nearest_t_db=math.nan if met else _lowest(search, best, "t_db"),
        nearest_s_db=math.nan if met else _lowest(search, best, "s_db"),
        evaluations=search.evaluations,
    )


def _merit(specification: FrequencySpecification) -> Merit:
    """The criterion among designs that meet the bounds, else how far they are above the one they break most."""
    criterion: Merit = {
        "peaks": lambda designs: np.maximum(designs.ms, designs.mt),
        "ms": lambda designs: designs.ms,
        "flatness": lambda designs: -designs.flatness,
    }[specification.criterion]

    def merit(designs: Designs) -> Real:
        above = designs.violation(specification)
        return np.where(above > 0.0, FAR + above, criterion(designs))

    return merit


def _lowest(search: OrderSearch, best: Designs, name: str) -> float:
    """The lowest |T| or |S| on its band when the other bound is let go, or something low enough."""
    bound, value = _bound_and_value(search, best, name)
    other_bound, other_value = _bound_and_value(search, best, "s_db" if name == "t_db" else "t_db")
    if value <= bound:
        return math.nan
    if other_value - other_bound < value - bound - AS_GOOD_DB:
        return value  # the bound that is broken most has been made as low as it goes

    def merit(designs: Designs) -> Real:
        value: Real = getattr(designs, name)
        return value

    lowest = search.best(merit, enough=bound)
    return value if lowest is None else float(merit(lowest)[0])


def _bound_and_value(search: OrderSearch, design: Designs, name: str) -> tuple[float, float]:
    """A bound [dB], infinite for none, and what a design does [dB]."""
    bound = search.specification.t_max if name == "t_db" else search.specification.s_max
    return math.inf if bound is None else bound.db, float(getattr(design, name)[0])
