"""Where a time-domain search begins: controllers on the bounds, drawn at random and of each simpler structure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.specification import NUMBERS, STRUCTURES
from fopid_core.design.time.problem import TimeProblem

Real = NDArray[np.float64]

SHAPES, SHAPES_EACH = 72, 12
"""Controllers drawn to begin with, and for each structure; the latter do not depend on the seed."""
WITHOUT_KP = {"without kp": {"kp": 0.0}}
"""For slow processes the best is often an integral and a derivative of low orders alone, a valley of its own."""
IDLE_ORDERS = (0.4, 1.0)
"""Orders tried for a part that the structure does not have."""
SLOW = (0.02, 0.5)
"""Filter times drawn, in units of the process's time."""
ROUGH, ROUGH_POINTS = 5, 16
"""Frequencies in a band, and time steps, where it is only to be seen which gains are about right."""
FACTORS = np.geomspace(1e-2, 1e2, 25)


@dataclass(frozen=True)
class Starts:
    """Stable controllers that lie about on the bounds.

    Attributes
    ----------
    drawn : ndarray, shape (n, variables)
    structured : list of (str, TimeProblem, ndarray)
        Each simpler structure: its name, the problem restricted to it and controllers for that, shape (m, variables).
    """

    drawn: Real
    structured: list[tuple[str, TimeProblem, Real]]


def starts(problem: TimeProblem, seed: int) -> Starts:
    """Controllers to begin from.

    Examples
    --------
    >>> from fopid_core.design.time.objectives import Objective
    >>> from fopid_core.design.time.specification import TimeSpecification
    >>> from fopid_core.model.process import read_process
    >>> specification = TimeSpecification(Objective.of("itae", {}), horizon=50.0, ms_max=1.6, u_max=20.0)
    >>> len(starts(TimeProblem(read_process("P1"), specification), seed=0).structured)
    7
    """
    simpler = simpler_problems(problem)
    shapes = [_shapes(problem, SHAPES, seed), *(_shapes(other, SHAPES_EACH, seed=0) for _, other in simpler)]
    owner = np.repeat(np.arange(len(shapes)), [len(rows) for rows in shapes])
    rows, origin = _on_the_bounds(problem, np.concatenate(shapes))
    stable = problem.stable(rows)
    if not stable.any():
        rows, origin = _stabilising(problem, np.concatenate(shapes))
        stable = np.ones(len(rows), dtype=bool)
    rows, owner = rows[stable], owner[origin[stable]]
    return Starts(rows[owner == 0], [(name, other, rows[owner == i + 1]) for i, (name, other) in enumerate(simpler)])


def simpler_problems(problem: TimeProblem) -> list[tuple[str, TimeProblem]]:
    """The problem without some numbers: those restrictions that its box contains and that leave something to choose."""
    others = []
    for name, numbers in {**STRUCTURES, **WITHOUT_KP}.items():
        low, high = problem.box.T
        kept = [NUMBERS.index(number) for number in numbers]
        other = problem.restricted(numbers)
        absent = [row for row in kept if row < 3]
        possible = all(low[row] <= 0.0 <= high[row] for row in absent)
        if possible and 0 < len(other.free) < len(problem.free):
            others.append((name, other))
    return others


def with_idle_orders(problem: TimeProblem, gains: Real) -> Real:
    """The same controller with different orders of the part whose gain is zero, shape (n, variables)."""
    rows = [gains]
    for gain, order in ((1, 3), (2, 4)):
        if gains[gain] == 0.0 and gain in problem.free and order in problem.free:
            rows = [row for row in rows for _ in IDLE_ORDERS]
            rows = [_with(row, order, IDLE_ORDERS[i % len(IDLE_ORDERS)]) for i, row in enumerate(rows)]
    return np.clip(np.array(rows), *problem.box.T)


def _with(row: Real, position: int, value: float) -> Real:
    changed = row.copy()
    changed[position] = value
    return changed


def _shapes(problem: TimeProblem, number: int, seed: int) -> Real:
    """Controllers of about gain 1 at the natural crossover, parts and orders drawn at random; some plain PID."""
    rng = np.random.default_rng(seed)
    parts = np.exp(rng.uniform(np.log([0.3, 0.1, 0.03]), np.log([1.0, 1.5, 1.5]), size=(number, 3)))
    orders = rng.uniform([0.7, 0.3], [1.4, 1.7], size=(number, 2))
    orders[: number // 4] = [1.0, 0.95]
    parts *= problem.scale[:3] * math.copysign(1.0, problem.gain)
    rows = np.concatenate([parts, orders], axis=1)
    if len(problem.variables) > len(NUMBERS):
        slow = SLOW[0] * (SLOW[1] / SLOW[0]) ** rng.uniform(size=number) / problem.speed
        rows = np.column_stack([rows, slow, rng.uniform(size=(number, 2))])
    return np.asarray(np.clip(rows, *problem.box.T))


def _on_the_bounds(problem: TimeProblem, shapes: Real) -> tuple[Real, NDArray[np.intp]]:
    """Each shape with the largest gain at which no bound is broken, or with the least broken; and which shape it is.

    Largest means up from small gains, which a stable process tolerates, and, where that is another one, of all: the
    bounds know nothing of stability, and a loop of far too much gain may keep them as well.
    """
    tried, worst = _scaled(problem, shapes)
    fits = worst >= 0.0
    largest = fits.shape[1] - 1 - fits[:, ::-1].argmax(axis=1)
    largest = np.where(fits.any(axis=1), largest, worst.argmax(axis=1))
    upwards = np.where(fits.all(axis=1), largest, (~fits).argmax(axis=1) - 1)
    every = np.arange(len(shapes))
    other = np.flatnonzero((upwards >= 0) & (upwards != largest))
    rows = np.concatenate([tried[every, largest], tried[other, upwards[other]]])
    return rows, np.concatenate([every, other])


def _stabilising(problem: TimeProblem, shapes: Real) -> tuple[Real, NDArray[np.intp]]:
    """Of each shape the gain that stabilises and breaks the bounds least, where they leave too little for stability."""
    tried, worst = _scaled(problem, shapes)
    stable = problem.stable(tried.reshape(-1, shapes.shape[1])).reshape(worst.shape)
    origin = np.flatnonzero(stable.any(axis=1))
    best = np.where(stable, worst, -np.inf).argmax(axis=1)
    return tried[origin, best[origin]], origin


def _scaled(problem: TimeProblem, shapes: Real) -> tuple[Real, Real]:
    """Each shape with all gains, (n, factors, variables), and what that leaves to the worst bound, (n, factors)."""
    tried = np.repeat(shapes[:, None], len(FACTORS), axis=1)
    tried[:, :, :3] *= FACTORS[:, None]
    tried = np.clip(tried, *problem.box.T)
    rough = problem.changed(points=ROUGH_POINTS, density=ROUGH, watched=())
    worst = rough.slack(tried.reshape(-1, shapes.shape[1])).min(axis=1)
    return tried, worst.reshape(tried.shape[:2])
