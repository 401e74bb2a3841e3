"""Where the search begins: a rough look at two lags with delay everywhere, and at what the beginning may have been."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fopid_core.design.identification.fit import Fit, at, fit
from fopid_core.design.identification.load_steps import likeliest_load
from fopid_core.design.identification.quality import whiteness
from fopid_core.design.identification.record import Record, validation_samples
from fopid_core.design.identification.response import InitialCondition, RecordResponse
from fopid_core.design.identification.structure import Structure, structure_of
from fopid_core.model.arrays import Floats

_TIME_CONSTANTS, _DELAYS = 11, 9
_LOG_DAMPINGS = tuple(math.log(c) for c in (0.15, 0.9, 4.0))
_STILL = 10
"""So many samples before the control moves tell whether the process rested."""
_LONG = 0.05
"""A rest of such a share of the record is no slow beginning of a move."""
_INDEPENDENT = 32
"""So many samples of a rough fit count as independent when beginnings are compared that leave no white noise."""
_IMMATERIAL = 0.02
"""Differences of this share of the measurement's spread count as none."""
_NO_BETTER = 4.0
"""A beginning must be better by more than this to be taken in place of one that is preferred."""
_RAMP_COUNTS = 4
"""A ramp counts as so many numbers: it must take a quarter off the error, since a slow process looks like one."""
_LOADS, _LOAD_COUNTS = 2, 12
"""So many steps of a load are looked for at most, and each counts as so many numbers beside its size: it must halve
what is left, since a richer process may look like one."""
_NEAR_ZERO = 0.1
"""A measurement that begins within this share of its range from zero began at rest at zero, if at rest at all."""
_POLISH = 12


def initial_conditions(record: Record) -> tuple[InitialCondition, ...]:
    """Beginnings in the order of preference: at rest, at rest at zero, after a step, not at rest.

    A process that stands still for long until the control first moves rested with the control that it had: that it had
    been moved from zero just before would be a delay as long as that rest.
    """
    first = float(record.control[0])
    moved = np.flatnonzero(record.control != first)
    if not moved.size:
        return (InitialCondition(record.control_before or 0.0),)
    if record.control_before is not None:
        return (InitialCondition(record.control_before),)
    stands_still = _stands_still(record.measurement[: moved[0] + 1])
    if stands_still and moved[0] >= _LONG * record.time.size:
        return (InitialCondition(first),)
    at_rest = [InitialCondition(first)] if first == 0.0 else [InitialCondition(first), InitialCondition(0.0)]
    if abs(record.measurement[0]) <= _NEAR_ZERO * np.ptp(record.measurement):
        at_rest.reverse()
    if stands_still:
        return tuple(at_rest)
    return (*at_rest, InitialCondition(first, step=True), InitialCondition(first, step=True, free=True))


def _stands_still(measurement: Floats) -> bool:
    """Whether a stretch is long enough to tell, and its two halves differ no more than noise would make them."""
    half = measurement.size // 2
    if half < _STILL // 2:
        return False
    early, late = measurement[:half], measurement[half:]
    noise = math.hypot(float(np.std(early)), float(np.std(late))) / math.sqrt(half)
    return bool(abs(np.mean(late) - np.mean(early)) <= 3.0 * noise)


def rough_fit(record: Record, samples: int, *, loads: bool = True) -> Fit:
    """Two lags with delay, on at most so many samples, with the beginning that the record calls for.

    Where something is left that is not noise, the operating point may have moved as well, and loads may have come.

    The beginnings are compared with fractional orders allowed, so that no beginning makes up for a model too simple.
    """
    open_start = InitialCondition(float(record.control[0]), step=True, free=True)
    table = scan(RecordResponse(record, structure_of("soptd"), open_start, samples))
    starts = initial_conditions(record)
    lags = [_two_lags(record, start, table, samples) for start in starts]
    if not np.ptp(record.control):
        return lags[0]
    judged = [_with_fractional_orders(record, found, samples) for found in lags]
    if any(whiteness(found.residual).white for found in judged):
        in_noise = all(found.error > _immaterial(found) for found in judged)
        return lags[_preferred(judged, judged[0].residual.size if in_noise else _INDEPENDENT)]
    moving = [replace(start, ramp=True) for start in dict.fromkeys((starts[0], starts[-1]))]
    more = [_two_lags(record, start, table, samples) for start in moving]
    lags, judged = lags + more, judged + [_with_fractional_orders(record, found, samples) for found in more]
    likely = (starts[0], starts[-1], lags[_preferred(judged)].response.start)
    for start in dict.fromkeys(likely) if loads else ():
        first = next(k for k, found in enumerate(lags) if found.response.start == start)
        loaded = _with_loads(record, lags[first], judged[first], samples)
        lags, judged = lags + loaded[0], judged + loaded[1]
    return lags[_preferred(judged)]


def _preferred(judged: list[Fit], independent: int = _INDEPENDENT) -> int:
    """The first that is about as good as the best."""
    scores = np.array([_score(found, independent) for found in judged])
    return int(np.argmax(scores <= scores.min() + _NO_BETTER))


def _with_loads(record: Record, lags: Fit, judged: Fit, samples: int) -> tuple[list[Fit], list[Fit]]:
    """The same beginning and one load, two loads, ...: two lags, and what they are judged by."""
    found: tuple[list[Fit], list[Fit]] = ([], [])
    for _ in range(_LOADS):
        near = judged
        for _ in range(2):  # again beside the numbers that it was found to leave
            start = replace(judged.response.start, loads=(*judged.response.start.loads, likeliest_load(near)))
            response = RecordResponse(record, lags.structure, start, samples)
            loaded = fit(response, lags.x, lags.rows, 2 * _POLISH, 1e-3)
            better = _with_fractional_orders(record, loaded, samples)
            near = at(judged.response, better.x, judged.rows)
        if _score(better) > _score(judged) - _NO_BETTER:
            break
        lags, judged = loaded, better
        found[0].append(lags)
        found[1].append(judged)
    return found


def _two_lags(record: Record, start: InitialCondition, table: Table, samples: int) -> Fit:
    response = RecordResponse(record, structure_of("soptd"), start, samples)
    rows = ~validation_samples(response.time.size)
    tried = [fit(response, seed, rows, _POLISH, 1e-3) for seed in table.best(start)]
    return min(tried, key=lambda candidate: candidate.error)


def _with_fractional_orders(record: Record, lags: Fit, samples: int) -> Fit:
    response = RecordResponse(record, structure_of("nioptd2"), lags.response.start, samples)
    log_tau, log_c, delay = lags.x
    return fit(response, np.array([log_tau, log_c, 2.0, 1.0, delay]), lags.rows, _POLISH, 1e-3)


def _score(found: Fit, independent: int = _INDEPENDENT) -> float:
    """Schwarz's criterion, with differences that do not matter left out."""
    start = found.response.start
    count = found.response.free_columns + _RAMP_COUNTS * start.ramp + _LOAD_COUNTS * len(start.loads)
    return 2.0 * independent * math.log(math.hypot(found.error, _immaterial(found))) + count * math.log(independent)


def _immaterial(found: Fit) -> float:
    """What a model may leave of the measurement without its mattering."""
    return _IMMATERIAL * float(np.std(found.response.measurement)) + 1e-300


@dataclass(frozen=True)
class Table:
    """Scalar products of the signals of a rough look, for every point of a grid.

    ``seeds`` has shape (m, 3): log tau, log c, delay [s]. ``products`` has shape (m, 7, 7): of what the control does,
    of a step at the first instant, of two free responses, of offset and ramp and of the measurement.
    """

    seeds: Floats
    products: Floats
    first: float  # control

    def best(self, start: InitialCondition) -> list[Floats]:
        """The point of the grid that leaves least unexplained, and the best with at most half its delay."""
        explained = self._explained(start)
        first = int(np.argmax(explained))
        early = self.seeds[:, 2] <= 0.5 * self.seeds[first, 2]
        return [self.seeds[first], self.seeds[np.argmax(np.where(early, explained, -np.inf))]]

    def best_of_each_delay(self, start: InitialCondition) -> list[Floats]:
        """The point of the grid that leaves least unexplained at each delay; the best of these first."""
        explained, delays = self._explained(start), self.seeds[:, 2]
        best = [int(np.argmax(np.where(delays == delay, explained, -np.inf))) for delay in np.unique(delays)]
        return [self.seeds[k] for k in sorted(best, key=lambda k: -explained[k])]

    def _explained(self, start: InitialCondition) -> Floats:
        """Of the measurement's power, by each point of the grid, shape (m,)."""
        used = [0, 4] + [1] * start.step + [2, 3] * start.free + [5] * start.ramp
        change = np.eye(7)
        change[0, 1] = 0.0 if start.step else self.first - start.before
        products = change @ self.products @ change.T
        scale = np.sqrt(np.maximum(np.diagonal(products, axis1=1, axis2=2), 1e-300))
        products = products / (scale[:, :, None] * scale[:, None, :])
        inner = products[:, used][:, :, used] + 1e-9 * np.eye(len(used))
        right = products[:, used, 6]
        explained: Floats = np.sum(right * np.linalg.solve(inner, right[:, :, None])[:, :, 0], axis=1)
        return explained


def scan(response: RecordResponse) -> Table:
    """A look at two lags with every time constant, damping and delay of a grid."""
    step, span = float(response.time[1]), float(response.time[-1])
    delays = np.concatenate([[0.0], np.geomspace(step, 0.5 * span, _DELAYS - 1)])
    rows = ~validation_samples(response.time.size)
    common = np.stack([np.ones(rows.sum()), response.time[rows] / span, response.measurement[rows]])
    seeds, products = [], []
    for log_tau in np.linspace(math.log(0.5 * step), math.log(2.0 * span), _TIME_CONSTANTS).tolist():
        for log_c in _LOG_DAMPINGS:
            driven, stepped, free = response.scan(np.array([log_tau, log_c, 0.0]), delays)
            rest = np.broadcast_to(np.concatenate([free[:, rows], common]), (delays.size, 5, common.shape[1]))
            signals = np.concatenate([driven[:, None, rows], stepped[:, None, rows], rest], axis=1)
            products.append(signals @ signals.transpose(0, 2, 1))
            seeds += [(log_tau, log_c, delay) for delay in delays.tolist()]
    return Table(np.array(seeds), np.concatenate(products), response.start.before)


def initial_parameters(structure: Structure, rough: Fit, simpler: list[Fit]) -> list[Floats]:
    """Where to begin with a structure, from two lags and from simpler structures that were fitted before."""
    log_tau, log_c, delay = rough.x
    lag, rest = log_tau + max(log_c, math.log(1.5)), math.exp(log_tau - max(log_c, 0.0))
    known = {fitted.structure.name: fitted.x for fitted in simpler}
    if structure.name == "foptd":
        return [np.array([lag, delay + rest]), np.array([lag, delay])]
    if structure.name == "nioptd1":
        one = known.get("foptd", np.array([lag, delay + rest]))
        return [np.array([one[0], 1.0, one[1]]), np.array([log_tau, 1.4, delay]), np.array([lag, 0.8, delay])]
    if structure.name == "soptd":
        return [rough.x]
    if structure.name == "nioptd2":
        two = known.get("soptd", rough.x)
        starts = [np.array([two[0], two[1], 2.0, 1.0, two[2]]), np.array([log_tau, log_c, 1.6, 0.8, delay])]
        if "nioptd1" in known:
            one = known["nioptd1"]
            starts.append(np.array([one[0], math.log(0.1), one[1], 0.5 * one[1], one[2]]))
        return starts
    return _rational_initial_parameters(structure, rough)


def _rational_initial_parameters(structure: Structure, rough: Fit) -> list[Floats]:
    """Two lags slower or faster than the rough ones, and more beside them: of each damping and delay the best."""
    log_tau, log_c, delay = rough.x
    response = rough.response.of(structure)
    shifts, dampings = np.log([0.4, 1.0, 2.5]), (math.log(0.2), log_c, math.log(4.0))
    shares = np.log([0.05, 0.3, 1.0, 3.0]) if len(structure.sections) > 1 else np.zeros(1)
    others = (math.log(0.2), math.log(1.7)) if len(structure.sections) > 1 and structure.sections[1].damped else (0.0,)
    best: dict[tuple[float, float], tuple[float, Floats]] = {}
    for shift, damping, share, other, late in product(shifts, dampings, shares, others, (0.0, 1.0)):
        numbers: list[float] = []
        for number, section in enumerate(structure.sections):
            own = log_tau + shift + number * share
            numbers += [own, other if number else damping] if section.damped else [own]
        found = at(response, np.array([*numbers, late * delay]), rough.rows)
        if found.error < best.get((damping, late), (math.inf, found.x))[0]:
            best[damping, late] = found.error, found.x
    return [x for _, x in best.values()]
