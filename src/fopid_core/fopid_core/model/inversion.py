"""From transforms to signals: the inverse Laplace transform by inverse FFT.

A transform sampled on the line s = a + jw is a Fourier series of exp(-a t) times its signal (Dubner and Abate 1968,
Crump 1976). A horizon much longer than the signal is fast is cut into windows, each an eighth of the one before, so
that the first instants are seen as sharply as the last. In each window the number of points is doubled until the
signal no longer changes; it begins where the transform has died out, so that two numbers of points cannot agree for
having missed the same detail.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fopid_core.errors import UnknownResponseError
from fopid_core.model.arrays import Complexes, Floats, Indexes

TOLERANCE = 1e-6  # two numbers of points must agree to this before either is believed
_LEAK = 1e-8  # of the line itself and of rounding, whatever the number of points
_PERIODS = 4  # the Fourier series repeats after so many times the window
_DAMPING = 24.0  # exp(-24) leaks from one period into the next; exp(24 / 4) is what rounding grows by within the window
_WINDOW_RATIO = 8
_MOST_WINDOWS = 16
_FAST_INSTANTS = 20.0  # the first window is so many times 1 / rate long
_FEWEST_POINTS = 1 << 12
_RESOLVED = 400.0  # points for each 1 / rate of the window, beyond which more of them add only rounding
_FEWEST_SAMPLES = 512  # where nothing is left
_SPLINE_GAIN, _EDGE_GAIN = 8.0, 3.0  # a cubic spline through twice the samples misses a sixteenth, less at its ends
_SAFETY = 3.0  # of what doubling the points changed
_ROUNDING_SEEN = 3  # doublings in a row that made it worse: without echoes, that is rounding


@dataclass(frozen=True)
class Signals:
    """k signals by their transforms.

    Attributes
    ----------
    transforms : callable
        From points s, shape (m,), to the transforms there, shape (k, m); the signals are smooth for t > 0.
    sizes : callable
        From instants [s], shape (n,), to sizes, shape (k, n): what an error is measured by, besides the signal and 1.
    rate : float
        How fast the signals change at first [1/s].
    growth : float
        No signal grows faster than exp(growth * t) [1/s]; below 0 they die out so fast.
    band : float
        The frequency [rad/s] above which next to nothing is left of the transforms.
    calm : float
        The instant [s] from which nothing fast is left of the signals, or nothing at all where they die out.
    echoes : bool
        Whether a signal may change as fast later as at first.
    most_points : int
        Where to stop looking closer.
    """

    transforms: Callable[[Complexes], Complexes]
    sizes: Callable[[Floats], Floats]
    rate: float
    growth: float = 0.0
    band: float = 0.0
    calm: float = 0.0
    echoes: bool = False
    most_points: int = 1 << 19


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

    @cached_property
    def spline(self) -> tuple[Callable[[Floats], Floats], Floats]:
        """The signals between the samples, and the largest error of that: what half of them miss of the others."""
        from scipy.interpolate import CubicSpline

        size = self.time.size - (self.time.size + 1) % 2
        half = CubicSpline(self.time[:size:2], self.values[:, :size:2], axis=1)(self.time[1:size:2])
        missed = np.abs(half - self.values[:, 1:size:2])
        edge = max(missed.shape[1] // 64, 2)
        error = np.maximum(missed[:, edge:-edge].max(axis=1) / _SPLINE_GAIN, missed.max(axis=1) / _EDGE_GAIN)
        return CubicSpline(self.time, self.values.T), error


def fastest_rate(horizon: float) -> float:
    """The fastest rate [1/s] that the shortest window on this horizon resolves."""
    return float(_FAST_INSTANTS * _WINDOW_RATIO**_MOST_WINDOWS / horizon)


def invert(signals: Signals, horizon: float) -> tuple[Piece, ...]:
    """Signals from their transforms, up to a horizon [s].

    Returns
    -------
    tuple of Piece
        One a window, in the order of time, together from 0 to the horizon; where the signals are too fast for the
        shortest window, from a first instant above 0.

    Examples
    --------
    >>> signals = Signals(lambda s: 1.0 / (s + 1.0)[None, :] ** 2, np.zeros_like, rate=1.0)
    >>> (piece,) = invert(signals, horizon=2.0)
    >>> round(float(piece.values[0, -1]), 6)  # t exp(-t)
    0.270671
    """
    count = math.ceil(math.log(max(signals.rate * horizon / _FAST_INSTANTS, 1.0), _WINDOW_RATIO))
    start = 0.0 if count <= _MOST_WINDOWS else horizon / _WINDOW_RATIO ** (_MOST_WINDOWS + 1)
    edges = [start, *(horizon / _WINDOW_RATIO**k for k in range(min(count, _MOST_WINDOWS), -1, -1))]
    pieces: list[Piece] = []
    for first, last in itertools.pairwise(edges):
        if pieces and signals.growth < 0.0 and first > signals.calm:
            pieces.append(_nothing(pieces[-1], last))
        else:
            pieces.append(_window(signals, first, last))
    return tuple(pieces)


def values_at(pieces: tuple[Piece, ...], time: Floats) -> tuple[Floats, Floats]:
    """All signals at any instants up to the horizon and their estimated errors; before the first instant as there.

    Returns
    -------
    values, errors : ndarray, shape (k, n)
    """
    time = np.maximum(time, pieces[0].time[0])
    values, errors = np.empty((2, pieces[0].values.shape[0], time.size))
    home = np.searchsorted([piece.time[-1] for piece in pieces[:-1]], time)
    for i in np.unique(home):
        own, piece = home == i, pieces[i]
        instants = time[own]
        spline, error = piece.spline
        values[:, own] = spline(instants).T
        errors[:, own] = (piece.accuracy + error)[:, None]
    return values, errors


def _nothing(before: Piece, last: float) -> Piece:
    """Signals that have died out by the end of the window before."""
    time = np.linspace(before.time[-1], last, _FEWEST_SAMPLES + 1)[1:]
    left = np.abs(before.values[:, -before.time.size // 8 :]).max(axis=1)
    return Piece(time, np.zeros((before.values.shape[0], time.size)), before.accuracy + left)


def _fewest_points(signals: Signals, first: float, last: float) -> int:
    """So many that nothing of the transforms is missed, unless what is fast in them is over."""
    if first > signals.calm:
        return _FEWEST_POINTS
    needed = 2.0 * signals.band * _PERIODS * last / math.pi
    number = max(1 << math.ceil(math.log2(max(min(needed, 1e18), 1.0))), _FEWEST_POINTS)
    if 2 * number > signals.most_points:
        raise UnknownResponseError(
            f"the response up to {last:.3g} s, with details of {signals.band:.3g} rad/s until then, takes "
            f"{2 * number:.3g} points",
            f"{signals.most_points}, so a shorter horizon or a slower loop",
        )
    return number


def _window(signals: Signals, first: float, last: float) -> Piece:
    """One window, with twice as many points again until that changes nothing, or no longer for the better."""
    number = _fewest_points(signals, first, last)
    line = _line(signals, last, np.arange(number // 2 + 1))
    transforms = signals.transforms(line)
    coarse = _samples(transforms, line[0].real, last)
    best, values, kept = np.array([np.inf]), coarse, 0
    gaps = [math.inf]
    while number < signals.most_points and gaps[-1] > TOLERANCE and not _is_rounding(signals, number, last, gaps):
        number *= 2
        above = _line(signals, last, np.arange(transforms.shape[1], number // 2 + 1))
        transforms = np.concatenate((transforms, signals.transforms(above)), axis=1)
        fine = _samples(transforms, line[0].real, last)
        start = math.ceil(first / last * (number // (2 * _PERIODS)))
        gap = _gap(signals, last, fine[:, ::2], coarse, start)
        gaps.append(float(gap.max()))
        if gaps[-1] < best.max():
            best, values, kept = gap, fine, 2 * start
        coarse = fine
    kept += 1 if first else 0  # the window before ends with our first instant
    return Piece(
        np.linspace(0.0, last, values.shape[1])[kept:],
        values[:, kept:],
        np.maximum(_SAFETY * best, _LEAK * np.maximum(np.abs(values).max(axis=1), 1.0)),
    )


def _is_rounding(signals: Signals, number: int, last: float, gaps: list[float]) -> bool:
    """Whether more points have begun to make it worse; with echoes, or early, that may be a detail coming into view."""
    if number > _RESOLVED * signals.rate * last:
        return gaps[-1] > min(gaps)
    recent = gaps[-_ROUNDING_SEEN - 1 :]
    return not signals.echoes and len(gaps) > _ROUNDING_SEEN + 1 and recent == sorted(recent)


def _gap(signals: Signals, last: float, fine: Floats, coarse: Floats, start: int) -> Floats:
    """The largest difference of each signal from an instant on, relative to the signal where that is above 1."""
    gap: Floats = np.abs(fine - coarse)[:, start:]
    if gap.max() > TOLERANCE:
        size = np.abs(fine[:, start:]) + signals.sizes(np.linspace(0.0, last, fine.shape[1])[start:])
        gap = gap / np.maximum(size, 1.0)
    return np.asarray(gap.max(axis=1), dtype=np.float64)


def _line(signals: Signals, last: float, index: Indexes) -> Complexes:
    """Points of the line that is summed over, one for each index from 0 on."""
    period = _PERIODS * last
    line = _DAMPING / period + signals.growth
    if abs(line) * period < 1.0:  # not through the origin, where parts that were taken out have their poles
        line = 1.0 / period
    return np.asarray(line + 2j * np.pi / period * index, dtype=np.complex128)


def _samples(transforms: Complexes, line: float, last: float) -> Floats:
    """The signals at evenly spaced instants from 0 to ``last``, from their transforms at the points of a line."""
    size = transforms.shape[1]
    number = 2 * (size - 1)
    series = np.fft.irfft(transforms * _taper(size), axis=1)[:, : number // _PERIODS + 1]
    values: Floats = series * np.exp(line * np.linspace(0.0, last, series.shape[1])) * (number / (_PERIODS * last))
    return values


def _taper(size: int) -> Floats:
    """One up to half the band, then down smoothly: what the window does not resolve stays where it is in time."""
    from scipy.special import erfc

    values: Floats = 0.5 * erfc(18.0 * (np.linspace(0.0, 1.0, size) - 0.75))
    return values
