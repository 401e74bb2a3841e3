"""What a controller did at its last tick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Mode = Literal["auto", "manual"]


@dataclass(slots=True)
class ControllerState:
    """What the controller did at its last tick (units of the signals).

    Attributes
    ----------
    setpoint, measurement, error : float
        As the controller took them: the setpoint within its rate, the error of the filtered measurement and without
        its deadband, angles that wrap around without their jumps.
    proportional, integral, derivative, feedforward : float
        The parts of the control; the integral carries what bumpless changes have left behind.
    control_unlimited, control : float
        Before and after the limits.
    saturated : bool
        Whether these two differ.
    mode : {"auto", "manual"}
    """

    setpoint: float = 0.0
    measurement: float = 0.0
    error: float = 0.0
    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    feedforward: float = 0.0
    control_unlimited: float = 0.0
    control: float = 0.0
    saturated: bool = False
    mode: Mode = "auto"
