"""What ties two controllers of a cascade together, so that the outer one does not wind up.

The control of the outer controller is the setpoint of the inner one. While the inner one is limited, the outer one
must know which setpoint could have been followed: the realisable setpoint (Hanus, Kinnaert and Henrotte 1987), the
one for which the inner control would just not have been limited. With u = D w + (what is remembered), D what a unit of
setpoint adds to the control at once, it is w + (limited - unlimited) / D. The outer controller takes it in as its
tracking input (back-calculation, as BKCAL_OUT and BKCAL_IN of function blocks).
"""

from __future__ import annotations

import math
from collections import deque

from fopid_core.runtime.controller import FopidController

_UNDER_WAY = 8
"""Ticks that a control may take to the inner controller and back."""


def realisable_setpoint(controller: FopidController, taken_back: float = 0.0) -> float:
    """The setpoint that an inner controller could follow at its last tick.

    The setpoint itself, bit for bit, while nothing limits the control; else between it and the measurement, which is
    what an inner loop has reached that does not follow at all: in manual mode, or while it holds its control.

    Parameters
    ----------
    controller : FopidController
        The inner one, after its tick.
    taken_back : float
        What its own tracking input has taken from the control before [control unit], where there is a third
        controller below.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.runtime.settings import ControllerSettings
    >>> inner = FopidController(ControllerSettings(Fopid(kp=2.0), control_max=1.0))
    >>> inner.step(setpoint=3.0, measurement=0.2), realisable_setpoint(inner)
    (1.0, 0.7)
    """
    state = controller.state
    if state.mode != "auto" or controller.holds:
        return state.measurement
    excess = state.control - state.control_unlimited + taken_back
    if excess == 0.0:
        return state.setpoint
    gain = controller.setpoint_feedthrough
    possible = state.setpoint + excess / gain if gain else math.nan
    low, high = sorted((state.setpoint, state.measurement))
    return min(max(possible, low), high) if math.isfinite(possible) else state.measurement


class TrackingInput:
    """What an outer controller makes of the setpoint that the inner one could follow.

    A message takes its time: what comes back may be the control of some ticks ago, followed exactly. That is no limit,
    and must not move the integral.

    Examples
    --------
    >>> tracking = TrackingInput()
    >>> for control in (1.0, 2.0, 3.0):
    ...     tracking.sent(control)
    >>> tracking.limit(2.0), tracking.limit(1.7)
    (None, 1.7)
    """

    def __init__(self) -> None:
        self._sent: deque[float] = deque(maxlen=_UNDER_WAY)

    def sent(self, control: float) -> None:
        """Remember a control that went out."""
        self._sent.append(control)

    def limit(self, tracked: float) -> float | None:
        """What the actuator or the inner loop was limited to; None while it follows."""
        return None if tracked in self._sent else tracked
