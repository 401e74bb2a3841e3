"""A simulated experiment in a folder: experiment.yaml, trace.csv, tunings.json; read back, it is the run it was."""

from __future__ import annotations

import csv
import json
import math
import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core.design.specification import Achieved
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.study.experiments.experiment import read_experiment
from fopid_core.study.experiments.loop_parameters import GAINS
from fopid_core.study.experiments.simulate import Simulated, run_of
from fopid_core.study.reports.run import Run, Tuning

EXPERIMENT, TRACE, TUNINGS = "experiment.yaml", "trace.csv", "tunings.json"
SIGNALS = ("setpoint", "measurement", "control", "disturbance")
LARGEST = 200_000_000
"""Bytes of a file that is read."""


def is_simulated(folder: Path) -> bool:
    """Whether a folder holds a simulated experiment."""
    return all(os.access(folder / name, os.R_OK) for name in (TRACE, EXPERIMENT))


def write_simulated(found: Simulated, folder: Path) -> Path:
    """Keep a simulated experiment; the path of its trace.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / EXPERIMENT).write_text(found.experiment.to_yaml(), encoding="utf-8")
    (folder / TUNINGS).write_text(json.dumps([asdict(one) for one in found.tunings], indent=1), encoding="utf-8")
    columns = {**asdict(found.trace), "disturbance": found.disturbance, **dict(zip(GAINS, found.gains.T, strict=True))}
    with (folder / TRACE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    return folder / TRACE


def read_simulated(folder: Path) -> Run:
    """The run of a folder that ``fopid simulate --out`` wrote.

    Raises
    ------
    InputError
        If a file is missing or is not what was written.
    """
    experiment = read_experiment(folder / EXPERIMENT)
    try:
        header, *rows = csv.reader(_text(folder / TRACE).splitlines())
        table = dict(zip(header, np.array(rows, dtype=float).T, strict=True))
        gains = np.column_stack([table[name] for name in GAINS])
        signals = {name: table[name] for name in SIGNALS}
        time = table["time"]
        kept = json.loads(_text(folder / TUNINGS)) if (folder / TUNINGS).exists() else []
        tunings = tuple(_tuning(one) for one in kept)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"run {str(folder)!r}: {error!r}; allowed: what fopid simulate --out wrote") from None
    return run_of(experiment, folder, time, signals, gains, tunings)


def _text(file: Path) -> str:
    try:
        if file.stat().st_size > LARGEST:
            raise InputError(f"file {str(file)!r} has {file.stat().st_size} bytes; allowed: {LARGEST}")
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"file {str(file)!r} cannot be read: {error}") from None


def _tuning(kept: dict[str, Any]) -> Tuning:
    known = {field.name for field in fields(Achieved)}
    achieved = {name: math.nan if value is None else value for name, value in kept["achieved"].items() if name in known}
    gains = kept["gains"]
    return Tuning(
        **{
            **kept,
            "achieved": Achieved(**achieved),
            "gains": None if gains is None else Fopid(**gains),
            "filter": MeasurementFilter(**kept["filter"]),
            "weights": SetpointWeights(**kept["weights"]),
            "unmet": tuple(kept["unmet"]),
        }
    )
