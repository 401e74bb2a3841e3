"""Whether a table of gains is sound: at each operating point, and on the way between two of them.

The scheduling variable stands still in all of this ("frozen"): what is shown holds for a variable that moves slowly
beside the loop (Rugh and Shamma, Automatica 36, 2000).

At a point the loop is checked exactly, as any design. Between two neighbours a and b the curve of f = D + C N, of
process N/D and controller C, goes from that of a to that of b. If f(jw) meets the origin at no frequency on the way, no
pole of the loop crosses the imaginary axis: what is stable at a is stable all along. f has no poles there, so that no
resonance hides between two values. The way is the straight line between the two curves, but for a sag, which is seen in
the middle and taken twice; the grid of the variable is refined until all is clear, or the effort is used up. With the
distance of f from the origin, S = D/f and T = C N/f are bounded on the way as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from fopid_core.design.sampled_loop import Running, running
from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.process import Process, read_process
from fopid_core.model.quasipolynomial import number_text
from fopid_core.model.stability import stability
from fopid_core.runtime.schedule import GainSchedule

_POINTS_PER_DECADE = 120  # of frequency, beside those of the loops' own grids
_SAG = 2.0  # a parabola sags most in its middle; twice that is on the safe side
_DEEPEST = 9  # halvings of the way between two operating points
_RESERVED = ("s", "e", "exp")


@dataclass(frozen=True)
class ScheduleBounds:
    """What is asked of every loop of a table; infinite for nothing.

    Attributes
    ----------
    ms_max, mt_max : float
        Of max abs(S) and max abs(T).
    """

    ms_max: float = math.inf
    mt_max: float = math.inf

    def __post_init__(self) -> None:
        for name in ("ms_max", "mt_max"):
            if not getattr(self, name) > 1.0:
                raise InputError(f"bounds.{name} = {getattr(self, name)}; allowed: above 1")


@dataclass(frozen=True)
class PointCheck:
    """The loop at one value of the scheduling variable.

    Attributes
    ----------
    at : float
    loop : Loop
    stable : bool or None
        None where it is not known.
    ms, mt : float
        NaN unless it is stable.
    """

    at: float
    loop: Loop
    stable: bool | None
    ms: float
    mt: float


@dataclass(frozen=True)
class WayCheck:
    """The loops between two operating points.

    Attributes
    ----------
    first, last : float
    stable : bool or None
        None where the grid is not fine enough to say.
    ms, mt : float
        No loop on the way exceeds these; infinite where that is not known.
    checked : int
        Values of the variable at which the loop was looked at.
    """

    first: float
    last: float
    stable: bool | None
    ms: float
    mt: float
    checked: int


@dataclass(frozen=True)
class ScheduleCheck:
    """What is known of a table of gains.

    Attributes
    ----------
    points : tuple of PointCheck
    ways : tuple of WayCheck
        Between one point and the next.
    running : tuple of Running
        The sampled loop at each point; empty without a sample time.
    unmet : tuple of str
        What is not as it should be, or not known; empty for a table that is sound.
    """

    points: tuple[PointCheck, ...]
    ways: tuple[WayCheck, ...]
    running: tuple[Running, ...]
    unmet: tuple[str, ...]


def check_schedule(schedule: GainSchedule, content: Mapping[str, Any]) -> ScheduleCheck:
    """Check a table of gains on its process.

    Parameters
    ----------
    schedule : GainSchedule
    content : mapping
        The file's: ``process``, and by choice ``bounds`` and ``sample_time``.

    Raises
    ------
    InputError
        If there is no process, or it cannot be read.

    Examples
    --------
    >>> from fopid_core.runtime.schedule import parse_schedule
    >>> content = {"process": "K/(s+1)^3", "bounds": {"ms_max": 1.7}, "points": [
    ...     {"at": 1, "K": 1, "kp": 1.0, "ki": 0.4}, {"at": 2, "K": 2, "kp": 0.5, "ki": 0.2}]}
    >>> check_schedule(parse_schedule(content), content).unmet
    ()
    """
    loops = _Loops(schedule, content)
    bounds = _bounds(content.get("bounds", {}))
    values = [point.at for point in schedule.points]
    points = tuple(loops.check(value) for value in values)
    ways = tuple(_way(loops, first, last, bounds) for first, last in pairwise(values))
    sample_time = content.get("sample_time")
    sampled = () if sample_time is None else tuple(
        running(each.loop.process, each.loop.controller, _sample_time(sample_time)) for each in points
    )  # fmt: skip
    return ScheduleCheck(points, ways, sampled, tuple(_unmet(points, ways, sampled, bounds)))


class _Loops:
    """The loop at any value of the scheduling variable."""

    def __init__(self, schedule: GainSchedule, content: Mapping[str, Any]) -> None:
        source = content.get("process")
        if not isinstance(source, str):
            raise InputError(f"process = {source!r}; allowed: the text of a process, to check the loops with")
        self._schedule, self._source = schedule, source
        self._names = tuple(schedule.points[0].process)
        for k, point in enumerate(schedule.points):
            if tuple(sorted(point.process)) != tuple(sorted(self._names)):
                given, allowed = (", ".join(names) or "none" for names in (point.process, self._names))
                raise InputError(f"points[{k}]: names {given}; allowed: those of points[0], {allowed}")
        for name in self._names:
            if name in _RESERVED or not re.fullmatch(r"[A-Za-z]\w*", name):
                raise InputError(f"name {name!r}; allowed: one such as K, T or tau1, other than s, e and exp")
            if not re.search(rf"\b{name}\b", source):
                raise InputError(f"name {name!r}: not in the process {source!r}; allowed: its names, and the gains")
        self.check = lru_cache(maxsize=None)(self._check)
        self._read = lru_cache(maxsize=None)(read_process)

    def process(self, value: float) -> Process:
        """With the names interpolated as the gains are."""
        k, share = self._schedule.place(value)
        first, second = self._schedule.points[k].process, self._schedule.points[k + 1].process
        text = self._source
        for name in self._names:
            number = (1.0 - share) * first[name] + share * second[name]
            text = re.sub(rf"\b{name}\b", f"({number_text(number)})", text)
        return self._read(text)

    def _check(self, value: float) -> PointCheck:
        loop = Loop(self.process(value), self._schedule.gains_at(value))
        stable = stability(loop).stable
        if not stable:
            return PointCheck(value, loop, stable, math.nan, math.nan)
        peaks = LoopPeaks(loop)
        return PointCheck(value, loop, stable, peaks.sensitivity().value, peaks.complementary().value)


def _way(loops: _Loops, first: float, last: float, bounds: ScheduleBounds) -> WayCheck:
    """Halve the way until all of it is known to be sound, or a loop on it is known not to be.

    Without bounds it is enough to know that the loops are stable.
    """
    ms = mt = 0.0
    stable: bool | None = True
    seen = {first, last}
    pieces = [(first, last, 0)]
    while pieces:
        low, high, depth = pieces.pop()
        middle = 0.5 * (low + high)
        seen.add(middle)
        at = [loops.check(value) for value in (low, middle, high)]
        if any(each.stable is not True for each in at):
            return WayCheck(first, last, False if any(each.stable is False for each in at) else None,
                            math.inf, math.inf, len(seen))  # fmt: skip
        highest = _band(at)
        clear = highest[0] <= bounds.ms_max and highest[1] <= bounds.mt_max and highest[0] < math.inf
        broken = highest[0] < math.inf and any(each.ms > bounds.ms_max or each.mt > bounds.mt_max for each in at)
        if clear or broken or depth >= _DEEPEST:
            stable = stable if highest[0] < math.inf else None
            ms, mt = max(ms, highest[0]), max(mt, highest[1])
        else:
            pieces += [(low, middle, depth + 1), (middle, high, depth + 1)]
    return WayCheck(first, last, stable, ms, mt, len(seen))


def _band(at: list[PointCheck]) -> tuple[float, float]:
    """More than max abs(S) and max abs(T) of all loops between the first and the last of three; infinite if unknown."""
    s = 1j * _frequencies(at)
    process = [each.loop.process.denominator(s) for each in at]
    forward = [each.loop.controller(s) * each.loop.process.numerator(s) for each in at]
    closed = [d + f for d, f in zip(process, forward, strict=True)]
    distance = _distance(closed[0], closed[-1]) - _sag(closed)
    if not distance.min() > 0.0:
        return math.inf, math.inf
    return float((_reach(process) / distance).max()), float((_reach(forward) / distance).max())


def _sag(curves: list[Complexes]) -> Floats:
    """How far the curves between the first and the last of three may be from the straight way."""
    sag: Floats = _SAG * np.abs(curves[1] - 0.5 * (curves[0] + curves[-1]))
    return sag


def _reach(curves: list[Complexes]) -> Floats:
    """The largest value on the way."""
    reach: Floats = np.maximum(np.abs(curves[0]), np.abs(curves[-1])) + _sag(curves)
    return reach


def _frequencies(at: list[PointCheck]) -> Floats:
    """[rad/s], where anything happens in the loops, and evenly in between."""
    own = np.concatenate([LoopPeaks(each.loop).log_frequency for each in at])
    count = math.ceil((own.max() - own.min()) / math.log(10.0) * _POINTS_PER_DECADE) + 2
    frequencies: Floats = np.exp(np.union1d(own, np.linspace(own.min(), own.max(), count)))
    return frequencies


def _distance(a: Complexes, b: Complexes) -> Floats:
    """Of the origin from the straight lines between complex numbers."""
    step = b - a
    length = np.abs(step) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(length > 0.0, np.clip(-(a.conj() * step).real / length, 0.0, 1.0), 0.0)
    distance: Floats = np.abs(a + share * step)
    return distance


def _bounds(given: Any) -> ScheduleBounds:
    names = ("ms_max", "mt_max")
    if not isinstance(given, dict) or set(given) - set(names):
        raise InputError(f"bounds = {given!r}; allowed: a mapping with {' and '.join(names)}")
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"bounds.{name} = {value!r}; allowed: a number above 1")
    return ScheduleBounds(**{name: float(value) for name, value in given.items()})


def _sample_time(given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not 1e-6 <= given <= 1e6:
        raise InputError(f"sample_time = {given!r}; allowed: 1e-06 to 1e+06 [s]")
    return float(given)


def _unmet(
    points: tuple[PointCheck, ...], ways: tuple[WayCheck, ...], sampled: tuple[Running, ...], bounds: ScheduleBounds
) -> list[str]:
    """What is not as it should be, in words."""
    found = []
    for each in points:
        where = f"at {each.at:g}"
        if each.stable is not True:
            found.append(f"{where}: {'unstable' if each.stable is False else 'not known to be stable'}")
        found += [
            f"{where}: max |{name}| = {value:.4g}; asked: {most:g}"
            for name, value, most in (("S", each.ms, bounds.ms_max), ("T", each.mt, bounds.mt_max))
            if value > most * (1.0 + 1e-6)
        ]
    for way in ways:
        where = f"from {way.first:g} to {way.last:g}"
        if way.stable is not True:
            found.append(f"{where}: {'unstable on the way' if way.stable is False else 'not known to be stable'}")
            continue
        found += [
            f"{where}: max |{name}| is not known to be below {value:.4g}; asked: {most:g}"
            for name, value, most in (("S", way.ms, bounds.ms_max), ("T", way.mt, bounds.mt_max))
            if value > most
        ]
    for each, loop in zip(points, sampled, strict=False):
        if loop.stable is not True:
            found.append(f"at {each.at:g}, sampled: {loop.reason or 'unstable'}")
    return found
