"""Signals in csv files, as historians, spreadsheets and control systems write them."""

from __future__ import annotations

import codecs
import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats

NEEDED, OPTIONAL = ("time", "control", "measurement"), ("setpoint",)
SYNONYMS = {
    "t": "time", "timestamp": "time", "op": "control", "mv": "control", "pv": "measurement", "sp": "setpoint",
}  # fmt: skip
"""What else a header may call them, as control systems do."""
SECONDS = {
    "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0,
    "hours": 3600.0, "d": 86400.0, "days": 86400.0,
}  # fmt: skip
"""Units of time in a header."""
MISSING = (
    "", "nan", "null", "none", "n/a", "na", "#n/a", "-", "--", "bad", "bad input", "no data", "i/o timeout"
)  # fmt: skip
"""What stands in a cell without a value, as spreadsheets and historians write."""
CLOCKS = ("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f", "%H:%M:%S", "%H:%M:%S.%f")
"""Times that can be read in one way only, beside ISO 8601."""
MONTH_FIRST = ("%m/%d/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S %p",
               "%m/%d/%Y %I:%M:%S.%f %p")  # fmt: skip
DAY_FIRST = ("%d/%m/%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S.%f", "%d/%m/%Y %I:%M:%S %p",
             "%d/%m/%Y %I:%M:%S.%f %p")  # fmt: skip
"""Dates between slashes, which a whole column tells apart."""
PREAMBLE = 50
"""So many lines may stand before the header."""
_DAY = 86400.0
_EPOCH = 1e8  # times from here on count from 1970, not from the start of a record
_UNITS_OF_EPOCHS = ((1e18, 1e-9), (1e17, 1e-7), (1e14, 1e-6), (1e11, 1e-3))  # 1e-7: since 1601, or since the year 1
_SPREADSHEET, _FASTEST = (20_000.0, 80_000.0), 1e-3  # days since 1900; nearer together they are no seconds
_MINUTES = np.array([2.0, 3.0, 4.0, 5.0, 6.0, 10.0, 15.0, 20.0, 30.0, 60.0, 120.0, 240.0])  # between rows of such


@dataclass(frozen=True)
class CsvSignals:
    """What a csv file holds.

    Attributes
    ----------
    values : mapping of str to ndarray, shape (n,)
        By ``time`` [s], ``control``, ``measurement`` and, where it is there, ``setpoint``.
    left_out : int
        Rows without a value in one of these columns, which are not among the values.
    """

    values: dict[str, Floats]
    left_out: int


def read_csv_signals(path: Path, columns: str | None = None) -> CsvSignals:
    """Read a csv file.

    In UTF-8, UTF-16 or Windows-1252. Separated by commas, semicolons or tabs; a decimal comma where commas do not
    separate; times in seconds, in the unit of their header, as ISO 8601, 31.01.2026 12:00:00, 01/31/2026 12:00:00 PM,
    01/31/2026 12:00:00, 31/01/2026 12:00:00, 12:00:00, also over midnight, counted from 1970 or in a spreadsheet's days
    (then from the first row on); lines of other text before the header, a row of units after it, or no header at all;
    rows with a gap are left out. Where day and month between slashes could be either, they are read so that the record
    is the shorter.

    Parameters
    ----------
    path : Path
    columns : str, optional
        ``PV,OP[,SP[,TIME]]``: the names in the header, or the numbers from 1 on, of measurement, control, setpoint and
        time. Time is the column of that name, or the first.

    Raises
    ------
    InputError
        If it cannot be read, with the row and column.
    """
    rows, separator = _rows(path)
    comma = separator != ","
    rows = rows[_preamble(rows, columns) :]
    headed = bool(rows) and not all(_is_value(cell, comma) for cell in rows[0])
    header = [cell.strip() for cell in rows[0]] if headed else [str(i + 1) for i in range(len(rows[0]) if rows else 0)]
    places = _asked(columns, header, path) if columns else _found(header, headed, path)
    body = rows[1:] if headed else rows
    if headed and body and not any(_is_value(cell, comma) for cell in body[0] if cell.strip()):
        header = [f"{name} [{unit.strip()}]" if "[" not in name else name
                  for name, unit in zip(header, body[0], strict=False)]  # fmt: skip
        body = body[1:]
    longer = next((number for number, row in enumerate(body, 1) if len(row) > len(header)), 0)
    if longer:
        raise InputError(
            f"{len(body[longer - 1])} cells in data row {longer}; allowed: one for each of {len(header)} columns"
        )
    values = {name: _column(body, name, place, comma) for name, place in places.items()}
    whole = np.logical_and.reduce([np.isfinite(column) for column in values.values()])
    values = {name: column[whole] for name, column in values.items()}
    numbers = any(math.isfinite(_number(cell, comma)) for row in body for cell in row[places["time"] :][:1])
    values["time"] = _seconds(values["time"], header[places["time"]] if headed else "time", numbers=numbers)
    return CsvSignals(values, int((~whole).sum()))


def _rows(path: Path) -> tuple[list[list[str]], str]:
    try:
        lines = _text(path.read_bytes()).splitlines()
        separator = next((mark for mark in ";\t" if 2 * sum(mark in line for line in lines) > len(lines)), ",")
        return [row for row in csv.reader(lines, delimiter=separator) if any(cell.strip() for cell in row)], separator
    except (OSError, csv.Error) as error:
        raise InputError(f"record {str(path)!r} cannot be read: {error}") from None
    except UnicodeDecodeError:
        raise InputError(f"record {str(path)!r} is no text; allowed: csv in UTF-8, UTF-16 or Windows-1252") from None


def _text(data: bytes) -> str:
    """What a file says: in UTF-8, in UTF-16 where it begins so, as spreadsheets write, or else in Windows-1252.

    Examples
    --------
    >>> [_text("Stellgröße;1,5".encode(encoding)) for encoding in ("utf-8", "utf-16", "cp1252")]
    ['Stellgröße;1,5', 'Stellgröße;1,5', 'Stellgröße;1,5']
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in data:
            raise
        return data.decode("cp1252")


def _preamble(rows: Sequence[Sequence[str]], columns: str | None) -> int:
    """How many rows stand before the first that names all columns, if there is one."""
    asked = [name.strip().lower() for name in columns.split(",")] if columns else NEEDED
    wanted = {name for name in asked if not name.isdigit()}
    for number, row in enumerate(rows[:PREAMBLE]):
        if wanted <= {name for cell in row for name in (cell.strip().lower(), _split(cell)[0].lower(), _plain(cell))}:
            return number
    return 0


def _found(header: Sequence[str], headed: bool, path: Path) -> dict[str, int]:
    """The columns by their names, or by their places where there is no header."""
    if not headed and len(header) in (3, 4):
        return {name: place for place, name in enumerate((*NEEDED, *OPTIONAL)[: len(header)])}
    names = [_plain(name) for name in header]
    missing = [name for name in NEEDED if name not in names]
    if missing:
        given = ", ".join(header) if header else "none"
        raise InputError(
            f"columns {given} of {str(path)!r}; allowed: a first line with {', '.join(NEEDED)}, or --columns PV,OP,SP"
        )
    twice = [name for name in (*NEEDED, *OPTIONAL) if names.count(name) > 1]
    if twice:
        raise InputError(f"columns {', '.join(header)} of {str(path)!r}; allowed: {twice[0]} once")
    return {name: names.index(name) for name in (*NEEDED, *OPTIONAL) if name in names}


def _asked(columns: str, header: Sequence[str], path: Path) -> dict[str, int]:
    """The columns that somebody has named: PV,OP[,SP[,TIME]]."""
    wanted = [name.strip() for name in columns.split(",")]
    if not 2 <= len(wanted) <= 4 or not all(wanted):
        raise InputError(f"columns {columns!r}; allowed: PV,OP or PV,OP,SP or PV,OP,SP,TIME")
    places = {name: _place(given, header, path) for name, given in zip(("measurement", "control", "setpoint", "time"),
                                                                       wanted, strict=False)}  # fmt: skip
    if places["measurement"] == places["control"]:
        raise InputError(f"columns {columns!r}: one column as measurement and control; allowed: two")
    if "time" not in places:
        names = [_plain(name) for name in header]
        places["time"] = names.index("time") if "time" in names else 0
    return places


def _place(given: str, header: Sequence[str], path: Path) -> int:
    names = [name.lower() for name in header]
    plain = [_split(name)[0] for name in names]
    for known in (names, plain):
        if known.count(given.lower()) == 1:
            return known.index(given.lower())
    if given.isdigit() and 1 <= int(given) <= len(header):
        return int(given) - 1
    raise InputError(
        f"column {given!r} of {str(path)!r}; allowed: one of {', '.join(header)}, or a number from 1 to {len(header)}"
    )


def _split(name: str) -> tuple[str, str]:
    """A column's name and its unit.

    Examples
    --------
    >>> _split("Time [s]"), _split("Control (V)")
    (('Time', 's'), ('Control', 'V'))
    """
    plain, _, unit = name.partition("(" if "(" in name else "[")
    return plain.strip(), unit.strip(" )]")


def _plain(name: str) -> str:
    plain = _split(name)[0].lower()
    return SYNONYMS.get(plain, plain)


def _is_value(cell: str, comma: bool) -> bool:
    if cell.strip().lower() in MISSING or not math.isnan(_number(cell, comma)):
        return True
    return _moment(cell, ("", *CLOCKS, *MONTH_FIRST, *DAY_FIRST)) is not None


def _number(cell: str, comma: bool) -> float:
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return math.nan


def _moment(cell: str, clocks: Sequence[str] = ("", *CLOCKS)) -> float | None:
    """Seconds since 1970 of a time, or since midnight of a day in 1900; without an offset as if it were UTC."""
    text = cell.strip()
    for clock in clocks:
        try:
            moment = datetime.strptime(text, clock) if clock else datetime.fromisoformat(text)
        except ValueError:
            continue
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return None


def _column(rows: list[list[str]], name: str, place: int, comma: bool) -> Floats:
    cells = [row[place] if place < len(row) else "" for row in rows]
    read = _between_slashes(cells) if name == "time" and any("/" in cell for cell in cells) else None
    if read is not None:
        return read
    values = np.empty(len(cells))
    for number, cell in enumerate(cells):
        if cell.strip().lower() in MISSING:
            values[number] = math.nan
            continue
        value = _number(cell, comma)
        moment = _moment(cell) if name == "time" and not math.isfinite(value) else None
        if moment is None and not math.isfinite(value):
            allowed = "seconds, or a time as 2026-01-31T12:00:00" if name == "time" else "a number"
            within = ", with a point for decimals where commas separate" if "," in cell and not comma else ""
            rest = f"allowed: {allowed}{within}; leave out rows without"
            raise InputError(f"{name} = {cell!r} in data row {number + 1}; {rest}")
        values[number] = value if moment is None else moment
    return values


def _between_slashes(cells: Sequence[str]) -> Floats | None:
    """Times that all begin with the month, or all with the day: of two readings, the one that lasts less long."""
    known = [place for place, cell in enumerate(cells) if cell.strip().lower() not in MISSING]
    readings = []
    for clocks in (MONTH_FIRST, DAY_FIRST):
        moments = [_moment(cells[place], clocks) for place in known]
        if None not in moments:
            read = np.full(len(cells), math.nan)
            read[known] = moments
            readings.append(read)
    return min(readings, key=lambda read: float(np.nanmax(read) - np.nanmin(read)), default=None)


def _seconds(time: Floats, header: str, *, numbers: bool) -> Floats:
    """Times in seconds, those far from 0 from the first on; ``numbers`` are in the unit of their header, if it has one.

    Without one, such that count from 1970 tell their unit by their size, and the days of a spreadsheet by theirs.
    """
    if not time.size:
        return time
    if not numbers:  # moments; of the day only, they begin anew at midnight
        anew = np.diff(time, prepend=time[0]) < -0.5 * _DAY
        return np.asarray(time - time[0] + _DAY * np.cumsum(anew) * (time[0] < 0.0))
    unit, first = _split(header)[1].lower(), float(time[0])
    if unit and unit not in SECONDS:
        raise InputError(f"time in {unit}; allowed: {', '.join(SECONDS)}, as in 'time [s]'")
    guessed = next((factor for least, factor in _UNITS_OF_EPOCHS if first >= least), 1.0)
    in_days = not unit and time.size > 1 and _SPREADSHEET[0] <= first < _SPREADSHEET[1]
    if in_days and _are_days(float(np.nanmedian(np.diff(time)))):
        return np.asarray((time - first) * _DAY)
    return np.asarray((time - first * (abs(first) >= _EPOCH)) * SECONDS.get(unit, guessed))


def _are_days(step: float) -> bool:
    """Whether times that may be a spreadsheet's days are such: nearer together than seconds, or by so many minutes.

    A step of five minutes is 0.00347222 days, which no clock makes in seconds; one that it may, as 0.01, is in seconds.
    """
    is_decimal = abs(step - round(step, 5)) < 1e-6
    rows = np.abs(step * _DAY - 60.0 * _MINUTES) < 0.01
    return 0.0 < step < _FASTEST or bool(rows.any() and not is_decimal)
