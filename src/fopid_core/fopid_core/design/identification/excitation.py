"""Does anything but the measurement move the control: if not, a record shows the controller and not the process.

In a loop that only answers disturbances the model that fits best is -1/C (Ljung 1999, ch. 13.4). Where it is known what
an experiment has added to the control, that is the instrument by which a model is judged: what it has moved is no
disturbance.
"""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Floats

LEAST_SHARE = 1e-4
"""What moves the control by a smaller share of its surprises than this is the error of a short linear controller."""
_LAGS = 8
_PREDICTABLE = 1e-12
_EDGES = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""The answer to what was added is looked for over as long as this many halves of the time it was held, in pieces."""
BEYOND_CHANCE = 4.0
"""The addend has moved the measurement when it explains so many times the power that it would explain by chance."""
MOST_MISSED = 0.3
"""The largest share of what the addend has moved that a model may miss."""


def external_share(record: Record, start: InitialCondition) -> float:
    """The share of the control's surprises, as a power, that no linear feedback of the measurement explains.

    A surprise is what the last controls do not tell. 1 where samples are uneven, since that hides a feedback.

    Parameters
    ----------
    record : Record
    start : InitialCondition
        What is known about the beginning: a step from rest in the first instant counts.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise = rng.standard_normal(500)
    >>> answer = Record(np.arange(500.0), -0.5 * noise - 0.1 * np.cumsum(noise), noise)
    >>> external_share(answer, InitialCondition(step=True)) < LEAST_SHARE
    True
    >>> round(external_share(Record(np.arange(500.0), rng.standard_normal(500), noise), InitialCondition(step=True)), 1)
    1.0
    """
    if not record.is_regular:
        return 1.0
    control, measurement = record.control, record.measurement
    if not start.step:
        control = np.concatenate([np.full(_LAGS, start.before), control])
        measurement = np.concatenate([np.full(_LAGS, measurement[0]), measurement])
    own, seen = _lagged(control)[:, 1:], _lagged(measurement)
    alone = _left(own, control[_LAGS:])
    if alone <= _PREDICTABLE * float(np.sum(np.diff(control) ** 2)):
        return 1.0
    return _left(np.column_stack([own, seen]), control[_LAGS:]) / alone


def missed_share(record: Record, time: Floats, measurement: Floats, residual: Floats) -> float:
    """Of what the addend has moved, the share that a model misses; infinite where it has moved no more than chance.

    Measurement and residual are both projected on the addend and its past. What disturbances have moved is in neither,
    but for chance.

    Parameters
    ----------
    record : Record
        With an excitation.
    time, measurement, residual : ndarray, shape (n,)
        Instants after the record's first [s], the measurement there, and what the model leaves of it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> time, added = np.arange(600.0), np.repeat(rng.integers(0, 2, 60), 10).astype(float)
    >>> moved, noise = np.convolve(added, np.exp(-time / 5.0))[:600], rng.standard_normal(600)
    >>> record = Record(time, added, moved + noise, excitation=added)
    >>> missed_share(record, time, moved + noise, noise) < 0.1
    True
    >>> missed_share(record, time, noise, 0.1 * noise)
    inf
    """
    assert record.excitation is not None
    instants = record.time - record.time[0]
    moves = instants[np.flatnonzero(np.diff(record.excitation))]
    half = 0.5 * float(np.median(np.diff(moves))) if moves.size > 1 else record.span / _EDGES[-1]
    summed = np.concatenate([[0.0], np.cumsum(record.excitation[:-1] * np.diff(instants))])
    means = np.diff([np.interp(time - half * edge, instants, summed) for edge in _EDGES], axis=0)
    late = time >= half

    def changes(signal: Floats) -> Floats:
        """Within half a hold: a slow disturbance leaves little there."""
        changed = signal[late] - np.interp(time[late] - half, time, signal)
        return np.asarray(changed - changed.mean())

    size = max(float(np.abs(means).max()), 1e-300)
    basis = np.linalg.qr(np.stack([changes(mean / size) for mean in means], axis=1))[0]
    measured = changes(measurement)
    moved, missed = basis.T @ measured, basis.T @ changes(residual)
    rest = measured - basis @ moved
    chance = moved.size * float(np.mean(rest**2)) * correlation_time(rest)
    if float(moved @ moved) < BEYOND_CHANCE * chance:
        return math.inf
    return float(np.linalg.norm(missed) / np.linalg.norm(moved))


def _lagged(signal: Floats) -> Floats:
    """The signal now and before, one column for each lag, shape (n - lags, 1 + lags)."""
    return np.lib.stride_tricks.sliding_window_view(signal, _LAGS + 1)[:, ::-1]


def _left(columns: Floats, target: Floats) -> float:
    """The power that columns and a constant leave unexplained."""
    matrix = np.column_stack([np.ones(target.size), columns])
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    return float(np.sum((target - matrix @ (np.linalg.lstsq(matrix / sizes, target, rcond=1e-12)[0] / sizes)) ** 2))
