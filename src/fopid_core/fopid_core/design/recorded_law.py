"""The controller that ran while a record was made, as the record itself shows it: it held its loop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter, lfiltic

from fopid_core.design.identification.record import FEWEST_SAMPLES, Record
from fopid_core.design.specification import TuningResult
from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.process import Process
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import as_designed
from fopid_core.runtime.simulation import simulate

LAGS = 4
"""The law looks so many samples back."""
LEFT_MAX = 0.02
"""Share of the control's range that it may be off by, told from its first samples and the other signals alone."""
MOST_LATE, FEWEST_ANSWERS = 100, 80
"""So many samples a control may be told late; then at least about so many must be left, for a law of 14 numbers."""
CLEARLY, SHARPLY, EXACT = 0.25, 5.0, 1e-9
"""A law that answers so late is off by that share of what one that answers at once is, where that is off, and one that
answers a sample later by so many times as much; one that is off by so little is exact."""
PART = 0.25
"""A part of a record in which a control moves at each sample shows its law where it is such a share of it."""
CLOSELY, AS_WELL = 0.002, 2.0
"""A law that is off by no more is compared with others; one that integrates instead where that is off by no more than
so many times as much."""
_AWAY = 1e9
FEW_SAMPLES = 5_000
"""So many samples of a load's step are looked at, at most."""
TIMES, MOST_SAMPLES, FAR = 5, 50_000, 30.0
"""It would not hold a process that it drives so many times as far as the record went, in so many times as long."""


@dataclass(frozen=True)
class RecordedLaw:
    """The next control, from those before and the measurement now and before, beside what it takes of the setpoint.

    Attributes
    ----------
    own : ndarray, shape (LAGS,)
        What it takes of the controls before, the newest first.
    measurement : ndarray, shape (LAGS + 1,)
        What it takes of it, the newest first.
    """

    own: Floats
    measurement: Floats

    def response(self, theta: Floats) -> Complexes:
        """From the measurement to the control, its sign turned, at frequencies [rad a sample]; shape (n,).

        Examples
        --------
        >>> law = RecordedLaw(np.array([1.0, 0.0, 0.0, 0.0]), np.array([-2.1, 2.0, 0.0, 0.0, 0.0]))
        >>> law.response(np.array([math.pi])).round(6)  # 2 e + 0.1 sum(e)
        array([2.05+0.j])
        """
        back = np.exp(-1j * theta)
        own, measured = np.append(1.0, -self.own), self.measurement
        return np.asarray(-np.polyval(measured[::-1], back) / np.polyval(own[::-1], back))


def recorded_law(record: Record, *, in_part: bool = False) -> RecordedLaw | None:
    """The law by which a record's control answers its setpoint and its measurement; None where none explains it.

    Without limits, and linear: what a control that is limited, rounded or moved by hand did is not explained. Nor is
    what has a longer memory: the law must tell the whole record from its first samples on; or, ``in_part``, the longest
    part of it in which the control moves at each sample.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> r, y = np.repeat([0.0, 1.0, -1.0], 50), rng.standard_normal(150)
    >>> law = recorded_law(Record(np.arange(150.0), 2.0 * (r - y) + 0.1 * np.cumsum(r - y), y, r))
    >>> round(float(law.measurement[0]), 6)
    -2.1
    >>> recorded_law(Record(np.arange(150.0), rng.standard_normal(150), y, r)) is None
    True
    """
    for part in _parts(record) if in_part else (record,):
        law, left = _answering(part)
        if left <= LEFT_MAX:
            return law
    return None


def lateness(record: Record) -> float:
    """By how long the control answers late, as the law that explains it shows [s]; 0 where none does.

    A control that is told late hides as much of its process's delay.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> r, y = np.repeat([0.0, 1.0, -1.0], 50), rng.standard_normal(150)
    >>> u = 2.0 * (r - y) + 0.1 * np.cumsum(r - y)
    >>> lateness(Record(0.5 * np.arange(150), u, y, r)), lateness(Record(0.5 * np.arange(150), np.roll(u, 8), y, r))
    (0.0, 4.0)
    """
    return next((late for part in _parts(record) if (late := _lateness(part))), 0.0)


def _parts(record: Record) -> Iterator[Record]:
    """The record, and its longest part in which the control moves at each sample: at a limit it answers nothing."""
    yield record if record.time.size <= MOST_SAMPLES else record.part(last=float(record.time[MOST_SAMPLES]))
    still = np.flatnonzero(np.diff(record.control, prepend=math.nan, append=math.nan) == 0.0)
    edges = np.concatenate([[0], still, [record.time.size - 1]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]) + 1, min(int(edges[longest + 1]) - 1, int(edges[longest]) + MOST_SAMPLES)
    if still.size and last - first >= max(PART * min(record.time.size, MOST_SAMPLES), FEWEST_SAMPLES):
        yield record.part(float(record.time[first]), float(record.time[last]))


def _lateness(record: Record) -> float:
    """Of one part [s]."""
    at_once = _answering(record)[1]
    if math.isinf(at_once):
        return 0.0
    most = min(LAGS if at_once <= LEFT_MAX else MOST_LATE, record.time.size - FEWEST_ANSWERS)
    if most < 1:
        return 0.0
    left = np.array([at_once, *(_answering(record, late)[1] for late in range(1, most + 2))])
    least = float(left.min())
    latest = int(np.flatnonzero(left <= max(2.0 * least, EXACT))[-1])
    is_law = least <= LEFT_MAX and (at_once <= LEFT_MAX or least <= CLEARLY * at_once)
    is_sharp = latest <= most and left[latest + 1] >= SHARPLY * max(least, EXACT)
    return latest * record.sample_time if is_law and is_sharp else 0.0


def made_prompt(record: Record) -> Record:
    """The record with the control from when it was given, where it was told late and what an experiment added is not.

    Of a controller that does act late its delay counts to the process then, as another in its place would find it.
    """
    late = round(lateness(record) / record.sample_time) if record.excitation is None else 0
    if not late:
        return record
    kept = record.time.size - late
    setpoint = None if record.setpoint is None else record.setpoint[:kept]
    return replace(
        record, time=record.time[:kept], control=record.control[late:], measurement=record.measurement[:kept],
        setpoint=setpoint, late=record.late + late * record.sample_time,
    )  # fmt: skip


def _answering(record: Record, late: int = 0, *, integrates: bool = False) -> tuple[RecordedLaw | None, float]:
    """The law by which a control answers what was so many samples before, and the share of its range it is off by.

    One that ``integrates`` leaves no offset: it is found from the control's moves.
    """
    if record.setpoint is None or not np.ptp(record.setpoint) or not record.is_regular:
        return None, math.inf
    if not np.ptp(record.setpoint[LAGS : record.time.size - late]):
        return None, _AWAY  # what does not move is answered at once by a law that answers later
    now = np.arange(LAGS + late, record.time.size)[:, np.newaxis]
    own, before = record.control[now - 1 - np.arange(LAGS)], record.control[now[:, 0] - 1]
    seen = own[:, :-1] - own[:, 1:] if integrates else own
    others = [signal[now - late - np.arange(LAGS + 1)] for signal in (record.setpoint, record.measurement)]
    columns, target = np.hstack([seen, *others]), record.control[LAGS + late :]
    matrix, wanted = columns - columns.mean(axis=0), target - before * integrates
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    numbers = np.linalg.lstsq(matrix / sizes, wanted - wanted.mean(), rcond=1e-9)[0] / sizes
    if integrates:  # u - u1 = c1 (u1 - u2) + c2 (u2 - u3) + ...
        moves = numbers[: LAGS - 1]
        numbers = np.concatenate([np.append(moves, 0.0) - np.append(-1.0, moves), numbers[LAGS - 1 :]])
    rest = np.hstack(others)
    others_alone = (rest - rest.mean(axis=0)) @ numbers[LAGS:]
    constant = target.mean() - float(own.mean(axis=0) @ numbers[:LAGS])
    poles = np.append(1.0, -numbers[:LAGS])
    told, _ = lfilter([1.0], poles, others_alone + constant, zi=lfiltic([1.0], poles, own[0]))
    with np.errstate(all="ignore"):  # a law that runs away by itself tells no record
        left = float(np.abs(told - target).max() / np.ptp(target))
    return RecordedLaw(numbers[:LAGS], numbers[-(LAGS + 1) :]), left if math.isfinite(left) else _AWAY


def contradicts_law(record: Record, process: Process) -> str:
    """How a process contradicts that the controller which ran held its loop; empty where it does not, or nobody knows.

    Parameters
    ----------
    record : Record
    process : Process
        Learnt from it.
    """
    law = recorded_law(record)
    if law is None or record.setpoint is None:
        return ""
    reached = float(np.ptp(np.append(record.measurement, record.setpoint)))
    samples = min(TIMES * record.time.size, MOST_SAMPLES)
    asked = -float(law.measurement.sum()) * reached  # a step of the setpoint, which the record may hardly move
    try:
        for measured in _held_by(law, process, record.sample_time, samples, asked=asked):
            if not abs(measured) <= FAR * reached:
                return "the controller that ran, as the record shows it, held its loop, and would not hold this process"
    except InputError:  # its response is not known
        return ""
    return ""


def _held_by(
    law: RecordedLaw, process: Process, sample_time: float, samples: int, *, asked: float = 0.0, load: float = 0.0
) -> Iterator[float]:
    """The measurement of a process from rest, sample by sample, with a law whose control is asked for some more."""
    plant = plant_of(PlantSettings(process, sample_time=sample_time))
    own, answered = np.zeros(LAGS), np.zeros(LAGS + 1)
    for _ in range(samples):
        answered = np.append(plant.measurement, answered[:-1])
        control = float(law.own @ own + law.measurement @ answered) + asked
        own = np.append(control, own[:-1])
        yield plant.step(control, load)


def beside_what_ran(record: Record, process: Process, tuning: TuningResult) -> float:
    """The error that a design leaves after a load's step, over that of the controller that ran; NaN if nobody knows it.

    On a process, over as long as the record; the law that the record shows stands for what ran. With few digits in its
    signals a record hides how much of the control is integral, and what ran looks many times as bad as it was: then
    nobody knows.

    Parameters
    ----------
    record : Record
    process : Process
        Learnt from it.
    tuning : TuningResult
        With gains.
    """
    law, h, samples = _close_law(record), record.sample_time, min(record.time.size, FEW_SAMPLES)
    if law is None or tuning.controller is None:
        return math.nan
    settings = as_designed(tuning.controller, h, tuning.filter, tuning.weights)
    try:
        ran = sum(min(abs(measured), _AWAY) for measured in _held_by(law, process, h, samples, load=1.0))
        plant = plant_of(PlantSettings(process, sample_time=h))
        new = simulate(FopidController(settings), plant, samples, lambda _: 0.0, lambda _: 1.0)
    except InputError:  # its response is not known
        return math.nan
    return float(np.abs(new.measurement).sum() / ran) if 0.0 < ran < _AWAY else math.nan


def _close_law(record: Record) -> RecordedLaw | None:
    """The law that explains a record or its part closely: one that integrates, where that explains it as well."""
    for part in _parts(record):
        free, left = _answering(part)
        if left <= CLOSELY:
            integral, off = _answering(part, integrates=True)
            return integral if off <= AS_WELL * max(left, EXACT) else free
    return None
