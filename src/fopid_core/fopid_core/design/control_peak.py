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


def open_control(gains: Real, time: Real) -> Real:
    """The ideal controller's control while nothing has come back yet, shape (n, instants), at instants above 0 [s].

    Notes
    -----
    kp + ki t^lam / Gamma(1 + lam) + kd t^-mu / Gamma(1 - mu), with the setpoint's weights as in ``first_control``. Of
    gains of one sign it is largest at an end of any interval.

    Examples
    --------
    >>> open_control(np.array([[2.0, 1.0, 0.5, 1.0, 1.0]]), np.array([0.5, 3.0])).tolist()
    [[2.5, 5.0]]
    """
    kp, ki, kd, lam, mu = _setpoint_columns(gains)
    return np.asarray(kp + ki * rgamma(1.0 + lam) * time**lam + kd * rgamma(1.0 - mu) * time**-mu)


def open_move(gains: Real, time: Real) -> Real:
    """The slope of ``open_control`` [1/s], shape (n, instants).

    Examples
    --------
    >>> open_move(np.array([[2.0, 3.0, 0.0, 2.0, 1.0]]), np.array([0.5])).tolist()
    [[1.5]]
    """
    _, ki, kd, lam, mu = _setpoint_columns(gains)
    return np.asarray(ki * rgamma(lam) * time ** (lam - 1.0) + kd * rgamma(-mu) * time ** (-mu - 1.0))


def _setpoint_columns(gains: Real) -> Real:
    """kp, ki, kd, lam, mu of what answers a setpoint, each of shape (n, 1)."""
    columns = gains.T[:5, :, None]
    if gains.shape[1] == 8:
        one = np.ones(len(gains))
        columns = columns * np.stack([gains[:, 6], one, gains[:, 7], one, one])[:, :, None]
    return np.asarray(columns)


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
