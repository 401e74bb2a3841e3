"""What a setpoint or a disturbance does within a phase: held, in steps, along a ramp or a sine, or as recorded.

``values`` is the one place where a profile becomes numbers, for the loop over ROS and the one without.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.experiments.yaml_schema import Tagged


@dataclass(frozen=True)
class Steps(Tagged):
    """Held values: ``points`` are (time from the start of the phase [s], value), in the order of time."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        times = [time for time, _ in self.points]
        if not times or times != sorted(times) or times[0] < 0.0:
            raise InputError(
                f"steps at {_shortened(times)} s; allowed: at least one, from 0 s on, in the order of time"
            )
        if not all(math.isfinite(number) for point in self.points for number in point):
            raise InputError("steps with a number that is not finite; allowed: finite numbers")


@dataclass(frozen=True)
class Ramp(Tagged):
    """From the present value to ``to`` within ``over`` [s], then held."""

    to: float
    over: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.to):
            raise InputError(f"to = {self.to}; allowed: a finite number")
        if not 0.0 < self.over < math.inf:
            raise InputError(f"over = {self.over}; allowed: above 0 s")


@dataclass(frozen=True)
class Sine(Tagged):
    """About the present value: ``amplitude`` times the sine of 2 pi t / ``period`` [s] + ``phase_deg``."""

    amplitude: float
    period: float
    phase_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("amplitude", "phase_deg"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(f"{name} = {getattr(self, name)}; allowed: a finite number")
        if not 0.0 < self.period < math.inf:
            raise InputError(f"period = {self.period}; allowed: above 0 s")


@dataclass(frozen=True)
class File(Tagged):
    """Held values from a csv file with the columns ``time`` [s] (from the start of the phase) and ``value``."""

    path: str


@dataclass(frozen=True)
class Bag(Tagged):
    """The signal of the same name from a bag, its 0 s at the start of the phase."""

    path: str


Profile = float | Steps | Ramp | Sine
"""What can be run; a number is held."""

Written = Profile | File | Bag
"""What can be written in a file."""


def check(name: str, profile: Written | None) -> None:
    """Raise InputError for a number that is not finite."""
    if isinstance(profile, (int, float)) and not math.isfinite(profile):
        raise InputError(f"{name} = {profile}; allowed: a finite number")


def loaded(name: str, profile: Written | None, folder: Path) -> Profile | None:
    """A profile with its file or bag read, so that it stands for itself.

    Parameters
    ----------
    name : str
        ``setpoint`` or ``disturbance``.
    profile : Profile, File, Bag or None
    folder : Path
        What relative paths start from.

    Raises
    ------
    InputError
        Naming the file or bag that cannot be read.
    """
    if isinstance(profile, File):
        return _read_csv(folder / profile.path)
    if isinstance(profile, Bag):
        return _read_bag(name, folder / profile.path)
    return profile


def _read_csv(path: Path) -> Steps:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return Steps(_points(csv.DictReader(file, skipinitialspace=True)))
    except OSError as error:
        raise InputError(f"file {str(path)!r} cannot be read: {error.strerror}") from None
    except (InputError, UnicodeDecodeError, csv.Error) as error:
        reason = f"{error}; allowed: csv in UTF-8" if not isinstance(error, InputError) else str(error)
        raise InputError(f"file {str(path)!r}: {reason}") from None


def _points(reader: csv.DictReader[str]) -> tuple[tuple[float, float], ...]:
    names = reader.fieldnames or ()
    if not {"time", "value"} <= set(names):
        raise InputError(f"columns {', '.join(names) or 'none'}; allowed: time and value, and others beside them")
    points = []
    for row in reader:
        try:
            points.append((float(row["time"]), float(row["value"])))
        except (TypeError, ValueError):
            given = f"time = {row['time']!r}, value = {row['value']!r}"
            raise InputError(f"line {reader.line_num}: {given}; allowed: numbers") from None
    return tuple(points)


def _read_bag(name: str, path: Path) -> Steps:
    from fopid_core.study.bags.bag import read_bag  # slow to import, and few experiments need it

    signal = read_bag(path, needed=(name,)).signals[name]
    changed = np.flatnonzero(np.diff(signal.value, prepend=np.nan) != 0.0)
    return Steps(tuple(zip(signal.time[changed].tolist(), signal.value[changed].tolist(), strict=True)))


def values(profile: Profile | None, before: float, samples: int, sample_time: float) -> Floats:
    """The values of a profile at samples 0 ... n-1 of its phase.

    Parameters
    ----------
    profile : Profile or None
        None holds.
    before : float
        The value until then.
    samples : int
    sample_time : float
        [s]

    Returns
    -------
    ndarray, shape (samples,)

    Examples
    --------
    >>> values(Ramp(to=2.0, over=2.0), before=1.0, samples=4, sample_time=1.0)
    array([1. , 1.5, 2. , 2. ])
    """
    time = np.arange(samples) * sample_time
    if isinstance(profile, Ramp):
        return np.asarray(before + (profile.to - before) * np.minimum(time / profile.over, 1.0))
    if isinstance(profile, Sine):
        angle = 2.0 * math.pi * time / profile.period + math.radians(profile.phase_deg)
        return np.asarray(before + profile.amplitude * np.sin(angle))
    if isinstance(profile, Steps):
        times, heights = np.array(profile.points).T
        first = np.rint(times / sample_time)  # the sample that each point counts from
        latest = np.searchsorted(first, np.arange(samples), side="right")
        return np.concatenate(([before], heights))[latest]
    return np.full(samples, before if profile is None else profile)


def _shortened(times: list[float]) -> str:
    return ", ".join(f"{time:g}" for time in times[:4]) + (" ..." if len(times) > 4 else "") if times else "no instants"
