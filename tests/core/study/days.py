"""Recorded days of a loop: steps of the setpoint, a load, noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate

H = 0.1
PROCESS = "2/(s+1)*exp(-0.3s)"


def day(gains: Fopid, noise: float = 0.005, process: str = PROCESS, **settings: float) -> Record:
    """40 s of the loop with these gains; the same noise whatever the gains."""
    controller = FopidController(ControllerSettings(gains, H, **settings))  # type: ignore[arg-type]
    plant = Plant(PlantSettings(Process.parse(process), H, delay_model="exact", noise_std=noise, seed=4))
    trace = simulate(
        controller, plant, 400, lambda k: float(k // 50 % 2) * (1.0 + 0.1 * (k // 100)), lambda k: 0.02 * (k > 300)
    )
    return Record(trace.time, trace.control, trace.measurement, trace.setpoint)


def write_day(path: Path) -> None:
    """A day as a csv file."""
    one = day(Fopid(0.4, 0.4))
    assert one.setpoint is not None
    table = np.column_stack([one.time, one.control, one.measurement, one.setpoint])
    np.savetxt(path, table, delimiter=",", header="time,control,measurement,setpoint", comments="")
