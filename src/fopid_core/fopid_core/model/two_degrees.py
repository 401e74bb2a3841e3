"""What makes the five numbers a controller of two degrees of freedom: a filter of the measurement, setpoint weights.

    u = kp (b r - F y) + ki s^-lam (r - F y) + kd s^mu (c r - F y)

The filter is in the loop, the weights are not: they shape the answer to the setpoint alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.quasipolynomial import QuasiPolynomial

Number = TypeVar("Number", float, Floats)

FILTER_ORDERS = (0, 1, 2)
LONGEST_FILTER = 1e9
"""[s]"""


@dataclass(frozen=True)
class MeasurementFilter:
    """F(s) = 1, 1 / (1 + T s) or 1 / (1 + T s + (T s)^2 / 2), the latter of damping 0.71.

    Attributes
    ----------
    order : int
        0 for none.
    time : float
        T [s]; the group delay at low frequency, whatever the order.

    References
    ----------
    Astrom and Hagglund, Advanced PID Control (2006), section 3.3.

    Examples
    --------
    >>> complex(MeasurementFilter(2, 1.0)(2j).round(3))
    (-0.2-0.4j)
    """

    order: int = 0
    time: float = 0.0

    def __post_init__(self) -> None:
        if self.order not in FILTER_ORDERS:
            raise InputError(f"filter order = {self.order}; allowed: 0, 1 or 2")
        if not 0.0 <= self.time <= LONGEST_FILTER:
            raise InputError(f"filter time = {self.time}; allowed: 0 to {LONGEST_FILTER:g} s")

    @property
    def is_idle(self) -> bool:
        """Whether it lets everything pass."""
        return self.order == 0 or self.time == 0.0

    @property
    def lag(self) -> float:
        """How far it lags behind [s]."""
        return 0.0 if self.is_idle else self.time

    @property
    def denominator(self) -> QuasiPolynomial:
        """1 / F(s)."""
        return QuasiPolynomial.polynomial(filter_coefficients(self.order, self.time)[::-1])

    def __call__(self, s: ArrayLike) -> Complexes:
        """F(s) at every element of ``s``."""
        return np.asarray(1.0 / self.denominator(s))

    def __str__(self) -> str:
        return "no filter" if self.is_idle else f"filter of order {self.order}, {self.time:.4g} s"


@dataclass(frozen=True)
class SetpointWeights:
    """How much of the setpoint the proportional and the derivative part see.

    Attributes
    ----------
    proportional, derivative : float
        b and c, 0 to 1.
    """

    proportional: float = 1.0
    derivative: float = 1.0

    def __post_init__(self) -> None:
        for name in ("proportional", "derivative"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"setpoint weight ({name}) = {getattr(self, name)}; allowed: 0 to 1")


NO_FILTER = MeasurementFilter()
WHOLE_SETPOINT = SetpointWeights()


def filter_coefficients(order: int, time: Number) -> tuple[Number | float, ...]:
    """Coefficients of 1 / F(s), lowest power first; of many filters at once from an array of times."""
    return tuple(time**power / math.factorial(power) for power in range(order + 1))
