"""Signals in csv files, as historians, spreadsheets and control systems write them."""

from __future__ import annotations

import codecs
import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.csv_numbers import Notation, is_missing
from fopid_core.study.csv_times import is_moment, times, unit_of

NEEDED, OPTIONAL = ("time", "control", "measurement"), ("setpoint",)
SYNONYMS = {
    "t": "time", "timestamp": "time", "time stamp": "time", "datetime": "time", "date time": "time",
    "date/time": "time", "zeit": "time", "zeitstempel": "time", "op": "control", "mv": "control",
    "stellgröße": "control", "pv": "measurement", "istwert": "measurement", "sp": "setpoint", "sv": "setpoint",
    "set point": "setpoint", "sollwert": "setpoint",
}  # fmt: skip
"""What else a header may call them, as control systems do."""
ROW_NUMBERS = ("", "#", "no", "no.", "nr", "nr.", "index", "row", "id", "unnamed: 0")
"""What a header calls a column that counts the rows."""
PREAMBLE = 50
"""So many lines may stand before the header."""
_FOLLOWS = 0.1
"""A measurement is so many times nearer to its setpoint than a control is."""
_MERGED = 0.5
"""Where fewer of the rows with a measurement have a control as well, they were written when they changed."""


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

    In UTF-8, UTF-16 or Windows-1252. Separated by commas, semicolons, tabs or bars; decimals and thousands with points
    or commas, as the file itself tells. Times in seconds, in the unit of their header, as ISO 8601, 31.01.2026
    12:00:00, 31-Jan-26 12:00:00, 01/31/2026 12:00:00 PM, 2026/01/31 12:00, 20260131120000, 12:00:00, also over
    midnight, counted from 1970 or in a spreadsheet's days (then from the first row on); where day and month between
    slashes could be either, so that the record is the shorter. Lines of other text before the header, a row of units
    after it, or no header at all; newest first or last. Rows with a gap are left out, and those that repeat the one
    before; a setpoint holds until the next, and so does a control that was not written at most measurements.

    Parameters
    ----------
    path : Path
    columns : str, optional
        ``PV,OP[,SP[,TIME]]``: the names in the header, or the numbers from 1 on, of measurement, control, setpoint and
        time. Time is the column of that name, the first with moments, or the first.

    Raises
    ------
    InputError
        If it cannot be read, with the row and column.
    """
    rows = _rows(path)
    rows = rows[_preamble(rows, columns) :]
    notation = Notation(cell for row in rows[1:] for cell in row)
    headed = bool(rows) and not all(_is_value(cell, notation) for cell in rows[0])
    header = [cell.strip() for cell in rows[0]] if headed else [str(i + 1) for i in range(len(rows[0]) if rows else 0)]
    body = rows[1:] if headed else rows
    places = _asked(columns, header, body, path) if columns else _found(header, headed, path)
    if headed and body and not any(_is_value(cell, notation) for cell in body[0] if cell.strip()):
        header = [f"{name} [{unit.strip()}]" if "[" not in name else name
                  for name, unit in zip(header, body[0], strict=False)]  # fmt: skip
        body = body[1:]
    for number, row in enumerate(body, 1):
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(f"{len(row)} cells in data row {number}; allowed: one for each of {len(header)} columns")
    cells = {name: [row[place] if place < len(row) else "" for row in body] for name, place in places.items()}
    values = {name: _column(column, name, notation) for name, column in cells.items() if name != "time"}
    values["time"] = times(cells["time"], header[places["time"]] if headed else "time", notation)
    if not headed and columns is None:
        _refuse_the_other_order(values)
    return _whole_rows(_oldest_first(values))


def _refuse_the_other_order(values: dict[str, Floats]) -> None:
    """Without a header the second column is the control; one that follows the fourth is the measurement."""
    if "setpoint" not in values:
        return
    control, measurement = (
        np.nanmedian(np.abs(values[name] - values["setpoint"])) for name in ("control", "measurement")
    )
    if control < _FOLLOWS * measurement:
        told = "no header, and the second column follows the fourth as a measurement does its setpoint"
        raise InputError(f"{told}; allowed: --columns 2,3,4,1, or a header with {', '.join((*NEEDED, *OPTIONAL))}")


def _oldest_first(values: dict[str, Floats]) -> dict[str, Floats]:
    """The rows in the order of their times, where the newest came first."""
    moves = np.diff(values["time"][np.isfinite(values["time"])])
    if not (moves.size and (moves <= 0.0).all() and (moves < 0.0).any()):
        return values
    turned = {name: column[::-1] for name, column in values.items()}
    least = np.nanmin(turned["time"])
    return turned | {"time": turned["time"] - min(least, 0.0)}


def _whole_rows(values: dict[str, Floats]) -> CsvSignals:
    """The rows that say all, each once."""
    measured = np.isfinite(values["time"]) & np.isfinite(values["measurement"])
    held = ["setpoint"] if "setpoint" in values else []
    if np.isfinite(values["control"][measured]).sum() < _MERGED * measured.sum():
        held.append("control")
    values = values | {name: _held(values[name]) for name in held}
    whole = np.logical_and.reduce([np.isfinite(column) for column in values.values()])
    if whole.size and not whole.any():
        given = f"{whole.size} rows, none of which has a value of {', '.join(values)}"
        raise InputError(f"{given}; allowed: rows with all of them")
    table = np.stack([column[whole] for column in values.values()])
    whole[np.flatnonzero(whole)[1:][(np.diff(table) == 0.0).all(axis=0)]] = False
    return CsvSignals({name: column[whole] for name, column in values.items()}, int((~whole).sum()))


def _held(values: Floats) -> Floats:
    """Each value until the next."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), -1))
    return np.where(last >= 0, values[last], math.nan)


def _rows(path: Path) -> list[list[str]]:
    try:
        lines = _text(path.read_bytes()).splitlines()
        separator = next((mark for mark in ";\t|" if 2 * sum(mark in line for line in lines) > len(lines)), ",")
        rows = csv.reader((line for line in lines if not line.startswith("#")), delimiter=separator)
        return [row for row in rows if any(cell.strip() for cell in row)]
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
    if data[1:2] == b"\0":
        return data.decode("utf-16-le")
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


def _asked(columns: str, header: Sequence[str], body: Sequence[Sequence[str]], path: Path) -> dict[str, int]:
    """The columns that somebody has named: PV,OP[,SP[,TIME]]."""
    wanted = [name.strip() for name in columns.split(",")]
    if not 2 <= len(wanted) <= 4 or not all(wanted):
        raise InputError(f"columns {columns!r}; allowed: PV,OP or PV,OP,SP or PV,OP,SP,TIME")
    places = {name: _place(given, header, path) for name, given in zip(("measurement", "control", "setpoint", "time"),
                                                                       wanted, strict=False)}  # fmt: skip
    if places["measurement"] == places["control"]:
        raise InputError(f"columns {columns!r}: one column as measurement and control; allowed: two")
    if "time" not in places:
        places["time"] = _place_of_time(columns, header, body)
    return places


def _place_of_time(columns: str, header: Sequence[str], body: Sequence[Sequence[str]]) -> int:
    """The column of that name, else the first with moments, else the first, unless that counts the rows."""
    names = [_plain(name) for name in header]
    if "time" in names:
        return names.index("time")
    moments = [
        place for place in range(len(header)) if any(is_moment(row[place]) for row in body[:2] if place < len(row))
    ]
    if not moments and header[0].lower() in ROW_NUMBERS:
        raise InputError(
            f"columns {columns!r} with a first column {header[0]!r}; allowed: the fourth names that of time"
        )
    return moments[0] if moments else 0


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
    plain = _split(name)[0].lower().removesuffix("%").rstrip()
    unit = unit_of(name)
    timed = plain.removesuffix(unit).rstrip(" _/").removesuffix(" in")  # time in min, time_min; not op_min
    return "time" if SYNONYMS.get(timed, timed) in ("time", "elapsed") else SYNONYMS.get(plain, plain)


def _is_value(cell: str, notation: Notation) -> bool:
    return is_missing(cell) or not math.isnan(notation.number(cell)) or is_moment(cell)


def _column(cells: Sequence[str], name: str, notation: Notation) -> Floats:
    notation = notation.of_column(cells)
    values = np.array([math.nan if is_missing(cell) else notation.number(cell) for cell in cells], dtype=np.float64)
    wrong = next((row for row, cell in enumerate(cells) if not (math.isfinite(values[row]) or is_missing(cell))), None)
    if wrong is not None:
        within = ", with a point for decimals where commas separate" if "," in cells[wrong] else ""
        raise InputError(
            f"{name} = {cells[wrong]!r} in data row {wrong + 1}; allowed: a number{within}; leave out rows without"
        )
    return values
