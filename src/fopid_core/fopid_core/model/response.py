"""The loop in time: step responses with exact fractional powers and exact delay.

What a signal does suddenly, at t = 0 and after every delay, is known in time (``asymptotics``); the smooth rest comes
from its transform (``inversion``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.asymptotics import SingularPart, expansion_at_infinity, fast_rate, leading_term
from fopid_core.model.inversion import Signals, fastest_rate, invert, values_at
from fopid_core.model.loop import Loop
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.spectral_abscissa import spectral_abscissa_bound
from fopid_core.model.stability import stability

Source = Literal["setpoint", "load"]

_LARGEST_EXPONENT = 600.0  # exp(700) overflows
_MOST_POINTS, _MOST_WORK = 1 << 19, 1 << 24  # in one window: points, and points times sudden terms
_HIGHEST_POWER = 6.0  # once the sudden part is out, the transforms fall faster than s**-6


@dataclass(frozen=True)
class Response:
    """The answer of the loop to a unit step.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Instants [s], from 0 to the horizon; without a number of points asked for, closer together where the loop is
        fast.
    output, control, error : ndarray, shape (n,)
        y, u and r - y at these instants; where a signal jumps, the value after the jump. Where the ideal derivative
        makes the control infinite, at the instant of a setpoint step, it is infinite here.
    accuracy, control_accuracy : float
        Estimated largest error of the output and of the control, relative to the signal where that is above 1.
    control_impulse : float
        Weight [s] of the impulse that the control contains at t = 0 (a derivative of order 1 at a setpoint step),
        infinite for something stronger (order above 1). It is not in ``control``.
    """

    time: Floats
    output: Floats
    control: Floats
    error: Floats
    accuracy: float
    control_accuracy: float
    control_impulse: float = 0.0

    @property
    def control_peak(self) -> float:
        """Largest absolute control; infinite when the ideal derivative makes it so."""
        return math.inf if self.control_impulse else float(np.max(np.abs(self.control)))


def step_response(loop: Loop, horizon: float, source: Source = "setpoint", points: int | None = None) -> Response:
    """The answer to a unit step of the setpoint, or of a load that adds to the control.

    Parameters
    ----------
    loop : Loop
    horizon : float
        Last instant [s].
    source : {"setpoint", "load"}
        Where the step comes in.
    points : int, optional
        Give the response at so many evenly spaced instants; otherwise at as many as describe it.

    Raises
    ------
    InputError
        If an argument is out of its range, or the loop is of advanced type and has no response.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> response = step_response(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0)), horizon=1.0, points=2)
    >>> round(float(response.output[-1]), 5)  # (1 - exp(-2)) / 2
    0.43233
    """
    _check(loop, horizon, source, points)
    transforms = _Transforms.of(loop, source, horizon)
    pieces = invert(transforms.remainders(_growth(loop, horizon)), horizon)
    if points is None:
        time, smooth = np.concatenate([p.time for p in pieces]), np.concatenate([p.values for p in pieces], axis=1)
    else:
        time = np.linspace(0.0, horizon, points)
        smooth = values_at(pieces, time)
    output, control = smooth + transforms.sudden_signals(time)
    error = (1.0 if source == "setpoint" else 0.0) - output
    accuracy, control_accuracy = np.max([p.accuracy for p in pieces], axis=0).tolist()
    return Response(time, output, control, error, accuracy, control_accuracy, transforms.control_impulse)


def check_horizon(loop: Loop, horizon: float) -> None:
    """Refuse a horizon [s] on which there is nothing to see."""
    if not (math.isfinite(horizon) and horizon > 0.0):
        raise InputError(f"horizon = {horizon}; allowed: a positive number of seconds")
    if horizon <= loop.process.delay:
        raise InputError(f"horizon = {horizon}; allowed: longer than the process's delay of {loop.process.delay:g} s")


def _check(loop: Loop, horizon: float, source: str, points: int | None) -> None:
    check_horizon(loop, horizon)
    if source not in ("setpoint", "load"):
        raise InputError(f"source = {source!r}; allowed: setpoint, load")
    if points is not None and points < 2:
        raise InputError(f"points = {points}; allowed: at least 2")
    if leading_term(loop.characteristic).order < loop.characteristic.degree:
        raise InputError(
            f"mu = {loop.controller.mu:g} on a process with delay of relative degree {loop.process.relative_degree:g}: "
            "the loop gain grows with frequency and the loop has no response; allowed: at most the relative degree"
        )


@dataclass(frozen=True)
class _Transforms:
    """Output and control as transforms over one denominator, and their sudden parts."""

    numerators: tuple[QuasiPolynomial, QuasiPolynomial]
    denominator: QuasiPolynomial
    sudden: tuple[SingularPart, ...]
    rate: float

    @staticmethod
    def of(loop: Loop, source: Source, horizon: float) -> _Transforms:
        if source == "setpoint":
            numerators = loop.open_loop_numerator, loop.controller.numerator * loop.process.denominator
        else:
            numerators = loop.process.numerator.shifted(loop.controller.integral_order), -loop.open_loop_numerator
        denominator = loop.characteristic.shifted(1.0)
        rate = max(fast_rate(loop.characteristic), 1.0 / horizon)
        sudden = tuple(_sudden_part(numerator, denominator, horizon, rate) for numerator in numerators)
        return _Transforms(numerators, denominator, sudden, rate)

    def remainders(self, growth: float) -> Signals:
        """What the sudden parts leave."""
        echoes = any(t.delay for t in self.denominator.terms)
        most_points = _MOST_WORK // (_MOST_WORK // _MOST_POINTS + sum(len(part.series) for part in self.sudden))
        return Signals(
            self._smooth, lambda time: np.abs(self.sudden_signals(time)), self.rate, growth, echoes, most_points
        )

    def _smooth(self, s: Complexes) -> Complexes:
        common = 1.0 / self.denominator(s)
        pairs = zip(self.numerators, self.sudden, strict=True)
        return np.stack([numerator(s) * common - part.transform(s) for numerator, part in pairs])

    def sudden_signals(self, time: Floats) -> Floats:
        """The sudden parts in time, shape (2, n)."""
        return np.stack([part.signal(time) for part in self.sudden])

    @property
    def control_impulse(self) -> float:
        """Weight of the impulse at t = 0; infinite when something stronger than an impulse stands there."""
        numerator = self.numerators[1]
        if numerator.is_zero:
            return 0.0
        over, under = leading_term(numerator), leading_term(self.denominator)
        weight = over.coefficient / under.coefficient
        if over.delay > 0.0 or over.order < under.order:
            return 0.0
        return weight if over.order == under.order else math.copysign(math.inf, weight)


def _growth(loop: Loop, horizon: float) -> float:
    """A bound on the exponential growth of a loop that is not stable [1/s]."""
    verdict = stability(loop)
    if verdict.unstable_poles == 0 or not verdict.decided:  # on the border nothing grows by much
        return 0.0
    growth = spectral_abscissa_bound(loop.characteristic, _LARGEST_EXPONENT / horizon)
    if math.isinf(growth):
        raise InputError(
            f"horizon = {horizon:g} s: the unstable loop grows by more than exp({_LARGEST_EXPONENT:g}) until then; "
            "allowed: a shorter one"
        )
    return growth


def _sudden_part(numerator: QuasiPolynomial, denominator: QuasiPolynomial, horizon: float, rate: float) -> SingularPart:
    if rate > fastest_rate(horizon):  # it would only hold in instants too short to be seen
        return SingularPart.of(QuasiPolynomial(()), rate, _HIGHEST_POWER)
    expansion = expansion_at_infinity(numerator, denominator, -_HIGHEST_POWER, horizon, rate)
    return SingularPart.of(expansion, rate, _HIGHEST_POWER)
