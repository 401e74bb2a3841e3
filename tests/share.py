"""How much of their work campaigns do: SHARE in the environment, 1 unless said."""

from __future__ import annotations

import os

SHARE = float(os.environ.get("SHARE") or 1.0)


def share_of(count: int) -> int:
    """As many of ``count`` as this run's share asks for, 1 at least."""
    return max(1, round(SHARE * count))
