"""What a sensor tells that is no move of the process: samples that drop out, one value again and again."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fopid_core.design.identification.noise import bridged, reported_step, resolution, white_level
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.slow_sensor import as_read
from fopid_core.model.arrays import Floats

_STILL, _BEFORE, _MOVES, _TURNS, _AS_NOISY = 20, 40, 0.5, 0.55, 0.5
"""So many equal samples in a row come from a sensor that is dead, where it was alive for so many before: it changed at
such a share of them, with that share of its usual noise, and its third differences, which are mostly noise, changed
their sign at such a share of them: in white noise 0.77. What dies away with what moved the process is none."""
_SHORT = 5
"""A sensor that reads in steps larger than its noise stands still by itself: for all lengths of time, so that most of
those longer than this are shorter than what counts."""
_STRAIGHT, _SHARPEST, _MOSTLY, _CORNERS = 0.1, 0.99, 0.7, 10
"""A signal runs straight where it bends by no more than that share of what its sharpest corners do: it was drawn so
where most of its samples lie straight, but for more than so many corners."""


def as_told(record: Record) -> tuple[Record, str]:
    """A record at the readings of its sensor, without those that dropped out; and what is said of the rest.

    Returns
    -------
    record : Record
        The same where nothing is amiss.
    told : str
        Clauses that begin with a semicolon.
    """
    told = as_read(record)
    whole, dropped = without_dropouts(told)
    read = as_read(whole) if told is record else whole
    is_seldom = told is not record or read is not whole
    return read, _clauses(dropped, f"the sensor has read every {read.sample_time:.3g} s only" if is_seldom else "")


def sound(record: Record) -> tuple[Record, str]:
    """The same without the samples of a sensor that stood still: it may have breaks there."""
    read, told = as_told(record)
    alive, dead = while_alive(read)
    return alive, told + _clauses(dead)


def _clauses(*told: str) -> str:
    return "".join(f"; {each}" for each in told if each)


def compressed(record: Record) -> str:
    """What is said of a record that a historian has thinned out: it may be why nothing can be learnt from it.

    Examples
    --------
    >>> time, corners = np.arange(300.0), np.arange(0.0, 300.0, 7.0)
    >>> measured = np.interp(time, corners, np.random.default_rng(0).standard_normal(corners.size))
    >>> compressed(Record(time, time, measured))
    'the measurement runs on straight lines between few samples, as a historian that compresses tells it'
    """
    for name, values in (("measurement", record.measurement), ("control", record.control)):
        moves = np.diff(values)
        bends, moving = np.abs(np.diff(moves)), np.abs(moves[1:])
        straight = (bends <= _STRAIGHT * np.quantile(bends, _SHARPEST)) & (moving > 0.0)
        if straight.mean() > _MOSTLY and np.count_nonzero(~straight) > _CORNERS:
            told = "runs on straight lines between few samples"
        elif not resolution(values) and (step := reported_step(values)):
            told = f"is told when it has moved by {step:.3g} only"
        else:
            continue
        return f"the {name} {told}, as a historian that compresses tells it"
    return ""


def without_dropouts(record: Record) -> tuple[Record, str]:
    """The record with samples that dropped out replaced by a line between their neighbours, and what is said of them.

    What the controller made of them stays: it has moved the process. Readings that are held for some ticks only look
    alike; a record of these stays as it is.

    Examples
    --------
    >>> time = np.arange(100.0)
    >>> measured = 50.0 + 0.1 * np.random.default_rng(0).standard_normal(100)
    >>> measured[[40, 60, 61]] = 0.0
    >>> found, told = without_dropouts(Record(time, time, measured))
    >>> told, bool(found.measurement.min() > 49.0)
    ('3 samples that dropped out, the first to 0 at 40 s, were replaced', True)
    """
    measurement, dropped = bridged(record.measurement)
    if not dropped.size or as_read(record) is not record:
        return record, ""
    first = f"to {record.measurement[dropped[0]]:.4g} at {record.time[dropped[0]]:.6g} s"
    told = f"a sample that dropped out {first} was replaced"
    if dropped.size > 1:
        told = f"{dropped.size} samples that dropped out, the first {first}, were replaced"
    return replace(record, measurement=measurement), told


def while_alive(record: Record) -> tuple[Record, str]:
    """The record without the samples at which the sensor stood still, and what is said of them.

    Only of a sensor that is noisy otherwise: a process that rests and a sensor that is dead look alike without noise.

    Examples
    --------
    >>> time = np.arange(200.0)
    >>> measured = 50.0 + 0.1 * np.random.default_rng(0).standard_normal(200)
    >>> measured[100:150] = measured[99]
    >>> found, told = while_alive(Record(time, time, measured))
    >>> found.time.size, told
    (150, 'the measurement stands still at 49.86 from 99 s to 149 s: is the sensor dead, or at the end of its range?')
    """
    values = record.measurement
    runs = _dead_runs(values)
    if not runs:
        return record, ""
    alive = np.ones(values.size, dtype=bool)
    for first, end in runs:
        alive[first + 1 : end] = False
    first, end = max(runs, key=lambda run: run[1] - run[0])
    told = f"from {record.time[first]:.6g} s to {record.time[end - 1]:.6g} s"
    others = f" (and {len(runs) - 1} times more)" if len(runs) > 1 else ""
    setpoint, excitation = (None if each is None else each[alive] for each in (record.setpoint, record.excitation))
    found = replace(
        record, time=record.time[alive], control=record.control[alive], measurement=values[alive], setpoint=setpoint,
        excitation=excitation,
    )  # fmt: skip
    told = f"the measurement stands still at {values[first]:.4g} {told}{others}"
    return found, f"{told}: is the sensor dead, or at the end of its range?"


def _dead_runs(values: Floats) -> list[tuple[int, int]]:
    """Where equal samples begin and end, of a sensor that was alive before, or once before it stood at that value."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [values.size]])
    still = [(first, end) for first, end in pairwise(edges.tolist()) if end - first > _STILL]
    lengths = np.diff(edges)
    if np.count_nonzero((lengths > _SHORT) & (lengths <= _STILL)) > len(still):
        return []
    noise = _usual_noise(values) if still else 0.0
    known = {values[first] for first, _ in still if _is_noisy(values[:first][-_BEFORE:], noise)}
    return [(first, end) for first, end in still if values[first] in known]


def _usual_noise(values: Floats) -> float:
    """Standard deviation of the noise, as most stretches of a signal show it; 0 where it hardly changes."""
    stretches = values[: values.size // _BEFORE * _BEFORE].reshape(-1, _BEFORE)
    changing = np.count_nonzero(np.diff(stretches), axis=1) > _MOVES * _BEFORE
    return float(np.median(white_level(stretches[changing]))) if changing.any() else 0.0


def _is_noisy(values: Floats, noise: float) -> bool:
    """Whether a signal changes most of the time, as noise makes it, and is as noisy as it usually is."""
    if values.size < _BEFORE or np.count_nonzero(np.diff(values)) <= _MOVES * _BEFORE:
        return False
    bends = np.diff(values, 3)
    return bool(np.mean(bends[1:] * bends[:-1] < 0.0) >= _TURNS and white_level(values) >= _AS_NOISY * noise)
