"""The process learnt from its own signals: the one door for records of every origin.

A structure's response to the recorded control is fitted to the measurement (output error, a prediction error method:
Ljung 1999, ch. 7). With noise that is white, and a control that answers it a sample later, that is consistent in
closed loop as well.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fopid_core.design.defaults import PHASE_MARGIN, gain_sign, natural_crossover
from fopid_core.design.identification.coloured_noise import fit_in_coloured_noise
from fopid_core.design.identification.excitation import LEAST_SHARE, MOST_MISSED, external_share, missed_share
from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.initial_estimates import initial_conditions, initial_parameters, rough_fit
from fopid_core.design.identification.quality import (
    Whiteness,
    covariance,
    fit_pct,
    parameter_covariance,
    relative_deviation,
    whiteness,
)
from fopid_core.design.identification.record import Record, validation_samples
from fopid_core.design.identification.response import InitialCondition, RecordResponse
from fopid_core.design.identification.runaway import response_to, runaway_fits
from fopid_core.design.identification.sampling import sampled_processes
from fopid_core.design.identification.structure import (
    TEMPLATE_STRUCTURES,
    UNSTABLE_STRUCTURES,
    Structure,
    structure_of,
)
from fopid_core.design.specification import Clock
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability

SIMPLER = 1.01
"""A model with fewer numbers is preferred while its held-back error is at most so many times the smallest."""
LEAST_FIT = 80.0
"""Below this fit [%] the control explains too little of the measurement, unless the rest is white noise."""
NOISES, MISSED_IN_NOISE, LEAST_FIT_IN_NOISE = 1.5, 0.1, 50.0
"""Unless it leaves no more than so many times the noise that was measured at rest, or misses no more than that share of
what an experiment has moved, and still explains so much [%]."""
MOST_DEVIATION = 0.25
"""Largest standard deviation of the model at its natural crossover, as a share of its size."""
MOST_UNSURE = 0.3
"""Largest standard deviation of an unstable pole, as a share of it."""
SHORTEST = 3.0
"""A record must last at least this over the natural crossover [rad]."""
UNSEEN_END = 60.0
"""A record that would have to be so many times longer shows no crossover."""
FASTEST = 0.5
"""A controller is not taken to work faster than this over the sample time [rad]."""
SLOWER = 0.7
"""Where the process is not known well enough, a controller that is so many times as fast is looked at."""
RICHER = ("rational:4", "rational:3/1")
GOOD_FIT, BEST_FIT = 98.0, 99.9
"""Where the templates fit worse than this [%] and leave a residual whose correlation matters, these are tried too; up
to the second where the best template may be used: a record that shows a template nothing shows a richer one no more."""
MATTERS = 0.1
"""A residual that is not white, but of smaller correlation, leaves a richer model 5 % of its size to explain."""
_ROUGH, _COARSE = 256, 512
_FIRST_LOOK = 12
"""So many evaluations tell which start is worth going on from."""
_STILL = 0.05
_GAP = 0.05
"""A gap of this share of the record is named where the control explains too little."""
_FEEDBACK = (
    "the control only answers the measurement, so the record shows the controller and not the process: "
    "move the setpoint, or add a step or a PRBS to the control"
)
_LARGER = "experiment longer, or with larger moves of the control"
_STABILISE = "stabilise the process first and record it in closed loop"


@dataclass(frozen=True)
class IdentifiedModel:
    """A learnt process.

    Attributes
    ----------
    template : str
    process : Process
    parameters, deviations : mapping
        By name, and their standard deviations.
    parameter_covariance : ndarray, shape (k, k)
        Of them, in their order.
    fit_pct : float
        On held-back samples, with the model fitted to the others: 100 (1 - |y - model| / |y - mean y|) [%].
    whiteness : Whiteness
        Of the residual.
    noise : float
        Standard deviation of the residual, in units of the measurement.
    crossover, deviation : float
        About where a controller would work [rad/s], and the standard deviation of the process there, as a share of
        its size.
    """

    template: str
    process: Process
    parameters: Mapping[str, float]
    deviations: Mapping[str, float]
    parameter_covariance: Floats = field(repr=False, compare=False)
    fit_pct: float
    whiteness: Whiteness
    noise: float
    crossover: float
    deviation: float
    _fit: Fit = field(repr=False, compare=False)
    _white: Fit = field(repr=False, compare=False)
    _covariance: Floats = field(repr=False, compare=False)
    _drawn: dict[tuple[int, int], tuple[Process, ...]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def structure(self) -> Structure:
        """What was fitted."""
        return self._fit.structure

    @property
    def start(self) -> InitialCondition:
        """What was taken for unknown about the beginning."""
        return self._fit.response.start

    @property
    def ramp(self) -> float:
        """How fast the operating point moved in the record [1/s]; 0 where nothing spoke for that."""
        return self._fit.ramp

    @property
    def loads(self) -> tuple[float, ...]:
        """When steps of a load came [s after the first instant], where something spoke for that."""
        return self._fit.response.start.loads

    @property
    def in_coloured_noise(self) -> bool:
        """Whether the noise has memory, and was made white for the fit."""
        return self._white is not self._fit

    @property
    def fitted(self) -> Fit:
        """The fit itself."""
        return self._fit

    @property
    def numbers(self) -> Floats:
        """The structure's free numbers."""
        return self._fit.x

    @property
    def gains(self) -> Floats:
        """The structure's linear numbers."""
        return self._fit.gains

    @property
    def first_deviation(self) -> float:
        """Standard deviation of the first free number: of one that runs away, that of its time, as a share of it."""
        return math.sqrt(float(self._covariance[0, 0]))

    @property
    def simulated(self) -> tuple[Floats, Floats, Floats]:
        """Instants [s], the measurement there, and what the model makes of the control; of long records averages."""
        measured = self._fit.response.measurement  # of one that runs away the prediction, a sample ahead
        return self._fit.response.time, measured, measured - self._fit.residual

    @property
    def slopes(self) -> Floats:
        """Derivatives of what the model makes of the control with respect to its numbers, at ``simulated``, (n, k)."""
        return self._fit.sensitivity

    def moved(self, moves: Floats) -> Process:
        """The process with its numbers moved by these, in the order of ``slopes``, as far as their ranges allow."""
        found, count = self._fit, self._fit.x.size
        low, high = found.structure.bounds(found.response.sample_time, float(found.response.time[-1]))
        gains = found.gains + moves[count : count + found.gains.size]
        return found.structure.process(np.clip(found.x + moves[:count], low, high), gains)

    def sample(self, count: int, seed: int = 0) -> tuple[Process, ...]:
        """Processes that the record cannot tell from this one: drawn from the covariance, and held to the record."""
        if (count, seed) not in self._drawn:  # every design that is verified asks for the same
            self._drawn[count, seed] = sampled_processes(self._white, self._covariance, count, seed)
        return self._drawn[count, seed]


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


def identify(
    record: Record, template: str = "all", clock: Clock = time.perf_counter, noise: float = 0.0, *,
    disturbances: bool = True, unstable: bool = True,
) -> IdentificationResult:  # fmt: skip
    """Fit models to a record and judge them.

    Parameters
    ----------
    record : Record
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
        Whether ``all`` looks for processes that run away, where nothing else explains the record.

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
    begun = clock()
    names = tuple(TEMPLATE_STRUCTURES) if template == "all" else tuple(template.split(","))
    structures = [structure_of(name) for name in names]
    refusal = _refusal_before(record)
    if refusal:
        return IdentificationResult(False, refusal, (), None, clock() - begun)
    rough = rough_fit(record, _ROUGH, loads=disturbances)
    if external_share(record, rough.response.start) < LEAST_SHARE:
        return IdentificationResult(False, _FEEDBACK, (), None, clock() - begun)
    models = _models(record, rough, structures)
    if template == "all" and _miss_something(record, models, noise):
        models += _models(record, rough, [structure_of(name) for name in RICHER])
    best = _preferred(models)
    runaways: tuple[IdentifiedModel, ...] = ()
    if unstable and template == "all" and _may_run_away(record, best, noise):
        runaways = _models(record, rough, list(UNSTABLE_STRUCTURES.values()))
        models += runaways
        best = _preferred(tuple(m for m in runaways if not _refusal(record, m, noise)) or (best,))
    if disturbances:
        best = _in_coloured_noise(record, best)
        if runaways and _refusal(record, best, noise):  # last of all: noise of its own control may hide what holds it
            noisy = _in_coloured_noise(record, _preferred(runaways))
            best = best if _refusal(record, noisy, noise) else noisy
    refusal = _refusal(record, best, noise)
    if refusal and runaways and _preferred(runaways).fit_pct > max(best.fit_pct, LEAST_FIT):
        best = _preferred(runaways)  # it tells more of what is amiss
        refusal = _refusal(record, best, noise)
    return IdentificationResult(not refusal, refusal or _told(best), models, best, clock() - begun)


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
    response = response_to(record, model.structure, start, _COARSE)
    rows = ~validation_samples(response.time.size)
    best = _model(record, min((fit(response, begin, rows, 40, 1e-5) for begin in begins), key=_unstable_last))
    refusal = _refusal(record, best, 0.0)
    return IdentificationResult(not refusal, refusal or _told(best), (best,), best, time.perf_counter() - begun)


def _told(best: IdentifiedModel) -> str:
    told = f"{best.template} explains {best.fit_pct:.2f} % of the measurement on held-back samples"
    beside = [f"a drift of {best.ramp:.3g} per second"] * bool(best.ramp)
    beside += [f"a load that came after {instant:.3g} s" for instant in best.loads]
    told = f"{told}, beside {' and '.join(beside)} that was taken out" if beside else told
    return f"{told}; the noise has memory" if best.in_coloured_noise else told


def _explains_little(best: IdentifiedModel) -> bool:
    return best.fit_pct < LEAST_FIT and not best.whiteness.white


def _in_coloured_noise(record: Record, best: IdentifiedModel) -> IdentifiedModel:
    """The same structure, where an autoregression makes white what it leaves, and it explains enough; else the model.

    Only where the noise is so large that it matters, and the record has even samples, not too many.
    """
    found = best.fitted
    every = record.is_regular and found.rows.size == record.time.size
    if not _explains_little(best) or not every:
        return best
    judges = validation_samples(found.rows.size)
    trained, _ = fit_in_coloured_noise(record, found, ~judges)
    plain, white = fit_in_coloured_noise(record, found, np.ones_like(judges))
    model = _judged(plain, white, fit_pct(plain.response.measurement[judges], trained.residual[judges]), record.span)
    return model if model.whiteness.white and model.fit_pct >= LEAST_FIT_IN_NOISE else best


def _models(record: Record, rough: Fit, structures: list[Structure]) -> tuple[IdentifiedModel, ...]:
    coarse: list[Fit] = []
    models = []
    for structure in [each for each in structures if not each.runs_away]:
        begin = RecordResponse(record, structure, rough.response.start, _COARSE)
        rows = ~validation_samples(begin.time.size)
        tried = [fit(begin, start, rows, _FIRST_LOOK, 1e-4) for start in initial_parameters(structure, rough, coarse)]
        chosen = min(tried, key=_unstable_last)
        coarse.append(fit(begin, chosen.x, rows, 40, 1e-5))
        models.append(_model(record, coarse[-1]))
    if any(each.runs_away for each in structures):
        starts = initial_conditions(record)
        unstable = runaway_fits(record, tuple(dict.fromkeys((starts[0], starts[-1]))))
        models += [_model(record, each) for each in unstable if each.structure in structures]
    return tuple(models)


def _unstable_last(found: Fit) -> tuple[bool, float]:
    return not process_stability(found.process).stable, found.error


def _model(record: Record, coarse: Fit) -> IdentifiedModel:
    """Fitted without the samples held back, judged on them, and then fitted to all."""
    response = response_to(record, coarse.structure, coarse.response.start)
    judges = validation_samples(response.time.size)
    trained = fit(response, coarse.x, ~judges, 12, 1e-6)
    found = fit(response, trained.x, np.ones_like(judges), 3, 1e-6)
    return _judged(found, found, fit_pct(response.measurement[judges], trained.residual[judges]), record.span)


def _may_run_away(record: Record, best: IdentifiedModel, noise: float) -> bool:
    """Whether a process with an unstable pole is to be looked for: where no other explains the record.

    Not where one leaves something: a prediction a sample ahead, by which unstable ones are fitted, flatters them.
    """
    return not _grows(record) and bool(_refusal(record, best, noise))


def _judged(found: Fit, white: Fit, explained: float, span: float) -> IdentifiedModel:
    """What a fit says, with the covariance that it has where its residual is white."""
    spread = covariance(white)
    crossover, deviation = _crossover(found, spread, span)
    parameters, named = found.structure.parameters(found.x, found.gains), parameter_covariance(found, spread)
    return IdentifiedModel(
        template=found.structure.name,
        process=found.process,
        parameters=parameters,
        deviations=dict(zip(parameters, np.sqrt(np.maximum(np.diag(named), 0.0)).tolist(), strict=True)),
        parameter_covariance=named,
        fit_pct=explained,
        whiteness=whiteness(white.residual[white.rows]),
        noise=found.error / found.response.level(found.x),
        crossover=crossover,
        deviation=deviation,
        _fit=found,
        _white=white,
        _covariance=spread,
    )


def _miss_something(record: Record, models: tuple[IdentifiedModel, ...], noise: float) -> bool:
    good = _about_best(models)
    matters = all(not m.whiteness.white and m.whiteness.correlation > MATTERS for m in good)
    explained = max(model.fit_pct for model in models)
    sound = explained >= GOOD_FIT and not _refusal(record, _preferred(models), noise)
    return matters and explained < (BEST_FIT if sound else GOOD_FIT)


def _crossover(found: Fit, spread: Floats, span: float) -> tuple[float, float]:
    """Where a controller would work [rad/s], and the relative deviation there.

    The natural crossover, or what is slower and known well enough, if the record is long enough to show it.
    """
    limit = FASTEST / found.response.sample_time
    fastest = min(natural_crossover(found.process, PHASE_MARGIN), limit)
    if fastest * span < SHORTEST and _hardly_lags(found.process, fastest, limit):
        fastest = limit  # an integrator in all but name: its own corner is nowhere in the record
    steps = max(math.log(fastest * span / SHORTEST) / -math.log(SLOWER), 11.0)
    tried = fastest * SLOWER ** np.arange(int(steps) + 1)
    tried = tried[(tried * span >= SHORTEST) | (tried == fastest)]
    deviation = [relative_deviation(found, spread, w) for w in tried.tolist()]
    known = [i for i, value in enumerate(deviation) if value <= MOST_DEVIATION]
    chosen = known[0] if known else 0
    return float(tried[chosen]), deviation[chosen]


def _hardly_lags(process: Process, low: float, high: float) -> bool:
    """Whether its phase leaves the usual margin at every frequency between these [rad/s]: it sets no speed."""
    angle = np.angle(gain_sign(process) * process(1j * np.geomspace(low, max(high, low), 200)))
    return bool(np.all((angle > PHASE_MARGIN - math.pi) & (angle < 0.0)))


def _preferred(models: tuple[IdentifiedModel, ...]) -> IdentifiedModel:
    """The one with fewest numbers among those about as good as the best."""
    return min(_about_best(models), key=lambda model: len(model.parameters))


def _about_best(models: tuple[IdentifiedModel, ...]) -> list[IdentifiedModel]:
    least = min(100.0 - model.fit_pct for model in models)
    return [model for model in models if 100.0 - model.fit_pct <= SIMPLER * least]


def _refusal_before(record: Record) -> str:
    """Why nothing can be learnt, from the signals alone."""
    control, measurement = record.control, record.measurement
    if np.ptp(measurement) == 0.0:
        return f"the measurement stays at {measurement[0]:g}: move the control until it answers"
    if np.ptp(control) > 0.0 or record.control_before not in (None, control[0]):
        return ""
    begins_at_rest = abs(measurement[0]) <= _STILL * np.ptp(measurement)
    if record.control_before is None and control[0] != 0.0 and begins_at_rest:
        return ""
    return (
        f"the control stays at {control[0]:g} (saturated throughout?), so the record does not show what it does: "
        "move it in steps within its limits, or say what it was before the record"
    )


def _refusal(record: Record, best: IdentifiedModel, noise: float) -> str:
    """Why the best model may not be used."""
    missed = _missed(record, best)
    if missed == math.inf:
        return f"disturbances have moved the measurement more than the experiment has: {_LARGER}"
    if missed > MOST_MISSED:
        return f"the model misses {min(100.0 * missed, 100.0):.0f} % of what the experiment has moved: {_LARGER}"
    known_rest = best.noise <= NOISES * noise or missed < MISSED_IN_NOISE
    if _explains_little(best) and (not known_rest or best.fit_pct < LEAST_FIT_IN_NOISE):
        return f"the control explains only {max(best.fit_pct, 0.0):.0f} % of the measurement: {_advice(record)}"
    if not process_stability(best.process).stable:
        if not best.structure.runs_away or _grows(record):
            return f"the model that fits best is unstable: {_STABILISE}"
        if not _is_unstable_for_sure(best, noise):
            return (
                "the loop may hold a process that runs away, but what disturbs it hides how fast: "
                f"{_LARGER}, and without disturbances"
            )
    runs_away = f"; if it runs away, {_STABILISE}" if _grows(record) else ""
    needed = SHORTEST / best.crossover
    if needed > UNSEEN_END * record.span:
        return f"the record shows no end of what the process does: {_LARGER}{runs_away}"
    if needed > record.span:
        return (
            f"too short: {record.span:.3g} s of a process that a controller would move at {best.crossover:.3g} rad/s; "
            f"record at least {needed:.3g} s{runs_away}"
        )
    if not best.deviation <= MOST_DEVIATION:
        return (
            f"too little information: the process is uncertain by {100.0 * best.deviation:.0f} % where a controller "
            f"would work; record longer, with larger moves of the control, or with a PRBS experiment{runs_away}"
        )
    return ""


def _is_unstable_for_sure(best: IdentifiedModel, noise: float) -> bool:
    """Whether the unstable pole stands out of the noise, and what is left is noise: its predictor hides loads."""
    known = best.first_deviation <= MOST_UNSURE
    return known and (best.whiteness.white or best.noise <= NOISES * noise or best.fit_pct >= GOOD_FIT)


def _missed(record: Record, best: IdentifiedModel) -> float:
    """Of what an experiment has moved, the share that the model misses; NaN where none is known."""
    if record.excitation is None or not record.excitation.any():
        return math.nan
    time, measurement, explained = best.simulated
    return missed_share(record, time, measurement, measurement - explained)


def _advice(record: Record) -> str:
    if _grows(record):
        return f"it runs away; {_STABILISE}"
    gaps = np.diff(record.time)
    longest = int(np.argmax(gaps))
    if gaps[longest] > max(_GAP * record.span, 10.0 * np.median(gaps)):
        first, last = record.time[longest : longest + 2] - record.time[0]
        return (
            f"there are no samples from {first:.4g} to {last:.4g} s after the first; use what is before or after that"
        )
    return "look for disturbances, a sensor that sticks or a wrong pair of signals, and move the control more"


def _grows(record: Record) -> bool:
    """Whether the measurement ends far from where it was for most of the record."""
    size = np.abs(record.measurement - record.measurement[0])
    tenth = size.size // 10
    return bool(size[-tenth:].mean() > 3.0 * size[:-tenth].mean())
