"""What an observer wrote, read while it writes, and the invariants that are held against it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

Sample = tuple[float, float]
"""When [s], and the value."""


class Record:
    """An observer's file; ``update`` reads what is new in it.

    Attributes
    ----------
    lines : dict
        By topic: (time, field, ...) of each message.
    """

    def __init__(self, file: Path) -> None:
        self.file, self._read = file, 0
        self.lines: dict[str, list[tuple[Any, ...]]] = {}

    def update(self) -> Record:
        """Read on; a line that is not whole yet waits."""
        if self.file.exists():
            with self.file.open("rb") as file:
                file.seek(self._read)
                whole = file.read().rpartition(b"\n")[0]
            self._read += len(whole) + 1 if whole else 0
            for line in whole.splitlines():
                time, topic, *fields = json.loads(line)
                self.lines.setdefault(topic, []).append((time, *fields))
        return self

    def of(self, topic: str, since: float = -math.inf) -> list[tuple[Any, ...]]:
        """The messages of a topic from a time on."""
        found = self.lines.get(topic, [])
        first = len(found)
        while first and found[first - 1][0] >= since:
            first -= 1
        return found[first:]


def outside_limits(controls: Iterable[Sample], low: float, high: float) -> list[Sample]:
    """Controls that are no number or beyond a limit: there must be none.

    >>> outside_limits([(0.0, 1.0), (0.1, float("nan")), (0.2, 3.1)], -1.0, 3.0)
    [(0.1, nan), (0.2, 3.1)]
    """
    return [sample for sample in controls if not low <= sample[1] <= high]


def longest_silence(times: Sequence[float]) -> float:
    """The longest time between two of them [s]; infinite for fewer.

    >>> longest_silence([0.0, 0.25, 1.0])
    0.75
    """
    return max((after - before for before, after in pairwise(times)), default=math.inf)


def settled_at(samples: Sequence[Sample], goal: float, band: float, hold: float, gap: float = 0.5) -> float | None:
    """From when on the samples stay within a band about a goal, once that has lasted; None if it has not.

    A silence longer than ``gap`` begins it anew.

    >>> settled_at([(0.0, 0.0), (1.0, 1.0), (1.1, 2.0), (1.2, 1.0), (1.4, 1.01), (1.6, 1.0)], 1.0, 0.02, 0.3)
    1.2
    >>> settled_at([(0.0, 1.0), (5.0, 1.0)], 1.0, 0.02, 0.3) is None
    True
    """
    since = before = None
    for time, value in samples:
        if before is not None and time - before > gap:
            since = None
        before = time
        since = (time if since is None else since) if abs(value - goal) <= band else None
        if since is not None and time - since >= hold:
            return since
    return None


def gone_at(addends: Sequence[Sample]) -> float | None:
    """From when on an addend is 0 for good; None if it is not.

    >>> gone_at([(0.0, 0.5), (0.1, 0.0), (0.2, 0.1), (0.3, 0.0), (0.4, 0.0)])
    0.3
    """
    since = None
    for time, value in addends:
        since = (time if since is None else since) if value == 0.0 else None
    return since
