"""The bound on max |S| of the loop as it runs, sampled and held, of many controllers at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.sampled_loop import sampled_process
from fopid_core.design.time.bands import least_in_bands, log_size
from fopid_core.design.time.search_response import Variables
from fopid_core.model.process import Process
from fopid_core.model.winding import right_half_plane_zeros

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

DECADES, POINTS, BANDS = 3.5, 240, 12
"""Below the Nyquist frequency."""


class SampledBound:
    """Max |S| and stability of the sampled loop.

    The process behind its hold is exact; the controller is taken at (1 - 1/z) / h in place of s, the backward
    difference and its fractional powers, which is near to what runs and smooth in all numbers. What is found is
    verified with the controller itself (`fopid_core.design.sampled_loop.running`).

    Parameters
    ----------
    process : Process
        Without its hold.
    sample_time : float
        [s]
    filter_order : int
    """

    def __init__(self, process: Process, sample_time: float, filter_order: int) -> None:
        self._log_theta = np.linspace(math.log(math.pi) - DECADES * math.log(10.0), math.log(math.pi), POINTS)
        theta = np.exp(self._log_theta)
        self._difference = -np.expm1(-1j * theta) / sample_time
        self._log_w = np.log(self._difference) - 0.5j * math.pi
        self._p = sampled_process(process, sample_time, theta)
        self._filter_order, self._integrating = filter_order, process.integrating_order
        self._unstable = int(right_half_plane_zeros(process.denominator).count[0])

    def slack(self, gains: Real, ms_max: float) -> Real:
        """Logarithm of what is left to the bound, shape (n, bands)."""
        left = least_in_bands(log_size(1.0 + self._loop(gains)), self._log_theta, BANDS)
        return np.asarray(math.log(ms_max) + left)

    def stable(self, gains: Real) -> NDArray[np.bool_]:
        """Which loops are stable, by the turns of 1 + L about the origin up to the Nyquist frequency, shape (n,)."""
        order = gains[:, 3:4] * (gains[:, 1:2] != 0.0) + self._integrating
        distance = (1.0 + self._loop(gains)) * self._difference**order
        begin = distance[:, 0] / np.sign(distance[:, 0].real)
        turned = np.angle(begin) + np.angle(distance[:, 1:] / distance[:, :-1]).sum(axis=1)
        return np.asarray(np.round(turned / math.pi) == self._unstable)

    def _loop(self, gains: Real) -> Complex:
        return self._p * Variables(gains, self._filter_order).feedback(self._log_w)
