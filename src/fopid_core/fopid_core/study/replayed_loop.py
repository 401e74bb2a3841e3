"""A recorded day of a loop, run again with another controller on processes that the record leaves possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import fftconvolve

from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process
from fopid_core.runtime.controller_bank import ControllerBank
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import ControllerSettings

KNOTS = 12
"""Of the step response by which the residual of a model is explained."""


def grown_steps(record: Record, processes: Sequence[Process]) -> Floats:
    """By how much each process's response to a unit step grows in each of the record's samples, shape (m, n)."""
    h, n = record.sample_time, record.time.size
    known = {each: plant_of(PlantSettings(each, h, delay_model="exact")).growth(n) for each in dict.fromkeys(processes)}
    return np.stack([known[each] for each in processes])


def simulated(
    record: Record, grown: Floats, settings: ControllerSettings, flaws: Flaws | None = None,
    lived: tuple[Floats, Floats] | None = None, step: float = 0.0,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Measurement and control of the loop on each of m processes, shapes (m, n): the controller as it runs.

    It begins at the recorded control, as a change of gains does. The processes are told by how much their step
    responses grow, shape (m, n); each has its own of the flaws, and of the control and the measurement that were
    ``lived``, shapes (m, n), where the record's own are not all. A sensor that reads in steps reads so again.
    """
    assert record.setpoint is not None
    m, n = grown.shape
    grown = grown[:, ::-1]
    flaws = flaws or Flaws()
    controls, measured = lived or (record.control, record.measurement)
    measured_first = float(record.measurement[0])
    felt = np.broadcast_to(flaws.felt(controls), (m, n))
    straight = replace(flaws, bend=np.reshape(flaws.bend, (-1, 1))).straight(measured)
    straight = np.broadcast_to(straight, (m, n))
    bank, stem = _begun(record, settings, m), felt[:, 0]
    measurement, control = np.tile(record.measurement, (m, 1)), np.tile(record.control, (m, 1))
    moved = np.zeros((m, n))
    for k in range(1, n):
        stem = flaws.stem(control[:, k - 1], stem)
        moved[:, k - 1] = stem - felt[:, k - 1]
        values = flaws.bent(straight[:, k] + np.einsum("ij,ij->i", moved[:, :k], grown[:, n - k :]))
        if step:
            values = measured_first + step * np.round((values - measured_first) / step)
        if not np.abs(values).max() < 1e90:
            control[:, k:] = np.inf
            break
        measurement[:, k] = values
        setpoint = float(record.setpoint[k])
        control[:, k] = bank.step([(setpoint, y, 0.0, 0.0, None) for y in values.tolist()])
    return measurement, control


def _begun(record: Record, settings: ControllerSettings, count: int) -> ControllerBank:
    """Controllers that go on from the first recorded control."""
    assert record.setpoint is not None
    bank = ControllerBank([settings] * count)
    for each in bank.controllers:
        each.set_mode("manual")
    first = float(record.control[0])
    bank.step([(float(record.setpoint[0]), float(record.measurement[0]), 0.0, first, None)] * count)
    for each in bank.controllers:
        each.set_mode("auto")
    return bank


def what_was_missed(record: Record, best: IdentifiedModel) -> Floats | None:
    """What the residual says beside the model: an impulse response of shape (n,); None where it is white noise.

    A step response in lines between knots at lags of geometric distances, by least squares of the residual on the
    control, beside a constant and a drift. A disturbance that came with a move of the control counts as one, too.
    """
    if best.whiteness.white:
        return None
    instants, measured, modelled = best.simulated
    n, moved = record.time.size, record.control - record.control[0]
    residual = np.interp(record.time - record.time[0], instants, measured - modelled)
    lags = np.unique(np.geomspace(1, n // 3, KNOTS).astype(int))
    hats = [np.diff(np.interp(np.arange(n), np.append(0, lags), np.append(0, np.eye(lags.size)[j])), prepend=0.0)
            for j in range(lags.size)]  # fmt: skip
    kernels = np.stack(hats)
    columns = [fftconvolve(kernel, moved)[:n] for kernel in kernels]
    columns += [np.ones(n), np.linspace(-1.0, 1.0, n)]
    sizes = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    found = np.linalg.lstsq(np.stack(columns, axis=1) / sizes, residual, rcond=1e-6)[0] / sizes
    missed: Floats = found[: lags.size] @ kernels
    return np.append(missed[1:], 0.0)
