"""Gains over a measured variable: a table of operating points, and the file it stands in.

    variable: airspeed [m/s]
    filter_time: 0.5     # [s] of the lag that the variable passes
    hysteresis: 0.2      # by which it may move back and forth without an effect
    process: "K/(T*s+1)*exp(-0.1*s)"
    bounds: {ms_max: 1.6}
    points:
      - {at: 10.0, kp: 2.0, ki: 1.0, K: 1.0, T: 2.0}
      - {at: 20.0, kp: 1.2, ki: 1.0, K: 2.0, T: 1.5}

Between two points the five numbers go in a straight line, and beyond the first and the last they stay. Process and
bounds are for ``design.schedule``, which checks the table; the controller does without.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from fopid_core import safe_yaml
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.settings import LARGEST

_GAINS = ("kp", "ki", "kd", "lam", "mu")
_KEYS = ("variable", "filter_time", "hysteresis", "points", "process", "bounds", "sample_time")
MOST_POINTS = 100


@dataclass(frozen=True)
class OperatingPoint:
    """The gains at one value of the scheduling variable.

    Attributes
    ----------
    at : float
        That value.
    gains : Fopid
    process : mapping
        What the names in the text of the process stand for there.
    """

    at: float
    gains: Fopid
    process: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class GainSchedule:
    """Gains over a scheduling variable.

    Attributes
    ----------
    points : tuple of OperatingPoint
        Ascending.
    filter_time : float
        Time constant of the lag that the variable passes [s]; 0 for none.
    hysteresis : float
        By how much the variable may move back and forth without an effect.
    variable : str
        What it is, for people.

    Examples
    --------
    >>> table = GainSchedule((OperatingPoint(0.0, Fopid(1.0)), OperatingPoint(2.0, Fopid(3.0, 1.0))))
    >>> [str(table.gains_at(value)) for value in (0.5, 9.0)]
    ['1.5 + 0.25 s^-1 + 0 s^1', '3 + 1 s^-1 + 0 s^1']
    """

    points: tuple[OperatingPoint, ...]
    filter_time: float = 0.0
    hysteresis: float = 0.0
    variable: str = ""

    def __post_init__(self) -> None:
        if not 2 <= len(self.points) <= MOST_POINTS:
            raise InputError(f"points: {len(self.points)} of them; allowed: 2 to {MOST_POINTS}")
        values = [point.at for point in self.points]
        for before, after in pairwise(values):
            if not before < after:
                raise InputError(f"points: at = {after:g} after {before:g}; allowed: ascending, each once")
        for name in ("filter_time", "hysteresis"):
            if not 0.0 <= getattr(self, name) <= 1e9:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: 0 to 1e+09")

    def place(self, value: float) -> tuple[int, float]:
        """Between which two points a value is: the number of the first, and the share of the second."""
        values = [point.at for point in self.points]
        k = min(max(bisect_right(values, value) - 1, 0), len(values) - 2)
        share = (value - values[k]) / (values[k + 1] - values[k])
        return k, min(max(share, 0.0), 1.0)

    def gains_at(self, value: float) -> Fopid:
        """The five numbers at a value of the variable."""
        k, share = self.place(value)
        return between(self.points[k].gains, self.points[k + 1].gains, share)


def between(first: Fopid, second: Fopid, share: float) -> Fopid:
    """Five numbers on the straight line from ``first`` to ``second``; at share 1 the second."""
    pairs = zip(first.gains, second.gains, strict=True)
    return Fopid(*((1.0 - share) * a + share * b for a, b in pairs))


def read_schedule(path: Path) -> tuple[GainSchedule, Mapping[str, Any]]:
    """The table of a file, and the whole content of it.

    Raises
    ------
    InputError
        Naming the file, the key, its value and what is allowed.
    """
    content = safe_yaml.read(path, "schedule")
    try:
        return parse_schedule(content), content
    except InputError as error:
        raise InputError(f"schedule {str(path)!r}: {error}") from None


def parse_schedule(content: Any) -> GainSchedule:
    """The table in the plain data of a file.

    Examples
    --------
    >>> parse_schedule({"points": [{"at": 1, "kp": 2}, {"at": 3, "kp": 1, "ki": 1}]}).gains_at(2.0).kp
    1.5
    """
    if not isinstance(content, dict) or not isinstance(content.get("points"), list):
        raise InputError("no list of points; allowed: a mapping with points, each with at, kp, ki, kd, lam, mu")
    _refuse_unknown(content, _KEYS)
    return GainSchedule(
        points=tuple(_point(given, k) for k, given in enumerate(content["points"])),
        filter_time=_number(content, "filter_time", 0.0, ""),
        hysteresis=_number(content, "hysteresis", 0.0, ""),
        variable=str(content.get("variable", "")),
    )


def _point(given: Any, k: int) -> OperatingPoint:
    where = f"points[{k}]"
    if not isinstance(given, dict) or "at" not in given:
        raise InputError(f"{where} = {given!r}; allowed: a mapping with at and the gains there")
    numbers = {str(name): _number(given, name, 0.0, f"{where}.") for name in given}
    if not any(name in numbers for name in ("kp", "ki", "kd")):
        raise InputError(f"{where}: no gain; allowed: kp, ki, kd, at least one of them")
    gains = {"kp": 0.0} | {name: numbers[name] for name in _GAINS if name in numbers}
    others = {name: value for name, value in numbers.items() if name not in ("at", *_GAINS)}
    try:
        return OperatingPoint(numbers["at"], Fopid(**gains), others)
    except InputError as error:
        raise InputError(f"{where}.{error}") from None


def _number(content: Mapping[Any, Any], name: Any, default: float, where: str) -> float:
    value = content.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise InputError(f"{where}{name} = {value!r}; allowed: a finite number")
    return float(value) if math.isfinite(value) else default


def _refuse_unknown(content: Mapping[Any, Any], allowed: Iterable[str]) -> None:
    for name in content:
        if name not in allowed:
            raise InputError(f"key {name!r}; allowed: {', '.join(allowed)}")
