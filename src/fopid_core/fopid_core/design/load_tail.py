"""How slowly the last of a load fades: an integral that hardly acts, or one of a low order, takes for ever."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process

LEFT_MAX = 0.02
"""Of the error after a load step, measured in the process's gain at the crossover, that may be left in the end."""
FADING_TURNS, FADING_LAGS, MOST_TURNS = 100.0, 5.0, 1000.0
"""When that is: after so many radians of the crossover, or in the time in which the process itself forgets a load, so
many of its lags, but for slow ones, up to so many radians."""
TURNS = 40.0
"""A loop has settled after so many radians of its crossover."""
_DECADES, _POINTS = 6.0, 241
_NEAR_REST = 1e-6  # of the crossover
_WEIGHTS = np.array([
    (-1.0) ** (k + 4) * sum(
        j**4 * math.factorial(2 * j)
        / (math.factorial(4 - j) * math.factorial(j) * math.factorial(j - 1) * math.factorial(k - j)
           * math.factorial(2 * j - k))
        for j in range((k + 1) // 2, min(k, 4) + 1)
    ) for k in range(1, 9)
])  # fmt: skip
_MULTIPLES = math.log(2.0) * np.arange(1.0, 9.0)


class LoadTail:
    """What a load has left long after its step, as a share of the process's gain at the crossover.

    From the transform at eight real arguments (Stehfest 1970), which is right for what fades without a swing to 1e-3
    of its beginning, and passes over swings; those are bounded by max |S|.

    Parameters
    ----------
    process : Process
    crossover : float
        Of the loop, or of the slowest that is meant [rad/s].

    Examples
    --------
    >>> tail = LoadTail(Process.parse("1/s"), 1.0)
    >>> [round(float(share), 4) for share in tail.left(np.array([[1.0, 0.05, 0, 1, 1], [0, 1, 0, 0.5, 1]]))]
    [0.0055, 0.0564]
    """

    def __init__(self, process: Process, crossover: float) -> None:
        s = _MULTIPLES / fading_time(process, crossover)
        with np.errstate(all="ignore"):
            self._inverse = 1.0 / np.asarray(process(s + 0j)).real
        self._log_s = np.log(s)
        self._weights = _WEIGHTS / np.arange(1.0, 9.0) / abs(complex(process(1j * crossover)))

    def left(self, gains: Floats) -> Floats:
        """The share that is left, for rows (kp, ki, kd, lam, mu); shape (n,)."""
        kp, ki, kd, lam, mu = gains.T[..., None]
        controller = kp + ki * np.exp(-lam * self._log_s) + kd * np.exp(mu * self._log_s)
        return np.asarray(np.abs((self._weights / (self._inverse + controller)).sum(axis=1)))


def fading_time(process: Process, crossover: float) -> float:
    """The time after which a load is to have faded [s].

    Examples
    --------
    >>> [round(fading_time(Process.parse(text), 1.0)) for text in ("1/s", "1/(s+1)", "1/(40s+1)", "1/(900s+1)")]
    [100, 100, 200, 1000]
    """
    s = _NEAR_REST * crossover
    with np.errstate(all="ignore"):
        residence = float(np.real(process(0.0 + 0j) / process(s + 0j)) - 1.0) / s  # infinite for an integrator
    lags = FADING_LAGS * residence if math.isfinite(residence) else 0.0
    return max(FADING_TURNS / crossover, min(lags, MOST_TURNS / crossover))


def slowest_crossover(process: Process, horizon: float, u_max: float) -> float:
    """What is meant by a horizon [s] and a bound on the control: the natural one, or a lower one [rad/s].

    The loop of such a crossover settles within the horizon, and its controller has no more gain than the bound there.
    """
    natural = natural_crossover(process, PHASE_MARGIN)
    w = natural * np.logspace(-_DECADES, 0.0, _POINTS)
    within = np.abs(process(1j * w)) * u_max >= 1.0
    return min(float(w[within][-1]) if within.any() else float(w[0]), TURNS / horizon)


def left_in_words(process: Process, controller: Fopid, crossover: float) -> str:
    """What a load has left, where that is more than is usual; else empty."""
    left = float(LoadTail(process, crossover).left(np.array([controller.gains]))[0])
    if left <= LEFT_MAX or not controller.ki:  # without an integral nobody expects that
        return ""
    after = f"after {fading_time(process, crossover):.3g} s"
    if left > 1.0:
        return f"; a load hardly fades: {after} its error is {left:.2g} times the process's gain at the crossover"
    return f"; a load fades slowly: {left:.2g} of its error is left {after}"
