"""Fractional powers of s as weights: one bank of first-order lags, read for any order.

On a band of frequencies s^-a with 0 < a < 1 is a weighted sum of lags 1/(s + p) with fixed, logarithmically
spaced poles p, an integrator and a direct term; only the weights depend on a. What the lags remember is therefore
good for every order: new numbers change how it is read, not what it holds. Derivatives read the same lags; their
weights are in ``sampled_derivative``.
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
POLES_PER_DECADE = 2.0  # and two more: 0.04 dB and 0.17 deg from the ideal at most, edge to edge, on any band
WIDEST = 1e10  # high over low: on wider bands 16 digits do not tell a lag at one edge from an integrator
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
    poles: int = 14

    def __post_init__(self) -> None:
        if not 0 < self.low < self.high < math.inf:
            raise InputError(f"band.low = {self.low}, band.high = {self.high}; allowed: 0 < low < high, finite [rad/s]")
        if self.high > WIDEST * self.low:
            raise InputError(
                f"band.low = {self.low}, band.high = {self.high}; allowed: high up to {WIDEST:g} times low"
            )
        if not 2 <= self.poles <= 60:
            raise InputError(f"band.poles = {self.poles}; allowed: 2 to 60")

    @staticmethod
    def for_sample_time(
        sample_time: float, horizon: float = 0.0, *, low: float = 0.0, high: float = 0.0, poles: int = 0
    ) -> Band:
        """From the Nyquist frequency down to 1/horizon, with as many poles as that takes.

        Parameters
        ----------
        sample_time : float
            Time between ticks [s].
        horizon : float
            Longest time scale that matters [s]; 0 for six decades: at 10 ms, time scales up to an hour.
        low, high, poles
            Those that are not 0 stay as given; the number of poles goes by the edges in force.

        Examples
        --------
        >>> Band.for_sample_time(0.01).poles, Band.for_sample_time(0.01, horizon=50.0).poles
        (14, 11)
        """
        if not 0.0 < sample_time < math.inf:
            raise InputError(f"sample_time = {sample_time}; allowed: above 0, finite [s]")
        nyquist = math.pi / sample_time
        if horizon == 0.0:
            horizon = 10**DECADES / nyquist
        if not 10.0 * sample_time <= horizon <= 1e9 * sample_time:
            allowed = f"{10.0 * sample_time:g} to {1e9 * sample_time:g} at this sample time, 0 chooses [s]"
            raise InputError(f"horizon = {horizon}; allowed: {allowed}")
        band = Band(low or 1.0 / horizon, high or nyquist)
        decades = math.log10(band.high / band.low)
        return replace(band, poles=poles or 2 + math.ceil(POLES_PER_DECADE * decades - 1e-9))

    def lag_poles(self) -> Vector:
        """Poles p [rad/s] of the lags, slowest first; the first one lies far below the band."""
        spread = np.geomspace(self.low / _EDGE, self.high * _EDGE, self.poles)
        return np.concatenate(([self.low / _SLOW], spread))


@dataclass(frozen=True)
class IntegralWeights:
    """s^-lam v = integrator * (1/s) v + lags @ [1/(s + p) v] + direct * v."""

    integrator: float
    lags: Vector
    direct: float


@lru_cache(maxsize=256)
def integral_weights(band: Band, order: float) -> IntegralWeights:
    """The reading that makes s^-order, with 0 <= order <= 2.

    A true integrator stays in it for every order above zero, so that no steady-state error is left.

    Examples
    --------
    >>> integral_weights(Band(1e-3, 1e3, 14), 1.0).integrator
    1.0
    """
    none = np.zeros(band.poles + 1)
    if order == 0.0:
        return IntegralWeights(0.0, none, 1.0)
    if order < 1.0:
        return IntegralWeights(*fractional_weights(band, order, integrator=True))
    if order == 1.0:
        return IntegralWeights(1.0, none, 0.0)
    # s^-order = 1/s * s^-(order-1), and 1/s * 1/(s+p) = (1/s - 1/(s+p)) / p
    _, lags, direct = fractional_weights(band, order - 1.0, integrator=False)
    over_poles = lags / band.lag_poles()
    return IntegralWeights(float(over_poles.sum()) + direct, -over_poles, 0.0)


def fractional_weights(band: Band, a: float, *, integrator: bool) -> tuple[float, Vector, float]:
    """Weights of integrator, lags and direct term for s^-a: least squares of the relative error."""
    decades = math.log10(band.high / band.low)
    s = 1j * np.geomspace(band.low, band.high, max(50, int(_POINTS_PER_DECADE * decades)))
    poles = band.lag_poles()
    # Either the integrator or the slow lag stands for what lies below the band: both would be alike on it.
    below = 1.0 / s if integrator else 1.0 / (s + poles[0])
    columns = np.stack([below, *(1.0 / (s + p) for p in poles[1:]), np.ones_like(s)], axis=1)
    weights = least_squares(columns * (s**a)[:, np.newaxis], np.ones(len(s), dtype=complex))
    lags = np.concatenate([[0.0 if integrator else weights[0]], weights[1:-1]])
    return (float(weights[0]) if integrator else 0.0), lags, float(weights[-1])


def least_squares(columns: NDArray[np.complex128], target: NDArray[np.complex128], alike: float = 1e-13) -> Vector:
    """Real weights whose sum of columns, shape (n, weights), is nearest to the target, shape (n,).

    Columns that differ by less than ``alike`` of their size count as one: their weights would cancel.
    """
    system = np.concatenate([columns.real, columns.imag])
    scale = np.linalg.norm(system, axis=0)
    weights = np.linalg.lstsq(system / scale, np.concatenate([target.real, target.imag]), rcond=alike)[0]
    return np.asarray(weights / scale)
