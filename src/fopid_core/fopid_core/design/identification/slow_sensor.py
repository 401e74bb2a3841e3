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
    first = int(np.flatnonzero(np.diff(record.measurement))[0] + 1) % ticks
    read = _readings(record.measurement, first, ticks)
    heard = read + ticks // 2
    heard = heard[heard < record.time.size]
    if heard.size - 1 < 2 * FEWEST_SAMPLES:
        return record

    def mean(values: Floats | None) -> Floats | None:
        if values is None:
            return None
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(np.diff(sums[heard]) / np.diff(heard))

    def at(values: Floats | None) -> Floats | None:
        return None if values is None else values[heard[:-1]]

    control = mean(record.control)
    return replace(
        record, time=record.time[heard[:-1]], measurement=record.measurement[read[: heard.size - 1]],
        control=record.control[heard[:-1]] if control is None else control, setpoint=at(record.setpoint),
        excitation=mean(record.excitation), control_before=record.control_before,
    )  # fmt: skip


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


def _readings(measurement: Floats, first: int, ticks: int) -> Indexes:
    """At which samples a reading is new, also where it is the same as the one before."""
    moves = np.flatnonzero(np.diff(measurement)) + 1
    read: list[int] = [first] if first < moves[0] else []
    for move in moves.tolist():
        while read and move - read[-1] > 1.5 * ticks:
            read.append(read[-1] + ticks)
        read.append(move)
    while read[-1] + ticks < measurement.size:
        read.append(read[-1] + ticks)
    return np.array(read)
