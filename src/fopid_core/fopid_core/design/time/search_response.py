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
from fopid_core.model.two_degrees import filter_coefficients

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

Parts = tuple[Complex, Complex]

DAMPING = 6.0
"""exp(-6) of what is left of the error one period later leaks into the response."""


class Variables:
    """Rows of variables (kp, ki, kd, lam, mu), or with (filter time, b, c) behind them, as columns, shape (n, 1).

    Parameters
    ----------
    rows : ndarray, shape (n, 5) or (n, 8)
    filter_order : int
    """

    def __init__(self, rows: Real, filter_order: int = 0) -> None:
        columns: Real = rows.T[..., None]
        self.kp, self.ki, self.kd, self.lam, self.mu = columns[:5]
        self.is_plain = len(columns) == 5
        one = np.ones((1, 1))
        rest: Real = np.stack([0.0 * one, one, one]) if self.is_plain else columns[5:]
        self.filter_time, self.b, self.c = rest
        self._filter_order = filter_order

    def feedback(self, log_w: Real | Complex) -> Complex:
        """C F at s = j w, shape (n, frequencies); a complex ln w is ln(s / j) of any s."""
        return self.filtered(self.controller(log_w), 1j * np.exp(log_w))

    def controller(self, log_w: Real | Complex) -> Complex:
        """C at s = j w, shape (n, frequencies)."""
        integral = self.ki * np.exp(-0.5j * math.pi * self.lam) * np.exp(-self.lam * log_w)
        derivative = self.kd * np.exp(0.5j * math.pi * self.mu) * np.exp(self.mu * log_w)
        return np.asarray(self.kp + integral + derivative)

    def filtered(self, controller: Complex, s: Complex) -> Complex:
        """C F from C at the same s."""
        return np.asarray(controller / self.inverse_filter(s)) if self.has_filter else np.asarray(controller)

    @property
    def has_filter(self) -> bool:
        """Whether the measurement is filtered."""
        return not self.is_plain and self._filter_order > 0

    def inverse_filter(self, s: Complex) -> Complex:
        """1 / F, of a filter that there is, shape (n, points)."""
        delayed = self.filter_time * s
        *parts, last = filter_coefficients(self._filter_order, 1.0)
        slow = last * delayed  # by Horner's rule: powers of complex numbers take long
        for part in parts[:0:-1]:
            slow = (slow + part) * delayed
        return np.asarray(slow + parts[0])


class ResponseGrid:
    """Responses to a unit step of the setpoint or of a load on evenly spaced instants.

    Parameters
    ----------
    process : Process
    horizon : float
        Last instant [s].
    points : int
        Number of steps up to there; a power of two is fastest.
    speed : float
        About the loop's crossover [rad/s], for the reference.
    filter_order : int
        Of the filter of the measurement.

    Examples
    --------
    >>> grid = ResponseGrid(Process.parse("1/(s+1)"), horizon=20.0, points=1024, speed=1.0)
    >>> error = grid.errors(np.array([[0.0, 1.0, 0.0, 1.0, 1.0]]))[0]
    >>> exact = np.exp(-grid.time / 2) * (np.cos(0.75**0.5 * grid.time) + np.sin(0.75**0.5 * grid.time) / 3**0.5)
    >>> bool(np.abs(error - exact).max() < 1e-4)
    True
    """

    def __init__(self, process: Process, horizon: float, points: int, speed: float, filter_order: int = 0) -> None:
        self.time = np.linspace(0.0, horizon, points + 1)
        period = 2.0 * horizon
        s: Complex = np.asarray(DAMPING / period + 2j * math.pi / period * np.arange(points + 1))
        self._s = s
        self._log_s, self._p = np.log(s), process(s)
        self._filter_order = filter_order
        self._reference = 1.0 / (s * (1.0 + s / speed) ** 4)
        self._rise = np.exp(DAMPING / period * self.time) * (2 * points / period)
        x = speed * self.time
        self._reference_error = np.exp(-x) * (1.0 + x + x**2 / 2.0 + x**3 / 6.0)
        self._inverse_gain = 0.0 if process.integrating_order > 0 else 1.0 / process.steady_state_gain
        self._taper = _taper(points + 1)

    @property
    def line(self) -> Complex:
        """Where transforms are taken, s = a + j w, shape (points + 1,)."""
        return self._s

    @property
    def control_at_rest(self) -> float:
        """Size of the control that holds a unit setpoint."""
        return abs(self._inverse_gain)

    def errors(self, gains: Real, parts: Parts | None = None) -> Real:
        """Setpoint minus output, shape (n, points + 1), for rows of variables; with ``parts`` known it is quicker."""
        forward, loop = parts or self.parts(gains)
        return self._reference_error - self._in_time(self._p * forward / (self._s * (1.0 + loop)) - self._reference)

    def load_errors(self, gains: Real, parts: Parts | None = None) -> Real:
        """The same after a unit step that adds to the control."""
        loop = (parts or self.parts(gains))[1]
        final = self._final_of_load(gains)
        moving = self._p / (self._s * (1.0 + loop)) - final * self._reference
        return -final * (1.0 - self._reference_error) - self._in_time(moving)

    def controls(self, gains: Real) -> Real:
        """The control of the ideal controller, shape (n, points + 1); its first few instants are smoothed."""
        forward, loop = self.parts(gains)
        settled = self._inverse_gain
        moving = forward / (self._s * (1.0 + loop)) - settled * self._reference
        return settled * (1.0 - self._reference_error) + self._in_time(moving * self._taper)

    def load_controls(self, gains: Real) -> Real:
        """The control after a unit step that adds to it, shape (n, points + 1): what the loop answers it with."""
        loop = self.parts(gains)[1]
        final = np.where(gains[:, 1:2] == 0.0, self._final_of_load(gains) * self._inverse_gain - 1.0, -1.0)
        moving = -loop / (self._s * (1.0 + loop)) - final * self._reference
        return final * (1.0 - self._reference_error) + self._in_time(moving)

    def _final_of_load(self, gains: Real) -> Real:
        """What a load leaves without integral action, shape (n, 1)."""
        kp, ki = gains[:, :1], gains[:, 1:2]
        stiffness = self._inverse_gain + kp
        return np.where((ki == 0.0) & (stiffness != 0.0), 1.0 / np.where(stiffness, stiffness, 1.0), 0.0)

    def parts(self, gains: Real) -> Parts:
        """What the setpoint goes through to the control, and the loop L."""
        v = Variables(gains, self._filter_order)
        integral = v.ki * self._powers(-gains[:, 3])
        derivative = v.kd * self._powers(gains[:, 4])
        controller = v.kp + integral + derivative
        if v.is_plain:
            return np.asarray(controller), np.asarray(self._p * controller)
        loop = self._p * v.filtered(np.asarray(controller, dtype=np.complex128), self._s)
        return np.asarray(v.b * v.kp + integral + v.c * derivative), np.asarray(loop)

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
