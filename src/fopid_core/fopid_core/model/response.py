"""The loop in time: step responses with exact fractional powers and exact delay.

The transform of a signal, sampled on the line s = a + jw, is a Fourier series of exp(-a t) times the signal
(Dubner and Abate 1968, Crump 1976), summed by one inverse FFT. What the signal does suddenly, at t = 0 and after every delay, is
taken out first and put back exactly (``asymptotics``). A horizon much longer than the loop is fast is cut into windows, each
an eighth of the one before, so that the first instants are seen as sharply as the last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import erfc

from fopid_core.errors import InputError
from fopid_core.model.asymptotics import SingularPart, expansion_at_infinity, fast_rate, leading_term
from fopid_core.model.loop import Loop
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.stability import stability

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Source = Literal["setpoint", "load"]

TOLERANCE = 1e-6  # two numbers of points must agree to this before either is believed
_DAMPING = 23.0  # exp(-23) = 1e-10: what one period of the Fourier series leaks into the next
_HIGHEST_POWER = 4.0  # the remainder falls as s**-4
_WINDOW_RATIO = 8
_MOST_WINDOWS = 10
_FEWEST_POINTS, _MOST_POINTS = 1 << 11, 1 << 20
_GROWTH_STEP, _MOST_GROWTH = 10.0, 600.0
_SAME_INSTANT = 1e-11


@dataclass(frozen=True)
class Response:
    """The answer of the loop to a unit step.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Instants [s], from 0 to the horizon; closer together where the loop is fast, unless a number of points was asked for.
    output, control, error : ndarray, shape (n,)
        y, u and r - y at these instants; where a signal jumps, the value after the jump. The ideal derivative makes the
        control infinite at the instant of a setpoint step: that value is infinite here, all others are exact.
    accuracy, control_accuracy : float
        Estimated largest error of the output and of the control, relative to the largest value where that is above 1.
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
    signals = (_Signal.of(loop, horizon, source, "output"), _Signal.of(loop, horizon, source, "control"))
    windows = [_Window.of(loop, signals, source, first, last) for first, last in _cut(loop, horizon)]
    time = np.concatenate([w.time for w in windows]) if points is None else np.linspace(0.0, horizon, points)
    remainders = [_gather(windows, time, i) for i in range(2)]
    output, control = (
        remainder + signal.singular.signal(time, _SAME_INSTANT * horizon)
        for remainder, signal in zip(remainders, signals, strict=True)
    )
    error = (1.0 if source == "setpoint" else 0.0) - output
    accuracy, control_accuracy = (max(w.accuracy[i] for w in windows) for i in range(2))
    return Response(time, output, control, error, accuracy, control_accuracy, signals[1].singular.impulse)


def _check(loop: Loop, horizon: float, source: str, points: int | None) -> None:
    if not (math.isfinite(horizon) and horizon > 0.0):
        raise InputError(f"horizon = {horizon}; allowed: a positive number of seconds")
    if source not in ("setpoint", "load"):
        raise InputError(f"source = {source!r}; allowed: setpoint, load")
    if points is not None and points < 2:
        raise InputError(f"points = {points}; allowed: at least 2")
    if leading_term(loop.characteristic).order < loop.characteristic.degree:
        raise InputError(
            f"controller {loop.controller} on a process with delay: the loop gain grows with frequency, so "
            "the loop is of advanced type and has no response; allowed: mu up to the process's relative degree"
        )


@dataclass(frozen=True)
class _Signal:
    """One signal of the loop: its sudden part, which is known in time."""

    singular: SingularPart

    @staticmethod
    def of(loop: Loop, horizon: float, source: Source, name: str) -> _Signal:
        process, order = loop.process, loop.controller.integral_order
        numerator = {
            ("setpoint", "output"): loop.forward,
            ("setpoint", "control"): loop.controller.numerator * process.denominator,
            ("load", "output"): process.numerator.shifted(order),
            ("load", "control"): -loop.forward,
        }[source, name]
        rate = max(fast_rate(loop.characteristic), 1.0 / horizon)
        rate = min(rate, _WINDOW_RATIO**_MOST_WINDOWS / horizon)
        if numerator.is_zero:
            return _Signal(SingularPart.of(numerator, rate, _HIGHEST_POWER))
        stepped = loop.characteristic.shifted(1.0)
        expansion = expansion_at_infinity(numerator, stepped, -_HIGHEST_POWER, horizon, rate)
        return _Signal(SingularPart.of(expansion, rate, _HIGHEST_POWER))


def _cut(loop: Loop, horizon: float) -> list[tuple[float, float]]:
    """Windows (first, last) [s] that cover the horizon, the earliest as short as the loop is fast."""
    stretch = fast_rate(loop.characteristic) * horizon / 20.0
    count = min(max(math.ceil(math.log(max(stretch, 1.0), _WINDOW_RATIO)), 0), _MOST_WINDOWS)
    edges = [0.0] + [horizon / _WINDOW_RATIO**k for k in range(count, -1, -1)]
    return list(zip(edges[:-1], edges[1:], strict=True))


@dataclass(frozen=True)
class _Window:
    """The remainders of both signals, smooth, at evenly spaced instants of one window."""

    time: Floats
    remainders: tuple[Floats, Floats]
    accuracy: tuple[float, float]

    @staticmethod
    def of(loop: Loop, signals: tuple[_Signal, _Signal], source: Source, first: float, last: float) -> _Window:
        growth = _growth(loop, signals, source, last)
        number = _FEWEST_POINTS
        coarse = _remainders(loop, signals, source, last, number, growth)
        while True:
            number *= 2
            fine = _remainders(loop, signals, source, last, number, growth)
            start = math.ceil(first / last * (number // 4) - 1e-9)
            gaps = [_gap(f[::2][start:], c[start:]) for f, c in zip(fine, coarse, strict=True)]
            if max(gaps) <= TOLERANCE or number >= _MOST_POINTS:
                break
            coarse = fine
        time = np.linspace(0.0, last, number // 2 + 1)
        keep = time >= first if first == 0.0 else time > first * (1.0 + 1e-9)
        return _Window(time[keep], (fine[0][keep], fine[1][keep]), (gaps[0], gaps[1]))

    @cached_property
    def splines(self) -> tuple[CubicSpline, CubicSpline]:
        return CubicSpline(self.time, self.remainders[0]), CubicSpline(self.time, self.remainders[1])


def _gap(fine: Floats, coarse: Floats) -> float:
    """Largest difference, relative to the largest value where that is above 1."""
    return float(np.max(np.abs(fine - coarse)) / max(1.0, float(np.max(np.abs(fine)))))


def _remainders(
    loop: Loop, signals: tuple[_Signal, _Signal], source: Source, last: float, number: int, growth: float
) -> tuple[Floats, Floats]:
    """Both remainders at number // 2 + 1 instants from 0 to ``last``."""
    period = 2.0 * last
    damping = (_DAMPING + 2.0 * growth) / period
    s = damping + 2j * np.pi / period * np.arange(number // 2 + 1)
    transforms = _transforms(loop, s, source)
    taper = _taper(number // 2 + 1)
    rise = np.exp(damping * np.linspace(0.0, last, number // 2 + 1)) * (number / period)
    first, second = (
        np.fft.irfft((transform - signal.singular.transform(s)) * taper)[: number // 2 + 1] * rise
        for transform, signal in zip(transforms, signals, strict=True)
    )
    return first, second


def _transforms(loop: Loop, s: Complex, source: Source) -> tuple[Complex, Complex]:
    """Transforms of output and control."""
    numerator, denominator, controller = loop.process.numerator(s), loop.process.denominator(s), loop.controller(s)
    forward = controller * numerator
    common = 1.0 / (s * (denominator + forward))
    if source == "setpoint":
        return forward * common, controller * denominator * common
    return numerator * common, -forward * common


def _taper(size: int) -> Floats:
    """One up to half the band, then down smoothly: an unresolved detail stays where it is in time."""
    position = np.linspace(0.0, 1.0, size)
    values: Floats = 0.5 * erfc((position - 0.75) * 18.0)
    return values


def _growth(loop: Loop, signals: tuple[_Signal, _Signal], source: Source, last: float) -> float:
    """How many e-folds an unstable loop grows by until ``last``, found as the first line that the next one confirms."""
    if stability(loop).stable:
        return 0.0
    growth = 0.0
    here = _remainders(loop, signals, source, last, _FEWEST_POINTS, growth)
    while growth < _MOST_GROWTH:
        following = _remainders(loop, signals, source, last, _FEWEST_POINTS, growth + _GROWTH_STEP)
        if max(_gap(f, h) for f, h in zip(following, here, strict=True)) < 1e-4:
            return growth
        growth, here = growth + _GROWTH_STEP, following
    raise InputError(f"horizon = {last:g} s: the loop is unstable and grows beyond all numbers; allowed: a shorter one")


def _gather(windows: list[_Window], time: Floats, index: int) -> Floats:
    """A remainder at any instants."""
    values = np.empty_like(time)
    edges = [w.time[-1] for w in windows]
    home = np.searchsorted(edges, time, side="left").clip(max=len(windows) - 1)
    for i, window in enumerate(windows):
        values[home == i] = window.splines[index](time[home == i])
    return values
