"""Noise with memory: an autoregression learnt from the residual makes it white, and the fit is made behind that filter.

A filter of both signals leaves a linear process as it is: generalised least squares (Clarke 1967).
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import MOST_CELLS, InitialCondition, RecordResponse
from fopid_core.design.identification.runaway import RunawayResponse
from fopid_core.design.identification.structure import Structure
from fopid_core.model.arrays import Booleans, Floats

ORDER, LONG_ORDER = 6, 32
"""Of the autoregression, and of that for a process that runs away: noise of its own control is slow beside ticks."""
_ROUNDS = 2
_EVALUATIONS = 20
_AT_REST = 1e-3
"""Rounds end where no number of the process moves by more than this share of the largest."""


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


def behind(whitening: Floats, signals: Floats) -> Floats:
    """What is left of signals, shape (..., n), behind a filter, without the samples that it takes to begin.

    Examples
    --------
    >>> behind(np.array([1.0, -0.5]), np.array([[2.0, 1.0, 0.5, 1.0]]))
    array([[0.  , 0.  , 0.75]])
    """
    filtered: Floats = lfilter(whitening, np.ones(1), signals, axis=-1)
    return filtered[..., whitening.size - 1 :]


class _Whitened(RecordResponse):
    """Mixed into a response: it, and what it is fitted to, behind a filter."""

    def __init__(
        self,
        record: Record,
        structure: Structure,
        start: InitialCondition,
        whitening: Floats,
        most: int = MOST_CELLS,
    ) -> None:
        super().__init__(record, structure, start, most)
        self.whitening = whitening

    def columns(self, x: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().columns(x))

    def target(self, x: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().target(x))

    def _filtered(self, signals: Floats) -> Floats:
        filtered: Floats = lfilter(self.whitening, np.ones(1), signals, axis=0)
        return filtered


class WhitenedResponse(_Whitened):
    """A response, and the measurement, behind a filter."""

    def slopes(self, x: Floats, coefficients: Floats) -> Floats:
        """The same behind the filter."""
        return self._filtered(super().slopes(x, coefficients))


class WhitenedRunawayResponse(_Whitened, RunawayResponse):
    """The response of a process that runs away, behind a filter: its slopes are differences of what is behind it."""


def fit_in_coloured_noise(found: Fit, rows: Booleans) -> tuple[Fit, Fit]:
    """The fit to an evenly spaced record, made on some of its samples, as it is and behind the filter.

    Parameters
    ----------
    found : Fit
        One that takes the noise for white, to all samples of the record.
    rows : ndarray of bool, shape (n,)
    """
    runs_away = found.structure.runs_away
    kind, order = (WhitenedRunawayResponse, LONG_ORDER) if runs_away else (WhitenedResponse, ORDER)
    return fit_in_turns(kind, found.response, found.x, whitener(found.residual, order), rows, _ROUNDS, _EVALUATIONS)


def fit_in_turns(
    kind: type[_Whitened],
    response: RecordResponse,
    x: Floats,
    whitening: Floats,
    rows: Booleans,
    most: int,
    evaluations: int,
) -> tuple[Fit, Fit]:
    """The process behind a filter and the filter from what the process leaves, so many times at most.

    Parameters
    ----------
    kind : type
        What the response behind the filter is.
    response : RecordResponse
        Without it, to an evenly spaced record.
    x : ndarray
        Free numbers of the process to begin with.
    whitening : ndarray, shape (1 + order,)
        Filter to begin with.
    rows : ndarray of bool, shape (n,)
    most, evaluations : int

    Returns
    -------
    Fit, Fit
        As it is, and behind the filter.
    """
    order = whitening.size - 1
    began = rows & (np.arange(rows.size) >= order)
    for _ in range(most):
        behind = kind(response.record, response.structure, response.start, whitening, response.most)
        white, before = fit(behind, x, began, evaluations, 1e-6), x
        residual = response.target(white.x) - response.columns(white.x) @ white.coefficients
        x, whitening = white.x, whitener(residual, order)
        if np.abs(x - before).max() <= _AT_REST * np.abs(x).max():
            break
    error = float(np.sqrt(np.mean(residual[rows] ** 2)))
    return Fit(response, x, white.coefficients, residual, error, rows), white
