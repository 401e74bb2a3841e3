"""Fractional powers of s at run time: one bank of first-order lags, read by weights.

On a band of frequencies s^-a with 0 < a < 1 is a weighted sum of lags 1/(s + p) with fixed,
logarithmically spaced poles p, an integrator and a direct term; only the weights depend on a. The bank
therefore keeps its memory when the orders change: new numbers change how it is read, not what it holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fopid_core.errors import InputError

Vector = NDArray[np.float64]

DECADES = 6.0  # width of the default band
DEFAULT_POLES = 14  # on six decades: 0.008 dB and 0.09 deg from the ideal, edge to edge
_EDGE = 3.0  # the poles reach this far beyond the band, so that its edges are as good as its middle
_SLOW = 300.0  # one further pole this far below the band stands for 1/s where an integrator may not
_POINTS_PER_DECADE = 40  # of the fit


@dataclass(frozen=True)
class Band:
    """The frequencies on which the fractional powers are met.

    Attributes
    ----------
    low, high : float
        Edges [rad/s].
    poles : int
        Number of lags spread over the band.
    """

    low: float
    high: float
    poles: int = DEFAULT_POLES

    def __post_init__(self) -> None:
        if not 0 < self.low < self.high < math.inf:
            raise InputError(f"band.low = {self.low}, band.high = {self.high}; allowed: 0 < low < high, finite [rad/s]")
        if not 2 <= self.poles <= 60:
            raise InputError(f"band.poles = {self.poles}; allowed: 2 to 60")

    @staticmethod
    def for_sample_time(sample_time: float) -> Band:
        """Six decades below the Nyquist frequency: at 10 ms, time scales up to an hour."""
        nyquist = math.pi / sample_time
        return Band(low=nyquist / 10**DECADES, high=nyquist)

    def lag_poles(self) -> Vector:
        """Poles p [rad/s] of the lags, slowest first; the first one lies far below the band."""
        spread = np.geomspace(self.low / _EDGE, self.high * _EDGE, self.poles)
        return np.concatenate(([self.low / _SLOW], spread))


@dataclass(frozen=True)
class Reading:
    """How a fractional operator is read from the bank's memory of its input v.

    The operator's output is ``integrator * (1/s) v + lags @ x + direct * v + slope * v' + curvature * v''``
    where x are the lags' outputs.
    """

    integrator: float
    lags: Vector
    direct: float
    slope: float = 0.0
    curvature: float = 0.0


@lru_cache(maxsize=256)
def integral_reading(band: Band, order: float) -> Reading:
    """The reading that makes s^-order, with 0 <= order <= 2.

    A true integrator stays in it for every order above zero, so that no steady-state error is left.

    Examples
    --------
    >>> integral_reading(Band(1e-3, 1e3), 1.0).integrator
    1.0
    """
    none = np.zeros(band.poles + 1)
    if order == 0.0:
        return Reading(0.0, none, 1.0)
    if order < 1.0:
        integrator, lags, direct = _fit(band, order, integrator=True)
        return Reading(integrator, lags, direct)
    if order == 1.0:
        return Reading(1.0, none, 0.0)
    # s^-order = 1/s * s^-(order-1), and 1/s * 1/(s+p) = (1/s - 1/(s+p)) / p
    _, lags, direct = _fit(band, order - 1.0, integrator=False)
    over_poles = lags / band.lag_poles()
    return Reading(float(over_poles.sum()) + direct, -over_poles, 0.0)


@lru_cache(maxsize=256)
def derivative_reading(band: Band, order: float) -> Reading:
    """The reading that makes s^order, with 0 <= order <= 2.

    Examples
    --------
    >>> derivative_reading(Band(1e-3, 1e3), 1.0).slope
    1.0
    """
    none = np.zeros(band.poles + 1)
    if order in (0.0, 1.0, 2.0):
        return Reading(0.0, none, float(order == 0.0), float(order == 1.0), float(order == 2.0))
    p = band.lag_poles()
    if order < 1.0:
        # s * (c/s + sum w/(s+p) + d) = c + sum w (1 - p/(s+p)) + d s
        c, w, d = _fit(band, 1.0 - order, integrator=True)
        return Reading(0.0, -w * p, c + float(w.sum()), d)
    # s^2 * (c/s + sum w/(s+p) + d) = c s + sum w (s - p + p^2/(s+p)) + d s^2
    c, w, d = _fit(band, 2.0 - order, integrator=True)
    return Reading(0.0, w * p**2, -float((w * p).sum()), c + float(w.sum()), d)


def _fit(band: Band, a: float, *, integrator: bool) -> tuple[float, Vector, float]:
    """Weights of integrator, lags and direct term for s^-a: least squares of the relative error."""
    decades = math.log10(band.high / band.low)
    s = 1j * np.geomspace(band.low, band.high, max(50, int(_POINTS_PER_DECADE * decades)))
    poles = band.lag_poles()
    # Either the integrator or the slow lag stands for what lies below the band: both would be alike on it.
    below = 1.0 / s if integrator else 1.0 / (s + poles[0])
    columns = np.stack([below, *(1.0 / (s + p) for p in poles[1:]), np.ones_like(s)], axis=1)
    relative = columns * (s**a)[:, np.newaxis]
    system = np.concatenate([relative.real, relative.imag])
    target = np.concatenate([np.ones(len(s)), np.zeros(len(s))])
    scale = np.linalg.norm(system, axis=0)
    weights = np.linalg.lstsq(system / scale, target, rcond=1e-13)[0] / scale
    lags = np.concatenate([[0.0 if integrator else weights[0]], weights[1:-1]])
    return (float(weights[0]) if integrator else 0.0), lags, float(weights[-1])


class FilterBank:
    """Lags, integrator and differences of one signal, exact for a signal that is linear between samples.

    Constant work and memory per tick.

    Parameters
    ----------
    band : Band
    sample_time : float
        Time between ticks [s].
    """

    def __init__(self, band: Band, sample_time: float) -> None:
        p = band.lag_poles()
        ph = p * sample_time
        hold = -np.expm1(-ph) / p  # response to a unit step after one sample
        self._sample_time = sample_time
        self._decay = np.exp(-ph)
        # The lags x obey x_k = decay x_(k-1) + (hold - from_new) v_(k-1) + from_new v_k. What is kept is
        # z_k = x_k - from_new v_k, which one multiplication and one addition carry on.
        self._from_new = _ramp_share(ph) * sample_time
        self._from_last = hold - self._from_new + self._decay * self._from_new
        self._hold = hold
        self._kept = np.zeros_like(p)
        self._scratch = np.zeros_like(p)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the input has always been zero."""
        self._kept[:] = 0.0
        self._integral = self._value = self._slope = self._curvature = 0.0

    def push(self, value: float) -> None:
        """Take the input's next sample."""
        self._kept *= self._decay
        np.multiply(self._from_last, self._value, out=self._scratch)
        self._kept += self._scratch
        self._integral += 0.5 * self._sample_time * (self._value + value)
        slope = (value - self._value) / self._sample_time
        self._curvature = (slope - self._slope) / self._sample_time
        self._slope, self._value = slope, value

    def bound(self, reading: Reading) -> Reading:
        """The reading for what this bank keeps; what ``read`` takes."""
        return replace(reading, direct=reading.direct + float(reading.lags @ self._from_new))

    def read(self, bound: Reading) -> float:
        """The operator's output now."""
        return (
            bound.integrator * self._integral
            + float(bound.lags.dot(self._kept))
            + bound.direct * self._value
            + bound.slope * self._slope
            + bound.curvature * self._curvature
        )

    def after_one_tick(self, reading: Reading) -> float:
        """What an integral's output is one sample time after a unit step."""
        return reading.integrator * self._sample_time + float(reading.lags @ self._hold) + reading.direct


def _ramp_share(ph: Vector) -> Vector:
    """(ph - 1 + exp(-ph)) / ph^2: what a lag keeps, per sample time, of an input that ramps from 0 to 1."""
    small = ph < 1e-3
    safe = np.where(small, 1.0, ph)
    series = 0.5 - ph / 6.0 + ph**2 / 24.0
    return np.where(small, series, (safe + np.expm1(-safe)) / safe**2)
