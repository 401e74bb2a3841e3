"""The controller as a transfer function: C(s) = kp + ki s^-lam + kd s^mu, eq. (16) of the paper."""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fopid_core import notebook
from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.two_degrees import WHOLE_SETPOINT, SetpointWeights

if TYPE_CHECKING:
    from fopid_core.model.loop import Loop
    from fopid_core.model.process import Process

LARGEST_GAIN = 1e100
"""Of kp, ki and kd, in size: beyond it products are no numbers any more."""

ORDER_RANGE = (0.0, 2.0)
"""Allowed orders lam and mu, as in section 4.1 of the paper."""


@dataclass(frozen=True)
class Fopid:
    """The five numbers of a fractional-order PID controller.

    Attributes
    ----------
    kp, ki, kd : float
        Proportional, integral and derivative gain, up to 1e100 in size, in units of the control over those of the
        error: kp as it is, ki times 1/s^lam, kd times s^mu, s in seconds.
    lam, mu : float
        Order of the integral and of the derivative, each in [0, 2].

    Examples
    --------
    >>> pid = Fopid(kp=2.0, ki=1.0, kd=0.5)
    >>> complex(pid(1j))
    (2-0.5j)
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    lam: float = 1.0
    mu: float = 1.0

    def __post_init__(self) -> None:
        for name in ("kp", "ki", "kd", "lam", "mu"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise InputError(f"{name} = {value}; allowed: a finite number")
            object.__setattr__(self, name, float(value))
        for name in ("kp", "ki", "kd"):
            if abs(getattr(self, name)) > LARGEST_GAIN:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: up to {LARGEST_GAIN:g} in size")
        low, high = ORDER_RANGE
        for name in ("lam", "mu"):
            if not low <= getattr(self, name) <= high:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: {low:g} to {high:g}")

    def __call__(self, s: ArrayLike) -> Complexes:
        """C(s) at every element of ``s`` (complex, principal branch, none of them zero)."""
        log_s = np.log(np.asarray(s, dtype=np.complex128))
        value = self.kp + self.ki * np.exp(-self.lam * log_s) + self.kd * np.exp(self.mu * log_s)
        return np.asarray(value, dtype=np.complex128)

    def derivative(self, s: ArrayLike) -> Complexes:
        """dC/ds at every element of ``s``."""
        s = np.asarray(s, dtype=np.complex128)
        log_s = np.log(s)
        slope = -self.lam * self.ki * np.exp(-self.lam * log_s) + self.mu * self.kd * np.exp(self.mu * log_s)
        derivative: Complexes = slope / s
        return derivative

    @property
    def integral_order(self) -> float:
        """The power of 1/s in the controller: ``lam``, or 0 without integral action."""
        return self.lam if self.ki else 0.0

    @property
    def integrates(self) -> bool:
        """Whether it remembers an error for good: an integral of order 0 is another proportional part."""
        return self.integral_order > 0.0

    @property
    def numerator(self) -> QuasiPolynomial:
        """C(s) times ``s**integral_order``."""
        return self.weighted_numerator(WHOLE_SETPOINT)

    def weighted_numerator(self, weights: SetpointWeights) -> QuasiPolynomial:
        """The same for the setpoint, of which the proportional and the derivative part see a share."""
        order, kp, kd = self.integral_order, self.kp * weights.proportional, self.kd * weights.derivative
        return QuasiPolynomial.of((Term(order, 0.0, kp), Term(0.0, 0.0, self.ki), Term(order + self.mu, 0.0, kd)))

    @property
    def gains(self) -> tuple[float, float, float, float, float]:
        """(kp, ki, kd, lam, mu)."""
        return astuple(self)

    def __mul__(self, process: Process) -> Loop:
        """The loop with a process: ``C * P``, or ``P * C``."""
        from fopid_core.model.loop import Loop
        from fopid_core.model.process import Process

        return Loop(process, self) if isinstance(process, Process) else NotImplemented

    __rmul__ = __mul__

    def _repr_html_(self) -> str:
        return notebook.table("kp + ki s^-lam + kd s^mu", asdict(self))

    def __str__(self) -> str:
        return f"{self.kp:.5g} + {self.ki:.5g} s^-{self.lam:.5g} + {self.kd:.5g} s^{self.mu:.5g}"


def read_gains(text: str) -> Fopid:
    """A controller from ``"KP,KI,KD,LAM,MU"``.

    Examples
    --------
    >>> read_gains("1, 0.5, 0, 0.9, 1").lam
    0.9
    """
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 5:
        raise InputError(f"gains {text!r}; allowed: five numbers KP,KI,KD,LAM,MU")
    return Fopid(*values)
