"""The loop: a controller and a process under negative feedback of the measurement, filtered or as it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.model.arrays import Complexes
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights


@dataclass(frozen=True)
class Loop:
    """Controller C(s), process P(s) and filter F(s) in a loop; call it with complex s to get L(s) = C(s) P(s) F(s).

    Everything takes an array of complex s of any shape, none of them zero. Setpoint weights change nothing but the
    answer to the setpoint.

    Examples
    --------
    >>> loop = Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0))
    >>> complex(loop.sensitivity(1j))
    (0.6+0.2j)
    """

    process: Process
    controller: Fopid
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT

    def __repr__(self) -> str:
        more = [f"filter={self.filter}"] if not self.filter.is_idle else []
        more += [f"weights={self.weights}"] if self.weights != WHOLE_SETPOINT else []
        return f"Loop({', '.join([repr(self.process), repr(self.controller), *more])})"

    def __call__(self, s: ArrayLike) -> Complexes:
        """L(s) = C(s) P(s) F(s)."""
        with np.errstate(invalid="ignore"):  # a pole on the axis: infinite
            opened = self.controller(s) * self.process(s)
        return opened if self.filter.is_idle else opened * self.filter(s)

    def sensitivity(self, s: ArrayLike) -> Complexes:
        """S(s) = 1 / (1 + L(s)); without filter and weights from the setpoint to the error."""
        numerator, denominator = self.process.numerator(s), self._slow_denominator(s)
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole on the axis: infinite
            return denominator / (denominator + self.controller(s) * numerator)

    def complementary_sensitivity(self, s: ArrayLike) -> Complexes:
        """T(s) = L(s) / (1 + L(s)); without filter and weights from the setpoint to the output."""
        forward = self.controller(s) * self.process.numerator(s)
        with np.errstate(divide="ignore", invalid="ignore"):
            return forward / (self._slow_denominator(s) + forward)

    def logarithmic_derivative(self, s: ArrayLike) -> Complexes:
        """L'(s) / L(s); on s = jw its real part is d arg L / dw, eq. (3) of the paper."""
        controller, slow = self.controller, self.filter.denominator
        found = controller.derivative(s) / controller(s) + self.process.logarithmic_derivative(s)
        return found if self.filter.is_idle else found - slow.derivative(s) / slow(s)

    @cached_property
    def open_loop_numerator(self) -> QuasiPolynomial:
        """The numerator of L(s) over ``open_loop_denominator``."""
        return self.controller.numerator * self.process.numerator

    @cached_property
    def open_loop_denominator(self) -> QuasiPolynomial:
        """The denominator of L(s): the process's and the filter's, times ``s**lam`` where there is integral action."""
        return self._slow_denominator.shifted(self.controller.integral_order)

    @cached_property
    def characteristic(self) -> QuasiPolynomial:
        """The quasi-polynomial whose zeros are the poles of the closed loop.

        Nothing is cancelled in it, so that a cancelled unstable pole still shows.
        """
        return self.open_loop_denominator + self.open_loop_numerator

    @cached_property
    def setpoint_numerator(self) -> QuasiPolynomial:
        """What the setpoint goes through on its way to the control, times ``s**lam`` and over 1 / F."""
        return self.controller.weighted_numerator(self.weights) * self.filter.denominator

    @cached_property
    def _slow_denominator(self) -> QuasiPolynomial:
        denominator = self.process.denominator
        return denominator if self.filter.is_idle else denominator * self.filter.denominator
