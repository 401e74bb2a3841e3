"""From transforms to signals: the inverse Laplace transform by inverse FFT.

A transform sampled on the line s = a + jw is a Fourier series of exp(-a t) times its signal (Dubner and Abate 1968,
Crump 1976). A horizon much longer than the signal is fast is cut into windows, each an eighth of the one before, so
that the first instants are seen as sharply as the last. In each window the number of points is doubled until the
signal no longer changes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Complexes, Floats

Transforms = Callable[[Complexes], Complexes]
"""From points s, shape (m,), to the transforms of k signals there, shape (k, m)."""

Sizes = Callable[[Floats], Floats]
"""From instants [s], shape (n,), to the sizes that errors are measured by, shape (k, n)."""

TOLERANCE = 1e-6  # two numbers of points must agree to this before either is believed
_LEAK = 1e-8  # of the line itself and of rounding, whatever the number of points
_DAMPING = 23.0  # exp(-23) = 1e-10: what one period of the Fourier series leaks into the next
_WINDOW_RATIO = 8
_MOST_WINDOWS = 16
_FAST_INSTANTS = 20.0  # the first window is so many times 1 / rate long
_FEWEST_POINTS, _MOST_POINTS = 1 << 11, 1 << 19
_MOST_FIRST_POINTS = 1 << 14  # the first window is as short as the signals are fast: more only adds rounding


@dataclass(frozen=True)
class Piece:
    """k signals at evenly spaced instants of one window.

    Attributes
    ----------
    time : ndarray, shape (n,)
    values : ndarray, shape (k, n)
    accuracy : ndarray, shape (k,)
        Estimated largest error, relative to the signal's size.
    """

    time: Floats
    values: Floats
    accuracy: Floats


def fastest_rate(horizon: float) -> float:
    """The fastest rate [1/s] that the shortest window on this horizon resolves."""
    return float(_FAST_INSTANTS * _WINDOW_RATIO**_MOST_WINDOWS / horizon)


def invert(transforms: Transforms, sizes: Sizes, horizon: float, rate: float, growth: float = 0.0) -> tuple[Piece, ...]:
    """Signals from their transforms.

    Parameters
    ----------
    transforms : callable
        Transforms of k signals that are smooth for t > 0.
    sizes : callable
        What an error of each signal is measured by, besides the signal itself and 1.
    horizon : float
        Last instant [s].
    rate : float
        How fast the signals change at first [1/s].
    growth : float
        No signal grows faster than exp(growth * t) [1/s].

    Returns
    -------
    tuple of Piece
        One a window, in the order of time, together from 0 to the horizon; where the signals are too fast for the
        shortest window, from a first instant above 0.

    Examples
    --------
    >>> (piece,) = invert(lambda s: 1.0 / (s + 1.0)[None, :] ** 2, lambda t: 0.0 * t, horizon=2.0, rate=1.0)
    >>> round(float(piece.values[0, -1]), 6)  # t exp(-t)
    0.270671
    """
    count = math.ceil(math.log(max(rate * horizon / _FAST_INSTANTS, 1.0), _WINDOW_RATIO))
    start = 0.0 if count <= _MOST_WINDOWS else horizon / _WINDOW_RATIO ** (_MOST_WINDOWS + 1)
    edges = [start, *(horizon / _WINDOW_RATIO**k for k in range(min(count, _MOST_WINDOWS), -1, -1))]
    return tuple(_window(transforms, sizes, first, last, growth) for first, last in itertools.pairwise(edges))


def values_at(pieces: tuple[Piece, ...], time: Floats) -> Floats:
    """All signals at any instants up to the horizon, shape (k, n); before the first instant as at that instant."""
    from scipy.interpolate import CubicSpline

    time = np.maximum(time, pieces[0].time[0])
    values = np.empty((pieces[0].values.shape[0], time.size))
    home = np.searchsorted([piece.time[-1] for piece in pieces[:-1]], time)
    for i, piece in enumerate(pieces):
        values[:, home == i] = CubicSpline(piece.time, piece.values, axis=1)(time[home == i])
    return values


def _window(transforms: Transforms, sizes: Sizes, first: float, last: float, growth: float) -> Piece:
    number, most = _FEWEST_POINTS, _MOST_POINTS if first else _MOST_FIRST_POINTS
    coarse, gap = _samples(transforms, last, number, growth), np.array([np.inf])
    while gap.max() > TOLERANCE and number < most:
        number *= 2
        fine = _samples(transforms, last, number, growth)
        start = math.ceil(first / last * (number // 4))
        shared = fine[:, ::2][:, start:]
        gap = np.abs(shared - coarse[:, start:])
        if gap.max() > TOLERANCE:
            time = np.linspace(0.0, last, number // 4 + 1)[start:]
            gap /= np.maximum(np.maximum(np.abs(shared), sizes(time)), 1.0)
        coarse = fine
    kept = slice(2 * start + (1 if first else 0), None)  # the window before ends with our first instant
    accuracy = np.maximum(gap.max(axis=1), _LEAK)
    return Piece(np.linspace(0.0, last, number // 2 + 1)[kept], fine[:, kept], accuracy)


def _samples(transforms: Transforms, last: float, number: int, growth: float) -> Floats:
    """The signals at number // 2 + 1 instants from 0 to ``last``; ``growth`` [1/s] moves the line to the right."""
    period = 2.0 * last
    line = _DAMPING / period + growth
    s: Complexes = np.asarray(line + 2j * np.pi / period * np.arange(number // 2 + 1), dtype=np.complex128)
    time = np.linspace(0.0, last, number // 2 + 1)
    series = np.fft.irfft(transforms(s) * _taper(number // 2 + 1), axis=1)[:, : number // 2 + 1]
    values: Floats = series * np.exp(line * time) * (number / period)
    return values


def _taper(size: int) -> Floats:
    """One up to half the band, then down smoothly: what the window does not resolve stays where it is in time."""
    from scipy.special import erfc

    values: Floats = 0.5 * erfc(18.0 * (np.linspace(0.0, 1.0, size) - 0.75))
    return values
