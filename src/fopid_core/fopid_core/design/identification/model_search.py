"""The models of a record that are worth a look: templates, richer ones, ones that run away, and all behind flaws."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.coloured_noise import fit_in_coloured_noise
from fopid_core.design.identification.dead_band import dead_band_of
from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.frequency_response import FrequencyResponse, contradicts, frequency_response
from fopid_core.design.identification.friction import friction_of
from fopid_core.design.identification.identified_model import IdentifiedModel, judged
from fopid_core.design.identification.initial_estimates import initial_conditions, initial_parameters, rough_fit
from fopid_core.design.identification.quality import fit_pct
from fopid_core.design.identification.record import Record, validation_samples
from fopid_core.design.identification.refusal import (
    LEAST_FIT,
    LEAST_FIT_IN_NOISE,
    REMEMBERS,
    explains_little,
    grows,
    refusal_beside_the_setpoint,
    refusal_of,
)
from fopid_core.design.identification.response import RecordResponse
from fopid_core.design.identification.runaway import response_to, runaway_fits
from fopid_core.design.identification.structure import (
    TEMPLATE_STRUCTURES,
    UNSTABLE_STRUCTURES,
    Structure,
    structure_of,
)
from fopid_core.design.identification.wandering_load import beside_wandering_loads, others_beside_wandering_loads
from fopid_core.model.stability import process_stability

SIMPLER = 1.01
"""A model with fewer numbers is preferred while its held-back error is at most so many times the smallest."""
NEARLY = 1.05
"""One that may be used is preferred to others that may not while its error is at most so many times the smallest."""
RICHER = ("rational:4", "rational:3/1")
GOOD_FIT, BEST_FIT = 98.0, 99.9
"""Where the templates fit worse than this [%] and leave a residual whose correlation matters, these are tried too; up
to the second where the best template may be used: a record that shows a template nothing shows a richer one no more."""
MATTERS = 0.1
"""A residual that is not white, but of smaller correlation, leaves a richer model 5 % of its size to explain."""
LEAVES_MUCH = 2.0
"""A model that leaves so many times the known noise is no reason not to look for dry friction, and no explanation with
it, or with a dead band."""
LEAVES_LESS = 0.9
"""A process that runs away and leaves white noise is likelier than a dead band where it leaves no more than that
share."""
SHARPEST = 100.0
"""Where the two highest powers of a model part beyond so many radians a sample, a record shows but one of them."""
_ROUGH, COARSE = 256, 512
_ROUNDS = 3
"""So often a dead band is looked for, each time beside the process that was learnt behind the last."""
_FIRST_LOOK = 12
"""So many evaluations tell which start is worth going on from."""


@dataclass(frozen=True)
class Found:
    """Models of a record, the best of them, and why it may not be used, if it may not."""

    models: tuple[IdentifiedModel, ...]
    best: IdentifiedModel
    refusal: str

    def behind(self, flaws: Flaws) -> Found:
        """The same of a process behind an actuator."""
        return self._each(lambda model: replace(model, flaws=flaws))

    def began(self, offset: float) -> Found:
        """The same from a stretch that began so long after the record [s]."""
        return self._each(lambda model: replace(model, offset=model.offset + offset)) if offset else self

    def _each(self, changed: Callable[[IdentifiedModel], IdentifiedModel]) -> Found:
        known = {id(model): changed(model) for model in (*self.models, self.best)}
        return Found(tuple(known[id(model)] for model in self.models), known[id(self.best)], self.refusal)


@dataclass(frozen=True)
class Search:
    """What is looked for in a record: with ``everything`` also what the structures asked for do not have."""

    structures: list[Structure]
    everything: bool
    noise: float
    disturbances: bool
    dead_band: bool
    unstable: bool

    def rough(self, record: Record) -> Fit:
        """Where it begins."""
        return rough_fit(record, _ROUGH, loads=self.disturbances)

    def of(self, record: Record, rough: Fit) -> Found:
        """Models of a record, from a rough one on; beside loads that wander where others are in doubt."""
        found = self._without_wandering(record, rough)
        at_length = self.everything and self.disturbances and self.unstable and self.dead_band
        return self._beside_wandering_loads(record, found) if at_length and _is_in_doubt(record, found) else found

    def _without_wandering(self, record: Record, rough: Fit) -> Found:
        models, noise = _models(record, rough, self.structures), self.noise
        if self.everything and _miss_something(record, models, noise):
            models += _models(record, rough, [structure_of(name) for name in RICHER])
        best = _preferred(models)
        if refusal_of(record, best, noise):
            usable = [model for model in _about_best(models, NEARLY) if not refusal_of(record, model, noise)]
            best = _preferred(tuple(usable) or models)
        if self.dead_band and (behind := self._behind_dead_band(record, best)):
            return self._held_instead(record, rough, behind) or behind
        runaways: tuple[IdentifiedModel, ...] = ()
        if self.everything and self.unstable and _may_run_away(record, best, noise):
            runaways = _models(record, rough, list(UNSTABLE_STRUCTURES.values()))
            best = _preferred(tuple(m for m in runaways if not refusal_of(record, m, noise)) or (best,))
        if self.disturbances:
            best = _in_any_noise(record, best, runaways, noise)
        refusal = refusal_of(record, best, noise)
        if refusal and runaways and _preferred(runaways).fit_pct > max(best.fit_pct, LEAST_FIT):
            best = _preferred(runaways)  # it tells more of what is amiss
            refusal = refusal_of(record, best, noise)
        if self.dead_band and (refusal or self._leaves_much(best)) and (freed := self._without_friction(record, best)):
            return freed
        return Found(models + runaways, best, refusal)

    def _held_instead(self, record: Record, rough: Fit, behind: Found) -> Found | None:
        """A process that runs away, where it leaves noise alone and a dead band more: play may pass for its loop."""
        best = behind.best
        explains_all = best.whiteness.white and not best.in_coloured_noise
        if not (self.everything and self.unstable) or explains_all or grows(record):
            return None
        runaways = _models(record, rough, list(UNSTABLE_STRUCTURES.values()))
        fit = [
            each
            for each in runaways
            if each.whiteness.white
            and each.noise < LEAVES_LESS * best.noise
            and not refusal_of(record, each, self.noise)
        ]
        return Found(behind.models + runaways, _preferred(tuple(fit)), "") if fit else None

    def _leaves_much(self, best: IdentifiedModel) -> bool:
        """Whether a model leaves more than the known noise."""
        return 0.0 < LEAVES_MUCH * self.noise < best.noise

    def _without_friction(self, record: Record, best: IdentifiedModel) -> Found | None:
        """The same without the dry friction that a record speaks for; None as for a dead band."""
        friction = friction_of(record, best.noise) if self.unstable else None
        if friction is None:
            return None
        flaws = Flaws(friction=friction)
        seen = flaws.of_record(record)
        found = replace(self, dead_band=False).of(seen, self.rough(seen)).behind(flaws)
        is_judged = record.excitation is not None and bool(record.excitation.any())  # by what an experiment has moved
        return None if found.refusal or (self._leaves_much(found.best) and not is_judged) else found

    def _beside_wandering_loads(self, record: Record, found: Found) -> Found:
        """A process beside loads that wander, where that explains some of what moved the loop from outside.

        Not where one that runs away explains more: its loop answers a load as one does whose load wanders.
        """
        best = beside_wandering_loads(record)
        if best is None or best.fit_pct <= 0.0 or _runs_away_instead(record, found, best):
            return found
        refusal = refusal_of(record, best, self.noise) or refusal_beside_the_setpoint(record, best)
        if refusal and not found.refusal:
            return found
        return Found((*found.models, best, *others_beside_wandering_loads(best)), best, refusal)

    def _behind_dead_band(self, record: Record, best: IdentifiedModel) -> Found | None:
        """The same behind the dead band that a record speaks for; None where it speaks for none, or that is no use.

        Beside the process that is learnt then, another may seem likelier. What leaves much more than the noise at rest
        is no explanation: a loop that holds a process that runs away, and a load, pass for an actuator that sticks.
        """
        found, linear = None, replace(self, dead_band=False)
        for _ in range(_ROUNDS):
            flaws = dead_band_of(record, best)
            if flaws is None:
                break
            seen = flaws.of_record(record)
            other = linear.of(seen, self.rough(seen)).behind(flaws)
            if found is not None and other.best.noise >= found.best.noise:
                break
            found, best = other, other.best
        return None if found is None or found.refusal or self._leaves_much(found.best) else found


def search_for(template: str, noise: float, disturbances: bool = True, unstable: bool = True) -> Search:
    """What `identify` looks for, as it was asked."""
    everything = template == "all"
    names = tuple(TEMPLATE_STRUCTURES) if everything else tuple(template.split(","))
    structures = [structure_of(name) for name in names]
    return Search(structures, everything, noise, disturbances, everything and disturbances, unstable)


def _is_in_doubt(record: Record, found: Found) -> bool:
    """Whether loads that wander may have passed for what was found: none, or in the place of noise something else.

    In normal operation they pass for lags, an actuator that sticks, or a process that runs away.
    """
    best = found.best
    if found.refusal or (best.structure.runs_away and best.in_coloured_noise):
        return True
    return record.excitation is None and best.whiteness.correlation > REMEMBERS


def _in_coloured_noise(
    record: Record, best: IdentifiedModel, noise: float, seen: FrequencyResponse | None = None
) -> IdentifiedModel:
    """The same structure, where an autoregression makes white what it leaves, and it explains enough; else the model.

    Only where the noise is so large that it matters, which it is to a process that runs away wherever that is not sure
    otherwise, and the record has even samples, not too many; and only what does not contradict what was ``seen``
    without a model.
    """
    found = best.fitted
    every = record.is_regular and found.rows.size == record.time.size
    matters = explains_little(best) or (best.structure.runs_away and bool(refusal_of(record, best, noise)))
    if not matters or not every:
        return best
    judges = validation_samples(found.rows.size)
    plain, white = fit_in_coloured_noise(found, np.ones_like(judges))
    if seen is not None and contradicts(seen, plain.process):
        return best
    trained, _ = fit_in_coloured_noise(found, ~judges)
    model = judged(plain, white, fit_pct(plain.response.measurement[judges], trained.residual[judges]), record.span)
    return model if model.whiteness.white and model.fit_pct >= LEAST_FIT_IN_NOISE else best


def _in_any_noise(
    record: Record, best: IdentifiedModel, runaways: tuple[IdentifiedModel, ...], noise: float
) -> IdentifiedModel:
    """The best in coloured noise, or one that runs away: noise of its own control may hide what holds it.

    Noise with memory, whose memory is learnt from what a model leaves, would explain any record by any process that
    runs away; what the record shows without a model tells them apart.
    """
    found = _in_coloured_noise(record, best, noise)
    if not runaways or not refusal_of(record, found, noise):
        return found
    seen, good = frequency_response(record), _about_best(runaways)
    for each in sorted(runaways, key=lambda model: (model not in good, len(model.parameters))):
        held = _in_coloured_noise(record, each, noise, seen)
        if held.in_coloured_noise and not refusal_of(record, held, noise):
            return held
    return found


def _runs_away_instead(record: Record, found: Found, wandering: IdentifiedModel) -> bool:
    """Whether one that runs away, in noise with memory, leaves surprises as small as loads that wander."""
    if not (record.is_regular and any(model.structure.runs_away for model in found.models)):
        return False
    fits = [model.fitted for model in found.models if model.structure.runs_away]
    whole = [each for each in fits if each.rows.size == record.time.size]
    errors = [fit_in_coloured_noise(each, np.ones_like(each.rows))[1].error for each in whole]
    return min(errors, default=math.inf) <= wandering.white.error


def _models(record: Record, rough: Fit, structures: list[Structure]) -> tuple[IdentifiedModel, ...]:
    coarse: list[Fit] = []
    models = []
    for structure in [each for each in structures if not each.runs_away]:
        begin = RecordResponse(record, structure, rough.response.start, COARSE)
        rows = ~validation_samples(begin.time.size)
        tried = [fit(begin, start, rows, _FIRST_LOOK, 1e-4) for start in initial_parameters(structure, rough, coarse)]
        chosen = min(tried, key=unstable_last)
        coarse.append(fit(begin, chosen.x, rows, 40, 1e-5))
        models.append(model_of(record, coarse[-1]))
    if any(each.runs_away for each in structures):
        starts = initial_conditions(record)
        unstable = runaway_fits(record, tuple(dict.fromkeys((starts[0], starts[-1]))))
        models += [model_of(record, each) for each in unstable if each.structure in structures]
    return tuple(models)


def unstable_last(found: Fit) -> tuple[bool, float]:
    """What fits are ordered by: stable ones before others, the best first."""
    return not process_stability(found.process).stable, found.error


def model_of(record: Record, coarse: Fit) -> IdentifiedModel:
    """Fitted without the samples held back, judged on them, and then fitted to all."""
    response = response_to(record, coarse.structure, coarse.response.start)
    judges = validation_samples(response.time.size)
    trained = fit(response, coarse.x, ~judges, 12, 1e-6)
    found = fit(response, trained.x, np.ones_like(judges), 3, 1e-6)
    return judged(found, found, fit_pct(response.measurement[judges], trained.residual[judges]), record.span)


def _may_run_away(record: Record, best: IdentifiedModel, noise: float) -> bool:
    """Whether a process with an unstable pole is to be looked for: where no other explains the record.

    Not where one leaves something: a prediction a sample ahead, by which unstable ones are fitted, flatters them.
    """
    return not grows(record) and bool(refusal_of(record, best, noise))


def _miss_something(record: Record, models: tuple[IdentifiedModel, ...], noise: float) -> bool:
    good = _about_best(models)
    matters = all(not m.whiteness.white and m.whiteness.correlation > MATTERS for m in good)
    explained = max(model.fit_pct for model in models)
    sound = explained >= GOOD_FIT and not refusal_of(record, _preferred(models), noise)
    return matters and explained < (BEST_FIT if sound else GOOD_FIT)


def _preferred(models: tuple[IdentifiedModel, ...]) -> IdentifiedModel:
    """The one with fewest numbers among those about as good as the best."""
    return min(_about_best(models), key=lambda model: len(model.parameters))


def _about_best(models: tuple[IdentifiedModel, ...], simpler: float = SIMPLER) -> list[IdentifiedModel]:
    shown = [model for model in models if _tells_its_powers_apart(model)] or models
    least = min(100.0 - model.fit_pct for model in shown)
    return [model for model in shown if 100.0 - model.fit_pct <= simpler * least]


def _tells_its_powers_apart(model: IdentifiedModel) -> bool:
    """Whether ``s^alpha + a1 s^beta`` changes from one to the other within what a record shows.

    With orders such as 1.06 and 1.004 it does so at 1e19 rad/s, and no response of it is known.
    """
    numbers = model.parameters
    if not {"a1", "alpha", "beta"} <= numbers.keys():
        return True
    apart = numbers["alpha"] - numbers["beta"]
    most = SHARPEST / model.fitted.response.sample_time
    return apart != 0.0 and math.log(numbers["a1"]) / apart <= math.log(most)
