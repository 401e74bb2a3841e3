"""The peaks of |S|, |T| and |C S| of one loop, exact, on any band of frequencies."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.model.loop import Loop
from fopid_core.model.peaks import Band, Peak, highest, limits
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.winding import Zeros, right_half_plane_zeros

EVERYWHERE: Band = (0.0, math.inf)

_LOG_STEP = 0.04  # 58 points a decade, more where a zero of 1 + L, or a pole or zero of L, is near the axis


@dataclass(frozen=True)
class LoopPeaks:
    """What a loop does at the frequencies where it does most.

    A peak is NaN where it is not known: when the loop is too close to the border of stability to call. One that was
    sought once is not sought again.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> peaks = LoopPeaks(Loop(Process.parse("1/(s^2+2e-6s+1)"), Fopid(kp=3.0)))
    >>> round(peaks.complementary().value, 1), round(peaks.complementary().frequency, 6)
    (750000.0, 2.0)
    """

    loop: Loop
    _found: dict[tuple[str, Band], Peak] = field(default_factory=dict, init=False, repr=False, compare=False)

    def sensitivity(self, band: Band = EVERYWHERE) -> Peak:
        """Of |S|, on a band [rad/s]."""
        return self._highest("S", self.loop.open_loop_denominator, band)

    def complementary(self, band: Band = EVERYWHERE) -> Peak:
        """Of |T|, on a band [rad/s]."""
        return self._highest("T", self.loop.open_loop_numerator, band)

    def weighted_complementary(self) -> Peak:
        """Of w |T(jw)| [rad/s]."""
        return self._highest("w T", self.loop.open_loop_numerator.shifted(1.0), EVERYWHERE)

    def noise_gain(self, band: Band = EVERYWHERE) -> Peak:
        """Of |C S|, from measurement noise to control, on a band [rad/s]."""
        return self._highest("C S", self.loop.controller.numerator * self.loop.process.denominator, band)

    def _highest(self, name: str, numerator: QuasiPolynomial, band: Band) -> Peak:
        if (name, band) not in self._found:
            self._found[name, band] = self._sought(numerator, band)
        return self._found[name, band]

    def _sought(self, numerator: QuasiPolynomial, band: Band) -> Peak:
        known = numerator.is_zero or self.closed.decided[0] or math.inf in limits(numerator, self.loop.characteristic)
        if not known or self.loop.process.cancels_at_origin:
            return Peak(math.nan, math.nan)
        return highest(numerator, self.loop.characteristic, self.log_frequency, band)

    @cached_property
    def closed(self) -> Zeros:
        """The unstable poles of the closed loop."""
        return right_half_plane_zeros(self.loop.characteristic)

    @cached_property
    def log_frequency(self) -> Floats:
        """Ascending ln w over all that happens in the loop, close together where a pole or a zero is near the axis."""
        others = (self.loop.process.denominator, self.loop.open_loop_numerator)
        zeros = [self.closed, *(right_half_plane_zeros(part) for part in others if not part.is_zero)]
        dense = np.concatenate([[0.0], *(found.log_frequency for found in zeros)])
        low, high = dense.min() - 1.0, dense.max() + 1.0
        z: Floats = np.union1d(dense, np.linspace(low, high, math.ceil((high - low) / _LOG_STEP) + 1))
        return z
