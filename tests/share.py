"""How much of the work is done, and which part of it: SHARE, MOST_CASES and TURN in the environment."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from typing import Any

SHARE = float(os.environ.get("SHARE") or 1.0)
"""Of each test's cases, of the long tests, and of campaigns; all unless said."""
MOST_CASES = int(os.environ.get("MOST_CASES") or 0)
"""Of one test, at most; 0, unless said, for any number."""
TURN = int(os.environ.get("TURN") or 0)
"""Which part that is; each commit has the next."""


def share_of(count: int) -> int:
    """As many of ``count`` as this run's share asks for, 1 at least."""
    return max(1, round(SHARE * count))


def some_of(cases: Iterable[Any], turn: int = 0, every: int | None = None) -> list[Any]:
    """One in so many, as this run's share asks for unless said, evenly spread; each turn takes others, 0 the first.

    Examples
    --------
    >>> some_of([], turn=3)
    []
    >>> some_of("abcdefg", turn=4, every=3)
    ['b', 'e']
    """
    each = list(cases)
    step = min(every or max(1, round(1.0 / SHARE)), max(1, len(each)))
    return each[turn % step :: step]


def a_few_of(cases: Iterable[Any]) -> list[Any]:
    """Of one test's cases as many as are run at most, others at each turn."""
    each = list(cases)
    return some_of(each, TURN, math.ceil(len(each) / MOST_CASES)) if MOST_CASES else each
