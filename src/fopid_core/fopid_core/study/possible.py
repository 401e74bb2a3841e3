"""Processes and flaws that a record leaves possible, drawn together by how likely it makes them.

A covariance knows of small moves only. A dead band makes a response jump, a second lag that is nearly none and a delay
stand in for each other, and a load that came at an unknown instant pulls at all of them. So the draws are from the
posterior itself: what enters linearly (gain, operating point, beginning, loads, bend) is integrated out, the rest is
sampled, from about the best fit on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from fopid_core.design.identification.flaws import Flaws, joined
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Floats, Indexes
from fopid_core.model.process import Process
from fopid_core.study.sequential_sampling import sample

PARTICLES, _FIRST = 320, 8
"""In the end, and so many times as many to begin with: a dead band shows in a small part of where it might be."""
WIDER = 3.0
"""The sampling begins with so many times the standard deviations of the best fit."""
_WIDTHS = (0.1, 1.0)
"""As shares of the usual ones, since what shows clearly is known far better."""
_BANDS, SCANNED = (5e-4, 0.25), 800
"""Dead bands, as shares of the control's range; and in how many ranges of equal ratio they are looked for."""
_AT_ONCE = 160
"""Of so many numbers the signals are held in memory at once."""
_MOST_RINGING = 25.0
"""The shape of two lags that is looked for at most, or four times what was found: a damping of 0.1."""
_SHIFT = 0.05
"""By how much of the range limits that were found may be off."""
_USUAL_BEND, _USUAL_LOAD = 0.3, 0.5
"""Usual sizes of what is looked for: of a bent characteristic at the ends of the record, of itself; of a load, of the
control's range."""
_ROUNDING, _DEPENDENT, _STEP = 1e-18, 1e-12, 1e-4


@dataclass(frozen=True)
class Possible:
    """Draws: processes, and as many flaws in arrays of shape (m,)."""

    processes: tuple[Process, ...]
    flaws: Flaws


def drawn(
    record: Record, best: IdentifiedModel, start: InitialCondition, flaws: Flaws, loads: tuple[int, ...],
    whitener: Floats, count: int, seed: int,
) -> Possible:  # fmt: skip
    """So many processes with their flaws.

    Whether an actuator sticks or has play is no number, and how much of what may be is near the best of either says
    nothing of which it is. So each has as many of the draws as its best explains the record well.

    Parameters
    ----------
    record : Record
    best : IdentifiedModel
        The linear part that fits best.
    start : InitialCondition
        What is unknown about the beginning.
    flaws : Flaws
        Those that were found.
    loads : tuple of int
        At which samples loads were found to step; one at any instant is supposed where there is none.
    whitener : ndarray
        The filter that makes the residual white.
    count, seed : int
    """
    random = np.random.default_rng([seed, 1])
    kinds = [_Posterior(record, best, start, replace(flaws, slip=slip), loads, whitener, flaws) for slip in (1.0, 0.0)]
    found = [
        sample(kind.log_first, kind.log_density, kind.begin(random), PARTICLES, random, kind.redrawn) for kind in kinds
    ]
    highest = [float(kind.log_density(numbers).max()) for kind, numbers in zip(kinds, found, strict=True)]
    first = round(count / (1.0 + math.exp(min(highest[1] - highest[0], 500.0))))
    parts = [
        kind.some(numbers, size, random)
        for kind, numbers, size in zip(kinds, found, (first, count - first), strict=True)
        if size
    ]
    return Possible(
        tuple(process for part in parts for process in part.processes), joined([part.flaws for part in parts])
    )


class _Posterior:
    """How likely a record makes two lags behind a delay, with an actuator of one kind, and loads."""

    def __init__(
        self, record: Record, best: IdentifiedModel, start: InitialCondition, flaws: Flaws, loads: tuple[int, ...],
        whitener: Floats, found: Flaws,
    ) -> None:  # fmt: skip
        self._record, self._best, self._start, self._flaws, self._whitener = record, best, start, flaws, whitener
        n, h = record.time.size, record.sample_time
        self._time = h * np.arange(n)
        self._span = float(np.ptp(record.control))
        log_tau, log_c, delay = best.numbers.tolist()
        center = [log_c + log_tau, math.exp(-2.0 * log_c), delay]
        most = 4.0 * (math.exp(center[0]) + delay) + 4.0 * h
        least_band, most_band = (math.log(share * self._span) for share in _BANDS)
        self._band_known = bool(found.dead_band) and found.slip == flaws.slip
        band = math.log(float(found.dead_band)) if self._band_known else math.nan
        rows = [
            (center[0] - 3.0, center[0] + 3.0), (1e-6, max(_MOST_RINGING, 4.0 * center[1])), (0.0, most),
            (np.fmin(least_band, band - 1.0), most_band), (-1.0, 1.0),
        ]  # fmt: skip
        self._limited = math.isfinite(float(flaws.low)) or math.isfinite(float(flaws.high))
        rows += [(-1.0, 1.0)] * self._limited + [(1.0, n - 2.0)] * max(len(loads), 1)
        self._low, self._high = np.array(rows).T
        self._center = np.array([*center, band, 0.0, *[0.0] * self._limited, *(loads or (0.5 * n,))])
        self._first_load = 5 + self._limited
        self._target = self._white(flaws.straight(record.measurement)[np.newaxis])[0]
        known = np.where(np.isnan(self._center), self._low, self._center)[np.newaxis]
        z = float(best.gains[0]) * self._driven(known)[1][0]
        z = z - z.mean()
        self._bent = self._white((z**2)[np.newaxis])[0]
        bend = _USUAL_BEND / max(float(np.abs(z).max()), 1e-300)
        load = _USUAL_LOAD * self._span
        gain = abs(float(best.gains[0]))
        self._sizes = [math.inf, *[gain * load] * max(len(loads), 1), bend]
        self._sigma = max(best.noise, 1e-9 * float(np.ptp(record.measurement)))
        self._deviations, slopes, usual = self._first_look(bool(loads))
        self._share, self._shift = self._scanned(slopes, usual)

    def some(self, particles: Floats, count: int, random: np.random.Generator) -> Possible:
        """So many of the particles as processes and flaws, with what enters linearly as likely as it is beside them."""
        chosen = particles[random.choice(len(particles), count, replace=len(particles) < count)]
        columns = self._columns(chosen)
        gram, right = self._normal(columns)
        means = np.linalg.solve(gram, right[:, :, np.newaxis])[:, :, 0]
        left = self._target - np.einsum("mk,mkn->mn", means, columns)
        freedom = self._target.size - columns.shape[1]
        sigma = np.sqrt(np.einsum("mn,mn->m", left, left) / freedom)
        # Columns may stand in for each other, as a step at first and a free response without a delay between them.
        scale = 1.0 / np.sqrt(np.einsum("mii->mi", gram))
        values, vectors = np.linalg.eigh(gram * scale[:, :, np.newaxis] * scale[:, np.newaxis, :])
        shares = random.standard_normal(means.shape) / np.sqrt(np.maximum(values, _DEPENDENT))
        moves = scale * np.einsum("mij,mj->mi", vectors, shares)
        numbers = means + sigma[:, np.newaxis] * moves
        flaws = self._flaws_of(chosen)
        flaws = replace(flaws, bend=self._flaws.bend + numbers[:, len(self._sizes) - 1])
        x = np.stack([chosen[:, 0] + 0.5 * np.log(chosen[:, 1]), -0.5 * np.log(chosen[:, 1]), chosen[:, 2]], axis=1)
        structure = self._best.structure
        return Possible(tuple(structure.process(a, g[:1]) for a, g in zip(x, numbers, strict=True)), flaws)

    def log_density(self, numbers: Floats) -> Floats:
        """Logarithm of how likely the record makes numbers of shape (m, k), up to a constant; shape (m,)."""
        inside = np.all((numbers >= self._low) & (numbers <= self._high), axis=1)
        value = np.full(len(numbers), -math.inf)
        if inside.any():
            parts = np.array_split(numbers[inside], math.ceil(inside.sum() / _AT_ONCE))
            value[inside] = np.concatenate([self._beside(*self._normal(self._columns(part)))[0] for part in parts])
            value[inside] += numbers[inside, 3]  # any dead band is as likely as any other: it counts by its size
        return value

    def _beside(self, gram: Floats, right: Floats) -> tuple[Floats, Floats]:
        """How likely columns make the record, shape (m,), and their sizes that explain it best, shape (m, k)."""
        sizes = np.asarray(np.linalg.solve(gram, right[:, :, np.newaxis])[:, :, 0], dtype=np.float64)
        power = float(self._target @ self._target)
        left = np.maximum(power - np.einsum("mk,mk->m", right, sizes), 0.0) + _ROUNDING * power
        freedom = self._target.size - gram.shape[1]
        likely: Floats = -0.5 * freedom * np.log(left) - 0.5 * np.linalg.slogdet(gram)[1]
        return likely, sizes

    def _normal(self, columns: Floats) -> tuple[Floats, Floats]:
        """The normal equations, shapes (m, k, k) and (m, k)."""
        gram = columns @ columns.transpose(0, 2, 1)
        k = gram.shape[1]
        known = np.zeros(k)
        known[: len(self._sizes)] = (self._sigma / np.array(self._sizes)) ** 2
        diagonal = np.einsum("mii->mi", gram)
        diagonal += known + _DEPENDENT * (diagonal + diagonal.max(axis=0))
        return gram, columns @ self._target

    def _flaws_of(self, numbers: Floats) -> Flaws:
        now = self._flaws
        band = np.exp(numbers[:, 3])
        shift = _SHIFT * self._span * (numbers[:, 5] if self._limited else np.zeros(len(numbers)))
        return Flaws(band, np.full(len(numbers), now.slip), now.low - shift, now.high + shift,
                     np.full(len(numbers), now.bend), now.centre, band * numbers[:, 4])  # fmt: skip

    def _driven(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Step responses of unit gain, and what they make of what is felt of the control; shapes (m, n)."""
        n, start = self._time.size, self._start
        step = two_lags(np.exp(numbers[:, 0]), numbers[:, 1], self._time - numbers[:, 2:3])
        felt = self._flaws_of(numbers).felt(self._record.control)
        moved = felt - (felt[:, :1] if start.step else start.before)
        spectra = np.fft.rfft(np.diff(step, axis=1), 2 * n) * np.fft.rfft(moved, 2 * n)
        return step, np.pad(np.fft.irfft(spectra, 2 * n)[:, : n - 1], ((0, 0), (1, 0)))

    def _columns(self, numbers: Floats) -> Floats:
        """What enters linearly, behind the whitener, shape (m, k, n): driven, loads, bend, offset, the beginning."""
        start, (step, driven) = self._start, self._driven(numbers)
        columns = [driven]
        for begun in numbers[:, self._first_load :].T:
            late = np.arange(self._time.size) - np.ceil(begun).astype(int)[:, np.newaxis]
            columns.append(np.where(late > 0, np.take_along_axis(step, np.maximum(late, 0), axis=1), 0.0))
        beginning = [np.ones_like(step)]
        if start.step:
            beginning.append(step)
        if start.free:
            at_once = two_lags(np.exp(numbers[:, 0]), numbers[:, 1], np.broadcast_to(self._time, step.shape))
            beginning += [at_once, np.diff(at_once, axis=1, append=at_once[:, -1:])]
        if start.ramp:
            beginning.append(np.broadcast_to(self._time / self._time[-1], step.shape))
        white = self._white(np.stack([*columns, *beginning], axis=1))
        bent = np.broadcast_to(self._bent, (len(white), 1, self._bent.size))
        return np.concatenate([white[:, : len(columns)], bent, white[:, len(columns) :]], axis=1)

    def _white(self, signals: Floats) -> Floats:
        if self._whitener.size == 1:
            return signals
        behind: Floats = lfilter(self._whitener, np.ones(1), signals, axis=-1)
        return behind[..., self._whitener.size - 1 :]

    def _first_look(self, loads: bool) -> tuple[Floats, Floats, Floats]:
        """Standard deviations with which the sampling begins, infinite where it begins anywhere.

        And by what lags, shape and delay move the measurement, shape (3, n), with their usual sizes.
        """
        center = np.where(np.isnan(self._center), self._low, self._center)
        steps = np.array([_STEP, _STEP * max(center[1], 0.01), _STEP * (center[2] + self._record.sample_time)])
        moved = np.repeat(center[np.newaxis], 6, axis=0)
        moved[[0, 1, 2], [0, 1, 2]] += steps
        moved[[3, 4, 5], [0, 1, 2]] -= steps
        columns = self._columns(moved)
        gram, right = self._normal(columns)
        modelled = np.einsum("mk,mkn->mn", np.linalg.solve(gram, right[:, :, np.newaxis])[:, :, 0], columns)
        slopes = (modelled[:3] - modelled[3:]) / (2.0 * steps[:, np.newaxis])
        usual = np.array([1.0, 1.0, math.exp(center[0])])
        spread = np.linalg.inv(slopes @ slopes.T / self._sigma**2 + np.diag(usual**-2.0))
        self._root = WIDER * np.linalg.cholesky(spread)
        rest = np.full(center.size - 4, math.inf)
        if loads:
            rest[self._first_load - 4 :] = 3.0 + 0.02 * self._time.size
        return rest, slopes, usual

    def _scanned(self, slopes: Floats, usual: Floats) -> tuple[Floats, Floats]:
        """How likely each of many narrow ranges of the dead band is, shape (s,), and what it makes of the lags, (s, 3).

        Each has its own moments at which the stem moves, so that the likelihood jumps from one to the next. Lags,
        shape and delay are let go along by their slopes. The root of the likelihood counts, as those are no more.
        """
        numbers = np.tile(np.where(np.isnan(self._center), self._low, self._center), (SCANNED, 1))
        numbers[:, 3] = self._band_at(np.linspace(0.5, SCANNED - 0.5, SCANNED))
        found = []
        for part in np.array_split(numbers, math.ceil(SCANNED / _AT_ONCE)):
            columns = self._columns(part)
            several = np.concatenate([columns, np.broadcast_to(slopes, (len(part), *slopes.shape))], axis=1)
            gram, right = self._normal(several)
            gram[:, [-3, -2, -1], [-3, -2, -1]] += (self._sigma / usual) ** 2
            found.append(self._beside(gram, right))
        likely = np.concatenate([each for each, _ in found]) + numbers[:, 3]
        share = np.exp(0.5 * (likely - likely.max()))
        return 0.5 * share / share.sum() + 0.5 / SCANNED, np.concatenate([sizes[:, -3:] for _, sizes in found])

    def _range_of(self, numbers: Floats) -> Indexes:
        """In which of the ranges that were scanned a dead band is."""
        at = SCANNED * (numbers[:, 3] - self._low[3]) / (self._high[3] - self._low[3])
        return np.asarray(np.clip(at, 0, SCANNED - 1), dtype=np.intp)

    def _band_at(self, place: Floats) -> Floats:
        """The logarithm of the dead band that is so many ranges above the smallest."""
        return np.asarray(self._low[3] + place / SCANNED * (self._high[3] - self._low[3]))

    def redrawn(self, numbers: Floats, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Other dead bands with the lags that go with them, and the logarithm of how much likelier the way back is."""
        tried, before = numbers.copy(), self._range_of(numbers)
        after = random.choice(SCANNED, len(numbers), p=self._share)
        tried[:, 3] = self._band_at(after + random.uniform(size=len(numbers)))
        tried[:, :3] += self._shift[after] - self._shift[before]
        return tried, np.log(self._share[before] / self._share[after])

    def log_first(self, numbers: Floats) -> Floats:
        """Logarithm of the density with which the sampling begins: about what was found, and half of it anywhere."""
        away = np.linalg.solve(self._root, (numbers[:, :3] - self._center[:3]).T)
        known = np.isfinite(self._deviations)
        spread, wide = self._deviations[known], (self._high - self._low)[4:][known]
        rest = (numbers[:, 4:] - self._center[4:])[:, known] / spread
        near = sum(np.exp(-0.5 * (rest / k) ** 2) / (k * spread) for k in _WIDTHS) / (
            len(_WIDTHS) * math.sqrt(2 * math.pi)
        )
        inside = np.all((numbers >= self._low) & (numbers <= self._high), axis=1)
        value = -0.5 * np.sum(away**2, axis=0) + np.sum(np.log(0.5 * near + 0.5 / wide), axis=1)
        value += np.log(self._share[self._range_of(numbers)])
        return np.where(inside, value, -math.inf)

    def begin(self, random: np.random.Generator) -> Floats:
        """Particles of that density."""
        count, known = _FIRST * PARTICLES, np.isfinite(self._deviations)
        found = np.empty((0, self._center.size))
        while len(found) < count:
            tried = random.uniform(self._low, self._high, (count, self._center.size))
            tried[:, :3] = self._center[:3] + random.standard_normal((count, 3)) @ self._root.T
            near = self._center[4:] + np.where(known, self._deviations, 0.0) * random.standard_normal(
                (count, known.size)
            )
            chosen = known & (random.uniform(size=near.shape) < 0.5)
            tried[:, 4:] = np.where(chosen, near, tried[:, 4:])
            tried[:, 3] = self.redrawn(tried, random)[0][:, 3]
            found = np.concatenate([found, tried[np.isfinite(self.log_first(tried))]])[:count]
        return found


def two_lags(lag: Floats, shape: Floats, time: Floats) -> Floats:
    """Step responses of 1/(shape lag^2 s^2 + lag s + 1), shapes (m,), (m,), (m, n); zero before zero."""
    inside = 1.0 - 4.0 * np.where(np.abs(shape - 0.25) < 1e-9, 0.25 - 1e-9, shape)
    after, response = np.maximum(time, 0.0), np.empty(time.shape)
    for some, root in ((inside > 0.0, np.sqrt(np.abs(inside))), (inside < 0.0, np.sqrt(inside.astype(complex)))):
        half = 0.5 * lag[some, np.newaxis]
        slow, fast = half * (1.0 + root[some, np.newaxis]), half * (1.0 - root[some, np.newaxis])
        swings = slow * np.exp(after[some] / -slow) - fast * np.exp(after[some] / -fast)
        response[some] = 1.0 - (swings / (slow - fast)).real
    return response
