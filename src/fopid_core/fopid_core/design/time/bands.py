"""The least value in each band of a grid: smooth in the gains where their minimum over all of it is not."""

from __future__ import annotations

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

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.5, 11)
    >>> least_in_bands((x[None] - 0.1) ** 2, x, 1).round(12).tolist()
    [[0.0]]
    """
    members = _members(values.shape[1], bands)
    rows = np.arange(len(values))[:, None]
    least = members[np.arange(bands), values[:, members].argmin(axis=2)]
    at = np.clip(least, 1, values.shape[1] - 2)
    before, here, after = values[rows, at - 1], values[rows, at], values[rows, at + 1]
    left, right = position[at] - position[at - 1], position[at + 1] - position[at]
    with np.errstate(divide="ignore", invalid="ignore"):
        fall, rise = (before - here) / left, (after - here) / right
        bend = (fall + rise) / (left + right)
        slope = (rise * left - fall * right) / (left + right)
        bottom = here - 0.25 * slope**2 / bend
    lowest = (at == least) & (fall >= 0.0) & (rise >= 0.0) & np.isfinite(bottom)
    return np.asarray(np.where(lowest, bottom, values[rows, least]))


def around(peak: float, width: float) -> tuple[float, ...]:
    """Where to look at a peak of so much width, as ln w."""
    return tuple((peak + width * AROUND).tolist())


@lru_cache(maxsize=64)
def _members(count: int, bands: int) -> NDArray[np.intp]:
    """Positions in each band, shape (bands, most of one); a shorter band repeats its last."""
    edges = np.linspace(0, count, bands + 1).astype(int)
    places = edges[:-1, None] + np.arange(np.diff(edges).max())
    return np.asarray(np.minimum(places, edges[1:, None] - 1))
