"""What is taken when a specification leaves it open: read off the process's own frequency response."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fopid_core.errors import InputError
from fopid_core.model.process import Process

PHASE_MARGIN = math.radians(60.0)
"""The middle of the 45 to 75 degrees that textbooks recommend [rad]."""

MS_MAX = 1.6
"""Between the 1.4 (robust) and 2.0 (fast) of Astrom and Hagglund; without a bound every index says more gain."""

U_MAX = 20.0
"""For a process of gain 1: twenty times the control that holds the setpoint."""

_W = np.logspace(-7.0, 7.0, 1401)


def natural_crossover(process: Process, phase_margin: float) -> float:
    """The frequency at which the process alone has the phase that the margin asks of the loop [rad/s].

    A process that never lags so far (a first-order lag) is taken where it has nine tenths of its own largest lag, one
    with the same phase everywhere (an integrator) where its gain is 1.

    Examples
    --------
    >>> round(natural_crossover(Process.parse("1/(s+1)^3"), math.radians(60.0)), 1)
    0.8
    """
    lag, gain = lag_and_gain(process)
    turning = np.ptp(lag) > math.radians(5.0)
    if not turning:
        return float(_W[np.argmin(np.abs(np.log(gain)))])
    wished = min(math.pi - phase_margin, lag[0] + 0.9 * (lag.max() - lag[0]))
    reached = np.flatnonzero(lag >= wished)
    return float(_W[reached[0]])


def lag_and_gain(process: Process) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Phase lag of the process (of positive gain) and its gain, where both are finite and not zero."""
    with np.errstate(all="ignore"):
        value = process(1j * _W)
    if not np.all(np.isfinite(value)) or np.any(value == 0.0):
        raise InputError(f"process {process} is zero or infinite at some frequency; allowed: give the crossover")
    lag = -np.unwrap(np.angle(value))
    return lag - 0.5 * math.pi * round(2.0 * lag[0] / math.pi) + 0.5 * math.pi * process.integrating_order, np.abs(value)
