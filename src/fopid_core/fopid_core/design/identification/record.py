"""The signals that a process is learnt from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Floats

FEWEST_SAMPLES = 30
REGULAR = 1e-3
"""Samples are evenly spaced when none is further from its place than this share of the sample time."""
_NEAR_TICKS = 0.15
"""Instants lie near ticks when their distances are, on the mean, no further than this from whole numbers of them."""
_BREAK_SAMPLES, _BREAK_TIMES = 50.0, 5.0
"""A distance of so many usual ones, and so many times as long as anything that was recorded without one, is a break;
what is shorter may be a measurement that is told only where it changes."""
_HOLE_TICKS, _EVEN, _EVEN_SHARE, _MOVED = 20.0, 0.1, 0.9, 3.0
"""So is one of so many ticks in a record that is even otherwise, to a share of a tick at a share of its instants, where
the control is another afterwards by so many times its usual moves: nobody knows when it moved."""
_LOOKS, _WORTH_A_LOOK = 3, 0.3
"""So many stretches are of interest, if they have that share of the longest's samples."""
_BLOCKS, _EVERY = 250, 5
"""The record is cut into about so many blocks; every fifth is held back to judge the fit."""


def validation_samples(samples: int) -> Booleans:
    """Which samples judge the fit and take no part in it: stretches so short that no transient falls between them."""
    return np.asarray(np.arange(samples) // max(samples // _BLOCKS, 1) % _EVERY == _EVERY // 2)


@dataclass(frozen=True)
class Record:
    """Signals of one run, open or closed loop; all arrays have shape (n,).

    Attributes
    ----------
    time : ndarray
        Instants [s], ascending, at any distances.
    control : ndarray
        The control from each instant on, held until the next.
    measurement : ndarray
        The measurement at each instant, before the control of that instant acts.
    setpoint : ndarray, optional
        Kept for those who want it; the fit needs control and measurement only.
    control_before : float, optional
        The control at which the process rested before the first instant, where that is known.
    left_out : int
        Rows of the source that had a gap and are not here.
    control_min, control_max, control_rate_max : float
        Limits of the control and of its moves per second, where the source says them; else infinite.
    excitation : ndarray, optional
        What an experiment has added to the control, where that is known: a part of the control that answers nothing.
    late : float
        By how long the source told the control late [s], which has been made good.

    Examples
    --------
    >>> time = np.arange(0.0, 5.0, 0.1)
    >>> Record(time, np.ones(50), 1.0 - np.exp(-time), control_before=0.0).sample_time
    0.1
    """

    time: Floats
    control: Floats
    measurement: Floats
    setpoint: Floats | None = None
    control_before: float | None = None
    left_out: int = 0
    control_min: float = -math.inf
    control_max: float = math.inf
    control_rate_max: float = math.inf
    excitation: Floats | None = None
    late: float = 0.0

    def __post_init__(self) -> None:
        for name in ("time", "control", "measurement", "setpoint", "excitation"):
            if getattr(self, name) is not None:
                self._take(name)
        if self.time.size < FEWEST_SAMPLES:
            raise InputError(f"record of {self.time.size} samples; allowed: {FEWEST_SAMPLES} or more, record longer")
        if not (self.control_min < self.control_max and self.control_rate_max > 0.0):
            given = f"control from {self.control_min:g} to {self.control_max:g}, rate up to {self.control_rate_max:g}"
            raise InputError(f"{given}; allowed: the lower limit first, a rate above 0")
        if self.control_before is not None and not math.isfinite(self.control_before):
            raise InputError(f"control_before = {self.control_before}; allowed: a finite number")
        behind = np.flatnonzero(np.diff(self.time) <= 0.0)
        if behind.size:
            given = f"time = {self.time[behind[0] + 1]:g} at row {behind[0] + 2}"
            raise InputError(f"{given}; allowed: ascending times; leave out rows that repeat or go back")

    def _take(self, name: str) -> None:
        values = np.asarray(getattr(self, name), dtype=np.float64)
        if values.ndim != 1 or values.shape != np.shape(self.time):
            raise InputError(f"{name} of shape {values.shape}; allowed: one number for each of the instants")
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            given = f"{name} = {values[wrong[0]]} at row {wrong[0] + 1}"
            raise InputError(f"{given}; allowed: finite numbers; leave out rows without")
        object.__setattr__(self, name, values)

    @property
    def span(self) -> float:
        """From the first to the last instant [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def sample_time(self) -> float:
        """The time between two ticks [s], to nine digits: of a record without ticks, the mean distance of two instants.

        Where samples are missing, the others still lie near ticks; their mean distance would fall between these.

        Examples
        --------
        >>> time = np.delete(np.arange(0.0, 10.0, 0.1), [20, 50, 51])
        >>> Record(time, time, time).sample_time
        0.1
        """
        gaps = np.diff(self.time)
        passed = gaps / np.median(gaps)
        ticks = np.round(passed)
        near = float(np.mean(np.abs(passed - ticks))) < _NEAR_TICKS
        return float(f"{self.span / (float(ticks.sum()) if near else gaps.size):.9g}")

    @property
    def is_regular(self) -> bool:
        """Whether the instants are evenly spaced."""
        even = np.linspace(self.time[0], self.time[-1], self.time.size)
        return bool(np.abs(self.time - even).max() < REGULAR * self.sample_time)

    @property
    def breaks(self) -> list[float]:
        """After which instants nothing was recorded for long, or the control was moved meanwhile [s].

        Examples
        --------
        >>> time = np.arange(0.0, 5.0, 0.1)
        >>> Record(np.append(time, time + 1000.0), np.ones(100), np.ones(100)).breaks
        [4.9]
        """
        gaps = np.diff(self.time)
        before = np.flatnonzero(gaps > _BREAK_SAMPLES * np.median(gaps))
        edges = np.concatenate([[-1], before, [gaps.size]])
        longest = (self.time[edges[1:]] - self.time[edges[:-1] + 1]).max()
        long = {k for k in before.tolist() if gaps[k] > _BREAK_TIMES * longest}
        return [float(self.time[k]) for k in sorted(long | self._holes)]

    @property
    def _holes(self) -> set[int]:
        """After which samples of an even record some are missing while the control was moved."""
        gaps, moves = np.diff(self.time), np.abs(np.diff(self.control))
        usual = np.median(gaps)
        if np.mean(np.abs(gaps - usual) <= _EVEN * usual) < _EVEN_SHARE:
            return set()
        moved = moves > _MOVED * np.quantile(moves, 0.95)
        return set(np.flatnonzero((gaps > _HOLE_TICKS * usual) & moved).tolist())

    @cached_property
    def stretches(self) -> tuple[Record, ...]:
        """Those between breaks, the longest first; what is much shorter than that says nothing beside it.

        Raises
        ------
        InputError
            If even the longest has too few samples.
        """
        breaks = self.breaks
        if not breaks:
            return (self,)
        edges = [-math.inf, *breaks, math.inf]
        inside = [self.time[(self.time > first) & (self.time <= last)] for first, last in pairwise(edges)]
        inside.sort(key=np.size, reverse=True)
        most = inside[0].size
        if most < FEWEST_SAMPLES:
            raise InputError(
                f"{most} of {self.time.size} samples between two gaps; allowed: {FEWEST_SAMPLES} or more; where only "
                "changes are told, export at even times"
            )
        least = max(FEWEST_SAMPLES, _WORTH_A_LOOK * most)
        return tuple(self.part(float(each[0]), float(each[-1])) for each in inside[:_LOOKS] if each.size >= least)

    @property
    def instrument(self) -> Floats | None:
        """What is known to have moved the loop from outside: an experiment, or else the setpoint; None for nothing."""
        for signal in (self.excitation, self.setpoint):
            if signal is not None and np.ptp(signal) > 0.0:
                return signal
        return None

    def evenly(self, most: int) -> Record:
        """The same at even instants, at most so many: measurements of some, the control's means between them.

        Examples
        --------
        >>> time = np.arange(0.0, 10.0, 0.1)
        >>> thin = Record(time, np.sin(time), time).evenly(50)
        >>> thin.time.size, thin.sample_time, thin.is_regular, float(thin.measurement[1])
        (50, 0.2, True, 0.2)
        """
        if self.is_regular and self.time.size <= most:
            return self
        each = -(-self.time.size // most)
        h = each * self.sample_time
        time = self.time[0] + h * np.arange(math.ceil(self.span / h + 0.5 / each))
        ends = np.append(self.time, self.time[-1] + self.sample_time)
        given = np.concatenate([[0.0], np.cumsum(self.control * np.diff(ends))])
        control = np.diff(np.interp(np.append(time, time[-1] + h), ends, given)) / h
        control[-1] = self.control[-1]
        measurement = self.measurement[::each] if self.is_regular else np.interp(time, self.time, self.measurement)
        latest = np.searchsorted(self.time, time + REGULAR * self.sample_time, side="right") - 1
        setpoint, excitation = (None if x is None else x[latest] for x in (self.setpoint, self.excitation))
        return replace(
            self, time=time, control=control, measurement=measurement, setpoint=setpoint, excitation=excitation
        )

    def averaged(self, most: int) -> tuple[Floats, Floats]:
        """Instants and measurements, of blocks of samples where there are more than ``most`` samples."""
        each = -(-self.time.size // most)
        if each == 1:
            return self.time, self.measurement
        starts = np.arange(0, self.time.size, each)
        counts = np.diff(np.append(starts, self.time.size))
        return np.add.reduceat(self.time, starts) / counts, np.add.reduceat(self.measurement, starts) / counts

    def part(self, first: float = -math.inf, last: float = math.inf) -> Record:
        """The samples from one instant to another [s].

        Raises
        ------
        InputError
            If there are none between them.

        Examples
        --------
        >>> time = np.arange(0.0, 5.0, 0.1)
        >>> Record(time, time, time).part(first=7.0)
        Traceback (most recent call last):
        fopid_core.errors.InputError: from 7 s to inf s there are no samples; allowed: within 0 s to 4.9 s
        """
        inside = (self.time >= first) & (self.time <= last)
        if not inside.any():
            within = f"{self.time[0]:g} s to {self.time[-1]:g} s"
            raise InputError(f"from {first:g} s to {last:g} s there are no samples; allowed: within {within}")
        setpoint, excitation = (None if x is None else x[inside] for x in (self.setpoint, self.excitation))
        before = self.control_before if inside[0] else None
        return replace(
            self, time=self.time[inside], control=self.control[inside], measurement=self.measurement[inside],
            setpoint=setpoint, control_before=before, excitation=excitation,
        )  # fmt: skip
