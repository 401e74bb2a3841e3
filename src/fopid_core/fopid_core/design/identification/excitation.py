"""What is known to have moved a loop from outside is the instrument by which a model is judged.

What it has moved is no disturbance: in a loop that answers disturbances the model that fits best is -1/C (Ljung 1999,
ch. 13.4).
"""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.identification.coloured_noise import behind
from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats

_EDGES = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""The answer to the instrument is looked for over as long as this many halves of a hold, in pieces."""
MANY_HALVES = _EDGES[-1]
"""A record of so many halves shows the whole answer once."""
BEYOND_CHANCE = 4.0
"""The instrument has moved the measurement when it explains so many times the power that it would explain by chance."""
ANSWERS = 0.3
"""What a setpoint moves is looked at no closer than this over the crossover, however short it is held."""
NO_CHANCE, SURELY = 2.5, 3.0
"""What is missed is no chance any more where it has so many times that power (in 5 of 1,000 cases, of ten numbers); it
then counts so many times."""
MOST_MISSED = 0.3
"""The largest share of what the instrument has moved that a model may miss."""


def missed_share(
    record: Record, time: Floats, measurement: Floats, residual: Floats, instrument: Floats, half: float
) -> float:
    """Of what an instrument has moved, the share that a model misses; infinite where it has moved no more than chance.

    Measurement and residual are both projected on the instrument and its past. What disturbances have moved is in
    neither, but for chance.

    Parameters
    ----------
    record : Record
    time, measurement, residual : ndarray, shape (n,)
        Instants after the record's first [s], the measurement there, and what the model leaves of it.
    instrument : ndarray, shape (samples of the record,)
        What moved the loop from outside: what an experiment added to its control, or its setpoint.
    half : float
        How closely the answer is looked at [s]: ``half_hold``, where the instrument is held for about as long as the
        loop takes to answer.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> time, added = np.arange(600.0), np.repeat(rng.integers(0, 2, 60), 10).astype(float)
    >>> moved, noise = np.convolve(added, np.exp(-time / 5.0))[:600], rng.standard_normal(600)
    >>> record = Record(time, added, moved + noise)
    >>> missed_share(record, time, moved + noise, noise, added, half_hold(record, added)) < 0.1
    True
    >>> missed_share(record, time, noise, 0.1 * noise, added, half_hold(record, added))
    inf
    """
    instants = record.time - record.time[0]
    summed = np.concatenate([[0.0], np.cumsum(instrument[:-1] * np.diff(instants))])
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


def missed_in_surprises(record: Record, surprises: Floats, whitening: Floats, instrument: Floats, half: float) -> float:
    """The same of a model of an even record whose residual is white behind a filter: of what is left of all behind it.

    Loads that wander hide what an instrument has moved; behind the filter they are as large as any surprise. So there
    chance is known, and what is missed beyond it counts more.

    Parameters
    ----------
    record : Record
    surprises : ndarray, shape (n,)
        What is left of the model's residual behind the filter.
    whitening : ndarray, shape (1 + order,)
    instrument : ndarray, shape (n,)
    half : float
        How closely the answer is looked at [s].
    """
    time = record.time - record.time[0]
    summed = np.concatenate([[0.0], np.cumsum(instrument[:-1] * np.diff(time))])
    means = np.diff([np.interp(time - half * edge, time, summed) for edge in _EDGES], axis=0)
    filtered = behind(whitening, means - means[:, :1]).T
    basis = np.linalg.qr(filtered / max(float(np.abs(filtered).max()), 1e-300))[0]
    left = surprises[whitening.size - 1 :]
    moved, missed = basis.T @ behind(whitening, record.measurement - record.measurement[0]), basis.T @ left
    chance = moved.size * float(np.mean(left**2))
    if float(moved @ moved) < BEYOND_CHANCE * chance:
        return math.inf
    share = float(np.linalg.norm(missed) / np.linalg.norm(moved))
    return share * SURELY if float(missed @ missed) > NO_CHANCE * chance else share


def half_hold(record: Record, instrument: Floats) -> float:
    """Half of the time for which an instrument is held between its moves, their median [s]; a ramp is one move.

    Examples
    --------
    >>> time = np.arange(60.0)
    >>> half_hold(Record(time, time, time), np.interp(time, [10.0, 20.0, 40.0, 41.0], [0.0, 1.0, 1.0, 0.0]))
    15.0
    """
    steps = np.sign(np.diff(instrument, prepend=instrument[0]))
    begins = record.time[(steps != 0.0) & (steps != np.roll(steps, 1))]
    return 0.5 * float(np.median(np.diff(begins))) if begins.size > 1 else record.span / MANY_HALVES
