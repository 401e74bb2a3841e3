"""What a picture needs of a long signal: fewer points that show the same, and a range that spikes do not spoil."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fopid_core.model.arrays import Floats

_RARE = 0.005  # of the samples, at each end
_FAR = 5.0  # times the range of the others


def decimate(time: Floats, value: Floats, stretches: int = 1500) -> tuple[Floats, Floats]:
    """First, lowest, highest and last of each of so many stretches with equal numbers of samples, and gaps of NaN.

    It looks the same as all samples (Jugel et al., "M4", VLDB 2014).

    Parameters
    ----------
    time, value : ndarray, shape (n,)
    stretches : int
        As many as the display has pixel columns, or more.

    Returns
    -------
    time, value : ndarray, shape (m,)
        Some of the samples, in order; all of them when there are no more than ``4 * stretches``.

    Examples
    --------
    >>> time, value = decimate(np.arange(1000.0), np.sin(np.arange(1000.0)), stretches=10)
    >>> time.size <= 40, float(time[-1])
    (True, 999.0)
    """
    n = time.size
    if n <= 4 * stretches:
        return time, value
    edges = np.linspace(0, n, stretches + 1).astype(int)
    kept = {0, n - 1}
    for start, end in pairwise(edges.tolist()):
        part = value[start:end]
        gap = np.isnan(part)
        lowest, highest = np.argmin(np.where(gap, np.inf, part)), np.argmax(np.where(gap, -np.inf, part))
        kept.update((start, start + int(lowest), start + int(highest), end - 1))
        kept.update((start + np.flatnonzero(np.diff(gap))).tolist())  # a gap stays a gap
    indexes = np.array(sorted(kept))
    return time[indexes], value[indexes]


def spike_free_range(value: Floats) -> tuple[float, float] | None:
    """The range to show a signal in when a few samples reach far beyond all others; None when none do.

    Examples
    --------
    >>> spike_free_range(np.array([0.0, 1.0] * 500)) is None
    True
    >>> spike_free_range(np.array([0.0, 1.0] * 500 + [900.0]))
    (-0.5, 1.5)
    """
    value = value[np.isfinite(value)]
    if value.size == 0:
        return None
    low, high = np.quantile(value, (_RARE, 1.0 - _RARE), method="closest_observation").tolist()
    if high == low or np.ptp(value) <= _FAR * (high - low):
        return None
    room = 0.5 * (high - low)
    return low - room, high + room
