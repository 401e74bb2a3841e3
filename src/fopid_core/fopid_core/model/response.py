"""The loop in time: step responses with exact fractional powers and exact delay, and how exact they are.

Where there is no delay the transform is inverted on hyperbolas (``delay_free``). With a delay, a loop of whole orders
is solved from one delay to the next (``method_of_steps``) unless there are too many of them, any other by inverse FFT
(``delayed``). Where transforms are inverted, the poles that ring or grow are found first, all of them, and stand apart
(``poles``, ``modes``): no grid in time or frequency has to resolve them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fopid_core.drawing import draw_over_time
from fopid_core.errors import InputError, UnknownResponseError
from fopid_core.model.arrays import Floats
from fopid_core.model.asymptotics import leading_term
from fopid_core.model.delay_free import DelayFree
from fopid_core.model.delayed import Delayed
from fopid_core.model.loop import Loop
from fopid_core.model.method_of_steps import Steps
from fopid_core.model.step_transforms import Source, StepTransforms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Response", "Source", "check_horizon", "step_response"]

HORIZON_RANGE = (1e-12, 1e12)
"""Shortest and longest horizon [s]."""

MOST_POINTS = 5_000_000
"""Instants that a response is given at, at most."""

LEAST_COEFFICIENT = 1e-250
"""Of the loop, in size: below it quotients are no numbers any more."""

WORST_ACCURACY = 1e-2
"""What is less accurate than this is refused."""

_ROUNDING = 1e-15  # nothing is known better


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
        Estimated largest error of the output and of the control, relative to what the signal has reached by then
        where that is above 1.
    control_impulse : float
        Weight [s] of the impulse that the control contains at t = 0 (a derivative of order 1 at a setpoint step),
        infinite for something stronger (order above 1). It is not in ``control``.
    uncertainty : ndarray, shape (n,)
        Estimated largest error of output and error at each instant, not relative to anything; empty where it is not
        known.
    """

    time: Floats
    output: Floats
    control: Floats
    error: Floats
    accuracy: float
    control_accuracy: float
    control_impulse: float = 0.0
    uncertainty: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def control_peak(self) -> float:
        """Largest absolute control; infinite when the ideal derivative makes it so."""
        return math.inf if self.control_impulse else float(np.max(np.abs(self.control)))

    def plot(self, figure: Figure | None = None, label: str = "", title: str = "") -> Figure:
        """Output and control over time, into a figure of another response where one is given."""
        rows = [("output", {label: (self.time, self.output)}), ("control", {label: (self.time, self.control)})]
        return draw_over_time(rows, figure, title)

    def __repr__(self) -> str:
        return f"<Response: {self.time.size} instants to {self.time[-1]:g} s, output known to {self.accuracy:.1g}>"


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
    UnknownResponseError
        If the response cannot be had to an accuracy that is known.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> response = step_response(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0)), horizon=1.0, points=2)
    >>> round(float(response.output[-1]), 5)  # (1 - exp(-2)) / 2
    0.43233
    """
    _check(loop, horizon, source, points)
    transforms = StepTransforms.of(loop, source)
    signals: DelayFree | Delayed | Steps
    if not transforms.longest_delay:
        signals = DelayFree.of(transforms, horizon, None if points is None else horizon / (points - 1))
    else:
        signals = Steps.of(transforms, horizon) or Delayed.of(transforms, horizon)
    time = signals.instants() if points is None else np.linspace(0.0, horizon, points)
    (error, control), (doubt, control_doubt) = signals.at(time), signals.error_at(time)
    output = (1.0 if source == "setpoint" else 0.0) - error
    accuracy = _relative(doubt, output)
    if not accuracy <= WORST_ACCURACY:
        raise UnknownResponseError(
            f"the response would be known to {accuracy:.2g} only",
            f"{WORST_ACCURACY:g}, so a shorter horizon or a loop further from the border",
            horizon,
        )
    return Response(
        time,
        output,
        control,
        error,
        accuracy,
        _relative(control_doubt, control),
        transforms.control_impulse,
        doubt,
    )


def _relative(doubt: Floats, signal: Floats) -> float:
    """The largest doubt, relative to what the signal has reached by then where that is above 1."""
    reached = np.maximum.accumulate(np.maximum(np.abs(signal), 1.0))
    seen = np.isfinite(reached)
    start = int(np.argmax(~seen)) if not seen.all() else 0
    reached[~seen] = np.inf
    if start == 0 and not seen.all():  # infinite at t = 0 alone
        reached[1:] = np.maximum.accumulate(np.maximum(np.abs(signal[1:]), 1.0))
    return max(float(np.max(doubt / reached)), _ROUNDING)


def check_horizon(loop: Loop, horizon: float) -> None:
    """Refuse a horizon [s] on which there is nothing to see."""
    low, high = HORIZON_RANGE
    if not low <= horizon <= high:
        raise InputError(f"horizon = {horizon}; allowed: {low:g} to {high:g} s")
    if horizon <= loop.process.delay:
        raise InputError(f"horizon = {horizon}; allowed: longer than the process's delay of {loop.process.delay:g} s")


def _check(loop: Loop, horizon: float, source: str, points: int | None) -> None:
    check_horizon(loop, horizon)
    if source not in ("setpoint", "load"):
        raise InputError(f"source = {source!r}; allowed: setpoint, load")
    if points is not None and not 2 <= points <= MOST_POINTS:
        raise InputError(f"points = {points}; allowed: at least 2, at most {MOST_POINTS}")
    if leading_term(loop.characteristic).order < loop.characteristic.degree:
        raise InputError(
            f"mu = {loop.controller.mu:g} on a process with delay of relative degree {loop.process.relative_degree:g}: "
            "the loop gain grows with frequency and the loop has no response; allowed: at most the relative degree"
        )
    least = min(abs(term.coefficient) for term in loop.characteristic.terms)
    if least < LEAST_COEFFICIENT:
        raise InputError(
            f"gains: a coefficient of the loop is {least:.2g}; allowed: 0, or at least {LEAST_COEFFICIENT:g} in size"
        )
