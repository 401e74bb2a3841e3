"""s^mu of a signal that is known at its samples only, as weights on what is remembered of it.

A difference over the last tick is the slope half a tick ago: at a tenth of the Nyquist frequency it lags by 9 deg, a
second difference by 18. So the weights are those for which the *sampled* reading, filter included, is s^mu from the
low edge of the band to a tenth of the Nyquist frequency. That amplifies what is above: white noise comes out 1.3
times as large as from a plain difference for mu = 1, 2.9 times for mu = 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fopid_core.runtime.filter_bank import Band, Vector, fractional_weights, least_squares

DIFFERENCES = 4  # the value, its slope, the slope's slope, and the slope of that
WELL_SAMPLED = 0.1 * math.pi  # [rad per sample] up to here s^mu is met: a tenth of the Nyquist frequency
_FIRST = 0.03  # of that: below, lines between samples are good enough
_LOUDNESS = 7e-3  # weight of what is above, up to order 1
_ALIKE = 1e-6  # lags that are so nearly a difference are one: weights that cancel cost digits
_POINTS = 60  # of the fit up to there, evenly by ratio, and from there to the Nyquist frequency, evenly
_NO_FILTER, _NO_TIME = (0.0, 0.0, 1.0), 1e-12  # a lag so short, in sample times, is none


@dataclass(frozen=True)
class DerivativeWeights:
    """s^mu v = washouts @ [s/(s + p) v] + differences @ [v, its slope, the slope's slope, the slope of that].

    The washouts are those of lines between samples; a slope is the step since the last sample over the sample time.
    """

    washouts: Vector
    differences: Vector


@lru_cache(maxsize=256)
def derivative_weights(
    band: Band, order: float, sample_time: float, filter_time: float = 0.0, *, by_lags: bool = True
) -> DerivativeWeights:
    """The reading that makes s^order, with 0 <= order <= 2, of a signal sampled every ``sample_time`` [s].

    Within 0.1 dB and 1 deg from the band's low edge to a tenth of the Nyquist frequency, or to the band's high edge
    where that is lower; with a filter, of s^order / (1 + filter_time s). Above, where there is mostly noise, it is
    kept low. The weights move continuously with the order.

    Parameters
    ----------
    band : Band
    order : float
    sample_time : float
        [s]
    filter_time : float
        Time constant of the lag before the derivative [s]; 0 for none.
    by_lags : bool
        Whether the quick lags help with what lines between samples miss. Their weights nearly cancel, and are good for
        this sample time alone; without them the differences do what they can, nearly as well, near it too.

    Examples
    --------
    >>> derivative_weights(Band(1e-3, 1e3, 14), 0.0, 1e-3).differences
    array([1., 0., 0., 0.])
    """
    weights = _of_lines(band, order)
    if order == 0.0:
        return DerivativeWeights(*np.split(weights, [band.poles + 1]))
    theta, met = _frequencies(band, sample_time)
    s = 1j * theta / sample_time
    loudness = np.where(met, 1.0, _LOUDNESS / max(1.0, order))
    target = np.where(met, 1.0, max(0.0, 1.0 - order)) * loudness
    filtered = np.where(met, sampled_lag(filter_time, sample_time, theta) * (1.0 + filter_time * s), 1.0)
    columns = sampled_columns(band, sample_time, theta) * (filtered * loudness / s**order)[:, np.newaxis]
    ahead = _looking_ahead(band, sample_time, by_lags)
    weights = weights + ahead @ least_squares(columns @ ahead, target - columns @ weights, _ALIKE)
    return DerivativeWeights(*np.split(weights, [band.poles + 1]))


def _of_lines(band: Band, order: float) -> Vector:
    """Weights of washouts and differences that make s^order of continuous signals, shape (poles + 5,)."""
    differences = np.zeros(DIFFERENCES)
    if order in (0.0, 1.0, 2.0):
        differences[int(order)] = 1.0
        return np.concatenate([np.zeros(band.poles + 1), differences])
    below = math.floor(order)
    c, w, d = fractional_weights(band, 1.0 - (order - below), integrator=True)
    if below == 0:
        # s * (c/s + sum w/(s+p) + d) = c + sum w s/(s+p) + d s
        differences[:2] = c, d
        return np.concatenate([w, differences])
    # s^2 * (c/s + sum w/(s+p) + d) = c s + sum w (s - p s/(s+p)) + d s^2
    differences[1:3] = c + float(w.sum()), d
    return np.concatenate([-w * band.lag_poles(), differences])


def _looking_ahead(band: Band, h: float, by_lags: bool) -> NDArray[np.float64]:
    """What is added to weights, shape (poles + 5, n): the second and third difference, and s/p - s/(s + p).

    All of them vanish like s^2 towards low frequencies, so that constants and ramps are differentiated as in the
    books. Of the lags only those between a twentieth of the sampling and the sampling can help.
    """
    p = band.lag_poles()
    quick = np.flatnonzero(by_lags & (p * h > 0.03) & (p * h < 4.0))
    ahead = np.zeros((p.size + DIFFERENCES, quick.size + 2))
    ahead[p.size + 2, 0] = ahead[p.size + 3, 1] = 1.0
    for column, lag in enumerate(quick, start=2):
        ahead[p.size + 1, column], ahead[lag, column] = 1.0 / p[lag], -1.0
    return ahead


def _frequencies(band: Band, h: float) -> tuple[Vector, NDArray[np.bool_]]:
    """Where the weights are fitted [rad per sample], and where s^mu is to be met there."""
    last = min(WELL_SAMPLED, band.high * h)
    first = max(band.low * h, _FIRST * last)
    last = max(last, first)
    theta = np.concatenate([np.geomspace(first, last, _POINTS), np.linspace(last, math.pi, _POINTS + 1)[1:]])
    return theta, theta <= last


def sampled_columns(band: Band, sample_time: float, theta: Vector) -> NDArray[np.complex128]:
    """What a derivative is read off, at z = exp(j theta): washouts and differences, shape (n, poles + 5)."""
    p, back = band.lag_poles(), np.exp(-1j * theta)[:, np.newaxis]
    slope = -np.expm1(-1j * theta)[:, np.newaxis] / sample_time
    washouts = slope * (-np.expm1(-p * sample_time) / p) / (1.0 - np.exp(-p * sample_time) * back)
    return np.concatenate([washouts, slope ** np.arange(DIFFERENCES)], axis=1)


def sampled_lag(time: float, sample_time: float, theta: Vector) -> NDArray[np.complex128]:
    """1/(1 + time s) of lines between samples, at z = exp(j theta)."""
    decay, from_last, from_new = lag_weights(time, sample_time)
    back = np.exp(-1j * theta)
    return np.asarray((from_new + from_last * back) / (1.0 - decay * back))


def lag_weights(time: float, sample_time: float) -> tuple[float, float, float]:
    """Of a first-order lag's last output, last input and new input."""
    if time <= _NO_TIME * sample_time:
        return _NO_FILTER
    ratio = sample_time / time
    decay, from_new = math.exp(-ratio), ratio * float(ramp_share(np.array([ratio]))[0])
    return decay, 1.0 - decay - from_new, from_new


def ramp_share(ph: NDArray[Any]) -> NDArray[Any]:
    """(ph - 1 + exp(-ph)) / ph^2: what a lag keeps, per sample time, of an input that ramps from 0 to 1."""
    small = np.abs(ph) < 1e-3  # where the closed form loses digits
    safe = np.where(small, 1.0, ph)
    series = 0.5 - ph / 6.0 + ph**2 / 24.0
    return np.where(small, series, (safe + np.expm1(-safe)) / safe**2)
