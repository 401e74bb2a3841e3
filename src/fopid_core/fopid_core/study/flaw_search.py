"""A process learnt from a record with what is not linear in it.

A linear model's covariance knows nothing of these. Each is looked for where it would show: in what the learnt model
leaves of the measurement, beside all that small changes of its numbers could explain, both made white. What speaks for
itself clearly is taken into the process, as large as the record says, within what it leaves possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from fopid_core.design.identification.coloured_noise import WhitenedResponse, behind
from fopid_core.design.identification.flaws import Flaws, joined
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.noise import sensor_noise
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.refusal import explains_little
from fopid_core.model.arrays import Floats
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.study.possible import Possible, drawn
from fopid_core.study.white_fit import WhiteFit

SIZES = 60
"""So many dead bands are tried, and limits on either side."""
_ANY, _NEAR = (0.002, 0.25), (0.6, 1.6)
"""Smallest and largest dead band: of the control's range, and of one that was found."""
PROOF = 18.0
"""Twice the logarithm of the likelihood grows by so much with a flaw: by chance, over all that are tried, rarely."""
_ROUNDS, _WHITENINGS, _ROUNDING = 6, 2, 1e-18
_MOST_TAKEN = 10.0
"""What is left of the measurement, as a share of it: loads that cancel each other many times over explain nothing, nor
does a dead band that no control overcomes."""
_LOADS, _STARTS, _ENDS = 4, 200, 12
"""Steps of a load that are looked for at most, at how many instants, and so many samples from the ends."""

RUNS_AWAY = "the record shows a process that runs away without its controller, which is not replayed; allowed: others"


@dataclass(frozen=True)
class Learnt:
    """A process with its flaws.

    Attributes
    ----------
    identified : IdentificationResult
        Of the linear part.
    flaws : Flaws
    possible : Possible or None
        The process and those, and as many as asked for that the record leaves possible; None without a process.
    linear : Record
        What the linear part was learnt from: without flaws and loads.
    """

    identified: IdentificationResult
    flaws: Flaws
    possible: Possible | None
    linear: Record


def learn(record: Record, template: str, count: int, seed: int) -> Learnt:
    """The process and its flaws, from an evenly spaced record, and ``count`` draws of what it leaves possible."""
    first, flaws, loads, bare = _begun(record, template)
    if not first.success or first.best is None:
        return Learnt(first, flaws, None, record)
    # A load that steps is not to pass for a drift.
    start = replace(first.best.start, ramp=False)
    response = first.best.white.response
    fitted = WhiteFit(first, bare, response.whitening if isinstance(response, WhitenedResponse) else np.ones(1))
    if first.best.start.ramp or fitted.whitener.size > 1:
        fitted = fitted.again(bare, start)
    for _ in range(_WHITENINGS + 1):
        for _ in range(_ROUNDS):
            search = _Search(record, fitted, flaws, loads)
            found = search.better()
            if found is None:
                break
            without = search.without(found[1], found[0].of_record(record))
            if np.ptp(without.measurement) > _MOST_TAKEN * np.ptp(record.measurement) or not np.ptp(without.control):
                break
            (flaws, loads), bare = found, without
            fitted = fitted.again(bare, start)
        if fitted.best.whiteness.white:
            break
        fitted = fitted.whiter(bare, start)
    if not fitted.identified.success:
        told = f"what a process of two lags and a delay leaves of the record is no noise: {fitted.identified.message}"
        return Learnt(replace(first, success=False, message=told), flaws, None, record)
    others = drawn(record, fitted.best, start, flaws, loads.starts, fitted.whitener, count, seed)
    possible = Possible((fitted.best.process, *others.processes), joined([flaws, others.flaws]))
    identified = fitted.identified
    if first.best.wanders:  # behind the filter hardly anything is explained
        best = replace(fitted.best, fit_pct=first.best.fit_pct, wanders=True)
        identified = replace(identified, message=first.message, best=best)
    return Learnt(identified, flaws, possible, fitted.record)


@dataclass(frozen=True)
class Loads:
    """Steps of a load on the control: at which samples, and how large."""

    starts: tuple[int, ...] = ()
    sizes: tuple[float, ...] = ()


def _begun(record: Record, template: str) -> tuple[IdentificationResult, Flaws, Loads, Record]:
    """A process to begin with, the flaws and loads beside which it was found, and the record without these.

    A process alone, where that leaves noise without a drift, which may be steps of a load; else beside loads, or alone
    where it explains enough, or behind a dead band.
    """
    flaws, loads = Flaws(centre=float(np.mean(record.measurement))), Loads()
    alone = identify(record, template, disturbances=False)
    if alone.best is None:
        return alone, flaws, loads, record
    drifts = alone.best.start.ramp and not alone.best.whiteness.white
    if not drifts and alone.success and alone.best.whiteness.white:
        return alone, flaws, loads, record
    sensor = sensor_noise(record)
    noise = sensor.level if sensor.at_rest else 0.0
    loaded = identify(record, template, noise=noise)
    if loaded.success and loaded.best is not None and loaded.best.loads:
        beside, bare = _without_loads(record, loaded.best)
        first = identify(bare, template, disturbances=False)
        if first.success:
            return first, flaws, beside, bare
    if alone.success or not (drifts or explains_little(alone.best)):
        return alone, flaws, loads, record
    found = identify(record, noise=noise)
    if not found.success or found.best is None:
        return alone, flaws, loads, record
    before = replace(found.flaws, centre=flaws.centre)
    bare = before.of_record(record)
    if found.best.wanders and bare.is_regular and found.best.fitted.response.time.size == bare.time.size:
        return found, before, loads, bare
    if found.flaws.dead_band and math.isinf(found.flaws.rate):
        first = identify(bare, template, disturbances=False)
        if first.success:
            return first, before, loads, bare
    told = f"{found.message}; a replay begins with what a process of two lags and a delay explains"
    told = f"{told}; allowed: a stretch without the rest (--from, --to)"
    return replace(alone, message=RUNS_AWAY if found.best.structure.runs_away else told), flaws, loads, record


def _without_loads(record: Record, best: IdentifiedModel) -> tuple[Loads, Record]:
    """The loads beside which a process of one gain was found, and the record without what they made of it."""
    gain, *rest = best.fitted.coefficients.tolist()
    first = best.fitted.response.free_columns - len(best.loads)
    sizes = tuple(part / gain for part in rest[first : first + len(best.loads)])
    starts = tuple(int(np.searchsorted(record.time - record.time[0], instant)) for instant in best.loads)
    plant = plant_of(PlantSettings(best.process, record.sample_time, delay_model="exact"))
    step = np.cumsum(np.append(0.0, plant.growth(record.time.size)))
    answered = np.zeros(record.time.size)
    for start, size in zip(starts, sizes, strict=True):
        answered[start:] += size * step[: record.time.size - start]
    return Loads(starts, sizes), replace(record, measurement=record.measurement - answered)


class _Search:
    """What other flaws would leave of the measurement than those supposed, made white and beside the model's slopes."""

    def __init__(self, record: Record, fitted: WhiteFit, flaws: Flaws, loads: Loads) -> None:
        self._record, self._flaws, self._whitener = record, flaws, fitted.whitener
        plant = plant_of(PlantSettings(fitted.best.process, record.sample_time, delay_model="exact"))
        self._grown = plant.growth(record.time.size)
        self._step = np.cumsum(np.append(0.0, self._grown))
        self._felt = flaws.felt(record.control)[0]
        driven = self._driven((self._felt - self._felt[0])[np.newaxis])[0]
        self._z = driven - driven.mean()
        _, measured, modelled = fitted.best.simulated
        self._slopes = _basis(fitted.best.slopes.T)
        self._freedom = measured.size - len(self._slopes) - 1
        measurement = record.measurement - record.measurement.mean()
        self._floor = _ROUNDING * float(measurement @ measurement)
        self._all = measured - modelled + self._white(self._of(loads)[np.newaxis])[0]
        n = record.time.size
        tried = np.unique(np.linspace(_ENDS, n - _ENDS, min(n, _STARTS)).astype(int))
        steps = self._white(np.stack([self._load(start) for start in tried.tolist()]))
        self._steps = dict(zip(tried.tolist(), steps, strict=True))
        # Beside other flaws a load may seem to have come at another instant: each is looked for anew.
        self._starts: tuple[int, ...] = ()
        self._known = self._slopes
        for _ in loads.starts:
            self._take(self._best_load()[1])
        self._left = self._beside(self._all[np.newaxis])[0]
        bent = self._beside(self._white(self._z[np.newaxis] ** 2))[0]
        self._bend_power = float(bent @ bent)
        self._bent = bent / max(math.sqrt(self._bend_power), 1e-300)

    def better(self) -> tuple[Flaws, Loads] | None:
        """With the one flaw, or step of a load, that the record speaks for most; None if for none clearly."""
        (gain, start), (more, flaws) = self._best_load(), self._best_flaws()
        if max(gain, more) < 1.0:
            return None
        if gain > more:
            self._take(start)
            flaws = self._flaws
        return flaws, self._sized(flaws)

    def _best_load(self) -> tuple[float, int]:
        """By how much one more step of a load explains more than it must, and where it is."""
        if len(self._starts) == _LOADS:
            return -math.inf, 0
        left, columns = self._beside(self._all[np.newaxis])[0], self._beside(np.stack(list(self._steps.values())))
        power = np.einsum("ij,ij->i", columns, columns)
        taken = (columns @ left) ** 2 / np.maximum(power, 1e-9 * power.max() + 1e-300)
        k, now = int(np.argmax(taken)), float(left @ left)
        rest = max(now - float(taken[k]), 0.0)
        return self._freedom * math.log((now + self._floor) / (rest + self._floor)) - PROOF, list(self._steps)[k]

    def _take(self, start: int) -> None:
        self._starts = (*self._starts, start)
        self._known = _basis(self._known, self._steps[start][np.newaxis])

    def _load(self, start: int) -> Floats:
        """What a unit step of a load makes of the measurement, shape (n,)."""
        return np.append(np.zeros(start), self._step[: self._record.time.size - start])

    def _sized(self, flaws: Flaws) -> Loads:
        """The loads with the sizes that fit best beside other flaws."""
        if not self._starts:
            return Loads()
        felt = flaws.felt(self._record.control)[0] - self._felt
        left = self._all - self._white(self._driven(felt[np.newaxis]))[0]
        if flaws.bend != self._flaws.bend:
            left = left - (flaws.bend - self._flaws.bend) * self._white(self._z[np.newaxis] ** 2)[0]
        columns = np.stack([*(self._steps[start] for start in self._starts), *self._slopes]).T
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        sizes = np.linalg.lstsq(columns / scale, left, rcond=1e-9)[0] / scale
        return Loads(self._starts, tuple(sizes[: len(self._starts)].tolist()))

    def without(self, loads: Loads, record: Record) -> Record:
        """A record without what loads make of the measurement."""
        return replace(record, measurement=record.measurement - self._of(loads))

    def _of(self, loads: Loads) -> Floats:
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
        return behind(self._whitener, signals)

    def _beside(self, signals: Floats) -> Floats:
        return np.asarray(signals - (signals @ self._known.T) @ self._known)

    def _errors(self, candidates: Flaws) -> tuple[Floats, Floats]:
        """Squared errors with other actuators, shape (m,), without and with a bend that fits."""
        moved = self._driven(candidates.felt(self._record.control) - self._felt)
        left = self._left - self._beside(self._white(moved))
        straight = np.einsum("ij,ij->i", left, left)
        bent = np.maximum(straight - (left @ self._bent) ** 2, 0.0)
        return straight + self._floor, bent + self._floor

    def _best_flaws(self) -> tuple[float, Flaws]:
        """By how much other flaws explain more than they must, and which."""
        candidates = self._others()
        straight, bent = self._errors(candidates)
        now = float(self._left @ self._left) + self._floor
        gain, more = self._freedom * np.log(now / straight), self._freedom * np.log(now / bent)
        new = _parts(candidates) - _parts(self._flaws)
        gain, more = gain - PROOF * new, more - PROOF * (new + (self._flaws.bend == 0.0))
        first, second = int(np.argmax(gain)), int(np.argmax(more))
        if gain[first] >= more[second]:
            return float(gain[first]), _one(candidates, first)
        chosen = _one(candidates, second)
        return float(more[second]), replace(chosen, bend=self._flaws.bend + self._bend_of(chosen))

    def _bend_of(self, flaws: Flaws) -> float:
        """By how much more it bends beside an actuator."""
        felt = flaws.felt(self._record.control)[0] - self._felt
        left = self._left - self._beside(self._white(self._driven(felt[np.newaxis])))[0]
        return float(left @ self._bent) / max(math.sqrt(self._bend_power), 1e-300)

    def _others(self) -> Flaws:
        """What is tried for the actuator: as supposed, without, sticking, play, limits."""
        control, now = self._record.control, self._flaws
        sizes = float(np.ptp(control)) * np.geomspace(*_ANY, SIZES)
        if now.dead_band:
            sizes = np.concatenate([sizes, now.dead_band * np.geomspace(*_NEAR, SIZES)])
        bands = np.concatenate([[now.dead_band, 0.0], sizes, sizes])
        slips = np.concatenate([[now.slip, 1.0], np.ones(sizes.size), np.zeros(sizes.size)])
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
