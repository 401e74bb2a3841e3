"""Processes that a record cannot tell from the one learnt: drawn from the covariance of the fit, held to the record."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from fopid_core.design.identification.fit import Fit, at
from fopid_core.design.identification.quality import noise_power
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process

RARE = 0.01
"""Of all records, the share that would speak as much against the truth as a draw may be spoken against."""
_HALVINGS, _DEPENDENT = 12, 1e-13


def sampled_processes(found: Fit, covariance: Floats, count: int, seed: int) -> tuple[Process, ...]:
    """Draws of the free numbers, each with gains as the record has them beside it, and their own scatter.

    The covariance is that of small moves. Of a number that the record hardly shows, a slow pole's or a fast one's, it
    makes moves far beyond, where the response is another: a draw that leaves a larger residual than chance would is
    drawn back towards the estimate, by halves.

    Parameters
    ----------
    found : Fit
    covariance : ndarray, shape (k, k)
        Of its free numbers and linear ones.
    count, seed : int
    """
    size, linear = found.x.size, found.gains.size
    values, vectors = np.linalg.eigh(covariance[:size, :size])
    normal = np.random.default_rng(seed).standard_normal((count, size + linear))
    moves = (normal[:, :size] * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return tuple(_drawn(found, move, scatter) for move, scatter in zip(moves, normal[:, size:], strict=True))


def _drawn(found: Fit, move: Floats, scatter: Floats) -> Process:
    """The process that a move of the free numbers leads to, or the part of it that the record bears."""
    low, high = found.structure.bounds(found.response.sample_time, float(found.response.time[-1]))
    power, count = noise_power(found), int(found.rows.sum())
    most = found.error**2 + power / count * chdtri(found.x.size, RARE)
    for halvings in range(_HALVINGS):
        near = at(found.response, np.clip(found.x + 0.5**halvings * move, low, high), found.rows)
        if near.error**2 <= most:
            break
    else:
        near = found
    return found.structure.process(near.x, near.gains + _gain_spread(near, power) @ scatter)


def _gain_spread(found: Fit, power: float) -> Floats:
    """A root of the covariance of the gains beside given free numbers, shape (k, k)."""
    columns = found.response.columns(found.x)[found.rows]
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    inverse = np.linalg.pinv((columns / sizes).T @ (columns / sizes), rcond=_DEPENDENT, hermitian=True)
    linear = found.gains.size
    values, vectors = np.linalg.eigh((power * inverse / np.outer(sizes, sizes))[:linear, :linear])
    root: Floats = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
