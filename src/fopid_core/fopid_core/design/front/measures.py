"""What many designs on one process do, at once: the figures of the trade-off, each with a check.

Stability is decided by the argument principle. A peak is sought on a grid that shows every resonance and then closer
and closer about the three highest places. The IAE is worked out twice, the second time with half the time step and over
twice the horizon, of which the first half counts; where the two differ it is that of ``model.response``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.design.time.bands import log_size
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.search_response import ResponseGrid, Variables
from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Complexes, Floats
from fopid_core.model.response import step_response
from fopid_core.model.response_indices import response_indices
from fopid_core.model.stability import stable_mask
from fopid_core.model.winding import right_half_plane_zeros

POINTS = 1024
"""Time steps of the rougher response; the finer one has twice as many."""
EXACT = 1e-4
"""Relative difference of two IAE that is let pass."""
DECADES, DENSITY = 7.0, 60
"""Frequencies to each side of the process's own, and how many in a decade."""
CANDIDATES, CLOSER, ROUNDS = 3, 9, 4
Measure = Callable[[Complexes, Complexes], Floats]
"""The logarithm of something, from L and C F at s = j w."""
ROWS = 32
"""So many responses at once fit the processor's memory."""


@dataclass(frozen=True)
class Measures:
    """Of n designs, shape (n,) each.

    Attributes
    ----------
    iae_load, iae_error : ndarray
        IAE of a unit load step, and its relative error.
    ms, mt, noise_gain : ndarray
        Peaks of |S|, |T|, and |C F S| up to the Nyquist frequency.
    stable : ndarray of bool
        For certain.
    """

    iae_load: Floats
    iae_error: Floats
    ms: Floats
    mt: Floats
    noise_gain: Floats
    stable: Booleans


def measured(problem: TimeProblem, rows: Floats) -> Measures:
    """The measures of rows of variables (kp, ki, kd, lam, mu, filter time, b, c), shape (n, 8)."""
    if not len(rows):
        none = np.zeros(0)
        return Measures(none, none, none, none, none, none > 0.0)
    order = problem.specification.filter_order
    stable = stable_mask(problem.process, rows[:, :5], rows[:, 5], order)
    iae, error = _known_iae(problem, rows, stable)
    peaks = _Peaks(problem, rows)
    nyquist = math.log(math.pi / problem.specification.sample_time)
    return Measures(
        iae, error, peaks.highest(_sensitivity), peaks.highest(_complementary),
        peaks.highest(_noise, nyquist), stable,
    )  # fmt: skip


def _known_iae(problem: TimeProblem, rows: Floats, stable: Booleans) -> tuple[Floats, Floats]:
    """IAE and relative error; infinite error where it is not known."""
    rough, fine = (_iae(problem, rows, points, spans) for points, spans in ((POINTS, 1), (2 * POINTS, 2)))
    error = np.abs(fine - rough) / np.where(fine > 0.0, fine, 1.0)
    for row in np.flatnonzero(stable & ~(error <= EXACT)):
        try:
            exact = step_response(problem.loop(rows[row]), problem.specification.horizon, "load")
        except InputError:
            error[row] = math.inf
            continue
        found, doubt = response_indices(exact.time, exact.error, exact.uncertainty)
        fine[row], error[row] = found.iae, doubt.iae / found.iae
    return fine, error


def _iae(problem: TimeProblem, rows: Floats, points: int, spans: int) -> Floats:
    """Trapezoid rule with so many steps, from responses over so many horizons."""
    horizon, order = problem.specification.horizon, problem.specification.filter_order
    grid = ResponseGrid(problem.process, spans * horizon, spans * points, problem.speed, order)
    weights = np.full(points + 1, grid.time[1])
    weights[[0, -1]] *= 0.5
    parts = [np.abs(grid.load_errors(rows[i : i + ROWS])[:, : points + 1]) @ weights for i in range(0, len(rows), ROWS)]
    return np.concatenate(parts)


class _Peaks:
    """The frequency responses of many loops."""

    def __init__(self, problem: TimeProblem, rows: Floats) -> None:
        self._process, self._order, self._rows = problem.process, problem.specification.filter_order, rows
        middle, reach = math.log(problem.speed), DECADES * math.log(10.0)
        grid = np.linspace(middle - reach, middle + reach, 2 * round(DECADES * DENSITY) + 1)
        z = right_half_plane_zeros(problem.process.denominator).log_frequency
        self._z = np.union1d(grid, z[(z > grid[0]) & (z < grid[-1])])

    def highest(self, measure: Measure, last: float = math.inf) -> Floats:
        """The largest value of exp(``measure``) up to ln w = ``last``, shape (n,)."""
        z = self._z if math.isinf(last) else np.union1d(self._z[self._z < last], [last])
        values = measure(*self._loops(self._rows, z[None]))
        inner = np.pad(values, ((0, 0), (1, 1)), constant_values=-np.inf)
        peaks = (values >= inner[:, :-2]) & (values >= inner[:, 2:])
        best = np.argsort(np.where(peaks, values, -np.inf), axis=1)[:, -CANDIDATES:]
        which = np.repeat(np.arange(len(values)), best.shape[1])
        at = best.ravel()
        low, high = z[np.maximum(at - 1, 0)], z[np.minimum(at + 1, len(z) - 1)]
        top = values[which, at]
        share = np.linspace(0.0, 1.0, CLOSER)
        for _ in range(ROUNDS):
            near = low[:, None] + (high - low)[:, None] * share
            closer = measure(*self._loops(self._rows[which], near))
            here = closer.argmax(axis=1)
            every = np.arange(len(near))
            top = np.maximum(top, closer[every, here])
            low, high = near[every, np.maximum(here - 1, 0)], near[every, np.minimum(here + 1, CLOSER - 1)]
        return np.asarray(np.exp(top.reshape(len(values), -1).max(axis=1)))

    def _loops(self, rows: Floats, log_w: Floats) -> tuple[Complexes, Complexes]:
        """L and C F at s = j w, shape (n, frequencies)."""
        feedback = Variables(rows, self._order).feedback(log_w)
        return self._process(1j * np.exp(log_w)) * feedback, feedback


def _sensitivity(loop: Complexes, feedback: Complexes) -> Floats:
    del feedback
    return -log_size(1.0 + loop)


def _complementary(loop: Complexes, feedback: Complexes) -> Floats:
    del feedback
    return log_size(loop) - log_size(1.0 + loop)


def _noise(loop: Complexes, feedback: Complexes) -> Floats:
    return log_size(feedback) - log_size(1.0 + loop)
