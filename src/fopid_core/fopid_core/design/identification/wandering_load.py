"""A process beside loads that wander without end: what an ordinary day of a plant shows, with a few setpoint moves.

The control answers such loads, and a model that is to explain the measurement explains them by it. What the past of the
residual tells is taken out by a long autoregression, and only what is left, the surprises, counts: the prediction error
method, consistent in closed loop (Ljung 1999, ch. 13.4). Autoregression and process are fitted in turns (Clarke 1967);
since that can end anywhere, it begins at several delays, behind the autoregression of the measurement itself.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from fopid_core.design.identification.coloured_noise import LONG_ORDER, WhitenedResponse, behind, fit_in_turns, whitener
from fopid_core.design.identification.dead_band import HAS_PLAY, STICKS
from fopid_core.design.identification.excitation import ANSWERS, missed_in_surprises
from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.flaws import Flaws, slewed
from fopid_core.design.identification.identified_model import IdentifiedModel, judged
from fopid_core.design.identification.initial_estimates import initial_parameters, scan
from fopid_core.design.identification.rate_limit import NEARER, POSSIBLE, PROOF, RATES, SHORTER, SPEAKS
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition, RecordResponse
from fopid_core.design.identification.sampling import RARE
from fopid_core.design.identification.structure import Structure, structure_of
from fopid_core.model.arrays import Floats

MOST_SAMPLES = 1 << 15
"""Of longer records the part is looked at in which the setpoint moves most."""
CAUTION = 1.4
"""Standard deviations are so many times what the surprises say, since the autoregression is learnt with the process:
the root mean square error of 30 random days over the deviation without it."""
_STRUCTURE, _OTHERS = structure_of("soptd"), ("foptd", "nioptd1", "rational:2/1")
"""Of the process, and those that are looked at beside it."""
_LOOK = 1024
"""Blocks of samples of a first look."""
_STARTS, _MOST_ROUNDS, _EVALUATIONS = 5, 25, 6
"""Delays at which the search begins, and how long it goes on from each."""
_AGREE, _AS_LIKELY, _ALIKE, _FAR_LESS = 2, 5.0, 0.2, 100.0
"""From so many of these it must come to the same, within that of twice the logarithm of the likelihood, and within that
share of the response at the crossover; or all others must be less likely by so much. On days that were learnt rightly
it did from two or more of five; where it came to five different ends (a load that goes up and down regularly, next to
no noise), the nearest less likely by 31, the likeliest was wrong."""
SAMPLES_EACH, _HIGHEST_ORDER = 10, 128
"""So many samples for each number of the autoregression, and of these at most."""
_BANDS = {HAS_PLAY: np.geomspace(0.01, 0.5, 20), STICKS: np.geomspace(0.01, 0.5, 40)}
"""Dead bands of the actuator that are looked for, as shares of the control's range in the record."""
_SPEAKS = 5.0
"""Twice the logarithm of the likelihood grows by so much with one that is there, and by 1.4 at most without, in random
days: taken for true at less than elsewhere, since a gain that is too large is the safer one."""
_GLANCE, _LOOKS = 2, 12
"""So many evaluations tell one from another, and limits on the actuator's moves, beside which the delay changes."""


def beside_wandering_loads(record: Record, *, dead_band: bool = True) -> IdentifiedModel | None:
    """Two lags and a delay; None where nothing is known to have moved the loop, or each search ends elsewhere.

    Parameters
    ----------
    record : Record
        In closed loop. Uneven samples are interpolated.
    dead_band : bool
        Whether an actuator that sticks or has play is looked for: small moves that it swallows would make a gain that
        is too small.

    Examples
    --------
    >>> from scipy.signal import lfilter
    >>> rng, time = np.random.default_rng(0), np.arange(3000.0)
    >>> control = np.repeat(rng.integers(0, 2, 30), 100).astype(float)
    >>> wandering, noise = np.cumsum(0.02 * rng.standard_normal(3000)), 0.01 * rng.standard_normal(3000)
    >>> measurement = lfilter([0.0, 0.1], [1.0, -0.9], control + wandering) + noise
    >>> found = beside_wandering_loads(Record(time, control, measurement, setpoint=control))
    >>> bool(abs(found.process.steady_state_gain - 1.0) < 0.1)
    True
    """
    even = _of_interest(record)
    if even.instrument is None or even.time.size < SAMPLES_EACH * LONG_ORDER:
        return None
    begin = whitener(even.measurement - even.measurement.mean(), LONG_ORDER)
    ends = [_turns(even, x, begin) for x in _first_looks(even, begin)]
    plain, white = min(ends, key=lambda found: found[1].error)
    s = np.array([1j * judged(plain, white, 0.0, even.span).crossover])
    same = [
        _likelier(other, white) <= _AS_LIKELY and abs(found.process(s) / plain.process(s) - 1.0)[0] <= _ALIKE
        for found, other in ends
    ]
    others = [_likelier(other, white) for (_, other), alike in zip(ends, same, strict=True) if not alike]
    if sum(same) < _AGREE and min(others, default=0.0) < _FAR_LESS:
        return None
    plain, white = _of_higher_order(even, plain, white)
    flaws = Flaws()
    if dead_band and (freed := _behind_dead_band(even, plain, white)):
        flaws, plain, white = freed
    return _model(even, plain, white, flaws, float(even.time[0] - record.time[0]))


def slow_beside_wandering_loads(record: Record, learnt: IdentifiedModel) -> IdentifiedModel | None:
    """The same behind a limit on the actuator's moves, where the surprises speak for one; else None.

    It is the smallest limit about as likely as the best, which is the safe side. Not beside an actuator that sticks or
    has play: what its dead band leaves unexplained looks a little like a limit, and the process would come out faster.

    Parameters
    ----------
    record : Record
    learnt : IdentifiedModel
        From it, or from a part of it, beside loads that wander.
    """
    if learnt.flaws.dead_band:
        return None
    even, plain, white = _of_interest(record), learnt.fitted, learnt.white
    if not np.array_equal(white.response.record.control, even.control):
        plain, white = _turns(even, plain.x, _whitening(white))
    moved = float(np.ptp(even.control))
    fastest = float(np.abs(np.diff(even.control)).max()) / even.sample_time
    begins = [np.append(plain.x[:-1], share * plain.x[-1]) for share in SHORTER]

    def tried(rates: Floats) -> dict[float, Fit]:
        rates = rates[rates < fastest]
        return {
            rate: min((_behind_filter(white, replace(even, control=felt), x, _LOOKS) for x in begins), key=_by_error)
            for rate, felt in zip(rates.tolist(), slewed(even.time, even.control, rates), strict=True)
        }

    looks = tried(moved / np.geomspace(even.sample_time, 0.25 * even.span, RATES))
    if not looks or max(_likelier(white, one) for one in looks.values()) < SPEAKS:
        return None
    looks |= tried(min(looks, key=lambda rate: looks[rate].error) * NEARER)
    best = min(looks.values(), key=_by_error)
    slowest = min(rate for rate, one in looks.items() if _likelier(one, best) <= POSSIBLE)
    found = _turns(Flaws(rate=slowest).of_record(even), looks[slowest].x, _whitening(white))
    if _likelier(white, found[1]) < PROOF:
        return None
    return _model(even, *found, Flaws(rate=slowest), learnt.offset)


def others_beside_wandering_loads(learnt: IdentifiedModel) -> tuple[IdentifiedModel, ...]:
    """Models of other structures that a record beside wandering loads bears about as well as the learnt one.

    Two lags may stand for one lag and a longer delay, and fall faster beyond what the record shows.

    Parameters
    ----------
    learnt : IdentifiedModel
        Beside loads that wander.
    """
    record, plain, white = learnt.fitted.response.record, learnt.fitted, learnt.white
    rare = chdtri(white.x.size, RARE)
    found = []
    for structure in map(structure_of, _OTHERS):
        begins = initial_parameters(structure, plain, [])
        looks = [_behind_filter(white, record, x, _LOOKS, structure) for x in begins]
        other = _turns(record, min(looks, key=_by_error).x, _whitening(white), structure)
        if _likelier(other[1], white) <= rare:
            found.append(_model(record, *other, learnt.flaws, learnt.offset))
    return tuple(found)


def _model(even: Record, plain: Fit, white: Fit, flaws: Flaws, offset: float) -> IdentifiedModel:
    model = judged(plain, white, 0.0, even.span, CAUTION)
    assert even.instrument is not None
    missed = missed_in_surprises(even, white.residual, _whitening(white), even.instrument, ANSWERS / model.crossover)
    explained = 100.0 * (1.0 - missed)
    return replace(model, fit_pct=explained, noise=white.error, flaws=flaws, wanders=True, offset=offset)


def _by_error(found: Fit) -> float:
    return found.error


def _behind_filter(white: Fit, seen: Record, x: Floats, evaluations: int, structure: Structure | None = None) -> Fit:
    """A process fitted anew to what an actuator makes of the control, behind the filter that there is."""
    response = white.response
    filtered = WhitenedResponse(seen, structure or response.structure, response.start, _whitening(white), MOST_SAMPLES)
    return fit(filtered, x, white.rows, evaluations)


def _whitening(white: Fit) -> Floats:
    assert isinstance(white.response, WhitenedResponse)
    return white.response.whitening


def _likelier(before: Fit, after: Fit) -> float:
    """By how much twice the logarithm of the likelihood grows, of fits whose residuals are white."""
    return 2.0 * after.residual.size * math.log(max(before.error, 1e-300) / max(after.error, 1e-300))


def _turns(record: Record, x: Floats, whitening: Floats, structure: Structure = _STRUCTURE) -> tuple[Fit, Fit]:
    start = InitialCondition(float(record.control[0]), step=True)
    response = RecordResponse(record, structure, start, MOST_SAMPLES)
    rows = np.ones(record.time.size, dtype=bool)
    return fit_in_turns(WhitenedResponse, response, x, whitening, rows, _MOST_ROUNDS, _EVALUATIONS)


def _of_higher_order(record: Record, plain: Fit, white: Fit) -> tuple[Fit, Fit]:
    """With an autoregression twice as long, and so on, as long as that pays (Akaike 1974).

    Of a long record a short one would pull at the process by more than chance does.
    """
    order = _whitening(white).size - 1
    while order < _HIGHEST_ORDER and 2 * order * SAMPLES_EACH <= record.time.size:
        longer = _turns(record, plain.x, whitener(plain.residual - plain.residual.mean(), 2 * order))
        if _likelier(white, longer[1]) < 2.0 * order:
            break
        (plain, white), order = longer, 2 * order
    return plain, white


def _behind_dead_band(record: Record, plain: Fit, white: Fit) -> tuple[Flaws, Fit, Fit] | None:
    """The dead band that the surprises speak for, and the process behind it; None where they do not."""
    shares = np.concatenate(list(_BANDS.values()))
    slips = np.repeat(list(_BANDS), [sizes.size for sizes in _BANDS.values()])
    sizes = float(np.ptp(record.control)) * shares
    every = Flaws(dead_band=sizes, slip=slips).felt(record.control)
    errors = [_behind_filter(white, replace(record, control=felt), white.x, _GLANCE).error for felt in every]
    best = int(np.argmin(errors))
    flaws = Flaws(dead_band=float(sizes[best]), slip=float(slips[best]))
    found = _turns(flaws.of_record(record), plain.x, _whitening(white))
    return (flaws, *found) if _likelier(white, found[1]) >= _SPEAKS else None


def _first_looks(record: Record, whitening: Floats) -> list[Floats]:
    """Two lags at some delays, the best first, by what little of the signals is left behind a filter."""
    control, measurement = behind(
        whitening, np.stack([record.control - record.control[0], record.measurement - record.measurement[0]])
    )
    left = Record(record.time[whitening.size - 1 :], control, measurement)
    start = InitialCondition(0.0)
    return scan(RecordResponse(left, _STRUCTURE, start, _LOOK)).best_of_each_delay(start)[:_STARTS]


def _of_interest(record: Record) -> Record:
    """With even samples, and no more than can be looked at."""
    if record.time.size > MOST_SAMPLES and record.instrument is not None:
        moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(record.instrument)))])
        within = moved[MOST_SAMPLES - 1 :] - moved[: moved.size - MOST_SAMPLES + 1]
        first = int(np.argmax(within))
        record = record.part(float(record.time[first]), float(record.time[first + MOST_SAMPLES - 1]))
    return record.evenly(MOST_SAMPLES)
