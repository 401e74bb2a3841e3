"""Does anything but the measurement move the control: if not, a record shows the controller and not the process.

In a loop that only answers disturbances, or runs out, the model that fits best is -1/C (Ljung 1999, ch. 13.4).
"""

from __future__ import annotations

import numpy as np

from fopid_core.design.identification.noise import resolution
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Booleans, Floats, Indexes

_LAGS = (8, 5, 3)
"""The law is looked for over so many samples back; fewer where gaps leave few stretches as long."""
_COVERED, _EACH = 0.6, 3
"""A memory is short enough when stretches without a gap hold this share of the samples, and so many for each number."""
_GAP = 1.5
"""A distance of so many usual ones is a gap."""
_MOST_LOST, _SELDOM = 3, 0.15
"""So many samples in a row are lost at most, and this share of all."""
LEAST_SHARE = 1e-5
"""What is left of the control's moves, as a power, where it is less than this, is the error of a short linear law."""
_UNEXPLAINED = 1e-3
"""A control that tells itself answers nothing where it does not explain the measurement to this share of its power."""
_NOTHING = 0.1
_STANDS_OUT = 8.0
"""A move from outside is so many times as large as what is usually left."""
_ROUNDED, _ROUNDED_BOTH = 1.2, 12.0
"""And as what rounding of the control leaves at most, or, where a law of the measurement is used, of both: that law is
too small where the measurement is rounded."""
_OWN, _OWN_ROUNDED = 0.8, 0.97
"""A control that is left by the measurement with more than this share of its surprises goes its own way: with more
where either is rounded, since that hides an answer."""
_HELD, _OWN_HELD = 0.5, 0.5
"""A control that stands still so often, beyond its limits, is moved by hand: less of its surprises tells that."""
_FEW_STEPS = 10.0
"""A measurement that moves by fewer steps of its quantisation shows no answer."""
_FEW_LEVELS, _DIGITS, _WHOLE = 8, 6, 1e-6
"""A control of so few levels is moved by hand or by a relay, neither rounded nor limited; a number of more digits is
not rounded either."""
_JUMP, _FAR, _BEYOND_NOISE = 1.1, 10.0, 5.0
"""A step from rest in the first instant is larger by this than all moves after it, but no further than this from where
the control then is; and the measurement then moves by so many times its noise."""
_PIECES, _FASTEST = (100, 500), 0.94
"""In the first of so many pieces, or of more, the measurement is not yet as fast as this share of what it will be."""
_FINE, _EXACTLY, _FEW_CORNERS, _FEWER = 1e-5, 1e-5, 0.05, 0.25
"""A control told no coarser than this share of its range goes in lines, exact to this share, where it turns at no more
of its samples than this, and at no more than this share of those at which the measurement does."""
_SETPOINT = 0.1
"""A setpoint that moves by this share of what the measurement does moves the loop."""


def moved_from_outside(record: Record, start: InitialCondition) -> bool:
    """Whether anything moves the control that no law of the measurement explains.

    The law is linear, over some samples in a row without a gap, whatever their stamps say exactly. Of what it leaves a
    move from outside stands out, unless the measurement tells nothing of the control at all; the rest is rounding, and
    what happened between the samples.

    Parameters
    ----------
    record : Record
    start : InitialCondition
        What is known about the beginning: a step from rest in the first instant counts.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise, begin = rng.standard_normal(500), InitialCondition(step=True)
    >>> answer = -0.5 * noise - 0.1 * np.cumsum(noise)
    >>> moved_from_outside(Record(np.arange(500.0), answer, noise), begin)
    False
    >>> moved_from_outside(Record(np.arange(500.0), answer + 9.0 * (np.arange(500) > 250), noise), begin)
    True
    >>> moved_from_outside(Record(np.arange(500.0), rng.standard_normal(500), noise), begin)
    True
    """
    if _is_known_to_move(record) or _steps_at_once(record, start) or _goes_in_lines(record):
        return True
    memory, ends = _stretches(record)
    if not np.ptp(record.control[ends]):
        return True  # where nothing was recorded
    own, seen = _lagged(record.control, ends, memory), _lagged(record.measurement, ends, memory)
    limited = _lagged(_at_a_limit(record), ends, memory)
    leaves = limited[:, 1:].all(axis=1) & (own[:, 0] != own[:, 1])
    free: Booleans = np.asarray(~limited.any(axis=1) | leaves)
    if np.count_nonzero(free) < _rows(memory) or not np.ptp(own[free, 0]):
        free = np.ones_like(free)
    columns, target = np.column_stack([own[:, 1:], seen]), own[:, 0]
    itself, alone = _law(own[free, 1:], target[free])
    law, left = _law(columns[free], target[free])
    power, alone_power = float(left @ left), float(alone @ alone)
    tells_itself = _NOTHING * alone_power < power <= LEAST_SHARE * _moved(own[free])
    if tells_itself and _is_apart(seen[free, 0], own[free]):
        return True
    one_way = left * np.sign(own[free, 0] - own[free, 1])
    left = np.where(leaves[free], np.maximum(one_way, 0.0), left)
    left = np.append(left, _beyond(law, columns, target, limited, free))
    if float(left @ left) <= LEAST_SHARE * _moved(own):
        return False
    step, unit = resolution(record.measurement), _unit(record.control)
    told = max(step, _unit(record.measurement))
    holds = float(np.mean(own[free, 0] == own[free, 1])) > _HELD
    goes_its_own_way = power > (_OWN_HELD if holds else _OWN_ROUNDED if unit or told else _OWN) * alone_power
    if goes_its_own_way:
        rounded = _ROUNDED * 0.5 * unit * (1.0 + float(np.abs(itself).sum()))
    else:
        by_control, by_measurement = (float(np.abs(part).sum()) for part in (law[:memory], law[memory:]))
        rounded = _ROUNDED_BOTH * 0.5 * (unit * (1.0 + by_control) + told * by_measurement)
    largest = float(np.abs(left).max())
    if largest <= rounded or np.ptp(record.measurement) < _FEW_STEPS * step:
        return False
    if largest > _STANDS_OUT * _usual(left):
        return True
    return goes_its_own_way and (holds or not _answers_the_next(record, ends[free], memory))


def _is_known_to_move(record: Record) -> bool:
    """Whether the record says so: by its setpoint, by what was added, or by a control that answers nothing."""
    added = record.excitation is not None and bool(record.excitation.any())
    asked = record.setpoint is not None and np.ptp(record.setpoint) > _SETPOINT * np.ptp(record.measurement)
    return added or bool(asked) or not np.ptp(record.control)


def _steps_at_once(record: Record, start: InitialCondition) -> bool:
    """Whether the control jumps in the first instant, from rest."""
    time, measurement, moves = record.time, record.measurement, np.abs(np.diff(record.control))
    jump = 0.0 if start.step else abs(record.control[0] - start.before)
    if jump <= max(_JUMP * moves.max(), _STANDS_OUT * _usual(moves)) or jump > _FAR * np.ptp(record.control):
        return False
    for over in (max(time.size // pieces, 1) for pieces in _PIECES):
        went = np.abs(measurement[over:] - measurement[:-over])
        speed = went / (time[over:] - time[:-over])
        if went.max() > _BEYOND_NOISE * _usual(np.diff(measurement)) and speed[0] < _FASTEST * speed.max():
            return True
    return False


def _goes_in_lines(record: Record) -> bool:
    """Whether the control goes in a few straight lines, as by hand, while the measurement does not."""
    unit, reach = _last_digit(record.control), float(np.ptp(record.control))
    if unit > _FINE * reach:
        return False
    bends, apart = (np.abs(np.diff(signal, 2)) for signal in (record.control, record.measurement))
    corners = np.count_nonzero(bends > max(_ROUNDED * 2.0 * unit, _EXACTLY * reach))
    turns = np.count_nonzero(apart > _EXACTLY * np.ptp(record.measurement))
    return bool(corners <= min(_FEW_CORNERS * bends.size, _FEWER * turns))


def _beyond(law: Floats, columns: Floats, target: Floats, limited: Booleans, free: Booleans) -> Floats:
    """How much further than a law wants it a control goes that comes to a limit."""
    goes = limited[:, 0] & ~limited[:, 1:].any(axis=1) & ~free
    wanted = target[free].mean() + (columns[goes] - columns[free].mean(axis=0)) @ law
    return np.asarray(np.maximum((target[goes] - wanted) * np.sign(target[goes] - columns[goes, 0]), 0.0))


def _answers_the_next(record: Record, ends: Indexes, memory: int) -> bool:
    """Whether a law of the measurement a sample later leaves nothing of the control, which was then told too early."""
    ends = ends[ends < record.time.size - 1]
    own, seen = _lagged(record.control, ends, memory), _lagged(record.measurement, ends + 1, memory + 1)
    left = _law(np.column_stack([own[:, 1:], seen]), own[:, 0])[1]
    return float(left @ left) <= LEAST_SHARE * _moved(own)


def _at_a_limit(record: Record) -> Booleans:
    """Where a control of many values stays at its largest or its smallest while the measurement moves."""
    control = record.control
    if np.unique(control).size <= _FEW_LEVELS:
        return np.zeros(control.size, dtype=bool)
    extreme = (control == control.max()) | (control == control.min())
    stays = (np.diff(control) == 0.0) & extreme[1:]
    for begin, end in _runs(stays):
        stays[begin:end] = np.ptp(record.measurement[begin : end + 1]) > 0.0
    return np.asarray(np.append(stays, False) | np.insert(stays, 0, False))


def _is_apart(measurement: Floats, control: Floats) -> bool:
    """Whether the measurement moves in ways of its own: in a loop that runs out both move in the same."""
    moved = measurement - measurement.mean()
    left = _law(control, measurement)[1]
    return float(left @ left) > _UNEXPLAINED * float(moved @ moved)


def _stretches(record: Record) -> tuple[int, Indexes]:
    """How far the law looks back, in samples, and the samples before which there are so many without a gap."""
    samples, gaps = record.time.size, np.diff(record.time)
    ends_here = (gaps > _GAP * np.median(gaps)) | _stale(record.control) | _stale(record.measurement)
    gap_before = np.concatenate([[0], np.cumsum(ends_here)])
    for memory in _LAGS:
        ends = np.flatnonzero(gap_before[memory:] == gap_before[:-memory]) + memory
        if ends.size >= max(_COVERED * samples, _rows(memory)):
            return memory, ends
    return memory, ends if ends.size >= _rows(memory) else np.arange(memory, samples)


def _stale(signal: Floats) -> Booleans:
    """From which sample to the next a signal that moves all the time stands still: what was told there was lost."""
    still = np.diff(signal) == 0.0
    for begin, end in _runs(still):
        still[begin:end] = end - begin <= _MOST_LOST
    return np.asarray(still & (0.0 < np.mean(still) < _SELDOM and not _unit(signal)))


def _runs(where: Booleans) -> list[tuple[int, int]]:
    """Where runs begin, and where they have ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _rows(memory: int) -> int:
    """How many samples it takes to tell a law."""
    return _EACH * (2 * memory + 2)


def _unit(values: Floats) -> float:
    """In which a signal of many values is told: the step of a converter, or of the last digit of a table."""
    if np.unique(values).size <= _FEW_LEVELS:
        return 0.0
    return _last_digit(values) or resolution(values)


def _last_digit(values: Floats) -> float:
    """Of a table; 0 where there are more than some digits."""
    sizes = np.abs(values[values != 0.0])
    for digits in range(1, _DIGITS + 1):
        units = 10.0 ** (np.floor(np.log10(sizes)) + 1 - digits)
        if np.abs(sizes / units - np.round(sizes / units)).max() < _WHOLE:
            return float(units.max())
    return 0.0


def _usual(sizes: Floats) -> float:
    """The standard deviation of normal numbers, by the median of their sizes."""
    return float(np.median(np.abs(sizes))) / 0.6745


def _moved(own: Floats) -> float:
    """The power of a control's moves, from its lags."""
    return float(np.sum((own[:, 0] - own[:, 1]) ** 2))


def _lagged(signal: np.ndarray, ends: Indexes, memory: int) -> np.ndarray:
    """The signal there and before, one column for each lag, shape (n, 1 + memory)."""
    return np.asarray(signal[ends[:, np.newaxis] - np.arange(memory + 1)])


def _law(columns: Floats, target: Floats) -> tuple[Floats, Floats]:
    """The numbers of columns beside a constant, and what they leave of a target."""
    matrix, wanted = columns - columns.mean(axis=0), target - target.mean()
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    numbers = np.linalg.lstsq(matrix / sizes, wanted, rcond=1e-12)[0] / sizes
    return numbers, wanted - matrix @ numbers
