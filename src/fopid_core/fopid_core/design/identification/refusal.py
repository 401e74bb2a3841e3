"""Why a record tells nothing, or a model that was learnt from it may not be used, and what to do instead."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.identification.coloured_noise import WhitenedResponse
from fopid_core.design.identification.excitation import (
    ANSWERS,
    MANY_HALVES,
    MOST_MISSED,
    half_hold,
    missed_in_surprises,
    missed_share,
)
from fopid_core.design.identification.feedback import moved_from_outside
from fopid_core.design.identification.identified_model import MOST_DEVIATION, SHORTEST, IdentifiedModel
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Floats
from fopid_core.model.stability import process_stability

LARGEST = 1e100
"""Of the signals: squares of larger ones are no numbers any more."""
OFTEN = 0.05
"""A control that is at one value for such a share of the record is at a limit."""
LEAST_FIT = 80.0
"""Below this fit [%] the control explains too little of the measurement, unless the rest is white noise."""
NOISES, MISSED_IN_NOISE, LEAST_FIT_IN_NOISE = 1.5, 0.1, 50.0
"""Unless it leaves no more than so many times the noise that was measured at rest, or misses no more than that share of
what an experiment has moved, and still explains so much [%]."""
CLOSE_FIT = 98.0
"""A prediction a sample ahead that explains so much [%] has left no load to hide."""
MOST_UNSURE = 0.3
"""Largest standard deviation of an unstable pole, as a share of it."""
REMEMBERS = 0.2
"""Correlation of what is left, beyond which it is no noise, whatever the setpoint has moved."""
FAR_TOO_SHORT = 60.0
"""A record that would have to be so many times longer shows no crossover."""
MUCH_LONGER = 2.0
"""A record that is too short is to be so many times as long at least."""
_STILL = 0.05
_FAR, _FEW = 20.0, 0.05
"""So many times as far from the median as all but that share of the samples."""
_GAP = 0.05
"""A gap of this share of the record is named where the control explains too little."""
_FEEDBACK = (
    "the control only answers the measurement, so the record shows the controller and not the process: "
    "move the setpoint, or add a step or a PRBS to the control"
)
_LARGER = "experiment longer, or with larger moves of the control"
_STABILISE = "stabilise the process first and record it in closed loop"


def refusal_before(record: Record) -> str:
    """Why nothing can be learnt from a record, by its signals alone; empty where something can."""
    control, measurement = record.control, record.measurement
    for name, values in (("control", control), ("measurement", measurement)):
        if (largest := float(np.abs(values).max())) > LARGEST:
            return f"the {name} reaches {largest:.3g}; allowed: up to {LARGEST:g}; leave out where the loop diverged"
    if np.ptp(measurement) == 0.0:
        return f"the measurement stays at {measurement[0]:g}: move the control until it answers"
    if np.ptp(control) > 0.0 or record.control_before not in (None, control[0]):
        return ""
    begins_at_rest = abs(measurement[0]) <= _STILL * np.ptp(measurement)
    if record.control_before is None and control[0] != 0.0 and begins_at_rest:
        return ""
    return (
        f"the control stays at {control[0]:g} (saturated throughout?), so the record does not show what it does: "
        "move it in steps within its limits, or say what it was before the record (control_before)"
    )


def refusal_of_feedback(record: Record, start: InitialCondition) -> str:
    """Why nothing can be learnt where nothing moved the loop from outside; empty where something did."""
    return "" if moved_from_outside(record, start) else _FEEDBACK


def refusal_of(record: Record, best: IdentifiedModel, noise: float) -> str:
    """Why a model may not be used; empty where it may.

    Parameters
    ----------
    record : Record
        From which it was learnt.
    best : IdentifiedModel
    noise : float
        Standard deviation of the measurement's noise; 0 where it is not known.
    """
    why = _why_not(record, best, noise)
    return f"{why}{_far_from_all_others(record)}" if why else ""


def _why_not(record: Record, best: IdentifiedModel, noise: float) -> str:
    missed = _missed(record, best)
    if missed == math.inf:
        return f"disturbances have moved the measurement more than the experiment has: {_LARGER}"
    if missed > MOST_MISSED:
        told = "loads that wander hide" if best.wanders else "the model misses"
        return f"{told} {min(100.0 * missed, 100.0):.0f} % of what the experiment has moved: {_LARGER}"
    known_rest = best.noise <= NOISES * noise or missed < MISSED_IN_NOISE
    if explains_little(best) and (not known_rest or best.fit_pct < LEAST_FIT_IN_NOISE):
        return f"the control explains only {max(best.fit_pct, 0.0):.0f} % of the measurement: {_advice(record)}"
    if not process_stability(best.process).stable and (unstable := _why_not_unstable(record, best, noise)):
        return unstable
    runs_away = f"; if it runs away, {_STABILISE}" if grows(record) else ""
    needed = SHORTEST / best.crossover
    longer = max(needed, MUCH_LONGER * record.span)  # of a record that is too short little is known
    if needed > FAR_TOO_SHORT * record.span:
        return f"the record shows no end of what the process does: {_LARGER}{runs_away}"
    if needed > record.span:
        return (
            f"too short: {record.span:.3g} s of a process that a controller would move at {best.crossover:.3g} rad/s; "
            f"record at least {longer:.3g} s{runs_away}"
        )
    if not best.deviation <= MOST_DEVIATION:
        return (
            f"too little information: the process is uncertain by {100.0 * best.deviation:.0f} % where a controller "
            f"would work; record longer, with larger moves of the control, or with a PRBS experiment{runs_away}"
        )
    return ""


def _why_not_unstable(record: Record, best: IdentifiedModel, noise: float) -> str:
    left = grows(record)
    if not best.structure.runs_away or left:
        held = record.setpoint is not None and np.ptp(record.setpoint) > 0.0 and not left
        return f"the model that fits best is unstable: {_LARGER if held else _STABILISE}"
    if record.setpoint is None and record.excitation is None and best.fit_pct < LEAST_FIT:
        return (
            f"a process that runs away would explain {best.fit_pct:.0f} % of the measurement, as others may where "
            "nobody tells what moved the loop: record the setpoint, too; are control and measurement exchanged?"
        )
    if not _is_unstable_for_sure(best, noise):
        return (
            "the loop may hold a process that runs away, but what disturbs it hides how fast: "
            f"{_LARGER}, and without disturbances"
        )
    return ""


def refusal_beside_the_setpoint(record: Record, best: IdentifiedModel) -> str:
    """Why a model of a loop that nothing but its setpoint moved may not be used; empty where it may.

    What it leaves is no noise, and what it misses of that which follows from the setpoint is much, or drowned: in a
    loop that answers disturbances a rich model explains these by the control, and is wrong by any factor.
    """
    is_noise = best.whiteness.correlation <= REMEMBERS and not best.in_coloured_noise
    setpoint = record.setpoint
    if setpoint is None or is_noise or best.structure.runs_away or record.excitation is not None:
        return ""
    if not np.ptp(setpoint):
        return ""
    missed = _missed_of_setpoint(record, best, setpoint)
    if missed <= MOST_MISSED:
        return ""
    much = "drowns in that" if missed == math.inf else f"is missed by {min(100.0 * missed, 100.0):.0f} %"
    told = f"what the model leaves is no noise, and what the setpoint has moved {much}"
    limit = max(record.control.min(), record.control.max(), key=lambda end: np.count_nonzero(record.control == end))
    share = np.mean(record.control == limit)
    if share > OFTEN:
        often = f"the control was at {limit:.4g} for {100.0 * share:.0f} % of the record, where a loop is not linear"
        return f"{told}; {often}: record moves in which it stays off its limits"
    return f"{told}: record without disturbances, larger moves of the setpoint, or more of them"


def _missed_of_setpoint(record: Record, best: IdentifiedModel, setpoint: Floats) -> float:
    """Of what it has moved, the share that a model misses; where noise has memory, behind what makes that white."""
    response, moved_by = best.white.response, best.white.response.record.instrument
    if isinstance(response, WhitenedResponse) and moved_by is not None:
        half = ANSWERS / best.crossover
        return missed_in_surprises(response.record, best.white.residual, response.whitening, moved_by, half)
    time, measurement, explained = best.simulated
    half = min(max(half_hold(record, setpoint), ANSWERS / best.crossover), record.span / MANY_HALVES)
    return missed_share(record, time, measurement, measurement - explained, setpoint, half)


def _is_unstable_for_sure(best: IdentifiedModel, noise: float) -> bool:
    """Whether the unstable pole stands out of the noise, and what is left is noise: its predictor hides loads."""
    known = best.first_deviation <= MOST_UNSURE
    return known and (best.whiteness.white or best.noise <= NOISES * noise or best.fit_pct >= CLOSE_FIT)


def _missed(record: Record, best: IdentifiedModel) -> float:
    """Of what an experiment has moved, the share that the model misses; NaN where none is known."""
    if record.excitation is None or not record.excitation.any():
        return math.nan
    time, measurement, explained = best.simulated
    half = half_hold(record, record.excitation)
    return missed_share(record, time, measurement, measurement - explained, record.excitation, half)


def _advice(record: Record) -> str:
    if grows(record):
        return f"it runs away; {_STABILISE}"
    gaps = np.diff(record.time)
    longest = int(np.argmax(gaps))
    if gaps[longest] > max(_GAP * record.span, 10.0 * np.median(gaps)):
        first, last = record.time[longest : longest + 2] - record.time[0]
        return (
            f"there are no samples from {first:.4g} to {last:.4g} s after the first; use what is before or after that"
        )
    return "look for disturbances, a sensor that sticks or a wrong pair of signals, and move the control more"


def _far_from_all_others(record: Record) -> str:
    """What some loggers write where a sensor says nothing: a few numbers far beyond all others."""
    away = np.abs(record.measurement - np.median(record.measurement))
    far = np.flatnonzero(away > _FAR * np.quantile(away, 1.0 - _FEW))
    if not 0 < far.size <= _FEW * away.size:
        return ""
    first = f"{record.measurement[far[0]]:.6g} at {record.time[far[0]]:.6g} s"
    return f"; the measurement is {first}, far beyond all but {far.size} samples: if no sensor said so, leave them out"


def grows(record: Record) -> bool:
    """Whether the measurement ends far from where it was for most of the record."""
    size = np.abs(record.measurement - record.measurement[0])
    tenth = size.size // 10
    return bool(size[-tenth:].mean() > 3.0 * size[:-tenth].mean())


def explains_little(best: IdentifiedModel) -> bool:
    """Whether the control explains too little of the measurement, and the rest is not white noise."""
    return best.fit_pct < LEAST_FIT and not best.whiteness.white
