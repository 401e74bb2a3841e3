"""The answer of a model structure to a recorded control, and how it changes with the model's numbers.

On the line s = a + jw the transform of a response to a held control is the model's transform times that of the
control's steps, so fractional powers and delays are exact and nothing is stepped through. The step response starts
like t^order; that part is taken out of the transform and added in time, so that the rest needs few frequencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.design.identification.structure import Structure
from fopid_core.model.arrays import Complexes, Floats

_DAMPING = 20.0
"""exp(-20) leaks from one period of the Fourier series into the next."""
_SUDDEN = 3.0
"""Step responses that start with a higher power of time than this are smooth enough as they are; those that start with
a jump belong to the free response, whose shape is no more than a guess."""
MOST_CELLS = 8192


@dataclass(frozen=True)
class InitialCondition:
    """What is unknown about the beginning.

    Attributes
    ----------
    before : float
        The control at which the process rested before the record.
    step : bool
        Whether that control is unknown, so that a step of unknown size acts at the first instant.
    free : bool
        Whether the process did not rest, so that a free response of unknown shape runs out.
    ramp : bool
        Whether the operating point moves at an unknown, constant rate.
    loads : tuple of float
        When steps of unknown size came to the control [s after the first instant].
    """

    before: float = 0.0
    step: bool = False
    free: bool = False
    ramp: bool = False
    loads: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Kernel:
    """A structure at given numbers, on the grid of frequencies."""

    x: Floats
    step: Complexes  # transform of the unit step response without delay and gain
    slopes: list[Complexes]  # of log denominator
    lag: Complexes  # exp(-L s)


class RecordResponse:
    """Responses of one structure at the instants of a record.

    Parameters
    ----------
    record : Record
    structure : Structure
    start : InitialCondition
    most : int
        With more samples than this, averages over blocks of samples stand for them.
    """

    def __init__(self, record: Record, structure: Structure, start: InitialCondition, most: int = MOST_CELLS) -> None:
        self.structure, self.start = structure, start
        self.record, self.most = record, most
        time, self.measurement = record.averaged(most)
        self.time: Floats = time - record.time[0]
        self._aligned = record.is_regular and time.size == record.time.size
        cells = time.size if self._aligned else min(max(2 * time.size, 512), 2 * most)
        self.sample_time = record.sample_time
        self._h = record.sample_time if self._aligned else record.span / cells
        period = 2 * cells
        line = _DAMPING / (period * self._h)
        self._grid: Floats = self._h * np.arange(period, dtype=np.float64)
        self._damp = np.exp(-line * self._grid)
        self._s: Complexes = np.asarray(line + 2j * np.pi / (period * self._h) * np.arange(period + 1))
        self._log_s = np.log(self._s)
        held = record.control if self._aligned else _cell_averages(record, cells, self._h)
        steps = np.diff(held, prepend=start.before)
        if start.step:
            steps[0] = 0.0
        self._control = np.fft.rfft(steps * self._damp[:cells], period)
        self._cells, self._period = cells, period
        self._loads = self._steps(np.array(start.loads))
        self._kernel: _Kernel | None = None

    def of(self, structure: Structure) -> RecordResponse:
        """The same for another structure."""
        return RecordResponse(self.record, structure, self.start, self.most)

    @property
    def free_columns(self) -> int:
        """How many columns the beginning and loads add."""
        begun = int(self.start.step) + (self._free_orders if self.start.free else 0)
        return begun + len(self.start.loads) * (self.structure.zeros + 1)

    @property
    def _free_orders(self) -> int:
        order = sum(section.alpha or 2.0 for section in self.structure.sections)
        return max(1, math.ceil(order))

    def columns(self, x: Floats) -> Floats:
        """Everything that enters linearly, shape (n, k): gains, what the beginning adds, loads, offset and ramp."""
        delayed = [self._spectrum(x, j, delayed=True) for j in range(self.structure.zeros + 1)]
        spectra = [spectrum * self._control for spectrum in delayed]
        if self.start.step:
            spectra.append(delayed[0])
        if self.start.free:
            spectra += [self._spectrum(x, j, delayed=False) for j in range(self._free_orders)]
        spectra += [spectrum * load for load in self._loads for spectrum in delayed]
        signals = self._signals(np.stack(spectra))
        ramp = [self.time / self.time[-1]] if self.start.ramp else []
        return np.column_stack([signals, np.ones(len(signals)), *ramp])

    def target(self, x: Floats) -> Floats:
        """What ``columns(x)`` are fitted to, shape (n,)."""
        del x  # the same for all
        return self.measurement

    def level(self, x: Floats) -> float:
        """How many times as large as the noise of the measurement that in ``target(x)`` is."""
        del x
        return 1.0

    def slopes(self, x: Floats, coefficients: Floats) -> Floats:
        """Derivatives of ``columns(x) @ coefficients`` with respect to x, shape (n, len(x))."""
        kernel = self._at(x)
        gains = coefficients[: self.structure.zeros + 1]
        numerator = np.polyval(gains[::-1], self._s)
        driven = -kernel.step * kernel.lag * numerator
        rest = self._start_transform(kernel, coefficients[gains.size :])
        spectra = []
        for slope in kernel.slopes:
            spectrum = self._fold(driven * slope) * self._control
            spectra.append(spectrum if rest is None else spectrum + self._fold(rest * slope))
        late = self._fold(driven * self._s) * self._control
        for load, of_load in zip(self._loads, self._load_numerators(coefficients), strict=True):
            moved = -kernel.step * kernel.lag * of_load
            spectra = [spectrum + self._fold(moved * slope) * load for spectrum, slope in
                       zip(spectra, kernel.slopes, strict=True)]  # fmt: skip
            late = late + self._fold(moved * self._s) * load
        if self.start.step:
            late = late - self._fold(coefficients[gains.size] * self._s * kernel.step * kernel.lag)
        return self._signals(np.stack([*spectra, late]))

    def load_shapes(self, x: Floats, gains: Floats, instants: Floats) -> Floats:
        """What a unit step of a load at each of some instants [s] makes of the measurement, shape (m, n)."""
        response = np.polyval(gains[::-1], self._s) * self._at(x).step * self._at(x).lag
        return np.ascontiguousarray(self._signals(self._fold(response) * self._steps(instants)).T)

    def _steps(self, instants: Floats) -> Complexes:
        """Spectra of unit steps at some instants [s], shape (m, cells + 1): on the grid or between two cells."""
        steps = np.zeros((instants.size, self._cells))
        place = np.clip(instants / self._h, 0.0, self._cells - 1.0)
        left = np.minimum(place.astype(np.intp), max(self._cells - 2, 0))
        rows = np.arange(instants.size)
        steps[rows, left] = 1.0 - (place - left)
        steps[rows, left + 1] += place - left
        spectra: Complexes = np.fft.rfft(steps * self._damp[: self._cells], self._period)
        return spectra

    def _load_numerators(self, coefficients: Floats) -> list[Complexes]:
        """The numerator of each load's answer."""
        each = self.structure.zeros + 1
        first = each + self.free_columns - len(self._loads) * each
        parts = coefficients[first : first + len(self._loads) * each].reshape(-1, each)
        return [np.asarray(np.polyval(part[::-1], self._s), dtype=np.complex128) for part in parts]

    def scan(self, x: Floats, delays: Floats) -> tuple[Floats, Floats, Floats]:
        """Roughly: what control and a step at the first instant do behind each delay, and two free responses.

        Shapes (m, n), (m, n), (2, n) for m delays [s]; the delay in ``x`` does not count.
        """
        kernel = self._at(x)
        steps = self._fold(kernel.step * np.exp(-np.multiply.outer(delays, self._s)))
        free = self._fold(np.stack([kernel.step, self._s * kernel.step]))
        found = self._signals(np.concatenate([steps * self._control, steps, free])).T
        return found[: delays.size], found[delays.size : -2], found[-2:]

    def _start_transform(self, kernel: _Kernel, coefficients: Floats) -> Complexes | None:
        """Minus the transform of what the beginning adds."""
        if not self.free_columns:
            return None
        total = np.zeros_like(self._s)
        first = int(self.start.step)
        if first:
            total = total - coefficients[0] * kernel.step * kernel.lag
        if self.start.free:
            free = coefficients[first : first + self._free_orders]
            total = total - np.polyval(free[::-1], self._s) * kernel.step
        return total

    def _at(self, x: Floats) -> _Kernel:
        if self._kernel is None or not np.array_equal(self._kernel.x, x):
            value, slopes = self.structure.denominator(x, self._log_s)
            self._kernel = _Kernel(x.copy(), 1.0 / (self._s * value), slopes, np.exp(-x[-1] * self._s))
        return self._kernel

    def _spectrum(self, x: Floats, power: int, delayed: bool) -> Complexes:
        """Of the samples of the response of s^power over the denominator to a unit step."""
        kernel = self._at(x)
        smooth = kernel.step * self._s**power if power else kernel.step
        order, log_lead, rate = self.structure.fast_end(x)
        start = order - power
        if not 0.0 < start < _SUDDEN:
            return self._fold(smooth * kernel.lag if delayed else smooth)
        smooth = smooth - np.exp(-log_lead - (start + 1.0) * np.log(self._s + rate))
        elapsed = np.maximum(self._grid - x[-1] if delayed else self._grid, 0.0)
        sudden = elapsed**start * np.exp(-rate * elapsed - log_lead) / math.gamma(start + 1.0)
        smooth_samples = self._fold(smooth * kernel.lag if delayed else smooth)
        spectrum: Complexes = smooth_samples + np.fft.rfft(sudden * self._damp)
        return spectrum

    def _fold(self, transform: Complexes) -> Complexes:
        """The spectrum of the samples of a signal from its transform, which reaches twice as far."""
        half = self._s.size // 2 + 1
        folded: Complexes = (transform[..., :half] + transform[..., ::-1][..., :half].conj()) / self._h
        return folded

    def _signals(self, spectra: Complexes) -> Floats:
        """Signals at the instants of the record, shape (n, k)."""
        grid = np.fft.irfft(spectra, axis=1)[:, : self._cells + 1] / self._damp[: self._cells + 1]
        if self._aligned:
            return np.ascontiguousarray(grid[:, : self.time.size].T)
        place = np.minimum(self.time / self._h, self._cells - 1e-9)
        left = place.astype(np.intp)
        share = place - left
        return ((1.0 - share) * grid[:, left] + share * grid[:, left + 1]).T


def _cell_averages(record: Record, cells: int, width: float) -> Floats:
    """Averages of the held control over cells of equal width [s]."""
    held = np.concatenate([[0.0], np.cumsum(record.control[:-1] * np.diff(record.time))])
    edges = record.time[0] + width * np.arange(cells + 1)
    averages: Floats = np.diff(np.interp(edges, record.time, held)) / width
    return averages
