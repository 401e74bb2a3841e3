"""Step responses of loops with delay: what is sudden, what rings, and the smooth rest by inverse FFT."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.errors import UnknownResponseError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.asymptotics import SingularPart, expansion_at_infinity
from fopid_core.model.delay_free import MOST_SAMPLES, check_growth, check_span
from fopid_core.model.inversion import Piece, Signals, fastest_rate, invert, values_at
from fopid_core.model.modes import Modes
from fopid_core.model.poles import Path, Poles, count_right_of, poles_right_of
from fopid_core.model.quasipolynomial import Points, QuasiPolynomial, Term
from fopid_core.model.step_transforms import StepTransforms

_LINES = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.003, 0.001)  # over the longest delay
_ANGLE = 0.75 * math.pi  # of the path near the cut of fractional powers
_MOST_MODES = 60  # poles, conjugates counted
_CLEAR = 1e-7
_CALM = 30.0  # a mode has died out after so many of its time constants
_LEFT_OUT = 1e-6  # of the transform's integral above the band
_SAMPLES_A_TURN = 32
_ALIVE = 1e-8
_MOST_POINTS, _MOST_WORK = 1 << 22, 1 << 25  # in one window: points, and points times sudden terms
_HIGHEST_POWER = 6.0  # once the sudden part is out, the transforms fall faster than s**-6


@dataclass(frozen=True)
class Delayed:
    """Error and control of a loop with delay after a unit step, at any instant up to the horizon."""

    transforms: StepTransforms
    modes: Modes
    settled: Floats
    sudden: tuple[SingularPart, ...]
    pieces: tuple[Piece, ...]

    @staticmethod
    def of(transforms: StepTransforms, horizon: float) -> Delayed:
        """Up to the horizon.

        Raises
        ------
        UnknownResponseError
            If the loop grows beyond all numbers, its poles near the imaginary axis are not all found, or it would take
            too many points.
        """
        rate = max(transforms.rate, 1.0 / horizon)
        line, modes = _modes(transforms, horizon)
        rate = max(rate, float(np.abs(modes.poles).max(initial=0.0)), 2.0 * line)
        settled = _settled(transforms)
        of_whole_orders = all(part.has_integer_orders for part in (transforms.characteristic, *transforms.numerators))
        whole = of_whole_orders and bool(np.all(np.isfinite(settled)))  # else it fades as a power of time
        settled = settled if whole else np.zeros(2)
        starts = modes.at_infinity(int(_HIGHEST_POWER)) + settled[:, None] * np.eye(1, int(_HIGHEST_POWER))
        sudden = tuple(
            _sudden_part(numerator, transforms.denominator, start, horizon, rate)
            for numerator, start in zip(transforms.numerators, starts, strict=True)
        )

        def smooth(s: Complexes) -> Complexes:
            points = Points(s)
            common = 1.0 / transforms.denominator.at(points)
            parts = zip(transforms.numerators, sudden, strict=True)
            rest = [numerator.at(points) * common - part.transform(points) for numerator, part in parts]
            return np.asarray(np.stack(rest) - modes.transform(s) - settled[:, None] / s)

        def sizes(time: Floats) -> Floats:
            return np.abs(_sudden_signals(sudden, time) + modes.at(time) + settled[:, None])

        work = _MOST_WORK // _MOST_POINTS + sum(len(part.series) for part in sudden)
        growth = -line if whole else 0.0
        signals = Signals(
            smooth, sizes, rate, growth, _band(smooth, rate, line), _CALM / line, True, max(_MOST_WORK // work, 1 << 14)
        )
        return Delayed(transforms, modes, settled, sudden, invert(signals, horizon))

    def at(self, time: Floats) -> Floats:
        """Error and control at rising instants, shape (2, n)."""
        return values_at(self.pieces, time)[0] + self._known(time)

    def error_at(self, time: Floats) -> Floats:
        """The estimated error of both, shape (2, n)."""
        errors = values_at(self.pieces, time)[1] + self.modes.error_at(time)
        before = (time > 0.0) & (time < self.pieces[0].time[0])
        if before.any():  # the signal lies between its first value and that at the first instant
            there = self.at(self.pieces[0].time[:1])
            errors[:, before] += np.abs(there - self.transforms.first_values()[:, None])
        return errors

    def _known(self, time: Floats) -> Floats:
        return _sudden_signals(self.sudden, time) + self.modes.at(time) + self.settled[:, None]

    def instants(self) -> Floats:
        """Rising instants from 0 on that describe the response.

        Raises
        ------
        UnknownResponseError
            If that takes too many.
        """
        check_span(self.transforms.rate, float(self.pieces[0].time[0]), float(self.pieces[-1].time[-1]))
        parts, total, first = [np.zeros(1)], 0, 0.0
        for piece in self.pieces:
            last = float(piece.time[-1])
            turns = self.modes.fastest(first, _ALIVE) * (last - first) / (2.0 * math.pi)
            count = 4 * math.ceil(max(piece.time.size, min(_SAMPLES_A_TURN * turns, 1e18)) / 4)
            total += count
            if total > MOST_SAMPLES:
                raise UnknownResponseError(
                    f"it rings for so long that the response takes more than {total:.3g} samples",
                    f"{MOST_SAMPLES}, or a number of points to give it at",
                    float(self.pieces[-1].time[-1]),
                )
            parts.append(np.linspace(first, last, count + 1)[1:])
            first = last
        return np.concatenate(parts)


def _modes(transforms: StepTransforms, horizon: float) -> tuple[float, Modes]:
    """A line left of the imaginary axis, its distance [1/s], and all modes to the right of it."""
    function = transforms.characteristic
    longest = transforms.longest_delay
    angle = math.pi if function.has_integer_orders else _ANGLE
    at_origin = function.zeros_at_origin - int(function.lowest_order) if function.has_integer_orders else 0
    for share in _LINES:
        path = Path(angle, share / longest)
        count, clearance = count_right_of(function, path)
        count -= at_origin  # it leaves aside those of s itself, but not those that delays make
        if not 0 <= count <= _MOST_MODES or clearance < _CLEAR:
            continue
        found = poles_right_of(function, path, count)
        if found is not None:
            check_growth(found.values, horizon)
            return path.line, Modes.of(transforms, found, _to_edge(found, path))
    raise UnknownResponseError(
        "the poles near the imaginary axis could not all be found, so that the response is not known",
        "a loop further from the border, or a shorter delay beside its speed",
        horizon,
    )


def _to_edge(found: Poles, path: Path) -> Floats:
    """How far each pole is from what may lie beyond the path."""
    if path.angle >= math.pi:
        return np.asarray(found.values.real + path.line)
    to_ray = np.abs(found.values) * np.sin(np.minimum(path.angle - np.angle(found.values), 0.5 * math.pi))
    return np.asarray(np.minimum(found.values.real + path.line, to_ray))


def _settled(transforms: StepTransforms) -> Floats:
    """The residues at s = 0, where the signals go but for the modes; not finite where it is no simple pole."""
    under = transforms.characteristic
    if under.lowest_order > 0.0 or under.sum_of_order(0.0) == 0.0:
        return np.full(2, np.nan)
    return np.array([n.sum_of_order(0.0) / under.sum_of_order(0.0) for n in transforms.numerators])


def _band(smooth: Callable[[Complexes], Complexes], rate: float, line: float) -> float:
    """The frequency [rad/s] above which next to nothing is left of the transforms' integral."""
    w = np.exp(np.linspace(math.log(1e-2 * min(line, rate)), math.log(1e2 * max(rate, line)), 3000))
    sizes = np.abs(smooth(1j * w)).max(axis=0) * w
    left = np.cumsum(sizes[::-1])[::-1] * math.log(w[1] / w[0]) / math.pi
    return float(w[min(int(np.argmax(left < _LEFT_OUT)) or w.size - 1, w.size - 1)])


def _sudden_signals(sudden: tuple[SingularPart, ...], time: Floats) -> Floats:
    return np.stack([part.signal(time) for part in sudden])


def _sudden_part(
    numerator: QuasiPolynomial, denominator: QuasiPolynomial, start: Floats, horizon: float, rate: float
) -> SingularPart:
    """What is sudden in a signal without its modes, which begin with ``start`` [0] / s + ``start`` [1] / s^2 + ..."""
    if rate > fastest_rate(horizon):  # it would only hold in instants too short to be seen
        return SingularPart.of(QuasiPolynomial(()), rate, _HIGHEST_POWER)
    expansion = expansion_at_infinity(numerator, denominator, -_HIGHEST_POWER, horizon, rate)
    less = QuasiPolynomial.of(Term(-float(i + 1), 0.0, -float(c)) for i, c in enumerate(start))
    return SingularPart.of(expansion + less, rate, _HIGHEST_POWER)
