"""Differential evolution, scipy's: the stochastic search that the field takes when it knows no slopes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

from fopid_core.design.time.gauss_newton import Descent, begin
from fopid_core.design.time.problem import TimeProblem

Real = NDArray[np.float64]

GENERATIONS, POPULATION = 200, 12
"""At most so many generations, of so many controllers for each free variable."""
SPREAD = 1e-6
"""Of the costs of a population, relative, at which it has arrived."""
FAR = 1e4
"""Cost, relative to the first good one's, of what is unstable or breaks a bound; more the further it is off."""
LEAST = 1e-5
"""Of a gain, in units of the problem's: below lies no more on a logarithmic scale."""
GAINS = 3


def evolved(problem: TimeProblem, seed: int, expired: Callable[[], bool]) -> list[Descent]:
    """The best controller of the last generation, polished by nothing; empty when none is stable and in bounds.

    Gains are sought on a logarithmic scale, all else on a linear one.
    """
    free, box = problem.free, problem.box
    if not len(free):
        return begin(problem, box[:, :1].T)
    low, high = box[free].T
    sign = np.where(low < 0.0, -1.0, 1.0)
    of_gain = free < GAINS
    smallest = LEAST * problem.scale[free]
    sizes = np.sort(np.abs([low, high]), axis=0)
    ends = np.where(of_gain, np.log(np.maximum(sizes, smallest)), np.stack([low, high]))

    def rows(x: Real) -> Real:
        """Controllers from points of the search, shape (points, variables), for x of shape (free, points)."""
        found = np.repeat(box[:, :1].T, x.shape[1], axis=0)
        with np.errstate(over="ignore"):
            found[:, free] = np.where(of_gain, sign * np.exp(x.T), x.T)
        return np.clip(found, *box.T)

    scale = float(np.median(problem.cost_and_slack(rows(ends.mean(axis=0)[:, None]))[0]))

    def penalised(x: Real, /) -> Real:
        found = rows(x)
        cost, slack = problem.cost_and_slack(found)
        worst = np.minimum(slack.min(axis=1), 0.0)
        value = np.where(worst < 0.0, FAR * scale * (1.0 - np.maximum(worst, -10.0)), cost)
        good = np.flatnonzero((worst == 0.0) & np.isfinite(cost))
        value[good[~problem.stable(found[good])]] = 20.0 * FAR * scale
        return np.asarray(np.where(np.isfinite(value), value, 40.0 * FAR * scale))

    def stops(*_: object, **__: object) -> bool:
        return expired()

    ended = differential_evolution(
        penalised,  # type: ignore[arg-type]  # of many points at once, since vectorized
        Bounds(*ends),
        seed=seed, maxiter=GENERATIONS, popsize=POPULATION, tol=SPREAD, polish=False, vectorized=True,
        updating="deferred", init="sobol", callback=stops,  # type: ignore[arg-type]
    )  # fmt: skip
    return begin(problem, rows(ended.x[:, None])) if ended.fun < FAR * scale else []
