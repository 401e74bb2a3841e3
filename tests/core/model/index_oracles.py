"""Indices of loops with delay, of fractional loops and of both, by other means, each with its own error.

With delay: the method of steps as series in powers of 1/s, in ball arithmetic of many digits. Without: the poles on the
principal sheet, and the integral along the cut that fractional powers make of the negative axis. Either signal is then
laid through Chebyshev points, finer until the last coefficients are small; zeros and integrals are a polynomial's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np
from flint import arb, arb_poly, arb_series, ctx, fmpq
from numpy.polynomial import chebyshev, legendre

from .random_loops import Polynomial, RandomLoop
from .response_oracles import Parts, partial_fractions, plus

POWERS = {"iae": (0, 1), "ise": (0, 2), "itae": (1, 1), "itse": (1, 2), "istes": (4, 2), "istse": (2, 2)}
Found = dict[str, tuple[float, float]]  # by name: value, largest error

_DEGREE = 31
_NODES, _WEIGHTS = legendre.leggauss(48)
_TAIL = 1e-11
_MOST_PIECES = 2000
_REACH = 60.0  # horizon in times of the fastest lag, beyond which the series take too long
_MOST_DELAYS = 40
_BITS = 1500


@dataclass(frozen=True)
class Stretch:
    """A part of the response over a variable in which it is smooth: the error, the time and dt/dx at values of x."""

    low: float
    high: float
    error: Callable[[np.ndarray], np.ndarray]
    time: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]


def indices(stretches: list[Stretch]) -> Found | None:
    """All six, or None where that takes too many pieces."""
    total = dict.fromkeys(POWERS, 0.0)
    doubt = dict.fromkeys(POWERS, 0.0)
    open_pieces, done = [(s, s.low, s.high) for s in stretches], 0
    while open_pieces:
        stretch, low, high = open_pieces.pop()
        done += 1
        if done > _MOST_PIECES:
            return None
        points = np.cos(math.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
        values = stretch.error(0.5 * (high + low) + 0.5 * (high - low) * points)
        series = chebyshev.chebfit(points, values, _DEGREE)
        size, tail = float(np.abs(values).max()), float(np.abs(series[-4:]).max())
        if tail > _TAIL * max(size, 1e-6) and high - low > 1e-9 * (stretch.high - stretch.low):
            middle = 0.5 * (low + high)
            open_pieces += [(stretch, low, middle), (stretch, middle, high)]
            continue
        for name, (of_time, of_error) in POWERS.items():
            value, missed = _integral(stretch, low, high, series, of_time, of_error)
            total[name] += value
            doubt[name] += 20.0 * (tail + 1e-13 * size) * missed
    return {name: (total[name], doubt[name] + 1e-13 * total[name]) for name in POWERS}


def _integral(
    stretch: Stretch, low: float, high: float, series: np.ndarray, of_time: int, of_error: int
) -> tuple[float, float]:
    """The integral over a piece, and what a unit of error in the signal makes of it."""
    zeros = np.array([])
    if of_error == 1:
        found = chebyshev.chebroots(series)
        zeros = np.sort(found.real[(np.abs(found.imag) < 1e-6) & (np.abs(found.real) < 1.0)])
    ends = np.concatenate(([-1.0], zeros, [1.0]))
    half = 0.5 * np.diff(ends)[:, None]
    x = 0.5 * (ends[1:] + ends[:-1])[:, None] + half * _NODES
    at = 0.5 * (high + low) + 0.5 * (high - low) * x
    weight = stretch.time(at) ** of_time * stretch.slope(at) * half * _WEIGHTS * 0.5 * (high - low)
    error = np.abs(chebyshev.chebval(x, series))
    return float(np.sum(weight * error**of_error)), float(np.sum(weight * (1.0 if of_error == 1 else 2.0 * error)))


def delayed_indices(case: RandomLoop) -> Found | None:
    """Of a loop with delay after a step of its setpoint; None where the series would take too long."""
    with ctx.workprec(_BITS):
        signal = _by_steps(case)
        if signal is None:
            return None
        return indices(signal)


def _by_steps(case: RandomLoop) -> list[Stretch] | None:
    parts = Parts.of(case, "setpoint", "error")
    base, delay = parts.base, float(case.delay)
    start, opened, forward = (
        _in_inverse_w(part, base, max(parts.opened)) for part in (parts.start, parts.opened, parts.forward)
    )
    size = max(
        (abs(float(c / opened[0])) ** (1.0 / (i * float(base))) for i, c in enumerate(opened) if i and c), default=1.0
    )
    if size * case.horizon > _REACH:
        return None
    count = math.ceil(case.horizon / delay)
    if count > _MOST_DELAYS:
        return None
    length = int((4.0 * size * case.horizon * math.e + 150.0) / float(base)) + 40
    gammas = [(arb(n) * _ball(base) + 1).rgamma() for n in range(length)]
    ctx.cap = length
    ratio = arb_series([_ball(c) for c in forward], length) / arb_series([_ball(c) for c in opened], length)
    row = arb_series([_ball(c) for c in start], length) / arb_series([_ball(c) for c in opened], length)
    rows = []
    for _ in range(count):
        coefficients = row.coeffs() + [arb(0)] * length
        rows.append(arb_poly([c * g for c, g in zip(coefficients[:length], gammas, strict=True)]))
        row = -row * ratio
    m = base.denominator
    stretches = []
    for k in range(count):
        width = min(delay, case.horizon - k * delay)
        # t = k delay + width x^m: then every power (t - k delay)^(n base) is a whole power of x
        stretches.append(Stretch(
            0.0, 1.0, _signal(rows[: k + 1], k, width, m, base, case.delay),
            partial(_time, k * delay, width, m), partial(_slope, width, m),
        ))  # fmt: skip
    return stretches


def _time(start: float, width: float, m: int, x: np.ndarray) -> np.ndarray:
    return start + width * x**m


def _slope(width: float, m: int, x: np.ndarray) -> np.ndarray:
    return np.asarray(width * m * x ** (m - 1))


def _signal(
    rows: list[arb_poly], k: int, width: float, m: int, base: Fraction, delay: Fraction
) -> Callable[[np.ndarray], np.ndarray]:
    def at(x: np.ndarray) -> np.ndarray:
        out = np.empty(x.size)
        for i, value in enumerate(x):
            since = arb(width) * arb(float(value)) ** m
            total = arb(0)
            for j, row in enumerate(rows):
                total += row((since + (k - j) * _ball(delay)) ** _ball(base))
            assert float(total.rad()) < 1e-14, "the oracle wants more digits"
            out[i] = float(total.mid())
        return out

    return at


def _ball(value: Fraction) -> arb:
    return arb(fmpq(value.numerator, value.denominator))


def _in_inverse_w(polynomial: Polynomial, base: Fraction, top: Fraction) -> list[Fraction]:
    """Coefficients of the powers of s^-base, from s^top on down."""
    out = [Fraction(0)] * (int((top - min(polynomial)) / base) + 1)
    for q, c in polynomial.items():
        out[int((top - q) / base)] = c
    return out


def delay_free_indices(case: RandomLoop) -> Found | None:
    """Of a fractional loop without delay; None where it rings for too long, or a pole lies on the cut."""
    parts = partial_fractions(case)
    base = float(parts.base)
    w, residues = (np.array([complex(v) for v in values]) for values in (parts.poles, parts.residues))
    on_sheet = np.abs(np.angle(w)) < base * math.pi
    if np.any(np.abs(np.abs(np.angle(w)) - base * math.pi) < 1e-3):
        return None
    poles = w[on_sheet] ** (1.0 / base)
    sizes = residues[on_sheet] * w[on_sheet] ** (1.0 / base - 1.0) / base
    settled = float(parts.powers.get(-round(1.0 / base), 0.0))
    whole = Parts.of(case, "setpoint", "error")
    over, under = (
        [(float(q), float(c)) for q, c in part.items()] for part in (whole.start, plus(whole.opened, whole.forward))
    )
    fast = float(np.abs(w).max()) ** (1.0 / base)
    first = min(1e-14 * case.horizon, 1e-6 / fast)

    def cut(step: float) -> tuple[np.ndarray, np.ndarray]:
        x = np.arange(-60.0 / base - math.log(case.horizon), math.log(100.0 / first), step)
        above, below = (sum(c * np.exp(q * (x + 1j * math.pi)) for q, c in part) for part in (over, under))
        return np.exp(x), (above / below).imag * step / math.pi  # s times the error's transform, on s = -r

    def signal(r: np.ndarray, weights: np.ndarray, z: np.ndarray) -> np.ndarray:
        t = np.exp(z)
        ringing = (sizes[:, None] * np.exp(poles[:, None] * t)).sum(axis=0).real
        return np.exp(-t[:, None] * r) @ weights + ringing + settled

    coarse, fine = cut(0.02), cut(0.01)
    probe = np.linspace(math.log(first), math.log(case.horizon), 200)
    unsure = float(np.abs(signal(*coarse, probe) - signal(*fine, probe)).max())
    edges = np.linspace(math.log(first), math.log(case.horizon), 48)
    found = indices([
        Stretch(low, high, lambda z: signal(*coarse, z), np.exp, np.exp)
        for low, high in itertools.pairwise(edges)
    ])  # fmt: skip
    if found is None:
        return None
    start = max(1.0, abs(float(signal(*coarse, probe[:1])[0])))
    more = {}
    for name, (value, own) in found.items():
        of_time, of_error = POWERS[name]
        weight = case.horizon ** (of_time + 1) / (of_time + 1)
        spread = unsure * (weight if of_error == 1 else 2.0 * math.sqrt(weight * value) + unsure * weight)
        more[name] = (value, own + spread + start**of_error * first ** (of_time + 1))
    return more
