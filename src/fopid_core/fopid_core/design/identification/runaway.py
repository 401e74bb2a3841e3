"""Processes that run away, learnt from the loop that holds them.

What an unstable model makes of the control grows without end, and with it whatever the control does not tell. So both,
the measurement and the model's answer, pass the filter that puts the mirror image of the unstable pole in its place,
(1 - a/z) / (1 - 1/(a z)) with a = exp(p h). It passes all frequencies alike: white noise stays white, the fit is the
prediction error of the best predictor in white noise of the measurement, and consistent in closed loop (Forssell and
Ljung, IEEE Trans. Automatic Control 45 (2000) 137-141). On the line of transforms the pole is cancelled before
anything is sampled in time, so nothing grows.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from scipy.signal import lfilter

from fopid_core.design.identification.fit import Fit, at, fit
from fopid_core.design.identification.record import Record, validation_samples
from fopid_core.design.identification.response import MOST_CELLS, InitialCondition, RecordResponse
from fopid_core.design.identification.structure import LAG, PAIR, UNSTABLE_STRUCTURES, Structure
from fopid_core.model.arrays import Complexes, Floats

_STEP = 1e-5
_ROUGH, _COARSE = 512, 2048
_RUNAWAYS, _LAGS, _DELAYS = 9, 7, 4
"""Points of the grid on which the search begins."""
_BEGIN = 3
"""So many of its best points are gone on from."""
_EVALUATIONS = 25
_BETTER = 0.98
"""A beginning that is not at rest must leave this share of the error at most."""


class RunawayResponse(RecordResponse):
    """A response, and the measurement, behind the filter of the model's own unstable pole.

    The record is put on even instants, of which there are at most ``most``.
    """

    def __init__(
        self, record: Record, structure: Structure, start: InitialCondition, most: int = MOST_CELLS
    ) -> None:  # fmt: skip
        super().__init__(record.evenly(most), structure, start, most)

    def target(self, x: Floats) -> Floats:
        """The measurement behind the filter."""
        return self._behind(x, self.measurement)

    def level(self, x: Floats) -> float:
        """The filter's gain, the same at all frequencies."""
        return self._growth(x)

    def columns(self, x: Floats) -> Floats:
        """As of a stable process, behind the filter."""
        signals = super().columns(x)
        later = 1 + self.start.ramp  # offset and ramp are made in time
        signals[:, -later:] = self._behind(x, signals[:, -later:])
        return signals

    def slopes(self, x: Floats, coefficients: Floats) -> Floats:
        """Of what the model makes of the control less the measurement, both behind the filter: by differences."""

        def left(numbers: Floats) -> Floats:
            return self.columns(numbers) @ coefficients - self.target(numbers)

        scale = np.full(x.size, _STEP)
        scale[-1] *= max(self.sample_time, float(x[-1]))
        moves = np.diag(scale)
        first = x[-1] < scale[-1]  # no delay below 0
        return np.stack([
            (left(x + move) - left(x if last and first else x - move)) / (move.sum() * (1.0 if last and first else 2.0))
            for move, last in zip(moves, np.arange(x.size) == x.size - 1, strict=True)
        ], axis=1)  # fmt: skip

    def _growth(self, x: Floats) -> float:
        """By how much the unstable pole grows in a sample."""
        return math.exp(self._h * math.exp(-x[0]))

    def _behind(self, x: Floats, signals: Floats) -> Floats:
        a = self._growth(x)
        behind: Floats = lfilter([1.0, -a], [1.0, -1.0 / a], signals, axis=0)
        return behind

    def _signals(self, spectra: Complexes) -> Floats:
        assert self._kernel is not None
        a = self._growth(self._kernel.x)
        later = np.exp(-self._s[: spectra.shape[-1]] * self._h)
        return super()._signals(spectra * ((1.0 - a * later) / (1.0 - later / a)))


def response_to(
    record: Record, structure: Structure, start: InitialCondition, most: int = MOST_CELLS
) -> RecordResponse:
    """The response of any structure."""
    kind = RunawayResponse if structure.runs_away else RecordResponse
    return kind(record, structure, start, most)


def runaway_fits(record: Record, starts: tuple[InitialCondition, ...]) -> list[Fit]:
    """The unstable structures, fitted roughly, from the beginning that explains most; at rest where that is as good.

    Parameters
    ----------
    record : Record
    starts : tuple of InitialCondition
        In the order of preference.
    """
    structures = list(UNSTABLE_STRUCTURES.values())
    best: tuple[float, list[Fit]] = (math.inf, [])
    for start in starts:
        found: list[Fit] = []
        for structure in structures:
            found.append(_fitted(record, structure, start, found))
        error = min(each.error for each in found)
        if error < _BETTER * best[0]:
            best = error, found
    return best[1]


def _fitted(record: Record, structure: Structure, start: InitialCondition, simpler: list[Fit]) -> Fit:
    rough = RunawayResponse(record, structure, start, _ROUGH)
    fine = RunawayResponse(record, structure, start, _COARSE)
    rows = ~validation_samples(rough.time.size)
    looks = [at(rough, x, rows) for x in _grid(structure, rough, simpler)]
    begun = sorted(looks, key=lambda each: each.error)[:_BEGIN]
    near = [fit(rough, each.x, rows, _EVALUATIONS, 1e-4) for each in begun]
    chosen = min(near, key=lambda each: each.error)
    return fit(fine, chosen.x, ~validation_samples(fine.time.size), _EVALUATIONS, 1e-6)


def _grid(structure: Structure, rough: RecordResponse, simpler: list[Fit]) -> list[Floats]:
    """Where the search may begin."""
    step, span = float(rough.time[1]), float(rough.time[-1])
    delays = (0.0, *np.geomspace(step, 0.05 * span, _DELAYS - 1).tolist())
    lags = np.linspace(math.log(0.5 * step), math.log(4.0 * span), _LAGS).tolist()
    if structure.sections[-1] is PAIR:
        log_tau, log_lag, delay = simpler[-1].x.tolist()
        quick = [math.log(step * share) for share in (1.0, 4.0)]
        pairs = [(0.5 * (log_lag + other), abs(log_lag - other) / 2.0) for other in quick]
        return [np.array([log_tau + move, middle, math.log(2.0) + apart, late * delay])
                for move, (middle, apart), late in product((-0.7, 0.0, 0.7), pairs, (0.0, 1.0))]  # fmt: skip
    away = np.linspace(math.log(2.0 * step), math.log(0.5 * span), _RUNAWAYS).tolist()
    beside = [(lag,) for lag in lags] if structure.sections[-1] is LAG else [()]
    return [np.array([tau, *lag, delay]) for tau, lag, delay in product(away, beside, delays)]
