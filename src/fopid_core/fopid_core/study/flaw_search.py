"""A process learnt from a record with what is not linear in it.

A linear model's covariance knows nothing of these. Each is looked for where it would show: in what the learnt model
leaves of the measurement, beside all that small changes of its numbers could explain, both made white. What speaks for
itself clearly is taken into the process, as large as the record says, within what it leaves possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve, lfilter

from fopid_core.design.identification.identify import IdentificationResult, IdentifiedModel, identify
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.study.flaws import Flaws

SIZES = 60
"""So many dead bands are tried, and limits on either side."""
_ANY, _NEAR = (0.002, 0.25), (0.6, 1.6)
"""Smallest and largest dead band: of the control's range, and of one that was found."""
PROOF = 18.0
"""Twice the logarithm of the likelihood grows by so much with a flaw: by chance, over all that are tried, rarely."""
_ORDER = 6
"""Of the autoregression that makes a residual white."""
_ROUNDS, _ROUNDING = 4, 1e-18
_USUAL_BEND = 0.3
"""By how much of itself a bent characteristic is usually off a straight one at the ends of the record."""
_LOADS, _STARTS = 4, 200
"""Steps of a load that are looked for at most, and at how many instants."""


@dataclass(frozen=True)
class Learnt:
    """A process with its flaws.

    Attributes
    ----------
    identified : IdentificationResult
        Of the linear part.
    flaws : Flaws
    possible : tuple of Flaws
        Those, and as many as asked for that the record leaves possible.
    beside : tuple of Process
        The linear part that goes with each of them: a longer dead band with less delay.
    linear : Record
        What the linear part was learnt from: without flaws and loads.
    """

    identified: IdentificationResult
    flaws: Flaws
    possible: tuple[Flaws, ...]
    beside: tuple[Process, ...]
    linear: Record


def learn(record: Record, template: str, count: int, seed: int) -> Learnt:
    """The process and its flaws, from an evenly spaced record, and ``count`` draws of flaws that it leaves possible."""
    flaws, loads = Flaws(centre=float(np.mean(record.measurement))), Loads()
    first = identify(record, template)
    if not first.success or first.best is None:
        return Learnt(first, flaws, (), (), record)
    fitted = _Fitted.of(record, first, template)
    for _ in range(_ROUNDS):
        search = _Search(record, fitted, flaws, loads)
        better = search.best()
        if better == flaws and search.loads.starts == loads.starts:
            break
        bare = better.of_record(record)
        bare = replace(bare, measurement=bare.measurement - search.of_loads(better))
        found = identify(bare, template)
        if found.best is None:
            break
        fitted, flaws, loads = _Fitted.of(bare, found, template), better, search.loads_of(better)
    if not fitted.identified.success:
        told = f"what a process of two lags and a delay leaves of the record is no noise: {fitted.identified.message}"
        return Learnt(replace(first, success=False, message=told), flaws, (), (), record)
    search = _Search(record, fitted, flaws, loads)
    possible = search.draws(count, seed)
    beside = tuple(search.process_beside(one) for one in possible)
    return Learnt(fitted.identified, flaws, (flaws, *possible), (fitted.best.process, *beside), fitted.record)


@dataclass(frozen=True)
class _Fitted:
    """A process learnt from a record whose residual was made white.

    Of a residual with memory, least squares make more than it says, and loads that come and stay pull at the model.
    A filter of both signals leaves a linear process as it is: generalised least squares (Clarke 1967).
    """

    identified: IdentificationResult
    record: Record
    whitener: Floats

    @staticmethod
    def of(record: Record, found: IdentificationResult, template: str) -> _Fitted:
        """The fit found to a record, or one to the filtered record where its residual has memory."""
        whitener, filtered = np.ones(1), record
        for _ in range(2):
            if found.best is None or found.best.whiteness.white:
                break
            _, measured, modelled = found.best.simulated
            whitener = np.convolve(whitener, _whitener(measured - modelled))
            filtered = _filtered(record, whitener)
            again = identify(filtered, template)
            if again.best is None:
                break
            found = again
        return _Fitted(found, filtered, whitener)

    @property
    def best(self) -> IdentifiedModel:
        """The model."""
        assert self.identified.best is not None
        return self.identified.best


def _whitener(residual: Floats) -> Floats:
    """The filter that leaves of a residual what its past does not tell."""
    past = np.stack([np.roll(residual, i)[_ORDER:] for i in range(1, _ORDER + 1)], axis=1)
    weights = np.linalg.lstsq(past, residual[_ORDER:], rcond=1e-8)[0]
    return np.append(1.0, -np.asarray(weights, dtype=np.float64))


def _filtered(record: Record, whitener: Floats) -> Record:
    """Control and measurement behind a filter; without the samples it takes to begin."""
    first = whitener.size - 1
    control, measurement = _behind(
        whitener, np.stack([record.control, record.measurement]) - [[record.control[0]], [record.measurement[0]]]
    )
    return Record(record.time[first:], control, measurement)


def _behind(whitener: Floats, signals: Floats) -> Floats:
    """Signals, shape (m, n), behind a filter, without the samples it takes to begin."""
    behind: Floats = lfilter(whitener, np.ones(1), signals, axis=1)
    return behind[:, whitener.size - 1 :]


@dataclass(frozen=True)
class Loads:
    """Steps of a load on the control: at which samples, and how large."""

    starts: tuple[int, ...] = ()
    sizes: tuple[float, ...] = ()


class _Search:
    """What other flaws would leave of the measurement than those supposed, made white and beside the model's slopes."""

    def __init__(self, record: Record, fitted: _Fitted, flaws: Flaws, loads: Loads) -> None:
        self._record, self._flaws, self._whitener = record, flaws, fitted.whitener
        plant = plant_of(PlantSettings(fitted.best.process, record.sample_time, delay_model="exact"))
        self._grown = plant.growth(record.time.size)
        self._step = np.cumsum(np.append(0.0, self._grown))
        self._felt = flaws.felt(record.control)[0]
        driven = self._driven((self._felt - self._felt[0])[np.newaxis])[0]
        self._z = driven - driven.mean()
        _, measured, modelled = fitted.best.simulated
        self._best, self._slopes = fitted.best, _basis(fitted.best.slopes.T)
        self._all = measured - modelled
        self._freedom = self._all.size - len(self._slopes) - 1
        measurement = record.measurement - record.measurement.mean()
        self._floor = _ROUNDING * float(measurement @ measurement)
        self.loads = loads
        self._take_loads()
        self._left = self._beside(self._all[np.newaxis])[0]
        bent = self._beside(self._white(self._z[np.newaxis] ** 2))[0]
        self._bend_power = float(bent @ bent)
        self._bent = bent / max(math.sqrt(self._bend_power), 1e-300)

    def _take_loads(self) -> None:
        """Find steps of loads, one after the other, while each speaks for itself."""
        n = self._record.time.size
        tried = np.unique(np.linspace(2 * _ORDER, n - 2 * _ORDER, min(n, _STARTS)).astype(int))
        shapes = self._white(np.stack([self._load(start) for start in tried.tolist()]))
        self._known = _basis(self._slopes, self._white_loads())
        while len(self.loads.starts) < _LOADS:
            left, columns = self._beside(self._all[np.newaxis])[0], self._beside(shapes)
            power = np.einsum("ij,ij->i", columns, columns)
            taken = (columns @ left) ** 2 / np.maximum(power, 1e-9 * power.max() + 1e-300)
            k, now = int(np.argmax(taken)), float(left @ left)
            if self._freedom * math.log((now + self._floor) / (max(now - float(taken[k]), 0.0) + self._floor)) < PROOF:
                break
            self.loads = Loads((*self.loads.starts, int(tried[k])), (*self.loads.sizes, 0.0))
            self._known = _basis(self._slopes, self._white_loads())

    def _load(self, start: int) -> Floats:
        """What a unit step of a load makes of the measurement, shape (n,)."""
        return np.append(np.zeros(start), self._step[: self._record.time.size - start])

    def _white_loads(self) -> Floats:
        if not self.loads.starts:
            return np.zeros((0, self._all.size))
        return self._white(np.stack([self._load(start) for start in self.loads.starts]))

    def loads_of(self, flaws: Flaws) -> Loads:
        """The loads with the sizes that fit best beside other flaws."""
        if not self.loads.starts:
            return self.loads
        felt = flaws.felt(self._record.control)[0] - self._felt
        left = self._all - self._white(self._driven(felt[np.newaxis]))[0]
        if flaws.bend != self._flaws.bend:
            left = left - (flaws.bend - self._flaws.bend) * self._white(self._z[np.newaxis] ** 2)[0]
        columns = np.concatenate([self._white_loads(), self._slopes]).T
        more = np.linalg.lstsq(columns, left, rcond=1e-9)[0][: len(self.loads.starts)]
        return Loads(self.loads.starts, tuple((np.asarray(self.loads.sizes) + more).tolist()))

    def of_loads(self, flaws: Flaws) -> Floats:
        """What the loads make of the measurement, shape (n,)."""
        loads = self.loads_of(flaws)
        total = np.zeros(self._record.time.size)
        for start, size in zip(loads.starts, loads.sizes, strict=True):
            total += size * self._load(start)
        return total

    def _driven(self, felt: Floats) -> Floats:
        """What the model makes of changes of what is felt, shape (m, n)."""
        moved = np.zeros_like(felt)
        moved[:, 1:] = fftconvolve(self._grown[np.newaxis], felt, axes=1)[:, : felt.shape[1] - 1]
        return moved

    def _white(self, signals: Floats) -> Floats:
        return _behind(self._whitener, signals)

    def _beside(self, signals: Floats) -> Floats:
        return np.asarray(signals - (signals @ self._known.T) @ self._known)

    def _errors(self, candidates: Flaws) -> tuple[Floats, Floats]:
        """Squared errors with other actuators, shape (m,), without and with a bend that fits."""
        moved = self._driven(candidates.felt(self._record.control) - self._felt)
        left = self._left - self._beside(self._white(moved))
        straight = np.einsum("ij,ij->i", left, left)
        bent = np.maximum(straight - (left @ self._bent) ** 2, 0.0)
        return straight + self._floor, bent + self._floor

    def best(self) -> Flaws:
        """The flaws for which the record speaks most, if it does clearly."""
        candidates = self._others()
        straight, bent = self._errors(candidates)
        now = float(self._left @ self._left) + self._floor
        gain, more = self._freedom * np.log(now / straight), self._freedom * np.log(now / bent)
        new = _parts(candidates) - _parts(self._flaws)
        gain, more = gain - PROOF * new, more - PROOF * (new + (self._flaws.bend == 0.0))
        first, second = int(np.argmax(gain)), int(np.argmax(more))
        if max(gain[first], more[second]) < 1.0:
            return self._flaws
        if gain[first] >= more[second]:
            return _one(candidates, first)
        chosen = _one(candidates, second)
        return replace(chosen, bend=self._flaws.bend + self._bend_of(chosen)[0])

    def _bend_of(self, flaws: Flaws) -> tuple[float, float]:
        """By how much more it bends, and the standard deviation of that."""
        felt = flaws.felt(self._record.control)[0] - self._felt
        left = self._left - self._beside(self._white(self._driven(felt[np.newaxis])))[0]
        along = float(left @ self._bent)
        rest = (float(left @ left) - along**2) / self._freedom
        size = max(math.sqrt(self._bend_power), 1e-300)
        return along / size, math.sqrt(max(rest, 0.0)) / size

    def _others(self) -> Flaws:
        """What is tried for the actuator: as supposed, without, sticking, play, limits."""
        control, now = self._record.control, self._flaws
        least, most = _NEAR if now.dead_band else _ANY
        sizes = (float(now.dead_band) or float(np.ptp(control))) * np.geomspace(least, most, SIZES)
        bands = np.concatenate([[now.dead_band, 0.0], sizes, sizes])
        slips = np.concatenate([[now.slip, 1.0], np.ones(SIZES), np.zeros(SIZES)])
        middle = float(np.median(control))
        high = middle + (float(control.max()) - middle) * np.linspace(0.1, 0.98, SIZES)
        low = middle + (float(control.min()) - middle) * np.linspace(0.1, 0.98, SIZES)
        even = float(np.abs(control).max()) * np.linspace(0.1, 0.98, SIZES)
        same, zero = np.full(3 * SIZES, now.dead_band), np.full(3 * SIZES, now.slip)
        return Flaws(
            np.concatenate([bands, same]), np.concatenate([slips, zero]),
            np.concatenate([np.full(bands.size + SIZES, now.low), low, -even]),
            np.concatenate([np.full(bands.size, now.high), high, np.full(SIZES, now.high), even]), now.bend, now.centre,
        )  # fmt: skip

    def process_beside(self, flaws: Flaws) -> Process:
        """The model with the numbers that fit best beside other flaws, to first order."""
        if replace(flaws, centre=self._flaws.centre) == self._flaws:
            return self._best.process
        felt = flaws.felt(self._record.control)[0] - self._felt
        left = self._all - self._white(self._driven(felt[np.newaxis]))[0]
        left = left - (flaws.bend - self._flaws.bend) * self._white(self._z[np.newaxis] ** 2)[0]
        columns = np.concatenate([self._white_loads(), self._best.slopes.T])
        sizes = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        moves = np.linalg.lstsq((columns / sizes[:, np.newaxis]).T, left, rcond=1e-7)[0] / sizes
        return self._best.moved(moves[len(self.loads.starts) :])

    def _ratio(self) -> float:
        """Of one dead band that is tried to the next."""
        least, most = _NEAR if self._flaws.dead_band else _ANY
        return float((most / least) ** (1.0 / (SIZES - 1)))

    def draws(self, count: int, seed: int) -> tuple[Flaws, ...]:
        """Flaws drawn by how likely they are beside the record.

        Before the record speaks, as likely as not that there is no dead band and no bend, of any size otherwise.
        """
        random, now = np.random.default_rng([seed, 1]), self._flaws
        tried = self._others()
        same = (np.asarray(tried.low) == now.low) & (np.asarray(tried.high) == now.high)
        straight, bent = self._errors(tried)
        error = bent if now.bend else straight
        likely = np.where(same, np.exp(-0.5 * self._freedom * np.log(error / error[same].min())), 0.0)
        free = (np.asarray(tried.dead_band) == 0.0) & same
        likely[~free] /= max(int((same & ~free).sum()), 1)
        likely[free] /= int(free.sum())
        chosen = random.choice(likely.size, count, p=likely / likely.sum())
        more, deviation = self._bend_of(now)
        deviation = max(deviation, _ROUNDING)
        found, usual = now.bend + more, _USUAL_BEND / max(float(np.abs(self._z).max()), 1e-300)
        spread = math.hypot(deviation, usual)
        odds = deviation / spread * math.exp(min(0.5 * (found / deviation) ** 2 - 0.5 * (found / spread) ** 2, 500.0))
        share = usual**2 / spread**2
        bends = share * found + math.sqrt(share) * deviation * random.standard_normal(count)
        bends *= random.uniform(size=count) < odds / (1.0 + odds)
        # Sizes between those tried are as likely, and a thousandth of a dead band makes another day.
        between = np.exp(random.uniform(-0.5, 0.5, count) * math.log(self._ratio()))
        bands, slips = between * np.asarray(tried.dead_band)[chosen], np.asarray(tried.slip)[chosen]
        rows = np.stack([bands, slips, *self._limits(count, random), bends], axis=1).tolist()
        return tuple(Flaws(band, slip, low, high, bend, now.centre) for band, slip, low, high, bend in rows)

    def _limits(self, count: int, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Limits near those supposed, low and high, drawn by how likely they are; shapes (count,)."""
        now, moves = self._flaws, np.linspace(-0.05, 0.05, SIZES + 1) * float(np.ptp(self._felt))
        if not (math.isfinite(now.low) or math.isfinite(now.high)):
            return np.full(count, now.low), np.full(count, now.high)
        bands = np.full(moves.size, now.dead_band)
        tried = Flaws(bands, now.slip, now.low - moves, now.high + moves, now.bend, now.centre)
        error = self._errors(tried)[int(now.bend != 0.0)]
        likely = np.exp(-0.5 * self._freedom * np.log(error / error.min()))
        chosen = random.choice(moves, count, p=likely / likely.sum())
        return now.low - chosen, now.high + chosen


def _basis(*rows: Floats) -> Floats:
    """An orthonormal basis of what rows span."""
    stacked = np.concatenate(rows)
    sized = stacked / np.maximum(np.linalg.norm(stacked, axis=1), 1e-300)[:, np.newaxis]
    _, values, basis = np.linalg.svd(sized, full_matrices=False)
    return np.asarray(basis[values > 1e-7 * values[0]])


def _parts(flaws: Flaws) -> Floats:
    """How many numbers flaws of the actuator have."""
    return np.asarray((np.asarray(flaws.dead_band) > 0.0) + 0.0 + np.isfinite(flaws.low) + np.isfinite(flaws.high))


def _one(flaws: Flaws, k: int) -> Flaws:
    size = np.broadcast(flaws.dead_band, flaws.slip, flaws.low, flaws.high, flaws.bend).size
    parts = [float(np.broadcast_to(v, size)[k]) for v in (flaws.dead_band, flaws.slip, flaws.low, flaws.high)]
    return replace(flaws, dead_band=parts[0], slip=parts[1], low=parts[2], high=parts[3])
