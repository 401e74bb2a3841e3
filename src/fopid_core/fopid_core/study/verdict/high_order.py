"""A controller of integer order as high as a fractional one's realisation, all of whose residues are free.

A fractional controller runs as an integrator, a direct term and lags with fixed, logarithmically spaced poles, and its
five numbers decide all their weights. Here every weight is a variable of its own:

    C(s) = F(s) (kp + ki / s + sum of r_i s / (s + p_i)).

The descent of the fractional design (``design.time.gauss_newton``) goes on from the fractional optimum, so what it ends
at is the best nearby, not for certain the best of all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.time.bands import least_in_bands, log_size
from fopid_core.design.time.gauss_newton import begin, descend, fresh
from fopid_core.design.time.problem import BANDS, FILTER_TIMES, SAFE, Linearised
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.two_degrees import filter_coefficients

MOST_CLEARED = 8
"""How often bounds are drawn in by what the search's grid does not show of a peak."""
ROUNDS, STEPS = 3, 20
"""Absolute values are rounded off less at every step; a new round begins with one that sees the whole valley."""
NEAR = (1.0 / 50.0, 300.0)
"""Poles that count, in units of the loop's speed: what is slower is an integrator to the loop, faster a gain."""
DENSITY = 20
"""Frequencies in each band."""
STEP = 1e-6
WITHIN = 1.001
"""How far above its bound a peak may be, relative."""
WIDE = 1e4
"""Of every weight, either way, in units of the process's gain."""


@dataclass(frozen=True)
class HighOrder:
    """A design of high order: its IAE of a load step and its peaks on a grid four times as dense as the search's."""

    iae: float
    ms: float
    mt: float
    noise_gain: float
    filter_time: float
    final_error: float
    is_within: bool


class HighOrderProblem:
    """What ``descend`` needs to know, for variables (kp, ki, r_1 to r_n, filter time)."""

    def __init__(
        self, start: Loop, poles: Floats, limits: tuple[float, float, float], horizon: float, points: int, speed: float,
        gain: float, nyquist: float, density: int = DENSITY,
    ) -> None:  # fmt: skip
        self._start, self._poles, self._order = start, poles, start.filter.order
        self.limits: tuple[float, ...] = limits
        self._grid = ResponseGrid(start.process, horizon, points, speed)
        self._log_w = math.log(speed) + math.log(10.0) * np.linspace(-2.5, 2.5, density * BANDS)
        self._log_noise_w = np.linspace(math.log(0.1 * speed), math.log(nyquist), 5 * density)
        self._s = [1j * np.exp(self._log_w), 1j * np.exp(self._log_noise_w)]
        self._p = [start.process(s) for s in self._s]
        self._on_line = start.process(self._grid.line)
        time = np.full(points + 1, self._grid.time[1])
        time[[0, -1]] *= 0.5
        self._weight = time
        size = 1.0 / abs(gain)
        self.scale = np.array([size, size * speed, *np.full(len(poles), size), 0.1 / speed])
        self.box = np.stack([-WIDE * self.scale, WIDE * self.scale], axis=1)
        self.box[-1] = np.array(FILTER_TIMES) / speed
        self.free = np.arange(len(self.scale))

    def fitted(self) -> Floats:
        """Variables that come nearest to the start, by relative error, shape (n + 3,)."""
        s = self._s[0]
        wanted = self._start.controller(s)
        weighted = (self._basis(s) * self.scale[:-1, None] / wanted).T
        found = np.linalg.lstsq(np.vstack([weighted.real, weighted.imag]), np.repeat([1.0, 0.0], len(s)), rcond=1e-6)[0]
        return np.append(found * self.scale[:-1], self._start.filter.time)

    def _basis(self, s: Complexes) -> Complexes:
        return np.stack([np.ones_like(s), 1.0 / s, *(s / (s + p) for p in self._poles)])

    def _controller(self, rows: Floats, s: Complexes) -> Complexes:
        slow = sum(part * s**power for power, part in enumerate(filter_coefficients(self._order, rows[:, -1:])))
        return np.asarray((rows[:, :-1] @ self._basis(s)) / slow)

    def _signals(self, rows: Floats) -> Floats:
        loop = self._controller(rows, self._grid.line) * self._on_line
        integral = np.ones((len(rows), 2))  # the integrator is there: nothing is left of the load
        return self._grid.load_errors(integral, (loop, loop))

    def peaks(self, rows: Floats) -> list[Floats]:
        """Negative logarithms of |S|, |T|, |C S|, least in bands, shape (n, bands) each."""
        loop, noise = (self._controller(rows, s) * p for s, p in zip(self._s, self._p, strict=True))
        sensitivity = log_size(1.0 + loop)
        return [
            least_in_bands(sensitivity, self._log_w, BANDS),
            least_in_bands(sensitivity - log_size(loop), self._log_w, BANDS),
            least_in_bands(log_size(1.0 + noise) - log_size(noise / self._p[1]), self._log_noise_w, 6),
        ]

    def slack(self, rows: Floats) -> Floats:
        """What is left to each bound, relative, shape (n, bounds)."""
        parts = [math.log(limit) + least for limit, least in zip(self.limits, self.peaks(rows), strict=True)]
        return np.concatenate(parts, axis=1) - SAFE

    def cost(self, rows: Floats) -> Floats:
        """IAE, shape (n,)."""
        return np.asarray(np.abs(self._signals(rows)) @ self._weight)

    def cost_and_slack(self, rows: Floats) -> tuple[Floats, Floats]:
        """IAE, shape (n,), and ``slack``."""
        return self.cost(rows), self.slack(rows)

    def linearised(self, row: Floats) -> Linearised:
        """Signals and bounds and their slopes."""
        rows = np.repeat(row[None], len(row) + 1, axis=0)
        rows[1:] += np.diag(STEP * self.scale)
        signals, slack = self._signals(rows), self.slack(rows)
        return Linearised(
            cost=float(np.abs(signals[0]) @ self._weight), signals=signals[0],
            signal_slopes=(signals[1:] - signals[0]) / STEP, absolute=self._weight, square=0.0 * self._weight,
            slack=slack[0], slack_slopes=((slack[1:] - slack[0]) / STEP).T,
        )  # fmt: skip

    def winding(self, row: Floats) -> float:
        """How far 1 + L turns, less what its beginning accounts for [rad]: the same for all that are stable."""
        return _turns(1.0 + self._controller(row[None], self._s[0])[0] * self._p[0])

    def follows(self, row: Floats) -> bool:
        """Whether the loop turns about -1 as the fractional one does, which is stable."""
        fractional = _turns(1.0 + self._start(self._s[0]))
        integral = 0.5 * math.pi * (1.0 - self._start.controller.integral_order)
        return abs(self.winding(row) - fractional - integral) <= 1.0

    def final_error(self, row: Floats) -> float:
        """What is left of the largest error at the horizon."""
        error = np.abs(self._signals(row[None])[0])
        return float(error[-1] / error.max())


def _turns(distance: NDArray[np.complex128]) -> float:
    return float(np.angle(distance[1:] / distance[:-1]).sum())


def high_order(
    start: Loop, poles: Floats, limits: tuple[float, float, float], horizon: float, speed: float, gain: float,
    nyquist: float, points: int,
) -> HighOrder | None:  # fmt: skip
    """The best controller of high order near a fractional design.

    Parameters
    ----------
    start : Loop
        A stable one, with integral action, within the bounds.
    poles : ndarray, shape (n,)
        [rad/s]
    limits : tuple of float
        On max |S|, max |T|, and the gain from noise to control up to ``nyquist`` [rad/s].
    horizon, speed, gain, points
        Of the load step, of the loop, of the process, and steps in time.

    Returns
    -------
    HighOrder or None
        None where the fractional design cannot be followed to an integer order: the loop with the fit is not stable.
    """
    poles = poles[(poles > NEAR[0] * speed) & (poles < NEAR[1] * speed)]
    args = (start, poles, limits, horizon, points, speed, gain, nyquist)
    problem = HighOrderProblem(*args)
    row = problem.fitted()
    if not problem.follows(row):
        return None
    fine = HighOrderProblem(*args, density=4 * DENSITY)
    for _ in range(MOST_CLEARED):
        found = begin(problem, row[None])[0]  # type: ignore[arg-type]
        for _ in range(ROUNDS):
            found = descend(problem, fresh(found), STEPS, 1e-4)  # type: ignore[arg-type]
        row = found.gains
        ms, mt, noise = (float(np.exp(-least.min())) for least in fine.peaks(row[None]))
        over = [peak / limit for peak, limit in zip((ms, mt, noise), limits, strict=True)]
        if max(over) <= WITHIN:
            break
        # What the search's grid did not show is kept clear of in the next round: by as much as it shows too little.
        shown = [
            min(limit, float(np.exp(-least.min())))
            for limit, least in zip(problem.limits, problem.peaks(row[None]), strict=True)
        ]
        problem.limits = tuple(
            here / part if part > 1.0 else limit for here, part, limit in zip(shown, over, problem.limits, strict=True)
        )
    return HighOrder(found.cost, ms, mt, noise, float(row[-1]), problem.final_error(row), max(over) <= WITHIN)
