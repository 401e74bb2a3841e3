"""One measured figure, and how it is measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes
    ----------
    name : str
    value : float
    unit : str
    baseline : float or None
        The same thing done by the baseline, in the same unit.
    baseline_name : str
    note : str
        How right the answers are, where that belongs to the figure.
    """

    name: str
    value: float
    unit: str
    baseline: float | None = None
    baseline_name: str = ""
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times faster than the baseline."""
        return None if self.baseline is None else self.baseline / self.value

    def __str__(self) -> str:
        """The figure in one line."""
        text = f"{self.value:.4g} {self.unit}"
        if self.baseline is not None:
            text += f" ({self.baseline:.4g} {self.unit} with {self.baseline_name}: {self.ratio:.3g} times)"
        return f"{text}; {self.note}" if self.note else text


def best_time(work: Callable[[], object], repeats: int = 20) -> float:
    """Shortest of several runs [s]: what the work takes when nothing else runs."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)
