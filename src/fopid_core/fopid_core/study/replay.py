"""What other gains would have done on a recorded day: the same setpoints and disturbances, with bands.

The process is learnt from the record. What the learnt process does not explain is what disturbed it, and would have
disturbed it with other gains as well; so the measurement would have been the recorded one, and what the process makes
of the difference between the two controls. That holds from wherever the day began. The bands are over processes that
the record cannot tell from the one learnt.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from fopid_core.design.identification.identify import IdentificationResult, IdentifiedModel, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import RobustLimits, plausible_processes, robustness, tune_robustly
from fopid_core.design.specification import Clock, TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller_bank import ControllerBank
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import ControllerSettings

DRAWS = 80
"""Processes that are drawn for the bands."""
BAND = 0.95
KNOTS = 12
"""Of the step response by which the residual of a model is explained."""
TEMPLATES = "foptd,soptd"
"""Few numbers, whose covariance says how far they may be off, and whole orders, which are simulated exactly."""
MOST_SAMPLES = 8_000
"""Of a record that is replayed: the work grows with their square."""
RUNAWAY = 1e3
"""A control that moves so many times as far as the recorded one: a loop that does not hold."""


@dataclass(frozen=True)
class Figures:
    """How a loop did.

    Attributes
    ----------
    iae : float
        Integral of |setpoint - measurement|.
    total_variation : float
        Of the control.
    peak_error : float
        Largest |setpoint - measurement|.
    """

    iae: float
    total_variation: float
    peak_error: float


@dataclass(frozen=True)
class Band:
    """A signal as it is expected, and between what it lies at each instant; arrays of shape (n,)."""

    expected: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True)
class Replay:
    """The answer to ``replay``.

    Attributes
    ----------
    success : bool
        Whether the record tells enough, and the gains hold on all that it leaves possible.
    message : str
    identified : IdentificationResult
    gains : Fopid or None
        Those replayed; None where none were given or found.
    before : Figures
        As recorded.
    after, after_low, after_high : Figures or None
        Expected, and the ends of the bands.
    time, setpoint : ndarray, shape (n,)
        Instants [s] and the setpoint there.
    measurement, control : Band or None
    beyond : float
        How far the control goes beyond what it did in the record, as a share of that range: there nothing was learnt.
    elapsed : float
        [s]
    """

    success: bool
    message: str
    identified: IdentificationResult
    gains: Fopid | None
    before: Figures
    after: Figures | None
    after_low: Figures | None
    after_high: Figures | None
    time: Floats
    setpoint: Floats
    measurement: Band | None
    control: Band | None
    beyond: float
    elapsed: float


def replay(
    record: Record,
    settings: ControllerSettings | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    limits: RobustLimits | None = None,
    clock: Clock = time.perf_counter,
) -> Replay:
    """Run other gains through a recorded day.

    Parameters
    ----------
    record : Record
        With a setpoint; from normal operation, or one step.
    settings : ControllerSettings, optional
        Gains, filter, weights and limits of the loop; their sample time gives way to the record's. Without them the
        gains are tuned on the learnt process.
    draws, seed : int
        Of the processes for the bands.
    limits : RobustLimits, optional
        What the loop must keep on every process that the record leaves possible.
    clock : callable
        Gives the time [s].

    Raises
    ------
    InputError
        If the record has no setpoint, or is too long.
    """
    begun = clock()
    even = evenly(record)
    setpoint = even.setpoint
    if setpoint is None:
        raise InputError("record without a setpoint; allowed: one with a setpoint, which the loop would have followed")
    limits, h = limits or RobustLimits(), even.sample_time
    before = figures(even.time, setpoint, even.measurement, even.control)
    identified = identify(record, TEMPLATES)
    gains = None if settings is None else settings.gains

    def refused(message: str) -> Replay:
        return Replay(False, message, identified, gains, before, None, None, None, even.time, setpoint, None, None,
                      0.0, clock() - begun)  # fmt: skip

    if not identified.success or identified.best is None:
        return refused(identified.message)
    asked = replace(limits, samples=draws, seed=seed)
    if settings is None:
        tuned = tune_robustly(identified, TuningRequest(identified.best.process, sample_time=h), asked)
        if not tuned.success or tuned.tuning is None or tuned.tuning.controller is None:
            return refused(tuned.message)
        gains = tuned.tuning.controller
        settings = ControllerSettings(gains)
    settings = replace(settings, sample_time=h, band=None)
    possible = plausible_processes(identified, asked, h)
    judged = robustness(settings.gains, possible, limits, settings.measurement_filter)
    if not judged.met:
        within = f"max |S| <= {limits.ms_max:g}, phase margin >= {math.degrees(limits.phase_margin_min):.3g} deg"
        return refused(f"these gains: {judged}; allowed: {within} on all of them")
    processes = (identified.best.process, *identified.best.sample(draws, seed))
    measurement, control = simulated(even, processes, settings, what_was_missed(even, identified.best), seed)
    reach = float(np.ptp(even.control))
    if not np.abs(control - even.control).max() <= RUNAWAY * max(reach, 1e-300):
        return refused("the sampled loop runs away with these gains; allowed: those that hold at this sample time")
    each = [figures(even.time, setpoint, y, u) for y, u in zip(measurement, control, strict=True)]
    low, high = (ends.tolist() for ends in _ends(np.array([[f.iae, f.total_variation, f.peak_error] for f in each])))
    over = max(float(control[0].max() - even.control.max()), float(even.control.min() - control[0].min()), 0.0)
    told = f"{identified.message}; {judged}"
    return Replay(True, told, identified, settings.gains, before, each[0], Figures(*low), Figures(*high), even.time,
                  setpoint, _band(measurement), _band(control), over / reach, clock() - begun)  # fmt: skip


def evenly(record: Record) -> Record:
    """The record at even instants: control and setpoint held, the measurement in lines; as it is where it is even."""
    if record.time.size > MOST_SAMPLES:
        raise InputError(f"record of {record.time.size} samples; allowed: {MOST_SAMPLES} to replay, take a part of it")
    if record.is_regular:
        return record
    instants = record.time[0] + record.sample_time * np.arange(record.time.size)
    latest = np.searchsorted(record.time, instants + 1e-9 * record.sample_time, side="right") - 1
    setpoint = None if record.setpoint is None else record.setpoint[latest]
    measurement = np.interp(instants, record.time, record.measurement)
    return Record(instants, record.control[latest], measurement, setpoint, record.control_before, record.left_out)


def figures(instants: Floats, setpoint: Floats, measurement: Floats, control: Floats) -> Figures:
    """How a loop did; signals of shape (n,).

    Examples
    --------
    >>> t = np.array([0.0, 1.0, 2.0])
    >>> figures(t, np.ones(3), np.array([0.0, 0.5, 1.0]), np.array([0.0, 2.0, 1.0]))
    Figures(iae=1.5, total_variation=3.0, peak_error=1.0)
    """
    error = np.abs(setpoint - measurement)
    return Figures(float(error[:-1] @ np.diff(instants)), float(np.abs(np.diff(control)).sum()), float(error.max()))


def simulated(
    record: Record, processes: Sequence[Process], settings: ControllerSettings, missed: Floats | None = None,
    seed: int = 0,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Measurement and control of the loop on each of the processes, shapes (m, n): the controller as it runs.

    It begins at the recorded control, as a change of gains does. To all processes but the first a normally distributed
    multiple of ``missed`` is added, an impulse response of shape (n,).
    """
    assert record.setpoint is not None
    n, m = record.time.size, len(processes)
    grown = np.stack([_added(process, record.sample_time, n) for process in processes])
    if missed is not None:
        shares = np.random.default_rng(seed).standard_normal(m)
        grown += np.where(np.arange(m) > 0, shares, 0.0)[:, np.newaxis] * missed
    grown = grown[:, ::-1]
    bank = ControllerBank([settings] * m)
    for each in bank.controllers:
        each.set_mode("manual")
    first = float(record.control[0])
    bank.step([(float(record.setpoint[0]), float(record.measurement[0]), 0.0, first, None)] * m)
    for each in bank.controllers:
        each.set_mode("auto")
    measurement, control = np.tile(record.measurement, (m, 1)), np.tile(record.control, (m, 1))
    moved = np.zeros((m, n))
    for k in range(1, n):
        moved[:, k - 1] = control[:, k - 1] - record.control[k - 1]
        measurement[:, k] += np.einsum("ij,ij->i", moved[:, :k], grown[:, n - k :])
        values = measurement[:, k]
        if not np.abs(values).max() < 1e90:
            control[:, k:] = np.inf
            break
        setpoint = float(record.setpoint[k])
        control[:, k] = bank.step([(setpoint, y, 0.0, 0.0, None) for y in values.tolist()])
    return measurement, control


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
    found = np.linalg.lstsq(np.stack(columns, axis=1), residual, rcond=1e-6)[0]
    missed: Floats = found[: lags.size] @ kernels
    return np.append(missed[1:], 0.0)


def _added(process: Process, sample_time: float, count: int) -> Floats:
    """By how much the response to a unit step grows in each of so many samples."""
    plant = plant_of(PlantSettings(process, sample_time, delay_model="exact"))
    return np.diff([plant.step(1.0) for _ in range(count)], prepend=0.0)


def _band(signals: Floats) -> Band:
    low, high = _ends(signals)
    return Band(signals[0], np.minimum(low, signals[0]), np.maximum(high, signals[0]))


def _ends(values: Floats) -> tuple[Floats, Floats]:
    """The ends of the band of rows, column by column; the first row is that of the best process."""
    low, high = np.quantile(values[1:] if len(values) > 1 else values, (0.5 - 0.5 * BAND, 0.5 + 0.5 * BAND), axis=0)
    return low, high
