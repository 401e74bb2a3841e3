"""What other gains would have done on a recorded day: the same setpoints and disturbances, with bands.

The process is learnt from the record. What the learnt process does not explain is what disturbed it, and would have
disturbed it with other gains as well; so the measurement would have been the recorded one, and what the process makes
of the difference between the two controls. That holds from wherever the day began. The bands are over processes that
the record cannot tell from the one learnt.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.identification.noise import resolution
from fopid_core.design.identification.record import REGULAR, Record
from fopid_core.design.identification.refusal import refusal_of_feedback
from fopid_core.design.identification.sensor_faults import as_told, while_alive
from fopid_core.design.recorded_law import contradicts_law
from fopid_core.design.recorded_tuning import HOW_ELSE, tune_recorded
from fopid_core.design.response_verification import held_to_record
from fopid_core.design.robust_verification import RobustLimits, Robustness, behind_hold, robustness
from fopid_core.design.specification import Clock, TuningResult
from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import NO_FILTER
from fopid_core.runtime.settings import ControllerSettings
from fopid_core.study.flaw_search import Learnt, learn
from fopid_core.study.replayed_loop import grown_steps, simulated, what_was_missed

DRAWS = 40
"""Processes that are drawn for the bands."""
UNSEEN_LIMIT = 0.25
"""How likely an actuator has a limit within one range of the recorded control beyond it, each way."""
BAND = 0.95
TEMPLATE = "soptd"
"""Few numbers, whose covariance says how far they may be off, and whole orders, which are simulated exactly. One lag
alone explains many a record as well to the eye, and knows nothing of how large a second one may be."""
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
    """A signal as it is expected (the median), and between what it lies at each instant; arrays of shape (n,)."""

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
        Of the linear part of the process.
    flaws : str
        What is not linear in it, in words; empty where nothing spoke for that.
    gains : Fopid or None
        Those replayed; None where none were given or found.
    before : Figures
        As recorded.
    after, after_low, after_high : Figures or None
        Expected (medians), and the ends of the bands.
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
    flaws: str
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
    tuned: bool = False,
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
    tuned : bool
        Tune the gains also where there are settings, for their filter, weights and limits.

    Raises
    ------
    InputError
        If the record has no setpoint, is too long or has a break, or its sensor was dead for a while.
    """
    begun = clock()
    record, told_of_sensor = as_told(record)
    if dead := while_alive(record)[1]:
        raise InputError(f"record: {dead} allowed: a stretch without (--from, --to)")
    if breaks := record.breaks:
        until = record.time[np.searchsorted(record.time, breaks[0], side="right")]
        told = f"record: no samples from {breaks[0]:.6g} s to {until:.6g} s"
        raise InputError(f"{told}; allowed: a stretch without a break (--from, --to)")
    even = evenly(record)
    if even.setpoint is None:
        raise InputError("record without a setpoint; allowed: one with a setpoint, which the loop would have followed")
    asked = replace(limits or RobustLimits(), samples=draws, seed=seed)
    learnt = _refused(learn(even, TEMPLATE, draws, seed), record)
    chosen, told = _accepted(learnt, settings, tuned, asked, even)
    lost = missing(record, even.time)
    day = _day(learnt, chosen, even, lost, asked) if chosen else None
    if chosen and day is None:
        told = "the sampled loop runs away with these gains; allowed: those that hold at this sample time"
    gains = chosen.gains if chosen else settings.gains if settings and not tuned else None
    before = figures(even.time, even.setpoint, even.measurement, even.control)
    least = day[1] if day else None
    if least is not None and least.iae > before.iae:
        told = f"{told}; on this day they leave more error than what ran, {least.iae:.4g} or more for {before.iae:.4g}"
    rest = (gains, before, *(day or _NO_DAY)[:3], even.time, even.setpoint, *(day or _NO_DAY)[3:], clock() - begun)
    return Replay(day is not None, told + told_of_sensor, learnt.identified, str(learnt.flaws), *rest)


_Day = tuple[Figures | None, Figures | None, Figures | None, Band | None, Band | None, float]
_NO_DAY: _Day = (None, None, None, None, None, 0.0)


def _refused(learnt: Learnt, record: Record) -> Learnt:
    """What was learnt at even instants, unless the record as it came shows the controller: lines hide that."""
    best = learnt.identified.best
    nothing = refusal_of_feedback(record, best.start) if best else ""
    if not (nothing and learnt.identified.success):
        return learnt
    return replace(learnt, identified=replace(learnt.identified, success=False, message=nothing))


def _accepted(
    learnt: Learnt, settings: ControllerSettings | None, tuned: bool, limits: RobustLimits, record: Record
) -> tuple[ControllerSettings | None, str]:
    """The controller to run, if it holds on all that the record leaves possible; and what was found, or why not."""
    identified, h = learnt.identified, record.sample_time
    if not identified.success or identified.best is None or learnt.possible is None:
        return None, identified.message
    against = "" if learnt.flaws.come_before else contradicts_law(record, identified.best.process)
    if against:  # of the gains that ran it would say that they are unstable
        return None, f"{identified.message}; {against}: {HOW_ELSE}"
    shares = learnt.flaws.slope(record.measurement) if learnt.flaws.bend else (1.0,)
    held = behind_hold(learnt.possible.processes, h)
    possible = tuple(process.scaled(share) for share in shares for process in held)

    doubt, contradicted = held_to_record(learnt.linear, identified.best, limits.ms_max)

    def refused(gains: Fopid) -> tuple[str, Robustness]:
        slow = settings.measurement_filter if settings else NO_FILTER
        verdict = robustness(gains, possible, limits, slow)
        return _refusal(verdict, limits) or _contradiction(doubt, contradicted(gains, slow)), verdict

    def refuse(tuning: TuningResult) -> str:
        return refused(tuning.controller)[0] if tuning.controller else ""

    told = identified.message
    if settings is None or tuned:
        found = tune_recorded(record, "frequency", None, limits, identified=identified, refuse=refuse)
        gains = found.tuned.tuning.controller if found.tuned and found.tuned.tuning else None
        if not found.success or gains is None:
            return None, found.message
        settings, told = replace(settings or ControllerSettings(gains), gains=gains), found.message
    settings = replace(settings, sample_time=h, band=None)
    refusal, verdict = refused(settings.gains)
    if refusal:
        return None, refusal
    parts = [told, str(learnt.flaws), doubt if doubt not in told else "", str(verdict)]
    return settings, "; ".join(part for part in parts if part)


def _contradiction(doubt: str, reason: str) -> str:
    """Why gains are not shown that the record itself speaks against, or nothing."""
    return f"these gains: {reason}; {doubt}; allowed: those that hold for both" if reason else ""


def _refusal(judged: Robustness, limits: RobustLimits) -> str:
    """Why gains are not shown, or nothing."""
    if judged.met:
        return ""
    within = f"max |S| <= {limits.ms_max:g}, phase margin >= {math.degrees(limits.phase_margin_min):.3g} deg"
    return f"these gains: {judged}; allowed: {within} on all of them"


def _day(
    learnt: Learnt, settings: ControllerSettings, record: Record, lost: Booleans, limits: RobustLimits
) -> _Day | None:
    """What the controller would have done; None where it runs away."""
    best, setpoint = learnt.identified.best, record.setpoint
    assert best is not None
    assert setpoint is not None
    assert learnt.possible is not None
    missed = what_was_missed(learnt.linear, best)
    grown = grown_steps(record, learnt.possible.processes)
    if missed is not None:
        shares = np.random.default_rng(limits.seed).standard_normal((limits.samples, 1))
        grown[1:, : missed.size] += shares * missed
    flaws = _with_unseen_limits(learnt.possible.flaws, record, settings, limits.seed)
    step = resolution(record.measurement)
    lived = _may_have_been(record, lost, len(grown), limits.seed, step)
    measurement, control = simulated(record, grown, settings, flaws, lived, step)
    reach = float(np.ptp(record.control))
    if not np.abs(control - record.control).max() <= RUNAWAY * max(reach, 1e-300):
        return None
    each = [figures(record.time, setpoint, y, u) for y, u in zip(measurement, control, strict=True)]
    low, middle, high = (
        Figures(*row.tolist()) for row in _spread(np.array([[f.iae, f.total_variation, f.peak_error] for f in each]))
    )
    moves = _band(control)
    highest, lowest = float(moves.expected.max()), float(moves.expected.min())
    over = max(highest - float(record.control.max()), float(record.control.min()) - lowest, 0.0)
    return middle, low, high, _band(measurement), moves, over / reach


def _with_unseen_limits(flaws: Flaws, record: Record, settings: ControllerSettings, seed: int) -> Flaws:
    """The draws, where a limit of the actuator may lie beyond what the control has met, unless one is given."""
    random = np.random.default_rng([seed, 2])
    lowest, highest = float(record.control.min()), float(record.control.max())
    count = np.size(flaws.low)
    sides = []
    for known, given, extreme, way in (
        (flaws.low, settings.control_min, lowest, -1.0), (flaws.high, settings.control_max, highest, 1.0)
    ):  # fmt: skip
        beyond = extreme + way * (highest - lowest) * random.uniform(size=count)
        unseen = (random.uniform(size=count) < UNSEEN_LIMIT) & np.isinf(known) & np.isinf(given)
        unseen[0] = False  # the best
        sides.append(np.where(unseen, beyond, known))
    return replace(flaws, low=sides[0], high=sides[1])


def evenly(record: Record) -> Record:
    """The record at even instants: control and setpoint held, the measurement in lines; as it is where it is even.

    Where samples are missing the control goes in a line, too: it moved at these ticks as well.
    """
    h = record.sample_time
    ticks = round(record.span / h) + 1
    if max(ticks, record.time.size) > MOST_SAMPLES:
        raise InputError(f"record of {ticks} samples; allowed: {MOST_SAMPLES} to replay, take a part of it")
    if record.is_regular:
        return record
    instants = np.linspace(record.time[0], record.time[-1], ticks)
    latest = np.searchsorted(record.time, instants + REGULAR * h, side="right") - 1
    control, lost = record.control[latest], missing(record, instants)
    control[lost] = np.interp(instants[lost], record.time, record.control)
    setpoint = None if record.setpoint is None else record.setpoint[latest]
    measurement = np.interp(instants, record.time, record.measurement)
    return replace(record, time=instants, control=control, measurement=measurement, setpoint=setpoint, excitation=None)


def missing(record: Record, instants: Floats) -> Booleans:
    """At which of even instants, shape (n,), a record has no sample.

    Examples
    --------
    >>> time = np.delete(np.arange(40.0), [3, 4])
    >>> [int(k) for k in np.flatnonzero(missing(Record(time, time, time), np.arange(40.0)))]
    [3, 4]
    """
    next_one = np.clip(np.searchsorted(record.time, instants), 1, record.time.size - 1)
    away = np.minimum(np.abs(instants - record.time[next_one - 1]), np.abs(record.time[next_one] - instants))
    return np.asarray(away > 0.501 * record.sample_time)


def _may_have_been(even: Record, lost: Booleans, count: int, seed: int, step: float = 0.0) -> tuple[Floats, Floats]:
    """Control and measurement, shapes (count, n), that a record with missing samples leaves possible; first as it is.

    They are off the line between their neighbours by as much as a sample that is there is, each drawn. What a sensor
    reads in steps is anywhere within one, for as long as it reads the same.
    """
    ways = [np.tile(signal, (count, 1)) for signal in (even.control, even.measurement)]
    beside = lost.copy()
    beside[1:] |= lost[:-1]
    beside[:-1] |= lost[1:]
    beside[[0, -1]] = True
    there = np.flatnonzero(~beside)
    if lost.any() and there.size:
        taken = np.random.default_rng([seed, 3]).choice(there, (count - 1, int(lost.sum())))
        for way, signal in zip(ways, (even.control, even.measurement), strict=True):
            way[1:, lost] += signal[taken] - 0.5 * (signal[taken - 1] + signal[taken + 1])
    if step:
        stays = np.append(0, np.cumsum(np.diff(even.measurement) != 0.0))
        within = np.random.default_rng([seed, 4]).uniform(-0.5, 0.5, (count - 1, int(stays[-1]) + 1))
        ways[1][1:] += 0.999 * step * within[:, stays]
    return ways[0], ways[1]


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


def _band(signals: Floats) -> Band:
    low, middle, high = _spread(signals)
    return Band(middle, low, high)


def _spread(values: Floats) -> Floats:
    """The ends of the band of rows, and the median between them, column by column; shape (3, k).

    The first row is that of the best process, which the others are drawn about; of so few, each end of the band leaves
    out what it should by Weibull's definition of a quantile only.
    """
    rows = values[1:] if len(values) > 1 else values
    spread: Floats = np.quantile(rows, (0.5 - 0.5 * BAND, 0.5, 0.5 + 0.5 * BAND), axis=0, method="weibull")
    return spread
