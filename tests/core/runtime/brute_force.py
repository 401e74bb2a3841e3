"""A controller that forgets nothing and sums over its whole past at every tick: the oracle for the bank of lags."""

from __future__ import annotations

from math import gamma
from typing import Literal

import numpy as np

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.filter_bank import Band, integral_weights
from fopid_core.runtime.operators import Operators
from fopid_core.runtime.sampled_derivative import derivative_weights

Kind = Literal["gruenwald", "linear"]


def gruenwald(order: float, h: float, count: int) -> np.ndarray:
    """First-order Gruenwald-Letnikov weights of s^order: newest sample first."""
    weights = np.ones(count)
    for j in range(1, count):
        weights[j] = weights[j - 1] * (1.0 - (order + 1.0) / j)
    return weights * h**-order


def integral_of_lines(order: float, h: float, count: int) -> np.ndarray:
    """Weights of s^-order, exact for samples joined by lines and a first line from zero."""
    j = np.arange(count + 1.0)
    power = np.concatenate(([0.0], j)) ** (order + 1.0)
    second = power[2:] - 2 * power[1:-1] + power[:-2]
    second[0] = 1.0
    return second * h**order / gamma(order + 2.0)


def as_sampled(order: float, h: float, count: int) -> np.ndarray:
    """What the derivative makes of a single 1: for what is done with its weights, not for the weights themselves."""
    operators = Operators(band := Band.for_sample_time(h), h)
    operators.set_weights(integral_weights(band, 1.0), derivative_weights(band, order, h))
    return np.array([operators.push(0.0, float(k == 0))[1] for k in range(count)])


class BruteForce:
    """C(s) by convolution with all errors so far, with limits; the five numbers change at any tick.

    ``antiwindup``: every error that asked for more than the limits allow is replaced, in the memory, by the one for
    which the control would just have been allowed; ``conditionally`` only where the error pushes further.
    """

    def __init__(self, h: float, count: int, kind: Kind, low: float = -np.inf, high: float = np.inf,
                 antiwindup: bool = True, conditionally: bool = False) -> None:  # fmt: skip
        self.h, self.kind, self.low, self.high = h, kind, low, high
        self.antiwindup, self.conditionally = antiwindup, conditionally
        self.past, self.k = np.zeros(count), 0

    def use(self, gains: Fopid) -> None:
        count = len(self.past)
        if self.kind == "gruenwald":
            integral, derivative = gruenwald(-gains.lam, self.h, count), gruenwald(gains.mu, self.h, count)
        else:
            integral = integral_of_lines(gains.lam, self.h, count)
            derivative = as_sampled(gains.mu, self.h, count)
        self.weights = gains.ki * integral + gains.kd * derivative
        self.weights[0] += gains.kp

    def step(self, error: float) -> float:
        k = self.k
        self.past[k] = error
        self.k += 1
        wanted = float(self.weights[: k + 1] @ self.past[k::-1])
        control = min(max(wanted, self.low), self.high)
        pushes_further = self.weights[0] * error * (control - wanted) < 0.0
        if self.antiwindup and (pushes_further or not self.conditionally):
            self.past[k] += (control - wanted) / self.weights[0]
        return control
