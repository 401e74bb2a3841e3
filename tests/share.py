"""How much of the work is done, and which part of it: SHARE and TURN in the environment, 1 and 0 unless said."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

SHARE = float(os.environ.get("SHARE") or 1.0)
TURN = int(os.environ.get("TURN") or 0)


def share_of(count: int) -> int:
    """As many of ``count`` as this run's share asks for, 1 at least."""
    return max(1, round(SHARE * count))


def some_of(cases: Iterable[Any], turn: int = 0) -> list[Any]:
    """Of cases as many as this run's share asks for, 1 at least, evenly spread; each turn takes others, 0 the first."""
    each, every = list(cases), max(1, round(1.0 / SHARE))
    return each[turn % min(every, len(each)) :: every] if each else []
