"""A sensor that reads more seldom than the controller ticks: between its readings the record repeats the last one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fopid_core.design.identification.record import FEWEST_SAMPLES, Record
from fopid_core.model.arrays import Floats, Indexes

_REGULAR, _USUAL, _JITTER = 0.9, 0.6, 0.1
"""Such a share of the moves come whole numbers of readings apart, such a share one reading; each may be off by a share
of the time between two, in whole ticks."""
_FEWEST_MOVES = 20
"""From so many moves on that is told."""


def as_read(record: Record) -> Record:
    """The record at the readings of a sensor that is slower than the controller; the record itself where it is not.

    A reading counts where it is as old as readings are on the mean, so that a process that is learnt from it has the
    delay by which the controller hears of it. The control is the mean of its values between two readings.

    Examples
    --------
    >>> time, noise = 0.1 * np.arange(600.0), np.random.default_rng(0).standard_normal(600)
    >>> held = np.repeat((np.sin(time) + 0.01 * noise)[::4], 4)
    >>> found = as_read(Record(time, time, held))
    >>> found.time.size, found.sample_time, round(float(found.time[0]), 6)  # the first reading is heard 0.2 s late
    (149, 0.4, 0.2)
    """
    ticks = _ticks_apart(record.measurement)
    if not ticks:
        return record
    read = _readings(record.measurement, ticks)
    heard = read + ticks // 2
    heard = heard[heard < record.time.size]
    if heard.size <= 2 * FEWEST_SAMPLES:
        return record
    first, setpoint, excitation = heard[:-1], record.setpoint, record.excitation
    return replace(
        record, time=record.time[first], measurement=record.measurement[read[: first.size]],
        control=_means(record.control, heard), setpoint=None if setpoint is None else setpoint[first],
        excitation=None if excitation is None else _means(excitation, heard),
    )  # fmt: skip


def _means(values: Floats, edges: Indexes) -> Floats:
    """Of the values from each edge to the next."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(np.diff(sums[edges]) / np.diff(edges))


def _ticks_apart(measurement: Floats) -> int:
    """Ticks from one reading to the next; 0 where there is one at each tick, or they come at no regular times."""
    moves = np.flatnonzero(np.diff(measurement))
    if moves.size < _FEWEST_MOVES:
        return 0
    apart = np.diff(moves)
    usual = int(np.median(apart))
    near = int(_JITTER * usual)
    whole = np.abs(apart - usual * np.maximum(np.round(apart / usual), 1.0)) <= near
    regular = usual >= 2 and whole.mean() >= _REGULAR and (np.abs(apart - usual) <= near).mean() >= _USUAL
    return usual if regular else 0


def _readings(measurement: Floats, ticks: int) -> Indexes:
    """At which samples a reading is new, also where it is the same as the one before."""
    moves = (np.flatnonzero(np.diff(measurement)) + 1).tolist()
    read: list[int] = [moves[0] % ticks]
    for move in moves:
        while move - read[-1] > 1.5 * ticks:
            read.append(read[-1] + ticks)
        if move > read[-1]:
            read.append(move)
    while read[-1] + ticks < measurement.size:
        read.append(read[-1] + ticks)
    return np.array(read)
