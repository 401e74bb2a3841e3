"""Gains held against what a record shows without a model, where the model that was learnt does not show it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fopid_core.design.identification.frequency_response import (
    POINTS,
    FrequencyResponse,
    contradicts,
    frequency_response,
)
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.record import FEWEST_SAMPLES, Record
from fopid_core.design.identification.refusal import LEAST_FIT
from fopid_core.design.identification.structure import UNSTABLE_STRUCTURES
from fopid_core.design.recorded_law import contradicts_law
from fopid_core.design.sampled_loop import running
from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter

_GAP = 2
"""Samples that are left out where a load came, which no past tells."""
_FINER = 8
"""Steps from one frequency at which a model is held to the response to the next: a resonance may stand between."""
_SURE = 1.5
"""So many times the radius of 95 of 100, where one of many frequencies may speak against gains."""
_HIGHER = 40
"""So many frequencies beyond the last that is known are looked at, up to the Nyquist frequency."""
MANY = 1.0 / 3.0
"""A response that is known at such a share of its frequencies may bear a model out."""
THROUGHOUT = 0.9
"""A model that leaves such a share is wrong throughout: of another kind."""
MOSTLY = 0.7
"""One that leaves such a share is no guide to where nothing is known."""


def doubt_of(record: Record, learnt: IdentifiedModel) -> str:
    """How a process that was learnt from a record contradicts it; empty where it does not."""
    return contradicts(_seen(record, learnt), learnt.process)


def bears_out(record: Record, learnt: IdentifiedModel) -> bool:
    """Whether a record shows the process without a model at many frequencies, and as it was learnt."""
    seen = _seen(record, learnt)
    return bool(seen.known.mean() >= MANY) and not contradicts(seen, learnt.process)


def wrong_throughout(record: Record, learnt: IdentifiedModel) -> str:
    """How a record contradicts a process nearly wherever it shows one without a model; empty where it does not."""
    return contradicts(_seen(record, learnt), learnt.process, THROUGHOUT)


def checked(record: Record, found: IdentificationResult, template: str = "all") -> IdentificationResult:
    """What was learnt from a record, a success only where two other calculations do not say that it is not its process.

    Parameters
    ----------
    record : Record
    found : IdentificationResult
        From it.
    template : str
        What was asked for: whoever names a structure knows that it comes near to the process only.
    """
    if not found.success or found.best is None:
        return found
    wrong = wrong_throughout(found.behind_actuator(record), found.best) if template == "all" else ""
    wrong = wrong or ("" if found.flaws.come_before else contradicts_law(record, found.best.process))
    return replace(found, success=False, message=f"{found.message}; {wrong}") if wrong else found


def to_design_for(record: Record, source: str) -> IdentificationResult:
    """What is learnt from a record, for designs that are not held to the record itself.

    Parameters
    ----------
    record : Record
    source : str
        What the record is called.

    Raises
    ------
    InputError
        If nothing can be learnt, or the record contradicts what was learnt throughout.
    """
    found = checked(record, identify(record))
    if not found.success or found.best is None:
        raise InputError(f"record {source!r}: {found.message}; allowed: one that a process can be learnt from")
    return found


def runs_away_instead(record: Record, learnt: IdentifiedModel, noise: float) -> IdentificationResult | None:
    """A process that runs away, where the record contradicts a stable one throughout and does not contradict it.

    A loop that holds such a process may look like a stable one beside a load (one of 320 in a campaign did): gains for
    that are near 0, and nothing that is known at some frequencies alone tells that they let it go.

    Parameters
    ----------
    record : Record
    learnt : IdentifiedModel
    noise : float
        Of the measurement, a standard deviation; 0 where it is not known.
    """
    if learnt.structure.runs_away or not wrong_throughout(record, learnt):
        return None
    found = identify(record, ",".join(UNSTABLE_STRUCTURES), noise=noise)
    return found if found.success and found.best and not doubt_of(record, found.best) else None


def _seen(record: Record, learnt: IdentifiedModel, points: int = POINTS) -> FrequencyResponse:
    return frequency_response(_cut(record, learnt.loads), points)


Judge = Callable[[Fopid | None, MeasurementFilter], str]
"""Why a controller with a filter of the measurement may not be used, or nothing; nothing without one."""


def held_to_record(
    record: Record, learnt: IdentifiedModel, ms_max: float, sample_time: float = 0.0
) -> tuple[str, Judge]:
    """How a process that was learnt from a record contradicts it, and what gains are to be held to then.

    Parameters
    ----------
    record : Record
    learnt : IdentifiedModel
        Where it knows of loads that came, the record is cut there.
    ms_max : float
    sample_time : float
        Of the controller [s]; 0 for that of the record.

    Returns
    -------
    doubt : str
        Empty where the record does not contradict the process: the judge finds only what is sure then.
    judge : callable
        Of designs for that process.

    See Also
    --------
    held_without_a_model, surely_without_a_model : What the judge asks.
    """
    fine = _seen(record, learnt, _FINER * (POINTS - 1) + 1)
    seen = replace(
        fine, frequency=fine.frequency[::_FINER], response=fine.response[::_FINER], radius=fine.radius[::_FINER]
    )
    doubt = contradicts(seen, learnt.process)
    if not doubt:
        return doubt, surely_without_a_model(fine, ms_max, sample_time)
    wrong = learnt.fit_pct < LEAST_FIT or bool(contradicts(seen, learnt.process, MOSTLY))
    return doubt, held_without_a_model(_with_what_is_between(fine), learnt.process, ms_max, sample_time, wrong=wrong)


def _with_what_is_between(fine: FrequencyResponse) -> FrequencyResponse:
    """A response with its regions at every so many of its frequencies, and as it is likeliest between known ones.

    At so many more frequencies a bound over whole discs would be one for a far larger region.
    """
    every = np.zeros(fine.frequency.size, dtype=bool)
    every[::_FINER] = True
    known = np.flatnonzero(fine.known & every)
    between = np.zeros_like(every)
    if known.size:
        between[known[0] : known[-1] + 1] = True
    likeliest = np.where(between & ~every & fine.known, 0.0, np.inf)
    return replace(fine, radius=np.where(every, fine.radius, likeliest))


def contradicts_rest(process: Process, gains: Fopid, sample_time: float, slow: MeasurementFilter = NO_FILTER) -> str:
    """How a process contradicts that some gains hold their loop at rest; empty where it does not, or nobody knows.

    Parameters
    ----------
    process : Process
    gains : Fopid
        That run.
    sample_time : float
        Of the controller [s].
    slow : MeasurementFilter
        That runs with them.

    Examples
    --------
    >>> contradicts_rest(Process.parse("1/(s+1)^3"), Fopid(kp=2.0), 0.01)
    ''
    >>> contradicts_rest(Process.parse("5/(s+1)^3"), Fopid(kp=2.0), 0.01)
    'the gains that run hold the loop, and would not hold the learnt process (2 unstable poles of the sampled loop)'
    """
    found = running(process, gains, sample_time, slow, with_margins=False)
    if found.stable is not False:
        return ""
    return f"the gains that run hold the loop, and would not hold the learnt process ({found.reason})"


def _cut(record: Record, instants: Sequence[float]) -> Record:
    """With a gap, which ends a piece of it, at some instants since its beginning [s]."""
    first = np.searchsorted(record.time - record.time[0], instants)
    kept = ~np.isin(np.arange(record.time.size), (first[:, np.newaxis] + np.arange(_GAP)).ravel())
    if kept.all() or kept.sum() < FEWEST_SAMPLES:
        return record
    names = ("time", "control", "measurement", "setpoint", "excitation")
    signals: dict[str, Any] = {name: getattr(record, name) for name in names}
    return replace(record, **{name: each[kept] for name, each in signals.items() if each is not None})


def no_objection(_: Fopid | None, __: MeasurementFilter) -> str:
    """The judge of loops with a process that nothing contradicts."""
    return ""


def surely_without_a_model(response: FrequencyResponse, ms_max: float, sample_time: float = 0.0) -> Judge:
    """A judge of designs for a process that does not contradict the response: a narrow resonance stands in few of them.

    Only where |S| is beyond its bound for all of a disc with ``_SURE`` times the radius, 1 / (|1 + C F G| + |C F| r).

    Parameters
    ----------
    response : FrequencyResponse
    ms_max : float
    sample_time : float
        Of the controller [s]; 0 for that of the response.

    Examples
    --------
    >>> w = np.geomspace(0.1, 5.0, 15)
    >>> seen = FrequencyResponse(w, 1.0 / (1j * w + 1.0) ** 3, np.full(15, 0.01), 0.01, 10)
    >>> judge = surely_without_a_model(seen, 2.2)
    >>> judge(Fopid(3.0, 1.0), NO_FILTER), judge(Fopid(1.0, 0.4), NO_FILTER)
    ('max |S| above 2.2 at 1.24 rad/s, by what the record shows without a model', '')
    """
    w, seen, radius = _behind_hold(response, sample_time)

    def judge(gains: Fopid | None, slow: MeasurementFilter) -> str:
        if gains is None or not w.size:
            return ""
        controller = gains(1j * w) * slow(1j * w)
        return _beyond(w, np.abs(1.0 + controller * seen) + _SURE * np.abs(controller) * radius, ms_max)

    return judge


def _behind_hold(response: FrequencyResponse, sample_time: float) -> tuple[Floats, Complexes, Floats]:
    """Where the response is known, it and its radius, behind the hold of the controller instead of its own."""
    known = response.known
    w = response.frequency[known]
    held = _hold(w, sample_time or response.sample_time) / _hold(w, response.sample_time)
    return w, response.response[known] * held, response.radius[known] * np.abs(held)


def _beyond(frequency: Floats, nearest: Floats, ms_max: float) -> str:
    """What is said where a loop comes nearer to -1 than its bound allows."""
    worst = int(np.argmin(nearest))
    if nearest[worst] * ms_max >= 1.0:
        return ""
    return f"max |S| above {ms_max:g} at {frequency[worst]:.3g} rad/s, by what the record shows without a model"


def held_without_a_model(
    response: FrequencyResponse, process: Process, ms_max: float, sample_time: float = 0.0, *, wrong: bool = False
) -> Judge:
    """A judge of designs for a process that contradicts the response, whose own loops are stable.

    At each known frequency |S| is bounded over the whole disc: 1 / (|1 + C F G| - |C F| r), with C as it is in
    continuous time and G behind the hold of the controller. From the lowest to the highest of them, 1 + C F G may not
    go around the origin otherwise than the process's own (Nyquist). Beyond the highest, where a delay that the process
    lacks may turn it further, no design may have a loop gain above 1, the process taken for a lag from there on.

    Parameters
    ----------
    response : FrequencyResponse
    process : Process
    ms_max : float
    sample_time : float
        Of the controller [s]; 0 for that of the response.
    wrong : bool
        Whether the process is mostly wrong, or explains too little: no design may do all its work below the
        frequencies then, of which nothing is known.

    Examples
    --------
    >>> from fopid_core.design.specification import TuningRequest
    >>> from fopid_core.design.tuner import tune
    >>> w = np.geomspace(0.1, 5.0, 15)
    >>> seen = FrequencyResponse(w, 1.0 / (1j * w + 1.0) ** 3, np.full(15, 0.01), 0.01, 10)
    >>> def judged(text, wrong=False):
    ...     process = Process.parse(text)
    ...     design = tune(TuningRequest(process, "rule", rule="simc-pi"))
    ...     return held_without_a_model(seen, process, 2.2, wrong=wrong)(design.controller, design.filter)
    >>> judged("1/(s+1)^3")
    ''
    >>> judged("0.4/(s+1)^3")
    'max |S| above 2.2 at 1.24 rad/s, by what the record shows without a model'
    >>> judged("0.02/(s+1)^3")
    'unstable by what the record shows without a model'
    >>> judged("-0.3/(10s+1)*exp(-60s)", wrong=True)
    'it works below 0.1 rad/s, where the record shows nothing without a model'
    """
    known = response.known
    w, seen, radius = _behind_hold(response, sample_time)
    held = seen / response.response[known]
    learnt = response.model(process)[known] * held
    beyond = w[-1] * np.geomspace(1.0, max(np.pi / (w[-1] * response.sample_time), 1.0), _HIGHER)
    largest = (abs(response.response[known][-1]) + response.radius[known][-1]) * w[-1] / beyond

    def judge(gains: Fopid | None, slow: MeasurementFilter) -> str:
        if gains is None:
            return ""
        controller = gains(1j * w) * slow(1j * w)
        difference = np.unwrap(np.angle((1.0 + controller * seen) / (1.0 + controller * learnt)))
        if abs(difference[-1] - difference[0]) > np.pi:
            return "unstable by what the record shows without a model"
        if wrong and min(np.abs(controller * one).max() for one in (seen, learnt)) < 1.0:
            return f"it works below {w[0]:.3g} rad/s, where the record shows nothing without a model"
        if (np.abs(gains(1j * beyond) * slow(1j * beyond)) * largest).max() > 1.0:
            return f"it works beyond {w[-1]:.3g} rad/s, where the record shows nothing without a model"
        return _beyond(w, np.abs(1.0 + controller * seen) - np.abs(controller) * radius, ms_max)

    return judge


def _hold(frequency: Floats, sample_time: float) -> Complexes:
    """What holding a control for so long makes of a frequency."""
    theta = frequency * sample_time
    return np.asarray(-np.expm1(-1j * theta) / (1j * theta))
