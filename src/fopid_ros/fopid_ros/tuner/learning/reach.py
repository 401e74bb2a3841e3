"""How far a loop has been moved to learn what runs: what comes after moves it no less."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Reach:
    """How far a measurement has been moved from the setpoint; in smaller moves friction looks like damping.

    Attributes
    ----------
    moved, allowed : float
        0 where nothing has been moved.
    amplitude : float
        What was added to the control for it.
    most : float
        What may be allowed, since a loop that moves more at rest than the one before is no better for it; infinite for
        a loop that may have been changed since.
    duration : float
        Of the experiment [s], for gains that show no time scale.
    """

    moved: float = 0.0
    allowed: float = 0.0
    amplitude: float = 0.0
    most: float = math.inf
    duration: float = 0.0


NOT_MOVED = Reach()
