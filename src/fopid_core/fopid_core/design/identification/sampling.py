"""Processes that a record cannot tell from the one learnt: drawn from the covariance of the fit."""

from __future__ import annotations

import numpy as np

from fopid_core.design.identification.fit import Fit
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process

_STEP = 1e-6


def sampled_processes(found: Fit, covariance: Floats, count: int, seed: int) -> tuple[Process, ...]:
    """Draws from a normal distribution, each drawn back towards the estimate until it is within the ranges.

    Drawn are the free numbers and the gains over the denominator's leading coefficient: of a process that integrates,
    or nearly so, the steady-state gain is hardly known, but it and the time constant go together.

    Parameters
    ----------
    found : Fit
    covariance : ndarray, shape (k, k)
        Of its free numbers and linear ones.
    count, seed : int
    """
    size = found.x.size + found.gains.size
    lead = _log_lead(found, found.x)
    change = np.eye(size)
    change[found.x.size :, found.x.size :] *= np.exp(-lead)
    change[found.x.size :, : found.x.size] = -np.outer(found.gains * np.exp(-lead), _lead_slopes(found))
    values, vectors = np.linalg.eigh(change @ covariance[:size, :size] @ change.T)
    normal = np.random.default_rng(seed).standard_normal((count, size))
    moves = (normal * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    moves *= _share_inside(found, moves)[:, None]
    numbers = np.clip(found.x + moves[:, : found.x.size], *_ranges(found))  # the clip takes rounding off
    gains = found.gains * np.exp(-lead) + moves[:, found.x.size :]
    return tuple(
        found.structure.process(x, g * np.exp(_log_lead(found, x))) for x, g in zip(numbers, gains, strict=True)
    )


def _log_lead(found: Fit, x: Floats) -> float:
    return found.structure.fast_end(x)[1]


def _lead_slopes(found: Fit) -> Floats:
    steps = _STEP * np.eye(found.x.size)
    slopes = [(_log_lead(found, found.x + step) - _log_lead(found, found.x - step)) / (2.0 * _STEP) for step in steps]
    return np.array(slopes)


def _share_inside(found: Fit, moves: Floats) -> Floats:
    """The share of each move that the ranges leave, shape (count,)."""
    low, high = _ranges(found)
    room = np.where(moves[:, : found.x.size] > 0.0, high - found.x, found.x - low)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = room / np.abs(moves[:, : found.x.size])
    inside: Floats = np.minimum(np.nan_to_num(shares, nan=1.0).min(axis=1), 1.0)
    return inside


def _ranges(found: Fit) -> tuple[Floats, Floats]:
    return found.structure.bounds(found.response.sample_time, float(found.response.time[-1]))
