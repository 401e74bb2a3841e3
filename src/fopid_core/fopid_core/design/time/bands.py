"""The least value in each band of a grid: smooth in the gains where their minimum over all of it is not."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

AROUND = np.array([-0.4, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4])
"""Where a peak is looked at, in units of its width."""
SMALLEST = 1e-300


def log_size(values: Complex) -> Real:
    """The logarithm of the absolute value; that of zero is finite, so that its slope is 0 and not unknown."""
    return np.asarray(0.5 * np.log(np.maximum(values.real**2 + values.imag**2, SMALLEST)))


def least_in_bands(values: Real, position: Real, bands: int) -> Real:
    """The least value in each of some bands along the second axis, between points by a parabola, shape (n, bands).

    A parabola goes no further below its points than on an even grid, an eighth of what they differ by; where a position
    is NaN there is none.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.5, 11)
    >>> least_in_bands((x[None] - 0.1) ** 2, x, 1).round(12).tolist()
    [[0.0]]
    """
    rows, count = values.shape
    members = _members(count, bands)
    in_bands = values.reshape(rows, bands, -1) if members.size == count else values[:, members]
    least = members[np.arange(bands), in_bands.argmin(axis=2)]
    at = np.minimum(np.maximum(least, 1), count - 2)
    flat, begins = values.ravel(), count * np.arange(rows)[:, None]
    before, here, after = (flat.take(begins + at + offset) for offset in (-1, 0, 1))
    gaps = np.diff(position)
    left, right = gaps[at - 1], gaps[at]
    with np.errstate(divide="ignore", invalid="ignore"):
        fall, rise = (before - here) / left, (after - here) / right
        slope = rise * left - fall * right
        depth = 0.25 * slope**2 / ((fall + rise) * (left + right))
        bottom = here - np.minimum(depth, 0.125 * np.maximum(before - here, after - here))
    lowest = (at == least) & (fall >= 0.0) & (rise >= 0.0) & np.isfinite(bottom)
    return np.asarray(np.where(lowest, bottom, flat.take(begins + least)))


def smooth_places(log_w: Real, delay: float) -> Real:
    """Places of frequencies for ``least_in_bands``, NaN where a delay turns by a radian and more to the next one.

    Examples
    --------
    >>> smooth_places(np.array([0.0, 1.0, 2.0]), delay=0.5).tolist()
    [0.0, 1.0, nan]
    """
    w = np.exp(log_w)
    turns = delay * np.diff(w, prepend=w[0]) > 1.0
    return np.where(turns, math.nan, log_w)


def around(peak: float, width: float) -> tuple[float, ...]:
    """Where to look at a peak of so much width, as ln w."""
    return tuple((peak + width * AROUND).tolist())


@lru_cache(maxsize=64)
def _members(count: int, bands: int) -> NDArray[np.intp]:
    """Positions in each band, shape (bands, most of one); a shorter band repeats its last."""
    edges = np.linspace(0, count, bands + 1).astype(int)
    places = edges[:-1, None] + np.arange(np.diff(edges).max())
    return np.asarray(np.minimum(places, edges[1:, None] - 1))
