"""Nelder and Mead's simplex from perturbed starts, with a penalty on what is not allowed: section 4.1 of the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fopid_core.design.time.gauss_newton import Descent
from fopid_core.design.time.problem import TimeProblem

Real = NDArray[np.float64]

PERTURBED = 0.15
"""Relative size of the perturbations."""
RESTARTS = 2
FORBIDDEN = 1e3
"""Cost, relative to the start's, of a loop that is unstable or breaks a bound; more the further it is off."""


class _TimeIsOverError(Exception):
    """Ends a search from within the function it minimises."""


def kept_first(descent: Descent) -> tuple[bool, float]:
    """The order of what simplices end with: a simplex does not come back over a bound that it is beyond by a hair."""
    return descent.slack < 0.0, descent.merit


def simplex_search(problem: TimeProblem, start: Descent, expired: Callable[[], bool]) -> Descent:
    """The best point that simplices of different shape reach, each from the best so far."""
    free, box = problem.free, problem.box
    if not len(free):
        return start
    unit = problem.scale[free]
    winding = problem.winding(start.gains)
    low, high = box[free].T / unit

    def descent_at(x: Real) -> Descent:
        gains = start.gains.copy()
        gains[free] = np.clip(x, low, high) * unit
        cost, slack = problem.cost_and_slack(gains[None])
        return Descent(gains, float(cost[0]), float(slack.min()))

    def penalised(x: Real) -> float:
        if expired():
            raise _TimeIsOverError
        here = descent_at(x)
        if abs(problem.winding(here.gains) - winding) > 1.0:
            return 2.0 * FORBIDDEN * start.cost
        return here.cost if here.slack >= 0.0 else FORBIDDEN * start.cost * (1.0 + min(-here.slack, 0.9))

    x, best = start.gains[free] / unit, start
    rng = np.random.default_rng(0)
    try:
        for _ in range(RESTARTS):
            simplex = x * (1.0 + PERTURBED * rng.uniform(-1.0, 1.0, size=(len(x) + 1, len(x))))
            simplex[0] = x
            simplex = np.clip(simplex + 0.01 * np.vstack([np.zeros(len(x)), np.eye(len(x))]), low, high)
            x = minimize(
                penalised,
                x,
                method="Nelder-Mead",
                options={"initial_simplex": simplex, "maxfev": 300, "xatol": 1e-5, "fatol": 1e-6 * start.cost},
            ).x
            best = min(best, descent_at(x), key=kept_first)
    except _TimeIsOverError:
        pass
    return best
