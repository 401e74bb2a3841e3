"""The program that a user of python-control and scipy would write, to measure ours against.

Nothing of this project's mathematics is used here: fractional powers are Oustaloup's rational approximation, the closed
loop is ``control.feedback``, the response ``control.step_response``, the tuning ``scipy.optimize.minimize``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.optimize import minimize
from scipy.special import rgamma

Real = NDArray[np.float64]

# Chosen in its favour: the cheapest of many that has the index of the benchmark's loop right to 0.1 %.
BAND = (1e-4, 1e3)  # of the approximation [rad/s]
SECTIONS = 6
POINTS = 501  # of a response
FREQUENCIES = np.logspace(-3, 3, 200)


def fractional_power(order: float) -> Any:
    """Oustaloup's approximation of s^order for -1 <= order <= 1, as a chain of first-order sections."""
    low, high = BAND
    k = np.arange(-SECTIONS, SECTIONS + 1)
    ratio, count = high / low, 2 * SECTIONS + 1
    zeros = low * ratio ** ((k + SECTIONS + 0.5 * (1 - order)) / count)
    poles = low * ratio ** ((k + SECTIONS + 0.5 * (1 + order)) / count)
    chain = control.ss([], [], [], [[high**order]])
    for zero, pole in zip(zeros, poles, strict=True):
        chain = chain * control.ss([[-pole]], [[1.0]], [[zero - pole]], [[1.0]])
    return chain


def integral(order: float) -> Any:
    """s^-order with a true integrator, so that there is no steady-state error."""
    return control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]]) * fractional_power(1.0 - order)


def derivative(order: float) -> Any:
    """s^order; above 1 the whole power is filtered at the upper end of the band to be proper."""
    if order <= 1.0:
        return fractional_power(order)
    high = BAND[1]
    return control.ss([[-high]], [[1.0]], [[-(high**2)]], [[high]]) * fractional_power(order - 1.0)


def closed_loop(process: Any, gains: Sequence[float] | Real) -> Any:
    """From the setpoint to the output, as a state space."""
    kp, ki, kd, lam, mu = gains
    controller = kp + ki * integral(lam) + kd * derivative(mu)
    return control.feedback(controller * process, 1)


def itae(process: Any, gains: Sequence[float] | Real, horizon: float, points: int = POINTS) -> float:
    """Integral of t |1 - y| by the trapezoid rule."""
    t = np.linspace(0.0, horizon, points)
    error = 1.0 - control.step_response(closed_loop(process, gains), t).outputs
    return float(trapezoid(t * np.abs(error), t))


def tune_itae(
    process: Any, horizon: float, ms_max: float, u_max: float, sample_time: float, start: Sequence[float]
) -> tuple[Real, int]:
    """Nelder-Mead on the index, with penalties for what is not allowed: gains and number of responses."""
    s = 1j * FREQUENCIES
    p = process(s)

    def cost(gains: Real) -> float:
        kp, ki, kd, lam, mu = gains
        if min(kp, ki, kd) < 0 or not 0.05 <= lam <= 1.95 or not 0.05 <= mu <= 1.95:
            return 1e6
        h = sample_time
        first_control = kp + ki * h**lam * rgamma(2 + lam) + kd * h**-mu * rgamma(2 - mu)
        ms = (1 / np.abs(1 + p * (kp + ki * s**-lam + kd * s**mu))).max()
        if first_control > u_max or ms > ms_max:
            return float(1e4 * (1.0 + first_control / u_max + ms / ms_max))
        loop = closed_loop(process, gains)
        if loop.poles().real.max() >= 0:
            return 1e5
        return itae(process, gains, horizon)

    found = minimize(
        cost, np.asarray(start), method="Nelder-Mead", options={"maxfev": 1500, "xatol": 1e-4, "fatol": 1e-4}
    )
    return np.asarray(found.x), int(found.nfev)
