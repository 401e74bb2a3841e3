"""The first control after a setpoint step, of the controller as it runs.

The ideal controller answers a setpoint step with an infinite control as soon as it differentiates. The controller as it
runs knows the error at its samples only, so its first control is finite and linear in the gains.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import rgamma

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

Real = NDArray[np.float64]


def first_control(gains: Real, sample_time: float) -> Real:
    """The control at the first sample after a unit setpoint step, shape (n,), for rows (kp, ki, kd, lam, mu).

    Rows of eight have the time of a filter of the measurement behind that, which changes nothing here, and the
    weights of the setpoint.

    Notes
    -----
    kp + ki h^lam / Gamma(2 + lam) + kd h^-mu r(mu), where r(mu) is the first weight of the sampled derivative.

    Examples
    --------
    >>> round(float(first_control(np.array([[2.0, 1.0, 0.5, 1.0, 1.0]]), sample_time=0.1)[0]), 2)
    8.56
    """
    kp, ki, kd, lam, mu = gains.T[:5]
    h = sample_time
    derivative = kd * h**-mu * _derivative_kick()(mu)
    if gains.shape[1] == 8:
        kp, derivative = gains[:, 6] * kp, gains[:, 7] * derivative
    return np.asarray(kp + ki * h**lam * rgamma(2.0 + lam) + derivative)


@cache
def _derivative_kick() -> Callable[[Real], Real]:
    """r(mu), read off the controller itself; at a sample time of 1 s, since it does not depend on it."""
    orders = np.linspace(0.0, 2.0, 41)
    kicks = [FopidController(ControllerSettings(Fopid(0.0, 0.0, 1.0, 1.0, mu), 1.0)).step(1.0, 0.0) for mu in orders]
    fine = np.linspace(0.0, 2.0, 4001)
    below, above = orders <= 1.0, orders >= 1.0  # noise is weighed otherwise above 1: a kink
    splines = [CubicSpline(orders[part], np.array(kicks)[part]) for part in (below, above)]
    table = np.where(fine <= 1.0, splines[0](fine), splines[1](fine))
    return lambda mu: np.interp(mu, fine, table)
