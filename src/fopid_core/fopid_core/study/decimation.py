"""Fewer points for a display that shows the same: first, lowest, highest and last of every stretch are kept."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fopid_core.model.arrays import Floats


def decimate(time: Floats, value: Floats, stretches: int = 1500) -> tuple[Floats, Floats]:
    """At most four points for each of so many stretches of equal numbers of samples ("M4", Jugel et al. 2014).

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
        kept.update((start, start + int(np.argmin(part)), start + int(np.argmax(part)), end - 1))
    indexes = np.array(sorted(kept))
    return time[indexes], value[indexes]
