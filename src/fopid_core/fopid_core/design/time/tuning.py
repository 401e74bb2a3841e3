"""Time-domain tuning, eqs. (23) to (30): the best index of the step response under bounds.

Every index of the error asks for more gain without end, so bounds belong to the specification: on max |S|, on the peak
of the control of the controller as it runs, and on the gain from measurement noise to control. The search begins from
the best of many designs that lie on the bounds already. An unstable loop never wins: what is handed out was decided
by the argument principle on the process itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.specification import Expired, Progress, no_progress
from fopid_core.design.time.gauss_newton import Descent, begin, descend
from fopid_core.design.time.nelder_mead import simplex_search
from fopid_core.design.time.problem import TimeProblem, TimeSpecification
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

Real = NDArray[np.float64]

SHAPES = 96
"""Controllers drawn to begin with."""
BEGUN, FOLLOWED = 6, 2
"""How many of them a descent begins from, and how many descents are followed to the end."""
FIRST_STEPS, LAST_STEPS = 8, 80
BARELY = 1e-4
"""A bound broken by this share counts as met."""
RIGHT, ROUGHLY_RIGHT = 1e-3, 2e-2
"""Relative error of the cost from which on the time steps are too long; the latter for costs that jump."""
RIGHT_MS, DENSE = 1e-4, 160
"""Relative error of ms from which on the frequencies are too few, and how many a band has then."""
ROUGH, ROUGH_POINTS = 5, 16
"""Frequencies in a band, and time steps, where it is only to be seen which gains are about right."""
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
    """

    controller: Fopid
    met: bool
    cost: float
    ms: float
    control_peak: float
    noise_gain: float
    final_error: float
    evaluations: int


def tune_time(
    process: Process,
    specification: TimeSpecification,
    start: Fopid | None = None,
    solver: str = "gauss-newton",
    seed: int = 0,
    progress: Progress | None = None,
    expired: Expired | None = None,
) -> TimeDesign | None:
    """The controller with the lowest cost under the bounds.

    Parameters
    ----------
    process : Process
    specification : TimeSpecification
    start : Fopid, optional
        A further point to begin from.
    solver : str
        ``gauss-newton``, or ``nelder-mead`` from perturbed starts as in the paper, which also ends every search for an
        objective that is not an integral.
    seed : int
        Of the starts; the same seed gives the same answer.
    progress, expired : callable, optional
        Called with the share done; asked whether to stop with the best found so far.

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
    (True, 2.5)
    """
    search = _Search(process, specification, solver, seed, progress or no_progress, expired or (lambda: False))
    problem = TimeProblem(process, specification)
    found = search.run(problem, _first_rows(start))
    while found is not None:
        better = _better_problem(problem, found)
        if better is None or search.expired():
            return _answer(problem, found, search.evaluations)
        polish_only = better.watch_control == problem.watch_control
        problem = better
        found = search.run(problem, found.gains[None], polish_only)
    return None


def _first_rows(start: Fopid | None) -> Real:
    return np.zeros((0, 5)) if start is None else np.array([start.gains])


def _better_problem(problem: TimeProblem, found: Descent) -> TimeProblem | None:
    """The problem on finer grids or with an eye on the whole control, if the found design needs it."""
    bounds, gains = problem.specification, found.gains[None]
    if not problem.watch_control and problem.largest_control(gains)[0] > bounds.u_max:
        return problem.changed(watch_control=True)
    denser = problem.changed(density=DENSE)
    if problem.density < DENSE and denser.ms(gains)[0] > max(bounds.ms_max, problem.ms(gains)[0]) * (1.0 + RIGHT_MS):
        return denser
    finer = problem.changed(points=2 * problem.points)
    cost = float(finer.cost_and_slack(gains)[0][0])
    is_right = abs(cost - found.cost) <= (RIGHT if bounds.objective.is_integral else ROUGHLY_RIGHT) * cost
    return None if is_right or finer.points > MOST_POINTS else finer


def _answer(problem: TimeProblem, found: Descent, evaluations: int) -> TimeDesign:
    gains = found.gains[None]
    return TimeDesign(
        controller=Fopid(*(float(number) for number in found.gains)),
        met=found.slack >= -BARELY,
        cost=found.cost,
        ms=float(problem.ms(gains)[0]),
        control_peak=float(problem.largest_control(gains)[0]),
        noise_gain=float(problem.noise_gain(gains)[0]),
        final_error=problem.final_error(gains[0]),
        evaluations=evaluations,
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
        self._report, self._share = report, 0.0

    def run(self, problem: TimeProblem, rows: Real, polish_only: bool = False) -> Descent | None:
        """The best stable design found from some rows of gains and, unless polishing, from drawn ones."""
        if not polish_only:
            rows = np.concatenate([rows, drawn_starts(problem, self.seed)])
        rows = np.clip(rows, *problem.box.T)
        rows = rows[stable_mask(self.process, rows)]
        if not len(rows):
            return None
        begun = sorted(begin(problem, rows), key=lambda descent: descent.merit)[:BEGUN]
        ended = self._simplex(problem, begun) if self.solver == "nelder-mead" else self._descend(problem, begun)
        self.evaluations += problem.evaluations
        ended.sort(key=lambda descent: descent.merit)
        return next(d for d in [*ended, *begun] if stable_mask(self.process, d.gains[None])[0])

    def report(self, share: float, what: str) -> None:
        """Say what is being done; a second round on finer grids does not take the share back."""
        self._share = max(self._share, share)
        self._report(self._share, what)

    def _descend(self, problem: TimeProblem, begun: list[Descent]) -> list[Descent]:
        if not self.specification.objective.is_integral:
            return self._simplex(problem, begun)
        under_way: list[Descent] = []
        for i, descent in enumerate(begun):
            self.report(
                0.1 + 0.1 * i, f"descending from start {i + 1} of {len(begun)}, best cost so far {_best(under_way)}"
            )
            under_way.append(descend(problem, descent, FIRST_STEPS, expired=self.expired))
        under_way.sort(key=lambda descent: descent.merit)
        self.report(0.7, f"finishing the best, cost {_best(under_way)}")
        ended = [descend(problem, descent, LAST_STEPS, expired=self.expired) for descent in under_way[:FOLLOWED]]
        return ended + under_way[FOLLOWED:]

    def _simplex(self, problem: TimeProblem, begun: list[Descent]) -> list[Descent]:
        self.report(0.2, "Nelder-Mead from perturbed starts")
        return [simplex_search(problem, descent, self.expired) for descent in begun[: FOLLOWED + 1]]


def _best(descents: list[Descent]) -> str:
    return f"{min(descents, key=lambda descent: descent.merit).cost:.5g}" if descents else "none"


def drawn_starts(problem: TimeProblem, seed: int) -> Real:
    """Stable controllers that lie about on the bounds, shape (n, 5)."""
    drawn = _on_the_bounds(problem, _shapes(problem, seed))
    stable: Real = drawn[stable_mask(problem.process, drawn)]
    return stable


def _shapes(problem: TimeProblem, seed: int) -> Real:
    """Controllers of about gain 1 at the natural crossover, parts and orders drawn at random; some plain PID."""
    rng = np.random.default_rng(seed)
    parts = np.exp(rng.uniform(np.log([0.3, 0.1, 0.03]), np.log([1.0, 1.5, 1.5]), size=(SHAPES, 3)))
    orders = rng.uniform([0.7, 0.3], [1.4, 1.7], size=(SHAPES, 2))
    orders[: SHAPES // 4] = [1.0, 0.95]
    parts *= problem.scale[:3] * math.copysign(1.0, problem.gain)
    low, high = problem.box.T
    return np.asarray(np.clip(np.concatenate([parts, orders], axis=1), low, high))


def _on_the_bounds(problem: TimeProblem, shapes: Real) -> Real:
    """Each shape with the largest gain at which no bound is broken, or with the least broken.

    Largest means up from small gains, which a stable process tolerates, and, where that is another one, of all: the
    bounds know nothing of stability, and a loop of far too much gain may keep them as well.
    """
    factors = np.geomspace(1e-2, 1e2, 25)
    tried = np.repeat(shapes[:, None], len(factors), axis=1)
    tried[:, :, :3] *= factors[:, None]
    tried = np.clip(tried, *problem.box.T)
    rough = problem.changed(points=ROUGH_POINTS, density=ROUGH)
    worst = rough.slack(tried.reshape(-1, 5)).min(axis=1).reshape(len(shapes), -1)
    fits = worst >= 0.0
    largest = fits.shape[1] - 1 - fits[:, ::-1].argmax(axis=1)
    largest = np.where(fits.any(axis=1), largest, worst.argmax(axis=1))
    upwards = np.where(fits.all(axis=1), largest, (~fits).argmax(axis=1) - 1)
    every = np.arange(len(shapes))
    other = np.flatnonzero((upwards >= 0) & (upwards != largest))
    return np.concatenate([tried[every, largest], tried[other, upwards[other]]])
