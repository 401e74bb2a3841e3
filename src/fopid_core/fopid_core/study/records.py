"""Records to learn a process from: csv files and bags."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from fopid_core.design.identification_record import Record
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.run import Run

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
    from fopid_core.study.bag import read_bag

    return record_of_run(read_bag(path, namespace), control_before)


def record_of_run(run: Run, control_before: float | None = None) -> Record:
    """The record of a run: a control within half a sample after a measurement counts as its answer."""
    measurement, control = run.signals["measurement"], run.signals["control"]
    known = measurement.time >= control.time[0] - 0.5 * run.sample_time
    time, values = measurement.time[known], measurement.value[known]
    fresh = np.diff(time, prepend=-np.inf) > 0.0
    time, values = time[fresh], values[fresh]
    setpoint = run.signals["setpoint"].held_at(time) if "setpoint" in run.signals else None
    return Record(time, control.held_at(time + 0.5 * run.sample_time), values, setpoint, control_before)


def _csv_columns(path: Path) -> dict[str, Floats]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"record {str(path)!r} cannot be read: {error}") from None
    header = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in NEEDED if name not in header]
    if missing:
        given = ", ".join(header) or "none"
        raise InputError(f"columns {given} of {str(path)!r}; allowed: a first line with {', '.join(NEEDED)}")
    body = [row for row in rows[1:] if any(cell.strip() for cell in row)]
    places = {name: header.index(name) for name in (*NEEDED, *OPTIONAL) if name in header}
    return {name: _column(body, name, place) for name, place in places.items()}


def _column(rows: list[list[str]], name: str, place: int) -> Floats:
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        try:
            values[number] = float(row[place])
        except (ValueError, IndexError):
            cell = row[place] if place < len(row) else ""
            raise InputError(f"{name} = {cell!r} in data row {number + 1}; allowed: a number") from None
    return values
