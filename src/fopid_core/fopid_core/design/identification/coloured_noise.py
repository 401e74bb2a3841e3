"""Noise with memory: an autoregression learnt from the residual makes it white, and the fit is made behind that filter.

A filter of both signals leaves a linear process as it is: generalised least squares (Clarke 1967).
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition, RecordResponse
from fopid_core.design.identification.runaway import RunawayResponse
from fopid_core.design.identification.structure import Structure
from fopid_core.model.arrays import Booleans, Floats

ORDER, LONG_ORDER = 6, 32
"""Of the autoregression, and of that for a process that runs away: noise of its own control is slow beside ticks."""
_ROUNDS = 2
_EVALUATIONS = 20


def whitener(residual: Floats, order: int = ORDER) -> Floats:
    """The filter that leaves of a residual, shape (n,), what its past does not tell, shape (1 + order,).

    Examples
    --------
    >>> white = np.random.default_rng(0).standard_normal(20000)
    >>> whitener(lfilter([1.0], [1.0, -0.9], white)).round(1)[:3] + 0.0
    array([ 1. , -0.9,  0. ])
    """
    past = np.stack([np.roll(residual, i)[order:] for i in range(1, order + 1)], axis=1)
    weights = np.linalg.lstsq(past, residual[order:], rcond=1e-8)[0]
    return np.append(1.0, -np.asarray(weights, dtype=np.float64))


class _Whitened(RecordResponse):
    """Mixed into a response: it, and what it is fitted to, behind a filter."""

    def __init__(self, record: Record, structure: Structure, start: InitialCondition, whitening: Floats) -> None:
        super().__init__(record, structure, start)
        self._whitening = whitening

    def columns(self, x: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().columns(x))

    def target(self, x: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().target(x))

    def _filtered(self, signals: Floats) -> Floats:
        filtered: Floats = lfilter(self._whitening, np.ones(1), signals, axis=0)
        return filtered


class WhitenedResponse(_Whitened):
    """A response, and the measurement, behind a filter."""

    def slopes(self, x: Floats, coefficients: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().slopes(x, coefficients))


class WhitenedRunawayResponse(_Whitened, RunawayResponse):
    """The response of a process that runs away, behind a filter: its slopes are differences of what is behind it."""


def fit_in_coloured_noise(record: Record, found: Fit, rows: Booleans) -> tuple[Fit, Fit]:
    """The fit to an evenly spaced record, made on some of its samples, as it is and behind the filter.

    Parameters
    ----------
    record : Record
    found : Fit
        One that takes the noise for white, to all samples of the record.
    rows : ndarray of bool, shape (n,)
    """
    runs_away = found.structure.runs_away
    kind, order = (WhitenedRunawayResponse, LONG_ORDER) if runs_away else (WhitenedResponse, ORDER)
    began = rows & (np.arange(rows.size) >= order)
    plain, white = found, found
    for _ in range(_ROUNDS):
        response = kind(record, found.structure, found.response.start, whitener(plain.residual, order))
        white = fit(response, plain.x, began, _EVALUATIONS, 1e-6)
        residual = found.response.target(white.x) - found.response.columns(white.x) @ white.coefficients
        error = float(np.sqrt(np.mean(residual[rows] ** 2)))
        plain = Fit(found.response, white.x, white.coefficients, residual, error, rows)
    return plain, white
