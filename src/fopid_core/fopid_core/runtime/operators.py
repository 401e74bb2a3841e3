"""s^-lam of one signal and s^mu of another, sample by sample: one matrix times one vector per tick.

Both signals are taken as linear between samples, for which every lag is discretised exactly.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fopid_core.runtime.filter_bank import Band, IntegralWeights, Vector
from fopid_core.runtime.sampled_derivative import DIFFERENCES, DerivativeWeights, lag_weights, ramp_share

Matrix = NDArray[np.float64]

TINY = 1e-150  # what is smaller counts as nothing
TICKS_BETWEEN_SWEEPS = 1024


class Operators:
    """What the controller remembers of its signals, and how that is read.

    Remembered of the integrated signal v: its lags, its area and its last value. Of the differentiated signal w: the
    washouts s/(s + p) w, value, slope and the slopes of that, all of them behind its filter, and its last value before
    the filter. One product carries all that on and reads it:

        [remembered; 0; integral; derivative]  <-  matrix @ [remembered; correction; new v; new w]

    Constant work and memory per tick.

    Parameters
    ----------
    band : Band
    sample_time : float
        Time between ticks [s].
    filter_time : float
        Time constant of the lag before the derivative [s]; 0 for none.

    Attributes
    ----------
    matrix : ndarray, shape (size + 3, size + 3)
        The first ``size`` rows carry on what is remembered.
    integrated : int
        How much of what is remembered is of the integrated signal; it comes first.
    weights : ndarray, shape (2, size)
        By which integral and derivative are read.
    of_error : ndarray, shape (size,)
        What a unit of error, in both signals, adds to what is remembered.

    Examples
    --------
    >>> from fopid_core.runtime.filter_bank import integral_weights
    >>> from fopid_core.runtime.sampled_derivative import derivative_weights
    >>> band = Band(1e-2, 1e2, 10)
    >>> operators = Operators(band, sample_time=0.5)
    >>> operators.set_weights(integral_weights(band, 1.0), derivative_weights(band, 0.0, sample_time=0.5))
    >>> operators.push(2.0, 3.0)
    [0.5, 3.0]
    """

    def __init__(self, band: Band, sample_time: float, filter_time: float = 0.0) -> None:
        self._poles = poles = band.lag_poles()
        self._sample_time = sample_time
        integral = integrated_rows(poles, sample_time)
        filter_weights = lag_weights(filter_time, sample_time)
        derivative = differentiated_rows(poles, sample_time, filter_weights, (sample_time,) * 3)
        n, m = len(integral), len(derivative)
        self.integrated, self.size = n, n + m
        self.matrix = np.zeros((n + m + 3, n + m + 3), order="F")
        self._multiply: Callable[[Vector, Vector], object] = self.matrix.dot
        self.weights = np.zeros((2, n + m))
        self.of_error: Vector
        self.fill(integral, derivative)
        self._correction = np.zeros(n + m)
        self._now, self._next = np.zeros(n + m + 3), np.zeros(n + m + 3)
        self._outputs, self._next_outputs = self._now[-2:], self._next[-2:]
        self._ticks = 0

    def fill(self, integral: Matrix, derivative: Matrix) -> None:
        """Carry on what is remembered by these rows; how it is read is said again after that."""
        n, m = self.integrated, len(derivative)
        self.matrix[:n, :n], self.matrix[:n, -2] = integral[:, :n], integral[:, n]
        self.matrix[n:-3, n:-3], self.matrix[n:-3, -1] = derivative[:, :m], derivative[:, m]
        self.of_error = self.matrix[:-3, -2] + self.matrix[:-3, -1]

    def reset(self) -> None:
        """Forget everything: both signals have always been zero."""
        self._now[:] = 0.0

    def copy_state(self, other: Operators) -> float:
        """Remember what another one with the same band does, with the filter at rest.

        Returns
        -------
        float
            By how much the differentiated signal must be lower from now on to go on from there.
        """
        self._now[:] = other._now
        before, after = self._now[self.size - 1], self._now[self.size - 1 - DIFFERENCES]
        self._now[self.size - 1] = after
        return float(before - after)

    def forget_faster(self, time: float) -> None:
        """Take the differentiated signal for one that has stood still at its last value for so long [s].

        Its slopes are then zero, and each washout has decayed; no less than as many ticks as there are slopes, which
        stand for the same past. What noise has left in them is gone, the slow move of the signal is not.
        """
        n, poles = self.integrated, self._poles
        stood = max(time, (DIFFERENCES - 1) * self._sample_time)
        self._now[n : n + poles.size] *= np.exp(-poles * stood)
        self._now[n + poles.size + 1 : n + poles.size + DIFFERENCES] = 0.0

    def keep_in(self, matrix: Matrix, memory: Vector) -> None:
        """Let matrix and memory live in these arrays from now on: rows of a bank, which then does the ticks."""
        matrix[...], memory[...] = self.matrix, self._now
        self.matrix, self._now = matrix, memory
        self._multiply, self._outputs = matrix.dot, memory[-2:]

    def set_weights(self, integral: IntegralWeights, derivative: DerivativeWeights) -> None:
        """Read by these from now on; what is remembered stays."""
        n, weights = self.integrated, np.zeros_like(self.weights)
        weights[0, :n] = [*integral.lags, integral.integrator, integral.direct]
        weights[1, n:-1] = [*derivative.washouts, *derivative.differences]
        self.set_reading(weights)

    def set_reading(self, weights: Matrix) -> None:
        """Read by these from now on, shape (2, size): the weights of all that is remembered."""
        self.weights = weights
        self.matrix[-2:] = weights @ self.matrix[: self.size]

    def set_correction(self, correction: Vector) -> None:
        """What a unit of correction adds to what is remembered, shape (size,)."""
        self._correction = correction
        self.matrix[:, -3] = self.matrix[:, : self.size] @ correction

    def read(self) -> list[float]:
        """Integral and derivative now."""
        return (self.weights @ self._now[: self.size]).tolist()  # type: ignore[no-any-return]

    def correct(self, amount: float) -> None:
        """Correct what is remembered, without a tick."""
        self._now[: self.size] += amount * self._correction

    def push(self, integrated: float, differentiated: float, correction: float = 0.0) -> list[float]:
        """Correct what is remembered, take the next sample of both signals; return integral and derivative."""
        now, after = self._now, self._next
        now[-2], now[-1] = integrated, differentiated
        if correction:
            now[-3] = correction
        self._multiply(now, after)
        self._now, self._next = after, now
        self._outputs, self._next_outputs = self._next_outputs, self._outputs
        self._ticks += 1
        if self._ticks == TICKS_BETWEEN_SWEEPS:
            self._sweep()
        return self._outputs.tolist()  # type: ignore[no-any-return]

    def integral_after_one_tick(self) -> float:
        """What the integral is one sample after a unit step."""
        n = self.integrated
        held = self.matrix[:n, n - 1] + self.matrix[:n, -2]
        return float(self.weights[0, :n] @ held)

    def _sweep(self) -> None:
        """What has decayed to nothing becomes zero: numbers near 1e-308 would slow every product down."""
        self._now[np.abs(self._now) < TINY] = 0.0
        self._ticks = 0


def integrated_rows(p: Vector, h: float) -> Matrix:
    """[lags, area, value] after a tick, as a matrix on [lags, area, value, new value], for lags of these poles."""
    n = len(p)
    from_new = ramp_share(p * h) * h
    matrix = np.zeros((n + 2, n + 3))
    matrix[:n, :n] = np.diag(np.exp(-p * h))
    matrix[:n, n + 1] = -np.expm1(-p * h) / p - from_new
    matrix[:n, n + 2] = from_new
    matrix[n, n:] = 1.0, 0.5 * h, 0.5 * h
    matrix[n + 1, n + 2] = 1.0
    return matrix


def differentiated_rows(
    p: Vector, h: float, filter_weights: tuple[float, float, float], distances: tuple[float, ...]
) -> Matrix:
    """[washouts, differences, unfiltered value] after a tick, as a matrix on the same and the new value.

    A difference is the step since the last tick over its distance [s].
    """
    n, last = len(p), len(p) + DIFFERENCES
    matrix = np.zeros((last + 1, last + 2))
    matrix[n, [n, last, last + 1]] = filter_weights
    for row, distance in zip(range(n + 1, last), distances, strict=True):
        matrix[row] = matrix[row - 1] / distance
        matrix[row, row - 1] -= 1.0 / distance
    slope = matrix[n + 1]
    matrix[:n] = np.outer(-np.expm1(-p * h) / p, slope)  # a washout of w is a lag of w', constant between samples
    matrix[:n, :n] = np.diag(np.exp(-p * h))
    matrix[last, last + 1] = 1.0
    return matrix
