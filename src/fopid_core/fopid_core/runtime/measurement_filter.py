"""The filter of the measurement, sample by sample: one complex lag, discretised exactly.

1 / (1 + T s) and 1 / (1 + T s + (T s)^2 / 2) are both the real part of one lag with a pole p, real or complex. The
measurement is taken as linear between samples, as everywhere in the controller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.model.two_degrees import MeasurementFilter
from fopid_core.runtime.sampled_derivative import ramp_share

Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class FilterStep:
    """One tick of the lag: x <- decay x + from_last u_last + from_new u_new, and the real part of x is the output.

    Examples
    --------
    >>> step = FilterStep.of(MeasurementFilter(1, 0.5), sample_time=1e-9)
    >>> round(step.from_new.real, 12), round(step.decay.real, 6)
    (1e-09, 1.0)
    """

    decay: complex
    from_last: complex
    from_new: complex

    @staticmethod
    def of(wanted: MeasurementFilter, sample_time: float) -> FilterStep:
        """Of a filter that is not idle."""
        pole, gain = (1.0, 1.0) if wanted.order == 1 else (1.0 - 1.0j, -2.0j)
        ratio = pole * sample_time / wanted.time
        decay, whole = np.exp(-ratio), -np.expm1(-ratio) / pole
        new = complex(ramp_share(np.array([ratio]))[0]) * sample_time / wanted.time
        return FilterStep(complex(decay), complex(gain * (whole - new)), complex(gain * new))

    def response(self, z: Complexes) -> Complexes:
        """Output over input at z = exp(j theta)."""
        parts = [
            (last + new * z) / (z - decay)
            for decay, last, new in (
                (self.decay, self.from_last, self.from_new),
                (self.decay.conjugate(), self.from_last.conjugate(), self.from_new.conjugate()),
            )
        ]
        return np.asarray(0.5 * (parts[0] + parts[1]))


class RunningFilter:
    """What the filter remembers.

    Parameters
    ----------
    wanted : MeasurementFilter
        One that is not idle.
    sample_time : float
        [s]

    Examples
    --------
    >>> slow = RunningFilter(MeasurementFilter(2, 1.0), sample_time=0.5)
    >>> slow.rest_at(3.0)
    >>> slow.push(3.0), round(slow.push(4.0), 4)
    (3.0, 3.0646)
    """

    def __init__(self, wanted: MeasurementFilter, sample_time: float) -> None:
        self.wanted = wanted, sample_time
        self.set_interval(sample_time)
        self.rest_at(0.0)

    def set_interval(self, interval: float) -> None:
        """The samples to come are so far apart [s]."""
        self.step = FilterStep.of(self.wanted[0], interval)

    def rest_at(self, value: float) -> None:
        """The measurement has always been this."""
        self.origin = value
        self._x, self._last = 0j, 0.0

    def push(self, measurement: float) -> float:
        """Take the next sample; the filtered one."""
        now, step = measurement - self.origin, self.step
        self._x = step.decay * self._x + step.from_last * self._last + step.from_new * now
        self._last = now
        return self.origin + self._x.real
