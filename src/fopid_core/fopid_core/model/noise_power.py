"""How much the control moves from noise of the measurement: an integral over frequency, with its error."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_COARSE_NODES, _COARSE_WEIGHTS = np.polynomial.legendre.leggauss(6)
_RIGHT = 1e-9  # of the integral
_MOST_CUTS = 30
_MOST_INTERVALS = 200_000


def noise_rms(loop: Loop, density: float, nyquist: float) -> float:
    """Root mean square of the control that white noise of the measurement makes, up to a frequency.

    The root of ``density / pi`` times the integral of |C F S|^2 from 0 to there. NaN where it is not known: the loop is
    too close to the border of stability.

    Parameters
    ----------
    loop : Loop
        A stable one.
    density : float
        Two-sided power spectral density [unit^2/Hz]; for noise that is new at each tick the variance of a sample times
        the sample time.
    nyquist : float
        [rad/s]

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> loop = Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0))  # C S = (s + 1) / (s + 2)
    >>> abs(noise_rms(loop, math.pi, 2.0) ** 2 - (2.0 - 3.0 * math.atan(1.0) / 2.0)) < 1e-9
    True
    """
    peaks = LoopPeaks(loop)
    if not peaks.closed.decided[0]:
        return math.nan
    z = peaks.log_frequency
    inside = z[z < math.log(nyquist)]
    edges = np.concatenate([[0.0], np.exp(inside), [nyquist]])
    left, right = edges[:-1], edges[1:]
    total, count = 0.0, left.size
    for _ in range(_MOST_CUTS):
        fine, coarse = _gauss(loop, left, right)
        size = total + float(fine.sum())
        open_ = np.abs(fine - coarse) > _RIGHT * size / count
        total += float(fine[~open_].sum())
        if not open_.any() or 2 * int(open_.sum()) > _MOST_INTERVALS:
            total += float(fine[open_].sum())
            break
        middle = 0.5 * (left[open_] + right[open_])
        left, right = np.concatenate([left[open_], middle]), np.concatenate([middle, right[open_]])
    return math.sqrt(density / math.pi * total)


def _gauss(loop: Loop, left: Floats, right: Floats) -> tuple[Floats, Floats]:
    """The integral over each interval by Gauss's rules of ten and of six nodes."""
    middle, half = 0.5 * (left + right)[:, None], 0.5 * (right - left)[:, None]
    parts = []
    for nodes, weights in ((_NODES, _WEIGHTS), (_COARSE_NODES, _COARSE_WEIGHTS)):
        parts.append(_power(loop, middle + half * nodes) @ weights * half[:, 0])
    return parts[0], parts[1]


def _power(loop: Loop, w: Floats) -> Floats:
    s = 1j * w
    value = loop.controller(s) * loop.filter(s) * loop.sensitivity(s)
    return np.asarray(value.real**2 + value.imag**2)
