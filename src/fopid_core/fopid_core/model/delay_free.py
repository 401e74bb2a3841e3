"""Step responses of loops without delay: known modes, and hyperbolas about everything else."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fopid_core.errors import UnboundedResponseError, UnknownResponseError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.contour import WINDOW_RATIO, Windows, invert_on_hyperbolas
from fopid_core.model.modes import LARGEST_EXPONENT, Modes
from fopid_core.model.poles import Path, Poles, count_right_of, poles_right_of
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.step_transforms import StepTransforms

_SECTORS = (0.25, 0.17, 0.32, 0.1, 0.05)  # of pi, beyond the imaginary axis, in the order they are tried
_GOOD_ENOUGH = 1e-9
_FIRST_INSTANT = 1e-4  # of the fastest time
_MOST_WINDOWS = 60
_FEWEST_SAMPLES = 256  # in a window
_SAMPLES_A_TURN = (64, 32)  # as many as wished, or fewer where that takes too many
MOST_SAMPLES = 1 << 22
_ALIVE = 1e-8
_FIRST_SEEN = 1e-2  # of the fastest time: later, the start of the response would be missed
_BLOCK = 1 << 17


@dataclass(frozen=True)
class DelayFree:
    """Error and control of a loop without delay after a unit step, at any instant up to the horizon."""

    modes: Modes
    windows: Windows
    first_values: Floats
    rate: float

    @staticmethod
    def of(transforms: StepTransforms, horizon: float, first: float | None = None) -> DelayFree:
        """For instants from ``first`` [s] on, by default from far below the loop's fastest time on.

        Raises
        ------
        UnknownResponseError
            If the loop grows beyond all numbers, or its poles are not all found.
        """
        rate = transforms.rate
        shortest = horizon * WINDOW_RATIO**-_MOST_WINDOWS
        wanted = _FIRST_INSTANT / rate if first is None and rate > 0.0 else first or horizon
        start = min(max(wanted, shortest), horizon / WINDOW_RATIO)
        best: DelayFree | None = None
        for sector in _SECTORS:
            found = _modes(transforms, sector * math.pi, horizon)
            if found is None:
                continue
            modes = found
            windows = _windows(transforms, modes, 0.95 * sector * math.pi, start, horizon)
            if best is None or windows.errors[:, 0].max() < best.windows.errors[:, 0].max():
                best = DelayFree(modes, windows, transforms.first_values(), rate)
            if best.windows.errors[:, 0].max() < _GOOD_ENOUGH:
                break
        if best is None:
            raise UnknownResponseError(
                "the poles could not all be found, so that the response is not known",
                "a loop whose poles lie further apart",
                horizon,
            )
        return best

    def at(self, time: Floats) -> Floats:
        """Error and control at rising instants, shape (2, n)."""
        values = np.concatenate([self._at(time[i : i + _BLOCK]) for i in range(0, time.size, _BLOCK)], axis=1)
        values[:, time <= 0.0] = self.first_values[:, None]
        return values

    def _at(self, time: Floats) -> Floats:
        return self.windows.at(time) + self.modes.at(time)

    def error_at(self, time: Floats) -> Floats:
        """The estimated error of both, shape (2, n)."""
        errors = np.concatenate(
            [
                self.windows.error_at(part) + self.modes.error_at(part)
                for part in (time[i : i + _BLOCK] for i in range(0, time.size, _BLOCK))
            ],
            axis=1,
        )
        errors[:, time <= 0.0] = 0.0
        before = (time > 0.0) & (time < self.windows.edges[0])
        if before.any():  # the signal lies between its first value and that at the first edge
            errors[:, before] += np.abs(self._at(self.windows.edges[:1]) - self.first_values[:, None])
        return errors

    def instants(self) -> Floats:
        """Rising instants from 0 on that describe the response: evenly spaced in each window, an even number in each.

        Raises
        ------
        UnknownResponseError
            If that takes too many.
        """
        edges = self.windows.edges
        check_span(self.rate, float(edges[0]), float(edges[-1]))
        turns = [self.modes.fastest(float(a), _ALIVE) * (b - a) / (2.0 * math.pi) for a, b in itertools.pairwise(edges)]
        for each in _SAMPLES_A_TURN:
            counts = [max(_FEWEST_SAMPLES, 4 * math.ceil(min(each * turn, 1e18) / 4)) for turn in turns]
            if sum(counts) <= MOST_SAMPLES:
                break
        else:
            raise UnknownResponseError(
                f"it rings for so long that the response takes {sum(counts):.3g} samples",
                f"{MOST_SAMPLES} samples, or a number of points to give it at",
                edges[-1],
            )
        parts = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(itertools.pairwise(edges), counts, strict=True)]
        return np.concatenate(([0.0, edges[0]], *parts))


@lru_cache(8)  # a loop is asked for its answer to the setpoint and to the load in turn
def _poles(characteristic: QuasiPolynomial, path: Path) -> Poles | None:
    count, _ = count_right_of(characteristic, path)
    return poles_right_of(characteristic, path, count)


def _modes(transforms: StepTransforms, sector: float, horizon: float) -> Modes | None:
    """The modes within ``sector`` of the right half-plane; None when they are not all found."""
    path = Path(0.5 * math.pi + sector)
    found = _poles(transforms.characteristic, path)
    if found is None:
        return None
    check_growth(found.values, horizon)
    to_edge = np.abs(found.values) * np.sin(np.minimum(path.angle - np.angle(found.values), 0.5 * math.pi))
    return Modes.of(transforms, found, to_edge)


def check_span(rate: float, first: float, horizon: float) -> None:
    """Refuse to describe what happens before the first instant that is seen."""
    if rate * first > _FIRST_SEEN:
        raise UnknownResponseError(
            f"it moves within {1.0 / rate:.3g} s",
            f"up to {_FIRST_SEEN / rate * (horizon / first):.3g} s, or a number of points to give the response at",
            horizon,
        )


def check_growth(poles: Complexes, horizon: float) -> None:
    """Refuse what grows beyond all numbers."""
    if poles.size and float(poles.real.max()) * horizon > LARGEST_EXPONENT:
        raise UnboundedResponseError(
            f"what is unstable grows by more than exp({LARGEST_EXPONENT:g}) until then", "a shorter one", horizon
        )


def _windows(transforms: StepTransforms, modes: Modes, sector: float, first: float, last: float) -> Windows:
    def remainder(s: Complexes) -> tuple[Complexes, Floats]:
        values, errors = transforms.with_rounding(s)
        return values - modes.transform(s), errors + modes.transform_error(s)

    return invert_on_hyperbolas(remainder, sector, first, last)
