"""How much of the work is done: SHARE in the environment, 1 unless said."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

SHARE = float(os.environ.get("SHARE") or 1.0)


def share_of(count: int) -> int:
    """As many of ``count`` as this run's share asks for, 1 at least."""
    return max(1, round(SHARE * count))


def some_of(cases: Iterable[Any]) -> list[Any]:
    """Of cases as many as this run's share asks for, evenly spread, the first among them."""
    return list(cases)[:: max(1, round(1.0 / SHARE))]
