"""What a survey's rows say: ratios of load IAE between controllers, medians with intervals, shares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fopid_core.model.arrays import Floats

Row = Mapping[str, Any]
Case = Mapping[str, Row]
"""The rows of one process by controller."""

SETTLED = 0.02
"""Of the largest error, left at the horizon: more, and the load is not rejected, its IAE no figure."""
RESAMPLES = 2000
LEVEL = (2.5, 97.5)
FEWEST = 5
"""Processes for which an interval is given."""


@dataclass(frozen=True)
class Median:
    """A median with its 95 % interval by bootstrap; the interval is NaN for few values."""

    value: float
    low: float
    high: float
    count: int


def by_case(rows: Iterable[Row]) -> list[Case]:
    """The rows of each process together, in the order of the work."""
    cases: dict[int, dict[str, Row]] = {}
    for row in rows:
        cases.setdefault(row["case"], {})[row["controller"]] = row
    return [cases[number] for number in sorted(cases)]


def is_known(row: Row) -> bool:
    """Whether a controller keeps its bounds and rejects the load."""
    return bool(row["status"] == "ok" and row["iae_load"] and abs(row["final_error"]) <= SETTLED)


def reductions(cases: Iterable[Case], better: str, than: str, name: str = "iae_load") -> Floats:
    """By how much one controller's figure is lower than another's, relative, where both are known.

    Examples
    --------
    >>> row = {"status": "ok", "final_error": 0.0}
    >>> reductions([{"pid": {**row, "iae_load": 2.0}, "fopid": {**row, "iae_load": 1.5}}], "fopid", "pid").tolist()
    [0.25]
    """
    both = [(case[better], case[than]) for case in cases if is_known(case[better]) and is_known(case[than])]
    return np.array([1.0 - one[name] / other[name] for one, other in both if one[name] and other[name]])


def median(values: Sequence[float] | Floats, seed: int = 0) -> Median:
    """The median and where 95 of 100 samples as large have it.

    Examples
    --------
    >>> found = median(np.arange(101.0))
    >>> found.value, 38.0 < found.low < 50.0 < found.high < 62.0
    (50.0, True)
    """
    values = np.asarray(values, dtype=np.float64)
    if values.size == 0:
        return Median(np.nan, np.nan, np.nan, 0)
    if values.size < FEWEST:
        return Median(float(np.median(values)), np.nan, np.nan, values.size)
    drawn = np.random.default_rng(seed).integers(values.size, size=(RESAMPLES, values.size))
    low, high = np.percentile(np.median(values[drawn], axis=1), LEVEL)
    return Median(float(np.median(values)), float(low), float(high), values.size)
