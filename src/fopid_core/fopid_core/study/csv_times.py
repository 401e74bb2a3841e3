"""The times of rows in csv files: seconds, days, moments as people and machines write them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import product

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.csv_numbers import Notation, is_missing

SECONDS = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0,
    "mins": 60.0, "minute": 60.0, "minutes": 60.0, "h": 3600.0, "hr": 3600.0, "hrs": 3600.0, "hour": 3600.0,
    "hours": 3600.0, "d": 86400.0, "day": 86400.0, "days": 86400.0,
}  # fmt: skip
"""Units of time in a header."""
ZONES = ("utc", "gmt", "z", "local", "cet", "cest", "est", "edt", "cst", "cdt", "mst", "mdt", "pst", "pdt")
"""What else may stand there, or after a moment: all rows are taken to be in the same."""
_HOURS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p")
_DATES = ("%d.%m.%Y", "%d.%m.%y", "%d-%b-%y", "%d-%b-%Y", "%Y/%m/%d")


def _clocks(*dates: str) -> tuple[str, ...]:
    return tuple(f"{date} {hour}" for date, hour in product(dates, _HOURS))


CLOCKS = ("", *_clocks(*_DATES), *_HOURS)
"""Times that can be read in one way only; the first stands for ISO 8601."""
MONTH_FIRST, DAY_FIRST = _clocks("%m/%d/%Y", "%m/%d/%y"), _clocks("%d/%m/%Y", "%d/%m/%y")
"""Dates between slashes, which a whole column tells apart."""
_COMPACT = re.compile(r"(19|20)\d{12}")  # 20260131120000
_DAY = 86400.0
_EPOCH = 1e8  # times from here on count from 1970, not from the start of a record
_UNITS_OF_EPOCHS = ((1e18, 1e-9), (1e17, 1e-7), (1e14, 1e-6), (1e11, 1e-3))  # 1e-7: since 1601, or since the year 1
_FASTEST = 1e-3
_DAYS = ((20_000.0, 80_000.0), (690_000.0, 790_000.0))  # since 1900, since the year 0; nearer together no seconds
_ROUNDED = 0.06  # s of a minute that is told to six decimals of a day
_MINUTES = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.0, 15.0, 20.0, 30.0, 60.0, 120.0, 240.0])  # between rows of such


def moment(cell: str, clocks: Sequence[str] = CLOCKS) -> float | None:
    """Seconds since 1970 of a time, or since midnight of a day in 1900; without an offset as if it were UTC.

    Examples
    --------
    >>> moment("28-Mar-26 20:00:00") == moment("2026-03-28T20:00:00Z") == moment("28.03.2026 20:00 CET")
    True
    """
    text = cell.strip()
    words = text.split()
    if len(words) > 1 and words[-1].lower() in ZONES:
        text = " ".join(words[:-1])
    for clock in clocks:
        try:
            found = datetime.strptime(text, clock) if clock else datetime.fromisoformat(text)
        except ValueError:
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None


def is_moment(cell: str) -> bool:
    """Whether a cell says when."""
    return moment(cell, (*CLOCKS, *MONTH_FIRST, *DAY_FIRST)) is not None


def unit_of(header: str) -> str:
    """The unit in the header of a column of times; empty where there is none.

    Examples
    --------
    >>> [unit_of(name) for name in ("Time [s]", "Time in min", "t_ms", "time/h", "Time (UTC)", "Time", "time (weeks)")]
    ['s', 'min', 'ms', 'h', '', '', 'weeks']
    """
    plain, bracket, rest = header.lower().partition("(" if "(" in header else "[")
    if bracket:
        unit = rest.strip(" )]")
        return "" if unit in ZONES else unit
    last = re.split(r"[\s_/]+", plain.strip())
    return last[-1] if len(last) > 1 and last[-1] in SECONDS else ""


def times(cells: Sequence[str], header: str, notation: Notation) -> Floats:
    """In seconds, NaN where there is none, those far from 0 from the first on.

    Numbers are in the unit of their header, if it has one; without one such that count from 1970 tell their unit by
    their size, and the days of a spreadsheet by theirs.

    Raises
    ------
    InputError
        For what is no time, with its row.
    """
    compact = [cell for cell in cells if not is_missing(cell)]
    if compact and all(_COMPACT.fullmatch(cell.strip()) for cell in compact):
        cells = [f"{cell.strip()[:8]}T{cell.strip()[8:]}" for cell in cells]
    elif any("/" in cell for cell in compact) and (read := _between_slashes(cells)) is not None:
        return _from_first(read)
    clocks, values, numbers = list(CLOCKS), np.full(len(cells), math.nan), False
    for row, cell in enumerate(cells):
        if is_missing(cell):
            continue
        value = notation.number(cell)
        if math.isfinite(value):
            values[row], numbers = value, True
            continue
        found = next((at for at in ((clock, moment(cell, (clock,))) for clock in clocks) if at[1] is not None), None)
        if found is None or found[1] is None:
            allowed = "seconds, or a time as 2026-01-31T12:00:00"
            raise InputError(f"time = {cell!r} in data row {row + 1}; allowed: {allowed}; leave out rows without")
        values[row] = found[1]
        clocks.remove(found[0])  # the next is likely to be written so, too
        clocks.insert(0, found[0])
    return _in_seconds(values, unit_of(header)) if numbers else _from_first(values)


def _between_slashes(cells: Sequence[str]) -> Floats | None:
    """Times that all begin with the month, or all with the day: of two readings, the one that lasts less long."""
    known = [place for place, cell in enumerate(cells) if not is_missing(cell)]
    readings = []
    for clocks in (MONTH_FIRST, DAY_FIRST):
        moments = [moment(cells[place], clocks) for place in known]
        if None not in moments:
            read = np.full(len(cells), math.nan)
            read[known] = moments
            readings.append(read)
    return min(readings, key=lambda read: float(np.nanmax(read) - np.nanmin(read)), default=None)


def _from_first(moments: Floats) -> Floats:
    """Moments from the first on; of the day only, they begin anew at midnight."""
    known = np.flatnonzero(np.isfinite(moments))
    if not known.size:
        return moments
    found, read = moments.copy(), moments[known]
    anew = np.diff(read, prepend=read[0]) < -0.5 * _DAY
    found[known] = read - read[0] + _DAY * np.cumsum(anew) * (read[0] < 0.0)
    return found


def _in_seconds(time: Floats, unit: str) -> Floats:
    """Numbers in seconds."""
    if unit and unit not in SECONDS:
        raise InputError(f"time in {unit}; allowed: {', '.join(SECONDS)}, as in 'time [s]'")
    known = time[np.isfinite(time)]
    first = float(known[0])
    guessed = next((factor for least, factor in _UNITS_OF_EPOCHS if first >= least), 1.0)
    step = abs(float(np.median(np.diff(known)))) if known.size > 1 else 0.0  # newest first as well
    if not unit and any(low <= first < high for low, high in _DAYS) and (0.0 < step < _FASTEST or _is_in_minutes(step)):
        return np.asarray((time - first) * _DAY)
    if not unit and _is_in_minutes(step):
        raise InputError(f"time every {step:.6g}, in seconds or in days; allowed: a header as 'time [s]' or 'time [d]'")
    return np.asarray((time - first * (abs(first) >= _EPOCH)) * SECONDS.get(unit, guessed))


def _is_in_minutes(step: float) -> bool:
    """Whether a step in days is of so many minutes: 0.00347222, which no clock makes in seconds; one as 0.01 it may."""
    is_decimal = abs(step - round(step, 5)) < 1e-6
    return bool((np.abs(step * _DAY - 60.0 * _MINUTES) < _ROUNDED * _MINUTES).any()) and not is_decimal
