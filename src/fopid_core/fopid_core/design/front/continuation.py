"""The designs of the trade-off, each begun from its neighbour: the bounds move, the optimum follows.

For a bound on max |S| and one on the gain from measurement noise to control, the least IAE of a load step is one point
of the trade-off. First the most is allowed of both; from there one walks along both edges of the surface (noise falls
at the largest Ms, Ms falls at the largest noise), then over what lies between, from each design to the next tighter
one.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.time.gauss_newton import Descent, begin, descend, fresh
from fopid_core.design.time.problem import TimeProblem
from fopid_core.model.arrays import Floats, Indexes

STEPS, TOLERANCE, PATIENT_STEPS = 5, 2e-4, 25
"""Of a descent from a neighbour; the latter where it ends with a bound broken."""
EDGE = 12
"""Designs on each edge of the surface."""
BROKEN = -1e-3
"""A bound that is missed by more cannot be kept: relative."""
ACTIVE = 0.02
"""What is this near to a bound, relative, is held by it."""
LEAST_ABOVE = 1e-6
"""Of a max |S|, above 1."""
LEAST_NOISE = 1.002
"""Lowest noise gain, in units of what integral action alone takes."""
NOISE_RANGE = 30.0
"""And not below the highest over this."""


@dataclass(frozen=True)
class Place:
    """An optimum and the bounds that it was found under.

    Attributes
    ----------
    ms_max, noise_max : float
    descent : Descent
    """

    ms_max: float
    noise_max: float
    descent: Descent


class Continuation:
    """Optima under moving bounds.

    Parameters
    ----------
    problem : TimeProblem
        Whose bounds on Ms and noise are the largest.
    """

    def __init__(self, problem: TimeProblem) -> None:
        self.problem = problem

    def surface(self, start: Floats, ms_min: float, points: int) -> list[Place]:
        """Optima all over the surface, about so many.

        Parameters
        ----------
        start : ndarray, shape (variables,)
            The optimum under the largest bounds.
        ms_min : float
            Smallest bound on max |S|.
        points : int
        """
        most = self.problem.specification
        first = self._solved(most.ms_max, most.noise_max, [start])
        loosest = min(most.noise_max, self._noise(first))
        quietest = max(self._least_noise(), loosest / NOISE_RANGE)
        if quietest >= loosest:  # no noise can be saved: the surface is one of its edges
            return self._walk([(ms, most.noise_max) for ms in _ms_levels(most.ms_max, ms_min, points)], [first])
        levels = np.geomspace(loosest, quietest, EDGE)
        down = self._walk([(most.ms_max, noise) for noise in levels], [first])
        if len(down) < 2:
            return down
        along = self._walk([(ms, most.noise_max) for ms in _ms_levels(most.ms_max, ms_min, EDGE)], [first])
        return self._between(down, along, points)

    def _between(self, down: list[Place], along: list[Place], points: int) -> list[Place]:
        """Columns of designs: each for one noise, from the largest Ms that is worth having down to the smallest."""
        noise = np.log([place.noise_max for place in down])
        reached = self.problem.ms(np.array([place.descent.gains for place in down]))
        top_ms = np.minimum(reached, self.problem.specification.ms_max)
        natural = np.log([self._noise(place.descent) for place in along])
        natural_ms = np.log([place.ms_max - 1.0 for place in along])

        def ends(levels: Floats) -> tuple[Floats, Floats]:
            highest = np.interp(-levels, -noise, np.log(np.maximum(top_ms - 1.0, LEAST_ABOVE)))
            # Below the Ms at which a loop makes less noise than is allowed, a column meets its neighbour.
            lowest = [natural_ms[natural >= level - ACTIVE].min(initial=natural_ms.max()) for level in levels]
            return highest, np.minimum(lowest, highest)

        def columns(count: int) -> tuple[Floats, Floats, Floats, Indexes]:
            """So many columns, as far from each other as the designs in them."""
            levels = np.linspace(noise[0], noise[-1], count)
            highest, lowest = ends(levels)
            return levels, highest, lowest, 1 + np.rint((highest - lowest) / (levels[0] - levels[1])).astype(np.intp)

        enough = bisect_left(range(2, points), points, key=lambda count: columns(count)[-1].sum())
        found, tops = [], list(down)
        for level, high, low, count in zip(*columns(2 + enough), strict=True):
            begun = min(tops, key=lambda place: abs(math.log(place.noise_max) - level))
            bounds = [(1.0 + math.exp(z), math.exp(level)) for z in np.linspace(high, low, count)]
            column = self._walk(bounds, [begun.descent])
            found += column
            tops += column[:1]
        return found

    def _walk(self, bounds: Sequence[tuple[float, float]], begun: list[Descent]) -> list[Place]:
        """From one pair of bounds to the next, as far as they can be kept."""
        path, found = list(begun), []
        for ms_max, noise_max in bounds:
            starts = [path[-1].gains]
            if len(path) > 1:
                starts.append(_ahead(path[-2].gains, path[-1].gains))
            descent = self._solved(ms_max, noise_max, starts)
            if descent.slack < BROKEN:
                break
            found.append(Place(ms_max, noise_max, descent))
            path.append(descent)
        return found

    def _solved(self, ms_max: float, noise_max: float, starts: Sequence[Floats]) -> Descent:
        problem = self.bounded(ms_max, noise_max)
        rows = np.clip(np.array(starts), *problem.box.T)
        found = descend(problem, min(begin(problem, rows), key=lambda d: d.merit), STEPS, TOLERANCE)
        return found if found.slack >= BROKEN else descend(problem, fresh(found), PATIENT_STEPS, TOLERANCE)

    def bounded(self, ms_max: float, noise_max: float) -> TimeProblem:
        """The problem under other bounds, on the same grids."""
        other = copy.copy(self.problem)
        other.specification = replace(self.problem.specification, ms_max=ms_max, noise_max=noise_max)
        return other

    def _noise(self, descent: Descent) -> float:
        return float(self.problem.noise_gain(descent.gains[None])[0])

    def _least_noise(self) -> float:
        """What a slow integral takes to hold a process that comes to rest; nothing for one that does not."""
        process = self.problem.process
        return 0.0 if process.integrating_order > 0 else LEAST_NOISE / abs(process.steady_state_gain)


def _ms_levels(high: float, low: float, count: int) -> Floats:
    return np.asarray(1.0 + np.geomspace(high - 1.0, low - 1.0, count))


def _ahead(before: Floats, here: Floats) -> Floats:
    """As far ahead as one has come, in ratios where there are any."""
    both = (before > 0.0) & (here > 0.0) | (before < 0.0) & (here < 0.0)
    ratio = np.where(both, here / np.where(both, before, 1.0), 1.0)
    return np.asarray(here * np.clip(ratio, 0.5, 2.0))
