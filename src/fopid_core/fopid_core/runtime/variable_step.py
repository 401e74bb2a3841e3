"""The operators of a controller whose samples come at uneven intervals: discretised anew for each of them.

The lags, the area and the filter are carried over the measured interval exactly, for a signal that is linear between
its samples. Slopes are divided differences over the instants as they are. How a derivative is read off them makes good
that a slope is that of the middle of an interval; that is known at a few intervals, and between them linear in the
logarithm of the interval.
"""

from __future__ import annotations

import math

from fopid_core.errors import InputError
from fopid_core.runtime.filter_bank import Band, IntegralWeights
from fopid_core.runtime.operators import Operators, differentiated_rows, integrated_rows
from fopid_core.runtime.sampled_derivative import DerivativeWeights, derivative_weights, lag_weights

SHORTEST = 0.25
"""Of the sample time: samples that are closer make slopes of noise. The controller takes the next one instead."""
LONGEST = 1e3
"""Sample times between two samples."""
_PER_OCTAVE, _OCTAVES = 2, (-2, 3)


def check_interval(interval: float, sample_time: float) -> None:
    """Raise InputError for an interval that no controller of this sample time takes [s]."""
    low, high = SHORTEST * sample_time, LONGEST * sample_time
    if not low <= interval <= high:
        raise InputError(f"interval = {interval}; allowed: {low:g} to {high:g}, of a sample time of {sample_time:g} s")


class DerivativeReadings:
    """The weights of a derivative, by the interval to the sample before.

    Parameters
    ----------
    band : Band
    order : float
    sample_time, filter_time : float
        [s]

    Examples
    --------
    >>> readings = DerivativeReadings(Band(1e-2, 1e2, 10), 1.0, 0.1, 0.0)
    >>> readings.at(0.1).differences.round(3).tolist(), readings.at(0.2).differences.round(3).tolist()
    ([0.0, 1.0, 0.048, 0.002], [0.0, 1.0, 0.097, 0.007])
    """

    def __init__(self, band: Band, order: float, sample_time: float, filter_time: float) -> None:
        first, last = (_PER_OCTAVE * octave for octave in _OCTAVES)
        self._sample_time, self._first = sample_time, first
        self._known = [
            derivative_weights(band, order, sample_time * 2.0 ** (place / _PER_OCTAVE), filter_time, by_lags=False)
            for place in range(first, last + 1)
        ]

    def at(self, interval: float) -> DerivativeWeights:
        """The weights at an interval [s]; beyond those that are known, of the nearest."""
        place = _PER_OCTAVE * math.log2(interval / self._sample_time) - self._first
        place = min(max(place, 0.0), len(self._known) - 1.0)
        left = min(int(place), len(self._known) - 2)
        share, low, high = place - left, self._known[left], self._known[left + 1]
        if share == 0.0:
            return low
        return DerivativeWeights(
            (1.0 - share) * low.washouts + share * high.washouts,
            (1.0 - share) * low.differences + share * high.differences,
        )


class VariableOperators(Operators):
    """`Operators` whose ticks are as far apart as ``set_interval`` says before each.

    Parameters
    ----------
    band : Band
    sample_time : float
        Of ticks before which no interval is said [s].
    filter_time : float
        Time constant of the lag before the derivative [s]; 0 for none.

    Examples
    --------
    >>> from fopid_core.runtime.filter_bank import integral_weights
    >>> band = Band(1e-2, 1e2, 10)
    >>> operators = VariableOperators(band, sample_time=0.5)
    >>> operators.set_orders(integral_weights(band, 1.0), 1.0)
    >>> operators.push(0.0, 0.0)
    [0.0, 0.0]
    >>> operators.set_interval(1.0)
    >>> operators.push(2.0, 0.0)[0]
    1.0
    """

    def __init__(self, band: Band, sample_time: float, filter_time: float = 0.0) -> None:
        super().__init__(band, sample_time, filter_time)
        self._band, self._sample_time, self._filter_time = band, sample_time, filter_time
        self._intervals = (sample_time,) * 3  # of the last tick, and of the two before
        self._built = self._intervals
        self._readings: DerivativeReadings
        self._integral: IntegralWeights

    def reset(self) -> None:
        """Forget everything: both signals have always been zero, and the ticks a sample time apart."""
        super().reset()
        self._intervals = (self._sample_time,) * 3

    def set_orders(self, integral: IntegralWeights, mu: float) -> None:
        """Read by these from now on; what is remembered stays."""
        self._integral = integral
        self._readings = DerivativeReadings(self._band, mu, self._sample_time, self._filter_time)
        self.set_weights(integral, self._readings.at(self._built[0]))

    def set_interval(self, interval: float) -> None:
        """The next sample comes so long after the last one [s]; a correction is said again after this."""
        self._intervals = intervals = (interval, *self._intervals[:2])
        if intervals == self._built:
            return
        last, self._built = self._built[0], intervals
        h, before, long_before = intervals
        # Of equal intervals exactly that interval.
        distances = (h, h + 0.5 * (before - h), h + ((before - h) + (long_before - h)) / 3.0)
        derivative = differentiated_rows(self._poles, h, lag_weights(self._filter_time, h), distances)
        self.fill(integrated_rows(self._poles, h), derivative)
        if h != last:
            self.set_weights(self._integral, self._readings.at(h))
        else:
            self.set_reading(self.weights)
