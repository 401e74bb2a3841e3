"""Records to learn a process from: csv files and bags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_law import made_prompt
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.settings import ControllerSettings
from fopid_core.study.csv_columns import read_csv_signals
from fopid_core.study.experiments.loop_parameters import GAINS, SETTING_KEYS, controller_settings
from fopid_core.study.reports.limit_figures import limit_history
from fopid_core.study.reports.run import Run

LIMITS = ("control_min", "control_max", "control_rate_max")
"""Parameters of the controller that a record keeps."""


def read_record(
    path: Path | str,
    namespace: str | None = None,
    control_before: float | None = None,
    columns: str | None = None,
) -> Record:
    """A record from a csv file with the columns time, control, measurement and optionally setpoint, or from a bag.

    A control of a csv file that was told late counts from when it was given.

    Parameters
    ----------
    path : Path or str
        A ``.csv`` file, the folder of a bag, or one of its files.
    namespace : str, optional
        Which loop, when a bag holds several.
    control_before : float, optional
        The control at which the process rested before, where that is known.
    columns : str, optional
        Of a csv file, ``PV,OP[,SP[,TIME]]``: names or numbers of the columns of measurement, control, setpoint, time.

    Raises
    ------
    InputError
        If it cannot be read, with the row and column.
    """
    if Path(path).suffix.lower() == ".csv":
        found = read_csv_signals(Path(path), columns)
        signals = found.values
        time, control, measurement = (signals[name] for name in ("time", "control", "measurement"))
        setpoint = signals.get("setpoint")
        return made_prompt(Record(time, control, measurement, setpoint, control_before, found.left_out))
    from fopid_core.study.bags.bag import read_bag

    return record_of_run(read_bag(path, namespace), control_before)


def refuse_limits_beside(record: Record, low: float, high: float) -> None:
    """Raise InputError for limits of the control between which it never was in a record.

    Examples
    --------
    >>> refuse_limits_beside(Record(np.arange(30.0), np.ones(30), np.zeros(30)), 5.0, 9.0)
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: control limits 5 to 9; allowed: such as the record's control keeps, 1 to 1
    """
    least, most = float(record.control.min()), float(record.control.max())
    if most < low or high < least:
        raise InputError(
            f"control limits {low:g} to {high:g}; allowed: such as the record's control keeps, {least:g} to {most:g}"
        )


def record_of_run(run: Run, control_before: float | None = None) -> Record:
    """The record of a run, with its limits: a control within half a sample after a measurement counts as its answer."""
    measurement, control = run.signals["measurement"], run.signals["control"]
    known = measurement.time >= control.time[0] - 0.5 * run.sample_time
    time, values = measurement.time[known], measurement.value[known]
    fresh = np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0.0
    time, values = time[fresh], values[fresh]
    setpoint = run.signals["setpoint"].held_at(time) if "setpoint" in run.signals else None
    limits: dict[str, Any] = {name: history[-1][1] for name in LIMITS if (history := limit_history(run, name))}
    held = control.held_at(time + 0.5 * run.sample_time)
    return Record(time, held, values, setpoint, control_before, **limits)


def settings_of_run(run: Run, gains: Fopid) -> ControllerSettings:
    """The controller's settings at the end of a run, as the bag tells them, but for the gains.

    From the experiment that was run and the controller's parameter events; what neither tells is as in the node.
    """
    controllers = {change.node for change in run.parameters if change.name == "kp"}
    known = dict(run.experiment.get("controller") or {})
    known |= {change.name: change.value for change in run.parameters if change.node in controllers}
    allowed = SETTING_KEYS.keys() - {*GAINS, "mode"}
    given = {name: value for name, value in known.items() if name in allowed and not name.startswith("band.")}
    return replace(controller_settings(given, run.sample_time), gains=gains)
