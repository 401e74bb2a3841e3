"""Peaks and margins of random loops from very many frequencies, by the numbers as they are written."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.model.margins import Margins

from .random_loops import Polynomial, RandomLoop

_PER_DECADE = 4000
_DECADES = 9  # to either side of where the loop moves
_CLOSE = 1e-6


def faults(case: RandomLoop, found: Margins) -> list[str]:
    """What contradicts the margins that were found: a frequency, each time."""
    w = _frequencies(case, found)
    wrong = []
    opened, slow = _loop(case, w)
    with np.errstate(all="ignore"):
        sizes = {"ms": np.abs(slow / (slow + opened)), "mt": np.abs(opened / (slow + opened))}
    for name, size in sizes.items():
        value, at = getattr(found, name), getattr(found, f"{name}_frequency")
        if math.isnan(value):
            continue
        highest = int(np.nanargmax(size))
        if size[highest] > value * (1.0 + 1e-8):
            wrong.append(f"{name} = {value!r}, but {size[highest]!r} at {w[highest]!r}")
        if 0.0 < at < math.inf:
            over, under = _loop(case, np.array([at]))
            there = float(np.abs((under if name == "ms" else over) / (under + over))[0])
            if abs(there / value - 1.0) > _CLOSE * max(1.0, 1e-8 * value):
                wrong.append(f"{name} = {value!r} at {at!r}, but there it is {there!r}")
    return wrong + _crossings(found, w, opened, slow)


def _crossings(found: Margins, w: np.ndarray, opened: np.ndarray, slow: np.ndarray) -> list[str]:
    """Where abs(L) or the phase crosses between two frequencies, and the margin there is worse than the answer's."""
    wrong = []
    ratio = opened / slow
    level = np.abs(opened) - np.abs(slow)
    for i in np.flatnonzero(level[1:] * level[:-1] < 0.0):
        margin = abs(math.remainder(float(np.angle(-ratio[i])), 2.0 * math.pi))
        turn = abs(float(np.angle(ratio[i + 1] / ratio[i])))
        if margin < abs(found.phase_margin) - 2.0 * turn - 1e-9:
            wrong.append(f"phase margin {found.phase_margin!r}, but {margin!r} at {w[i]!r}")
        ahead = math.remainder(float(np.angle(-ratio[i])), 2.0 * math.pi) % (2.0 * math.pi) / w[i]
        if ahead < found.delay_margin - (2.0 * turn + 1e-9) / w[i] - 1e-3 * found.delay_margin and turn < 0.1:
            wrong.append(f"delay margin {found.delay_margin!r}, but {ahead!r} at {w[i]!r}")
    crosses = (ratio.imag[1:] * ratio.imag[:-1] < 0.0) & (ratio.real[1:] < 0.0) & (ratio.real[:-1] < 0.0)
    for i in np.flatnonzero(crosses):
        share = ratio.imag[i] / (ratio.imag[i] - ratio.imag[i + 1])
        factor = -1.0 / (ratio.real[i] + share * (ratio.real[i + 1] - ratio.real[i]))
        step = abs(math.log(abs(ratio[i + 1] / ratio[i]))) + abs(float(np.angle(ratio[i + 1] / ratio[i])))
        if abs(math.log(factor)) < abs(math.log(found.gain_margin)) - 2.0 * step - 1e-9:
            wrong.append(f"gain margin {found.gain_margin!r}, but {factor!r} at {w[i]!r}")
    return wrong


def _frequencies(case: RandomLoop, found: Margins) -> np.ndarray:
    known = [f for f in (found.ms_frequency, found.mt_frequency, *found.crossovers) if 0.0 < f < math.inf]
    middle = known or [1.0]
    low, high = min(middle) * 10.0**-_DECADES, max(middle) * 10.0**_DECADES
    if case.delay:  # beyond, the phase turns faster than any grid
        high = min(high, 300.0 / float(case.delay))
        low = min(low, 1e-3 * high)
    w = np.geomspace(low, high, int(_PER_DECADE * math.log10(high / low)))
    near = [f * (1.0 + np.linspace(-1.0, 1.0, 2001) * width) for f in known for width in (1e-2, 1e-5, 1e-8)]
    w = np.unique(np.concatenate([w, *near]))
    return w[(w >= low) & (w <= high)]


def _loop(case: RandomLoop, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of L(jw)."""
    kp, ki, kd, lam, mu = (float(g) for g in case.gains)
    over, under = (_product(factors, w) for factors in (case.numerator, case.denominator))
    controller = kp + ki * _power(w, -lam) + kd * _power(w, mu)
    return controller * over * np.exp(-1j * float(case.delay) * w), under


def _product(factors: tuple[Polynomial, ...], w: np.ndarray) -> np.ndarray:
    out = np.ones(w.size, dtype=complex)
    for factor in factors:
        out *= sum(float(c) * _power(w, float(q)) for q, c in factor.items())
    return out


def _power(w: np.ndarray, order: float) -> np.ndarray:
    quarter = order % 4.0
    exact = {0.0: 1.0, 1.0: 1j, 2.0: -1.0, 3.0: -1j}.get(quarter)
    return w**order * (np.exp(0.5j * math.pi * order) if exact is None else exact)
