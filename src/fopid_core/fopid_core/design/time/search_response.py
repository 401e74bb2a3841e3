"""Step responses of many controllers on one process, as fast as a search needs them.

One inverse FFT on the line s = a + j w gives a whole response (Dubner and Abate 1968). What does not depend on the
gains is worked out once. A smooth reference 1 / (1 + s/c)^4 is taken out of the output, and put back in time, so that
what is transformed both begins and ends at zero: then a small ``a`` is enough, and no error is blown up at late times.
``model.response`` is the accurate answer, with an error estimate.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fopid_core.model.process import Process

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

DAMPING = 6.0
"""exp(-6) of what is left of the error one period later leaks into the response."""


class ResponseGrid:
    """Responses to a unit setpoint step on evenly spaced instants.

    Parameters
    ----------
    process : Process
    horizon : float
        Last instant [s].
    points : int
        Number of steps up to there; a power of two is fastest.
    speed : float
        About the loop's crossover [rad/s], for the reference.

    Examples
    --------
    >>> grid = ResponseGrid(Process.parse("1/(s+1)"), horizon=20.0, points=1024, speed=1.0)
    >>> error = grid.errors(np.array([[0.0, 1.0, 0.0, 1.0, 1.0]]))[0]
    >>> exact = np.exp(-grid.time / 2) * (np.cos(0.75**0.5 * grid.time) + np.sin(0.75**0.5 * grid.time) / 3**0.5)
    >>> bool(np.abs(error - exact).max() < 1e-4)
    True
    """

    def __init__(self, process: Process, horizon: float, points: int, speed: float) -> None:
        self.time = np.linspace(0.0, horizon, points + 1)
        period = 2.0 * horizon
        s = DAMPING / period + 2j * math.pi / period * np.arange(points + 1)
        self._s, self._log_s, self._p = s, np.log(s), process(s)
        self._reference = 1.0 / (s * (1.0 + s / speed) ** 4)
        self._rise = np.exp(DAMPING / period * self.time) * (2 * points / period)
        x = speed * self.time
        self._reference_error = np.exp(-x) * (1.0 + x + x**2 / 2.0 + x**3 / 6.0)
        self._final_control = 0.0 if process.integrating_order > 0 else 1.0 / process.steady_state_gain
        self._taper = _taper(points + 1)

    def errors(self, gains: Real) -> Real:
        """Setpoint minus output, shape (n, points + 1), for rows (kp, ki, kd, lam, mu)."""
        loop = self._p * self._controller(gains)
        return self._reference_error - self._in_time(loop / (self._s * (1.0 + loop)) - self._reference)

    def controls(self, gains: Real) -> Real:
        """The control of the ideal controller, shape (n, points + 1); its first few instants are smoothed."""
        controller = self._controller(gains)
        settled = self._final_control
        moving = controller / (self._s * (1.0 + self._p * controller)) - settled * self._reference
        return settled * (1.0 - self._reference_error) + self._in_time(moving * self._taper)

    def _controller(self, gains: Real) -> Complex:
        kp, ki, kd, lam, mu = gains.T[..., None]
        return np.asarray(kp + ki * self._powers(-lam[:, 0]) + kd * self._powers(mu[:, 0]))

    def _powers(self, orders: Real) -> Complex:
        """s^order, shape (n, points + 1), each different order worked out once: most of the time goes here."""
        if len(orders) == 1:
            return np.asarray(np.exp(orders[0] * self._log_s)[None])
        different, which = np.unique(orders, return_inverse=True)
        return np.asarray(np.exp(different[:, None] * self._log_s)[which])

    def _in_time(self, transform: Complex) -> Real:
        return np.fft.irfft(transform, axis=1)[:, : len(self.time)] * self._rise


def _taper(size: int) -> Real:
    """One up to half the band, then smoothly down, so that a jump rings only near where it is."""
    position = np.linspace(0.0, 1.0, size)
    return np.where(position < 0.5, 1.0, np.cos(math.pi * (np.maximum(position, 0.5) - 0.5)) ** 2)
