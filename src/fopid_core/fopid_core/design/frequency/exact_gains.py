"""The gains that meet phase margin, crossover and flat phase, eqs. (1) to (3), for given orders.

The three equations are linear in the gains: at s = j w_gc the controller must equal
c0 = e^(j(-pi + phase margin)) / P(s), and the flat phase reads Re[C'(s)/c0] = -Re[P'(s)/P(s)]. So every (lam, mu) has
exactly one design, found without iterating.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fopid_core.design.specification import require
from fopid_core.model.process import Process

Real = NDArray[np.float64]


@dataclass(frozen=True)
class ControllerTarget:
    """What the controller must be at s = j w_gc: the value c0, and a slope that makes the phase flat."""

    s: complex
    c0: complex
    flat: float

    @staticmethod
    def of(process: Process, phase_margin: float, crossover: float) -> ControllerTarget:
        """The target for a process, eqs. (1) to (3)."""
        s = 1j * crossover
        p = complex(process(s))
        require(0 < abs(p) < math.inf, f"|P| at the crossover {crossover:g} rad/s", abs(p), "above 0 and finite")
        c0 = cmath.exp(1j * (phase_margin - math.pi)) / p
        return ControllerTarget(s, c0, -complex(process.logarithmic_derivative(s)).real)

    def gains(self, lam: Real, mu: Real) -> Real:
        """Rows (kp, ki, kd, lam, mu), shape (n, 5); not finite where the equations contradict each other."""
        s, c0 = self.s, self.c0
        integral, derivative = np.exp(-lam * np.log(s)), np.exp(mu * np.log(s))
        # Im[C] = Im[c0] and the flat phase hold ki and kd only; then kp follows from Re[C] = Re[c0].
        i_im, d_im = integral.imag, derivative.imag
        i_flat, d_flat = (-lam * integral / (s * c0)).real, (mu * derivative / (s * c0)).real
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = i_im * d_flat - d_im * i_flat
            ki = (c0.imag * d_flat - d_im * self.flat) / determinant
            kd = (i_im * self.flat - i_flat * c0.imag) / determinant
            kp = c0.real - ki * integral.real - kd * derivative.real
        return np.stack([kp, ki, kd, lam, mu], axis=-1)


def exact_gains(process: Process, phase_margin: float, crossover: float, lam: ArrayLike, mu: ArrayLike) -> Real:
    """The gains that meet phase margin, crossover and flat phase exactly, eqs. (1) to (3).

    Parameters
    ----------
    process : Process
    phase_margin : float
        [rad]
    crossover : float
        [rad/s]
    lam, mu : array_like, shape (n,)

    Returns
    -------
    ndarray, shape (n, 5)
        Rows kp, ki, kd, lam, mu; not finite where the three equations contradict each other.

    Raises
    ------
    InputError
        If the process is zero or infinite at the crossover.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import read_process
    >>> gains = exact_gains(read_process("P1"), 1.2, 0.5, [1.1], [0.9])[0]
    >>> loop = Fopid(*gains)(0.5j) * read_process("P1")(0.5j)
    >>> bool(abs(loop - np.exp(1j * (1.2 - np.pi))) < 1e-12)
    True
    """
    return ControllerTarget.of(process, phase_margin, crossover).gains(np.asarray(lam, float), np.asarray(mu, float))


def has_one_sign(gains: Real) -> NDArray[np.bool_]:
    """Whether each row's kp, ki and kd are all positive or all negative (kp and kd may be zero)."""
    kp, ki, kd = gains[:, 0], gains[:, 1], gains[:, 2]
    return ((kp >= 0) & (ki > 0) & (kd >= 0)) | ((kp <= 0) & (ki < 0) & (kd <= 0))
