"""The answer to a load step of the loop as it runs: the exact process behind a hold, the controller at every tick.

At z = exp(j theta) the measurement after a load step that begins with a tick is

    Y(z) = P(z) / (1 - 1/z) / (1 + C(z) P(z)),

with P(z) and C(z) of ``design.sampled_loop``; a stable loop's Y has no pole on the circle, so an inverse FFT gives y.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from fopid_core.design.sampled_loop import sampled_controller, sampled_process
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import ControllerSettings

_LOWEST = 1e-5
"""[rad per tick]; stands for z = 1."""


class SampledLoad:
    """Load steps on one process with many controllers, all with the same tick.

    Parameters
    ----------
    process : Process
    sample_time : float
        [s]
    horizon : float
        [s]; the answer is taken to have died out after twice that.
    """

    def __init__(self, process: Process, sample_time: float, horizon: float) -> None:
        self._process, self._h = process, sample_time
        self._ticks = math.ceil(horizon / sample_time)
        self._points = 1 << math.ceil(math.log2(2 * self._ticks))

    @cached_property
    def _theta(self) -> Floats:
        theta = np.linspace(0.0, math.pi, self._points // 2 + 1)
        theta[0] = _LOWEST
        return theta

    @cached_property
    def _sampled(self) -> np.ndarray:
        return sampled_process(self._process, self._h, self._theta)

    def answer(self, settings: ControllerSettings) -> Floats:
        """The measurement at every tick up to the horizon, shape (ticks,).

        Examples
        --------
        >>> from fopid_core.model.fopid import Fopid
        >>> load = SampledLoad(Process.parse("1/(s+1)"), 0.1, 40.0)
        >>> y = load.answer(ControllerSettings(Fopid(0.0, 1.0), 0.1))
        >>> round(float(y.sum() * 0.1), 2)  # without overshoot it would be 1 / ki
        1.0
        """
        controller = sampled_controller(FopidController(settings), self._theta)
        held = self._sampled / -np.expm1(-1j * self._theta)
        answer = np.fft.irfft(held / (1.0 + controller * self._sampled))[: self._ticks]
        # A fractional integral lets the answer fade so slowly that its tail comes round as a constant: y is 0 at first.
        return np.asarray(answer - answer[0])

    def iae(self, settings: ControllerSettings) -> float:
        """Integral of the absolute measurement."""
        return float(np.abs(self.answer(settings)).sum() * self._h)
