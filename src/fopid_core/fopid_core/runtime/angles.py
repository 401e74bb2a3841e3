"""Angles that wrap around."""

from __future__ import annotations

import math

TURN = 2.0 * math.pi
"""[rad]"""


def nearest_turn(angle: float, near: float) -> float:
    """The angle, whole turns added, that is nearest to another one [rad].

    Examples
    --------
    >>> round(nearest_turn(-3.0, 3.0), 4)
    3.2832
    """
    return angle + TURN * round((near - angle) / TURN)
