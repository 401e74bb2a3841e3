"""The error and the control of a loop after a unit step, as transforms over one denominator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.asymptotics import SingularPart, expansion_at_infinity, fast_rate, leading_term
from fopid_core.model.loop import Loop
from fopid_core.model.poles import EPSILON, scaled_value
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.two_degrees import WHOLE_SETPOINT

Source = Literal["setpoint", "load"]

_LARGEST_LOG = 690.0


@dataclass(frozen=True)
class StepTransforms:
    """Error and control, each a quotient of quasi-polynomials.

    Attributes
    ----------
    numerators : tuple of QuasiPolynomial
        Of the error and of the control.
    characteristic : QuasiPolynomial
        The loop's; over s times it stand both numerators.
    """

    numerators: tuple[QuasiPolynomial, QuasiPolynomial]
    characteristic: QuasiPolynomial

    @staticmethod
    def of(loop: Loop, source: Source) -> StepTransforms:
        """Those of a loop.

        Examples
        --------
        >>> from fopid_core.model.fopid import Fopid
        >>> from fopid_core.model.process import Process
        >>> transforms = StepTransforms.of(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0)), "setpoint")
        >>> complex(transforms(np.array([1.0 + 0j]))[0, 0].round(4))  # (s + 1) / (s + 2) / s
        (0.6667+0j)
        """
        if source == "setpoint":
            forward = loop.setpoint_numerator
            prompt = loop.filter.is_idle and loop.weights == WHOLE_SETPOINT
            error = loop.open_loop_denominator if prompt else loop.characteristic - forward * loop.process.numerator
            numerators = error, forward * loop.process.denominator
        else:
            slow = loop.filter.denominator.shifted(loop.controller.integral_order)
            numerators = -loop.process.numerator * slow, -loop.open_loop_numerator
        return StepTransforms(numerators, loop.characteristic)

    @property
    def denominator(self) -> QuasiPolynomial:
        """The characteristic quasi-polynomial times s."""
        return self.characteristic.shifted(1.0)

    @property
    def longest_delay(self) -> float:
        """[s], 0 without."""
        return max(t.delay for part in (*self.numerators, self.characteristic) for t in part.terms)

    @property
    def rate(self) -> float:
        """The frequency [rad/s] beyond which only the highest powers of s count."""
        return fast_rate(self.characteristic)

    def __call__(self, s: Complexes) -> Complexes:
        """Both transforms, shape (2, m)."""
        return self.with_rounding(s)[0]

    def with_rounding(self, s: Complexes) -> tuple[Complexes, Floats]:
        """Both transforms and what rounding leaves uncertain in them, shapes (2, m)."""
        under, log_under = scaled_value(self.denominator, s)
        log_s = np.abs(np.log(s))
        values, errors = np.zeros((2, s.size), dtype=np.complex128), np.zeros((2, s.size))
        for i, numerator in enumerate(self.numerators):
            if numerator.is_zero:
                continue
            over, log_over = scaled_value(numerator, s)
            size = np.exp(np.minimum(log_over - log_under, _LARGEST_LOG))
            values[i] = over / under * size
            digits = EPSILON * (2.0 + log_s * self.denominator.degree)
            errors[i] = digits * (np.abs(values[i]) / np.abs(under) + size / np.abs(under))
        return values, errors

    def first_values(self) -> Floats:
        """Their limits as t falls to 0, shape (2,); infinite where they are."""
        rate = min(max(self.rate, 1e-100), 1e100)
        zero = np.zeros(1)
        limits = []
        for numerator in self.numerators:
            expansion = expansion_at_infinity(numerator, self.denominator, -1.0, 0.0, rate)
            limits.append(float(SingularPart.of(expansion, 0.0, 1.0).signal(zero)[0]))
        return np.array(limits)

    @property
    def control_impulse(self) -> float:
        """Weight of the control's impulse at t = 0; infinite when something stronger than an impulse stands there."""
        numerator = self.numerators[1]
        if numerator.is_zero:
            return 0.0
        over, under = leading_term(numerator), leading_term(self.denominator)
        weight = over.coefficient / under.coefficient
        if over.delay > 0.0 or over.order < under.order:
            return 0.0
        return weight if over.order == under.order else math.copysign(math.inf, weight)
