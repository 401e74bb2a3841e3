"""How fast an unstable loop grows: the line Re s = a to the right of all its poles."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.model.adaptive_grid import refine
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.asymptotics import fast_rate, leading_term
from fopid_core.model.quasipolynomial import QuasiPolynomial

_POINTS = 400
_TURN_STEP = 0.5  # rad of the longest delay's phase between points
_MOST_TURNS = 20_000
_FINENESS = 1.02  # the line is found to 2 %


def spectral_abscissa_bound(function: QuasiPolynomial, largest: float) -> float:
    """A line Re s = a with no zero to its right, at most 2 % further right than it need be.

    Parameters
    ----------
    function : QuasiPolynomial
    largest : float
        Where to give up.

    Returns
    -------
    float
        a, at least ``largest`` / 1000; infinite when it would be above ``largest``.

    Examples
    --------
    >>> round(spectral_abscissa_bound(QuasiPolynomial.polynomial([1.0, -3.0]), largest=100.0), 1)
    3.0
    """
    low, high = 0.0, 1e-3 * largest
    while not _is_clear(function, high):
        if high >= largest:
            return math.inf
        low, high = high, min(2.0 * high, largest)
    while low and high > _FINENESS * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if _is_clear(function, middle) else (middle, high)
    return high


def _is_clear(function: QuasiPolynomial, line: float) -> bool:
    """Whether no zero lies to the right of a line: the argument principle, counted on a fine grid."""
    lead = leading_term(function)
    delayed = sum(abs(t.coefficient) * math.exp(-t.delay * line) for t in function.terms if t.order == lead.order)
    if delayed >= 2.0 * abs(lead.coefficient):  # the undelayed term itself is in the sum
        return False
    z = _grid(function, line)

    def curve(z: Floats) -> Complexes:
        return function(line + 1j * np.exp(z)) / lead.coefficient

    z, values = refine(curve, z)
    turned = float(np.angle(values[0] / np.sign(function(line).real / lead.coefficient)))
    turned += float(np.sum(np.angle(values[1:] / values[:-1])))
    end = line + 1j * np.exp(z[-1])
    turned += lead.order * (0.5 * math.pi - np.angle(end)) - float(np.angle(values[-1] / end**lead.order))
    return bool(round(0.5 * lead.order - turned / math.pi) == 0)


def _grid(function: QuasiPolynomial, line: float) -> Floats:
    top = max(fast_rate(function), line) * 10.0
    z = np.linspace(math.log(1e-3 * line), math.log(top), _POINTS)
    longest = max(t.delay for t in function.terms)
    if not longest:
        return z
    turns = min(math.ceil(top * longest / _TURN_STEP), _MOST_TURNS)
    return np.unique(np.concatenate((z, np.log(np.linspace(0.0, top, turns + 1)[1:]))))
