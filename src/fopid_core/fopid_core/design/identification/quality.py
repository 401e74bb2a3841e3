"""How good a learnt model is: fit on held-back data, whiteness of the residual, uncertainty of the numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from fopid_core.design.identification.fit import Fit
from fopid_core.model.arrays import Booleans, Floats

WHITE = 0.01
"""A residual counts as white unless chance alone would make it less white in fewer than so many cases."""
_LAGS = 20
_STEP = 1e-6
_AT_BOUND = 1e-6


@dataclass(frozen=True)
class Whiteness:
    """The test of Ljung and Box (1978) on a residual: noise, or something that the model has missed.

    Attributes
    ----------
    statistic : float
        Chi-squared distributed with ``lags`` degrees of freedom for white noise.
    lags : int
    p_value : float
        Probability that white noise has a larger statistic.
    correlation : float
        Largest autocorrelation: about the share of the residual's variance that a richer model could explain.
    """

    statistic: float
    lags: int
    p_value: float
    correlation: float

    @property
    def white(self) -> bool:
        """Whether the residual passes for white noise."""
        return self.p_value >= WHITE


def fit_pct(measurement: Floats, residual: Floats) -> float:
    """100 (1 - |residual| / |measurement - mean|), in per cent; -inf where the measurement does not move.

    Examples
    --------
    >>> fit_pct(np.array([0.0, 1.0, 2.0]), np.array([0.1, -0.2, 0.1]))
    82.67...
    """
    spread = float(np.linalg.norm(measurement - measurement.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(residual)) / spread) if spread else -math.inf


def autocorrelation(residual: Floats, lags: int) -> Floats:
    """At lags 1 to ``lags``, shape (lags,)."""
    e = residual - residual.mean()
    power = float(e @ e) or 1.0
    return np.array([float(e[k:] @ e[:-k]) / power for k in range(1, lags + 1)])


def whiteness(residual: Floats) -> Whiteness:
    """Test a residual, shape (n,), at 20 lags or a fifth of its length."""
    n = residual.size
    lags = min(_LAGS, n // 5)
    rho = autocorrelation(residual, lags)
    statistic = float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return Whiteness(statistic, lags, float(chdtrc(lags, statistic)), float(rho.max()))


def covariance(found: Fit) -> Floats:
    """Of the free numbers and the linear ones, as far as the samples that were fitted tell, shape (k, k).

    Samples of a residual that is correlated over some time count as fewer: their number is divided by the sum of the
    autocorrelation up to its first zero on both sides. Numbers at a bound of their range have no variance.
    """
    slopes = found.sensitivity[found.rows]
    free = _inside(found)
    sizes = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    inverse = np.zeros((slopes.shape[1],) * 2)
    inverse[np.ix_(free, free)] = np.linalg.pinv((slopes / sizes)[:, free].T @ (slopes / sizes)[:, free], rcond=1e-13)
    scaled: Floats = noise_power(found) * inverse / np.outer(sizes, sizes)
    return scaled


def noise_power(found: Fit) -> float:
    """Variance of the residual, times how many samples of it count as one."""
    residual = found.residual[found.rows]
    freedom = max(residual.size - int(_inside(found).sum()), 1)
    return float(residual @ residual) / freedom * correlation_time(residual)


def _inside(found: Fit) -> Booleans:
    """Which numbers are not held by a bound; a delay of zero could still be longer."""
    low, high = found.structure.bounds(found.response.sample_time, float(found.response.time[-1]))
    free = np.ones(found.x.size + found.coefficients.size, dtype=bool)
    free[: found.x.size] = np.minimum(found.x - low, high - found.x) > _AT_BOUND * (high - low)
    free[found.x.size - 1] = True
    return free


def correlation_time(residual: Floats) -> float:
    """In samples; 1 for white noise."""
    rho = autocorrelation(residual, residual.size // 4)
    end = int(np.argmax(rho <= 0.0)) if np.any(rho <= 0.0) else rho.size
    return 1.0 + 2.0 * float(np.sum(rho[:end]))


def relative_deviation(found: Fit, spread: Floats, frequency: float) -> float:
    """Standard deviation of the model at a frequency [rad/s], as a share of its size there."""
    s = np.array([1j * frequency])
    _, slopes = found.structure.denominator(found.x, np.log(s))
    powers = s ** np.arange(found.gains.size)
    numerator = complex(found.gains @ powers)
    row = np.concatenate([[-complex(slope[0]) for slope in slopes], -s, powers / numerator])
    size = row.size
    return float(np.sqrt(abs(row @ spread[:size, :size] @ row.conj())))


def parameter_covariance(found: Fit, spread: Floats) -> Floats:
    """Of the parameters that people know, in their order, to first order."""
    numbers = np.concatenate([found.x, found.gains])
    count = found.x.size

    def named(values: Floats) -> Floats:
        return np.array(list(found.structure.parameters(values[:count], values[count:]).values()))

    steps = _STEP * np.maximum(np.abs(numbers), 1e-3)
    moved = [(named(numbers + step) - named(numbers - step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    slopes = np.stack(moved, axis=1)
    matrix: Floats = slopes @ spread[: numbers.size, : numbers.size] @ slopes.T
    return matrix
