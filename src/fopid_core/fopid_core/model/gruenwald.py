"""The loop sampled: first-order Gruenwald-Letnikov differences, as the paper computed its tables.

Replacing s by (1 - z) / h, with z one sample of delay, turns every power of s into its Gruenwald-Letnikov
difference. The samples of the loop's response are then the power series coefficients of its transform in z, which one
FFT on a circle inside the unit circle gives (convolution quadrature, Lubich 1988).
"""

from __future__ import annotations

import math

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.response import Response, Source, check_horizon
from fopid_core.model.two_degrees import WHOLE_SETPOINT

_MOST_SAMPLES = 1 << 21
_ALIASING = 1e-9  # what of one turn of the circle leaks into the samples
_MOST_GROWTH = 10.0  # from the horizon to the end of that turn; a loop that is stable as sampled does not grow


def gl1_response(loop: Loop, horizon: float, step: float, source: Source = "setpoint") -> Response:
    """The answer to a unit step, of the loop in which every fractional operator is a first-order difference.

    The first sample of the answer comes one step after the step itself, as in a loop that runs, and the output at
    t = 0 is 0. Delays are rounded to whole samples. A loop that is unstable as sampled is refused. The control is that
    of the sampled controller: its first value kp + ki h^lam + kd h^-mu is the kick that an ideal derivative makes
    infinite.

    Parameters
    ----------
    loop : Loop
    horizon : float
        Last instant [s].
    step : float
        Sample time h [s].
    source : {"setpoint", "load"}

    Returns
    -------
    Response
        ``accuracy`` is that of the samples; the distance from the exact response is of first order in ``step``.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> response = gl1_response(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0)), horizon=1.0, step=0.5)
    >>> response.output.round(6).tolist()  # y (1/h + 2) = 1 + (the last y) / h
    [0.0, 0.25, 0.375]
    """
    _check(loop, horizon, step)
    count = round(horizon / step)
    size = 2 ** math.ceil(math.log2(2 * (count + 1)))
    radius = _ALIASING ** (1.0 / size)
    z = radius * np.exp(-2j * np.pi / size * np.arange(size // 2 + 1))
    numerator = _differences(loop.process.numerator, z, step)
    denominator = _differences(loop.process.denominator, z, step)
    controller = _differences(loop.controller.numerator, z, step)
    integral = ((1.0 - z) / step) ** loop.controller.integral_order
    common = 1.0 / ((1.0 - z) * (integral * denominator + controller * numerator))
    if source == "setpoint":
        transforms = controller * numerator * common, controller * denominator * common
    else:
        transforms = integral * numerator * common, -controller * numerator * common
    turn = np.fft.irfft(np.stack(transforms), size, axis=1) * radius ** -np.arange(size)
    _check_growth(turn, count, step)
    output, control = np.append(0.0, turn[0, :count]), turn[1, np.minimum(np.arange(count + 1), count - 1)]
    error = (1.0 if source == "setpoint" else 0.0) - output
    return Response(
        np.arange(count + 1, dtype=np.float64) * step, output, control, error, 10.0 * _ALIASING, 10.0 * _ALIASING
    )


def _check(loop: Loop, horizon: float, step: float) -> None:
    check_horizon(loop, horizon)
    if not loop.filter.is_idle or loop.weights != WHOLE_SETPOINT:
        raise InputError(f"{loop.filter}, {loop.weights}; allowed here, as in the paper: neither filter nor weights")
    if not (math.isfinite(step) and 0.0 < step <= horizon / 2.0):
        raise InputError(f"step = {step}; allowed: above 0 and at most half the horizon of {horizon:g} s")
    if horizon / step > _MOST_SAMPLES:
        raise InputError(
            f"step = {step}; allowed: at least {horizon / _MOST_SAMPLES:.3g} s on a horizon of {horizon:g} s"
        )


def _check_growth(turn: Floats, count: int, step: float) -> None:
    """Refuse samples that one turn of the circle cannot tell apart from those of the next."""
    size = np.max(np.abs(turn[:, :count]), axis=1)
    if np.any(np.max(np.abs(turn[:, count:]), axis=1) > _MOST_GROWTH * size):
        raise InputError(f"step = {step}; the loop sampled at it is unstable; allowed: a step at which it is stable")


def _differences(function: QuasiPolynomial, z: Complexes, step: float) -> Complexes:
    """The quasi-polynomial with s replaced by (1 - z) / h and exp(-d s) by whole powers of z."""
    log_s = np.log((1.0 - z) / step)

    def value(term: Term) -> Complexes:
        lag: Complexes = z ** round(term.delay / step)
        return term.coefficient * np.exp(term.order * log_s) * lag

    return sum((value(term) for term in function.terms), np.zeros_like(z))
