"""Time-domain tuning, eqs. (23) to (30): the best index of the step response under bounds.

Every index of the error asks for more gain without end, so bounds belong to the specification: on max |S|, on the peak
of the control of the controller as it runs, and on the gain from measurement noise to control. The search begins from
the best of many designs that lie on the bounds already. An unstable loop never wins: what is handed out was decided
by the argument principle on the process itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.specification import Bounds, Expired, Progress, no_progress
from fopid_core.design.time.bands import around
from fopid_core.design.time.evolution import evolved
from fopid_core.design.time.gauss_newton import Descent, begin, descend, fresh
from fopid_core.design.time.nelder_mead import kept_first, simplex_search
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.starts import Starts, starts, with_idle_orders
from fopid_core.design.verification import EXACT, checks
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.peaks import Band, Peak
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights

Real = NDArray[np.float64]

BEGUN, BEGUN_EACH, FOLLOWED = 4, 2, 3
"""How many of the controllers drawn a descent begins from, how many of each structure, and how many descents are
followed to the end."""
FIRST_STEPS, LAST_STEPS = 8, 80
FLOORS, LAST_TOLERANCE = (1e-4, 1e-6), 1e-6
"""Roundings of absolute values with which a descent is taken up again: in narrow valleys it stops too early."""
CARRIED, SAME = 6, 1e-5
"""How many designs are looked at again on finer grids, and by how much their costs differ at least, relative."""
RIGHT, ROUGHLY_RIGHT = 1e-3, 2e-2
"""Relative error of the cost from which on the time steps are too long; the latter for costs that jump."""
MOST_WATCHED = 400
"""Frequencies that are added, one exact peak after the other."""
FAR = np.logspace(3.0, 9.0, 7)
"""Where a loop's gain is watched whose limit at 0 or infinity is its peak, in units of the natural crossover."""
DRAWN_FURTHER, MOST_DRAWN_IN = 1.2, 0.5
"""A bound is drawn in by so many times what the control is above it, and by no larger share of it than the latter."""
HALF_WAY = 0.2
"""A peak's width is where the logarithm has fallen by this."""
NEAR = 0.5
"""Of a bound on the control: below, only the last design is held against the exact response, which takes long."""
MOST_POINTS = 1 << 14


@dataclass(frozen=True)
class TimeDesign:
    """The outcome of a time-domain search.

    Attributes
    ----------
    controller : Fopid
        The best stable design.
    met : bool
        Whether all bounds are met.
    cost : float
    ms, control_peak, noise_gain : float
        What the bounds are on.
    final_error : float
        What is left of the error at the horizon.
    evaluations : int
        Number of controllers looked at.
    at_edge : tuple of str
        Free numbers that end on the edge of their range.
    filter, weights
        Of the measurement and of the setpoint.
    variables : ndarray, shape (5,) or (8,)
        All that was chosen, as a search begins from it.
    simpler : mapping
        For each simpler structure what its best controller costs, roughly, bounds that it breaks included, and its
        variables.
    """

    controller: Fopid
    met: bool
    cost: float
    ms: float
    control_peak: float
    noise_gain: float
    final_error: float
    evaluations: int
    at_edge: tuple[str, ...]
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT
    variables: Real = field(default_factory=lambda: np.zeros(0))
    simpler: Mapping[str, tuple[float, Real]] = field(default_factory=dict)


def tune_time(
    process: Process,
    specification: TimeSpecification,
    start: Fopid | None = None,
    solver: str = "gauss-newton",
    seed: int = 0,
    progress: Progress | None = None,
    expired: Expired | None = None,
    near: Sequence[Real] = (),
) -> TimeDesign | None:
    """The controller with the lowest cost under the bounds.

    Parameters
    ----------
    process : Process
    specification : TimeSpecification
    start : Fopid, optional
        A further point to begin from.
    solver : str
        ``gauss-newton``; ``nelder-mead`` from perturbed starts as in the paper, which also ends every search for an
        objective that is not an integral; or ``differential-evolution``, from nothing but the box.
    seed : int
        Of the starts; the same seed gives the same answer.
    progress, expired : callable, optional
        Called with the share done; asked whether to stop with the best found so far.
    near : sequence of ndarray
        Variables of designs to begin from and from nothing else: quick, where the best is known to lie near one.

    Returns
    -------
    TimeDesign or None
        None when neither a controller drawn nor the start is stable.

    Examples
    --------
    >>> from fopid_core.design.time.objectives import Objective
    >>> from fopid_core.model.process import read_process
    >>> specification = TimeSpecification(Objective.of("itae", {}), horizon=50.0, ms_max=1.6, u_max=20.0)
    >>> design = tune_time(read_process("P1"), specification)
    >>> design.met, round(design.cost, 1)
    (True, 2.6)
    """
    search = _Search(process, specification, solver, seed, progress or no_progress, expired or (lambda: False))
    problem = TimeProblem(process, specification)
    first = _first_rows(problem, start)
    rows = np.array([*first, *near]) if near else first
    found = search.run(problem, rows, polish_only=bool(near), followed=max(len(near), 1))
    while found:
        better = _better_problem(problem, found[0])
        if better is None or search.expired():
            return replace(_answer(problem, found[0], search.evaluations), simpler=search.simpler)
        polish_only = better.watch_control == problem.watch_control
        problem = better
        found = search.run(problem, np.array([descent.gains for descent in found]), polish_only)
    return None


def _first_rows(problem: TimeProblem, start: Fopid | None) -> Real:
    return np.zeros((0, len(problem.variables))) if start is None else problem.row(start.gains)


def _better_problem(problem: TimeProblem, found: Descent) -> TimeProblem | None:
    """The problem on finer grids or with an eye on what the found design breaks, if it breaks something."""
    bounds, gains = problem.specification, found.gains[None]
    if not problem.watch_control and problem.later_control_breaks(found.gains):
        return problem.changed(watch_control=True)
    peaks = _peaks_above(problem, found)
    if peaks and len(problem.watched) < MOST_WATCHED:
        return problem.changed(watched=problem.watched + peaks)
    finer = problem.changed(points=2 * problem.points)
    cost = float(finer.cost_and_slack(gains)[0][0])
    is_right = abs(cost - found.cost) <= (RIGHT if bounds.objective.is_integral else ROUGHLY_RIGHT) * cost
    is_last = is_right or finer.points > MOST_POINTS
    drawn_in = _drawn_in(problem, found) if is_last or _is_near_a_bound(problem, gains) else problem.drawn_in
    if max(drawn_in) < MOST_DRAWN_IN and drawn_in != problem.drawn_in:
        return problem.changed(drawn_in=drawn_in, watch_control=True)
    return None if is_last else finer


def _is_near_a_bound(problem: TimeProblem, gains: Real) -> bool:
    """Whether the control may break its bounds between the instants of the grid, so that the exact one is worth it."""
    bounds = problem.specification
    return math.isfinite(bounds.rate_max) or problem.largest_control(gains)[0] > NEAR * bounds.u_max


def _peaks_above(problem: TimeProblem, found: Descent) -> tuple[float, ...]:
    """Frequencies, as ln w, around exact peaks that are above what the problem's grids show and allow."""
    bounds, gains = problem.specification, found.gains[None]
    peaks = LoopPeaks(problem.loop(found.gains))
    seen = (
        (bounds.ms_max, problem.ms, peaks.sensitivity, (0.0, math.inf)),
        (bounds.mt_max, problem.mt, peaks.complementary, (0.0, math.inf)),
        (bounds.noise_max, problem.noise_gain, peaks.noise_gain, (0.0, math.pi / bounds.sample_time)),
    )
    places: list[float] = []
    for bound, on_grid, exact, band in seen:
        if math.isfinite(bound) and (peak := exact(band)).value > max(bound, on_grid(gains)[0] * (1.0 + EXACT)):
            places += _around(exact, peak) or _towards(exact, problem, peak.frequency)
    return tuple(place for place in places if place not in problem.watched)


def _drawn_in(problem: TimeProblem, found: Descent) -> tuple[float, float]:
    """By how much the bounds on the control must be drawn in for what the grid of instants does not show."""
    asked, size, move = problem.specification, *problem.drawn_in
    if found.slack < 0.0:
        return size, move
    bounds = Bounds(sample_time=asked.sample_time, horizon=asked.horizon, u_max=asked.u_max, rate_max=asked.rate_max)
    for check in checks(problem.loop(found.gains), bounds):
        if not check.holds and math.isfinite(check.value):
            above = DRAWN_FURTHER * (check.value / check.bound - 1.0)
            size, move = (size + above, move) if check.name == "control peak" else (size, move + above)
    return size, move


def _towards(exact: Callable[[Band], Peak], problem: TimeProblem, limit: float) -> tuple[float, ...]:
    """Frequencies, as ln w, on the way to a limit that is the peak, 0 or infinity."""
    if limit == 0.0:
        return tuple(np.log(problem.speed / FAR).tolist())
    w, delay = problem.speed * FAR, problem.process.delay
    if delay:  # which turns the loop to and fro for ever
        turns = np.ceil(w * delay / math.pi)
        to, fro = turns * math.pi / delay, (turns + 1.0) * math.pi / delay
        w = np.array([max(pair, key=lambda w: exact((w, w)).value) for pair in zip(to, fro, strict=True)])
    return tuple(np.log(w).tolist())


def _around(exact: Callable[[Band], Peak], peak: Peak) -> tuple[float, ...]:
    """Frequencies around a peak, as ln w; none where it is a limit."""
    if not 0.0 < peak.frequency < math.inf:
        return ()
    place, width = math.log(peak.frequency), 0.5
    while width > 1e-9:
        edge = peak.frequency * math.exp(-width)
        if math.log(peak.value / exact((edge, edge)).value) < HALF_WAY:
            break
        width *= 0.5
    return around(place, width)


def _answer(problem: TimeProblem, found: Descent, evaluations: int) -> TimeDesign:
    gains, loop = found.gains[None], problem.loop(found.gains)
    return TimeDesign(
        controller=loop.controller,
        met=found.slack >= 0.0,
        cost=found.cost,
        ms=float(problem.ms(gains)[0]),
        control_peak=float(problem.largest_control(gains)[0]),
        noise_gain=float(problem.noise_gain(gains)[0]),
        final_error=problem.final_error(gains[0]),
        evaluations=evaluations,
        at_edge=problem.at_edge(found.gains),
        filter=loop.filter,
        weights=loop.weights,
        variables=found.gains,
    )


class _Search:
    """One search: how it is done, and how much of it was."""

    def __init__(
        self,
        process: Process,
        specification: TimeSpecification,
        solver: str,
        seed: int,
        report: Progress,
        expired: Callable[[], bool],
    ) -> None:
        self.process, self.specification, self.solver = process, specification, solver
        self.seed, self.expired = seed, expired
        self.evaluations = 0
        self.simpler: dict[str, tuple[float, Real]] = {}
        self._report, self._share = report, 0.0

    def run(self, problem: TimeProblem, rows: Real, polish_only: bool = False, followed: int = 1) -> list[Descent]:
        """The best stable designs found from some rows of gains and, unless polishing, from many others."""
        rows = np.clip(rows, *problem.box.T)
        begun = begin(problem, rows[problem.stable(rows)]) if len(rows) else []
        stochastic = self.solver == "differential-evolution" and not polish_only
        if stochastic:
            begun += evolved(problem, self.seed, self.expired)
        elif not polish_only:
            others = starts(problem, self.seed)
            begun += sorted(begin(problem, others.drawn), key=_merit)[:BEGUN] + self._simpler_optima(problem, others)
        if not begun:
            return []
        ended = begun if stochastic else self._ended(problem, begun, followed if polish_only else 0)
        self.evaluations += problem.evaluations
        ended = sorted([*ended, *begun], key=kept_first if self._by_simplex else _merit)
        stable = problem.stable(np.array([descent.gains for descent in ended]))
        return _different([descent for descent, holds in zip(ended, stable, strict=True) if holds])

    def _ended(self, problem: TimeProblem, begun: list[Descent], polished: int) -> list[Descent]:
        return self._simplex(problem, begun) if self._by_simplex else self._descend(problem, begun, polished)

    @property
    def _by_simplex(self) -> bool:
        return self.solver == "nelder-mead" or not self.specification.objective.is_integral

    def _simpler_optima(self, problem: TimeProblem, others: Starts) -> list[Descent]:
        """The best controllers of each simpler structure, as starts for the whole problem."""
        found: list[Descent] = []
        for i, (name, simpler, rows) in enumerate(others.structured):
            self.report(0.05 + 0.3 * i / len(others.structured), "descending in simpler structures")
            begun = sorted(begin(simpler, rows), key=_merit)[:BEGUN_EACH]
            if self.specification.objective.is_integral:
                begun = [descend(simpler, descent, FIRST_STEPS, expired=self.expired) for descent in begun]
                begun = sorted(begun, key=_merit)[:1]
                begun = [descend(simpler, descent, LAST_STEPS, expired=self.expired) for descent in begun]
            if begun:
                best = min(begun, key=_merit)
                self.simpler[name] = best.merit, best.gains
                found += [replace(fresh(best), gains=row) for row in with_idle_orders(problem, best.gains)]
            self.evaluations += simpler.evaluations
        return [d for d in found if problem.stable(d.gains[None])[0]]

    def report(self, share: float, what: str) -> None:
        """Say what is being done; a second round on finer grids does not take the share back."""
        self._share = max(self._share, share)
        self._report(self._share, what)

    def _descend(self, problem: TimeProblem, begun: list[Descent], polished: int) -> list[Descent]:
        """Down from some designs: the best few to the end, or so many at once where they are only to be polished."""
        begun = sorted(begun, key=_merit)
        under_way = begun if polished else []
        for i, descent in enumerate([] if polished else begun):
            best = f"best cost so far {min(under_way, key=_merit).cost:.5g}" if under_way else ""
            self.report(0.4 + 0.3 * i / len(begun), f"descending from start {i + 1} of {len(begun)} {best}")
            under_way.append(descend(problem, descent, FIRST_STEPS, expired=self.expired))
        under_way.sort(key=_merit)
        self.report(0.7, f"finishing the best, cost {under_way[0].cost:.5g}")
        followed = polished or FOLLOWED
        return [self._finished(problem, descent) for descent in under_way[:followed]] + under_way[followed:]

    def _finished(self, problem: TimeProblem, descent: Descent) -> Descent:
        """Down to the end, and again from there with absolute values rounded off less."""
        ended = descend(problem, descent, LAST_STEPS, expired=self.expired)
        for floor in FLOORS:
            again = replace(fresh(ended), floor=floor)
            ended = descend(problem, again, LAST_STEPS, LAST_TOLERANCE, expired=self.expired)
        return ended

    def _simplex(self, problem: TimeProblem, begun: list[Descent]) -> list[Descent]:
        self.report(0.2, "Nelder-Mead from perturbed starts")
        begun = sorted(begun, key=_merit)[:FOLLOWED]
        return [simplex_search(problem, descent, self.expired) for descent in begun]


def _merit(descent: Descent) -> float:
    return descent.merit


def _different(descents: list[Descent]) -> list[Descent]:
    """The first few of them that do not cost the same."""
    kept: list[Descent] = []
    for descent in descents:
        if all(abs(descent.cost - other.cost) > SAME * other.cost for other in kept):
            kept.append(descent)
    return kept[:CARRIED]
