"""The process learnt from its own signals: the one door for records of every origin.

A structure's response to the recorded control is fitted to the measurement (output error, a prediction error method:
Ljung 1999, ch. 7). With noise that is white, and a control that answers it a sample later, that is consistent in
closed loop as well.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.fit import fit
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.model_search import COARSE, Found, Search, model_of, search_for, unstable_last
from fopid_core.design.identification.rate_limit import PROOF, SPEAKS, gained, left_behind, rate_limit_of
from fopid_core.design.identification.record import Record, validation_samples
from fopid_core.design.identification.refusal import (
    refusal_before,
    refusal_beside_the_setpoint,
    refusal_of,
    refusal_of_feedback,
)
from fopid_core.design.identification.response import InitialCondition
from fopid_core.design.identification.runaway import response_to
from fopid_core.design.identification.sensor_faults import as_told, compressed, sound
from fopid_core.design.identification.wandering_load import (
    others_beside_wandering_loads,
    slow_beside_wandering_loads,
)
from fopid_core.design.specification import Clock
from fopid_core.model.arrays import Floats

NO_END = 30.0
"""A lag of so many records shows less than a thirtieth of its end in one: it integrates, for all that can be seen."""


@dataclass(frozen=True)
class IdentificationResult:
    """The answer to ``identify``.

    Attributes
    ----------
    success : bool
        Whether ``best`` may be used.
    message : str
        One line: what was found, or why not and what to do instead.
    models : tuple of IdentifiedModel
        In the order asked for.
    best : IdentifiedModel or None
        The simplest of those that fit best; None where none could be fitted.
    elapsed : float
        [s]
    """

    success: bool
    message: str
    models: tuple[IdentifiedModel, ...]
    best: IdentifiedModel | None
    elapsed: float

    @property
    def flaws(self) -> Flaws:
        """What the record speaks for: a dead band of the actuator, a limit on its moves, or dry friction.

        The models are of the rest.
        """
        return self.best.flaws if self.best else Flaws()

    def with_limit(self, rate: float) -> IdentificationResult:
        """The same, behind an actuator that is known to move so fast at most [1/s]."""

        def behind(model: IdentifiedModel) -> IdentifiedModel:
            return replace(model, flaws=replace(model.flaws, rate=rate))

        best = behind(self.best) if self.best else None
        return replace(self, models=tuple(behind(model) for model in self.models), best=best)

    def behind_actuator(self, record: Record) -> Record:
        """A record as the linear process saw it: what actuator and friction left of its control."""
        return self.flaws.of_record(record) if self.flaws.come_before else record


def identify(
    record: Record, template: str = "all", clock: Clock = time.perf_counter, noise: float = 0.0, *,
    disturbances: bool = True, unstable: bool = True,
) -> IdentificationResult:  # fmt: skip
    """Fit models to a record and judge them.

    Parameters
    ----------
    record : Record
        Where nothing was recorded for long, the longest stretch from which something can be learnt counts.
    template : str
        ``foptd``, ``soptd``, ``nioptd1``, ``nioptd2``; ``all`` of them, and richer ones where these miss something;
        ``rational:N/M`` with a denominator of order N and a numerator of order M; ``unstable:N`` with one of N poles
        on the right; or several with commas.
    clock : callable
        Gives the time [s].
    noise : float
        Standard deviation of the measurement's noise, where it is known: a model that leaves little more has explained
        what there is, however small the moves were.
    disturbances : bool
        Whether steps of a load are looked for, and noise may have memory.
    unstable : bool
        Whether ``all`` looks for processes that run away, or beside loads that wander, where nothing else explains the
        record: either takes long.

    Returns
    -------
    IdentificationResult
        Unsuccessful when the record carries too little information, or shows a process that runs away with no loop
        to hold it.

    Raises
    ------
    InputError
        If the template is not known.

    Examples
    --------
    >>> time = np.arange(0.0, 20.0, 0.05)
    >>> record = Record(time, np.ones(400), 2.0 * (1.0 - np.exp(-time)))
    >>> found = identify(record, "foptd")
    >>> found.success, round(found.best.parameters["K"], 3), round(found.best.parameters["T"], 3)
    (True, 2.0, 1.0)
    """
    begun, search = clock(), search_for(template, noise, disturbances, unstable)
    whole, told_of_sensor = sound(record)
    learnt: list[tuple[Record, IdentificationResult]] = []
    for part in whole.stretches:
        learnt.append((part, _learnt_from(part, search, float(part.time[0] - record.time[0]))))
        if learnt[-1][1].success:
            break
    stretch, found = learnt[-1] if learnt[-1][1].success else learnt[0]
    told = found.message + told_of_sensor
    if not found.success and record.excitation is None and (thinned := compressed(as_told(record)[0])):
        told += f"; {thinned}: export raw values"
    if len(whole.stretches) > 1:
        where = f"{stretch.time.size} from {stretch.time[0]:.6g} s to {stretch.time[-1]:.6g} s"
        told += f"; of {record.time.size} samples the {where}, a stretch without a break, were used"
    return replace(found, message=told + _late(record), elapsed=clock() - begun)


def _learnt_from(record: Record, search: Search, offset: float) -> IdentificationResult:
    """What is found in a stretch without breaks, which began so long after its record [s]."""
    nothing = refusal_before(record)
    if nothing:
        return IdentificationResult(False, nothing, (), None, 0.0)
    rough = search.rough(record)
    nothing = refusal_of_feedback(record, rough.response.start)
    if nothing:
        return IdentificationResult(False, nothing, (), None, 0.0)
    found = search.of(record, rough)
    refusal = found.refusal or refusal_beside_the_setpoint(record, found.best)
    found = found.began(offset)
    told = refusal or _told(found.best)
    if not refusal and not np.ptp(record.control) and record.control_before is None:
        told += (
            f"; taken for a step of the control from 0 to {record.control[0]:g} at the first sample (control_before)"
        )
    return IdentificationResult(not refusal, told, found.models, found.best, 0.0)


def behind_slow_actuator(
    record: Record, learnt: IdentificationResult, template: str = "all", noise: float = 0.0, *, possible: bool = False
) -> IdentificationResult | None:
    """What was learnt, behind a limit on the actuator's moves; None where a record does not speak for one.

    Parameters
    ----------
    record : Record
        With moves as large as may be.
    learnt : IdentificationResult
        From it; where it is ``possible`` that counts, perhaps from smaller moves.
    template, noise
        As for `identify`.
    possible : bool
        Whether the smallest limit is wanted that the record leaves possible, though it may not speak for any.
    """
    begun, best, stretch = time.perf_counter(), learnt.best, sound(record)[0].stretches[0]
    record, offset = stretch, float(stretch.time[0] - record.time[0])
    if best is not None and best.wanders:
        without = None if possible else _without_wandering_loads(record, learnt)
        alone = without and behind_slow_actuator(record, without, template, noise)
        return alone or _slow_beside_wandering_loads(record, learnt, best, offset)
    flaws = rate_limit_of(record, best, 0.0 if possible else SPEAKS) if best is not None else None
    if best is None or flaws is None:
        return None
    seen = Flaws(rate=flaws.rate).of_record(record)
    is_settled = any(model.wanders for model in learnt.models)  # what runs away and what wanders were looked for
    search = search_for(template, noise, unstable=not is_settled)
    found = search.of(seen, search.rough(seen)).began(offset)
    if possible and not best.flaws.friction and (found.refusal or found.best.flaws.friction):
        # Friction that was not known may have passed for a limit.
        anew = identify(record, template, noise=noise)
        left = left_behind(record, best, flaws.rate)
        if anew.success and anew.best is not None and anew.flaws.friction and anew.best.noise < left:
            return behind_slow_actuator(record, anew, template, noise, possible=True)
    is_new = math.isinf(learnt.flaws.rate)
    if not possible and (found.refusal or (is_new and gained(best.fitted, found.best.fitted) < PROOF)):
        return None
    # What small moves showed as stable does not run away for a limit that may be there.
    if found.refusal or (possible and found.best.structure.runs_away and not best.structure.runs_away):
        return replace(learnt, best=replace(best, flaws=flaws))
    found = found.behind(replace(found.best.flaws, rate=flaws.rate))
    told = _told(found.best) + _late(record)
    return IdentificationResult(True, told, found.models, found.best, time.perf_counter() - begun)


def _without_wandering_loads(record: Record, learnt: IdentificationResult) -> IdentificationResult | None:
    """What else explains an experiment, and best: what an actuator does to its moves may pass for loads that wander."""
    if record.excitation is None or not record.excitation.any():
        return None
    others = [model for model in learnt.models if not (model.wanders or model.structure.runs_away)]
    return replace(learnt, best=max(others, key=lambda model: model.fit_pct)) if others else None


def _slow_beside_wandering_loads(
    record: Record, learnt: IdentificationResult, best: IdentifiedModel, offset: float
) -> IdentificationResult | None:
    begun, slow = time.perf_counter(), slow_beside_wandering_loads(record, best)
    if slow is None or refusal_of(record, slow, 0.0):
        return None
    others = [model for model in learnt.models if not model.wanders]
    found = Found((*others, slow, *others_beside_wandering_loads(slow)), slow, "").began(offset)
    told = _told(found.best) + _late(record)
    return IdentificationResult(True, told, found.models, found.best, time.perf_counter() - begun)


def _late(record: Record) -> str:
    """What is said of a control that was told late."""
    answers = f"; the control answers setpoint and measurement {record.late:.3g} s late by the law that explains it"
    return f"{answers}, and counts from when it would have been given at once" if record.late else ""


def refit(
    record: Record, model: IdentifiedModel, start: InitialCondition, begins: Sequence[Floats]
) -> IdentificationResult:
    """A structure fitted to a record that differs a little from the one it was learnt from: behind a filter, say.

    Parameters
    ----------
    record : Record
    model : IdentifiedModel
        Of that structure.
    start : InitialCondition
        What is unknown about the beginning of the record.
    begins : sequence of ndarray
        Numbers of the structure from which the fit begins; the best end counts.
    """
    begun = time.perf_counter()
    response = response_to(record, model.structure, start, COARSE)
    rows = ~validation_samples(response.time.size)
    best = model_of(record, min((fit(response, begin, rows, 40, 1e-5) for begin in begins), key=unstable_last))
    refusal = refusal_of(record, best, 0.0)
    return IdentificationResult(not refusal, refusal or _told(best), (best,), best, time.perf_counter() - begun)


def _told(best: IdentifiedModel) -> str:
    explains = f"{best.template} explains {best.fit_pct:.2f} % of the measurement on held-back samples"
    if best.wanders:
        explains = f"{best.template} explains {best.fit_pct:.0f} % of what the loop was moved by from outside"
    told = f"{explains}; {best.flaws}" if str(best.flaws) else explains
    if best.wanders:
        return f"{told}; beside it loads wander"
    lag, span = best.parameters.get("T", 0.0), float(best.fitted.response.time[-1])
    if best.template == "foptd" and lag > NO_END * span:
        told += f"; it integrates, for all that the record shows: {best.parameters['K'] / lag:.4g} per second"
    beside = [f"a drift of {best.ramp:.3g} per second"] * bool(best.ramp)
    beside += [f"a load that came after {instant:.3g} s" for instant in best.loads]
    told = f"{told}, beside {' and '.join(beside)} that was taken out" if beside else told
    return f"{told}; the noise has memory" if best.in_coloured_noise else told
