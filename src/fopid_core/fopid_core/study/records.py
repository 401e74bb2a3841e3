"""Records to learn a process from: csv files and bags."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.reports.run import Run

NEEDED, OPTIONAL = ("time", "control", "measurement"), ("setpoint",)


def read_record(path: Path | str, namespace: str | None = None, control_before: float | None = None) -> Record:
    """A record from a csv file with the columns time, control, measurement and optionally setpoint, or from a bag.

    Parameters
    ----------
    path : Path or str
        A ``.csv`` file, the folder of a bag, or one of its files.
    namespace : str, optional
        Which loop, when a bag holds several.
    control_before : float, optional
        The control at which the process rested before, where that is known.

    Raises
    ------
    InputError
        If it cannot be read, with the row and column.
    """
    if Path(path).suffix.lower() == ".csv":
        columns = _csv_columns(Path(path))
        return Record(
            columns["time"], columns["control"], columns["measurement"], columns.get("setpoint"), control_before
        )
    from fopid_core.study.bags.bag import read_bag

    return record_of_run(read_bag(path, namespace), control_before)


def record_of_run(run: Run, control_before: float | None = None) -> Record:
    """The record of a run: a control within half a sample after a measurement counts as its answer."""
    measurement, control = run.signals["measurement"], run.signals["control"]
    known = measurement.time >= control.time[0] - 0.5 * run.sample_time
    time, values = measurement.time[known], measurement.value[known]
    fresh = np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0.0
    time, values = time[fresh], values[fresh]
    setpoint = run.signals["setpoint"].held_at(time) if "setpoint" in run.signals else None
    return Record(time, control.held_at(time + 0.5 * run.sample_time), values, setpoint, control_before)


def _csv_columns(path: Path) -> dict[str, Floats]:
    """Separated by commas, semicolons or tabs; numbers have a decimal comma only where commas do not separate."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        separator = next((mark for mark in ";\t" if lines and mark in lines[0]), ",")
        rows = [row for row in csv.reader(lines, delimiter=separator) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"record {str(path)!r} cannot be read: {error}") from None
    header = [_plain_name(name) for name in rows[0]] if rows else []
    missing = [name for name in NEEDED if name not in header]
    if missing:
        given = ", ".join(rows[0]) if rows else "none"
        raise InputError(f"columns {given} of {str(path)!r}; allowed: a first line with {', '.join(NEEDED)}")
    twice = [name for name in (*NEEDED, *OPTIONAL) if header.count(name) > 1]
    if twice:
        raise InputError(f"columns {', '.join(rows[0])} of {str(path)!r}; allowed: {twice[0]} once")
    longer = next((number for number, row in enumerate(rows) if len(row) > len(header)), 0)
    if longer:
        raise InputError(
            f"{len(rows[longer])} cells in data row {longer}; allowed: one for each of {len(header)} columns"
        )
    places = {name: header.index(name) for name in (*NEEDED, *OPTIONAL) if name in header}
    return {name: _column(rows[1:], name, place, comma=separator != ",") for name, place in places.items()}


def _plain_name(name: str) -> str:
    """A column's name without its unit, which must be the second where it is of time.

    Examples
    --------
    >>> _plain_name(" Time [s]"), _plain_name("Control (V)")
    ('time', 'control')
    """
    plain, _, unit = name.partition("(" if "(" in name else "[")
    plain, unit = plain.strip().lower(), unit.strip(" )]")
    if plain == "time" and unit not in ("", "s"):
        raise InputError(f"time in {unit}; allowed: seconds, as 'time' or 'time [s]'")
    return plain


def _column(rows: list[list[str]], name: str, place: int, comma: bool) -> Floats:
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        cell = row[place] if place < len(row) else ""
        try:
            values[number] = float(cell.replace(",", ".") if comma else cell)
        except ValueError:
            raise InputError(
                f"{name} = {cell!r} in data row {number + 1}; allowed: a number; leave out rows without"
            ) from None
    return values
