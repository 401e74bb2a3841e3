"""What the running controller says of itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import UNPACED, AntiWindup, Pace
from fopid_ros.common.design_parameters import DEADBAND, FILTER, GAINS, PACE, WEIGHTS
from fopid_ros.tuner.controller_client import ControllerClient, RunningDesign

TICKS_MIN = 30
"""What lasts fewer ticks tells nothing."""
INTEGRAL_TIMES = 18.0
"""Length of an experiment when nobody says it, in integral times of the running controller."""


@dataclass(frozen=True)
class RunningController:
    """What the running controller says of itself.

    Attributes
    ----------
    gains : Fopid
    sample_time : float
        [s]
    control_min, control_max : float
    filter, weights
        Of the measurement and of the setpoint.
    pace : Pace
        Of control and setpoint.
    antiwindup : str
    deadband : float
    """

    gains: Fopid
    sample_time: float
    control_min: float
    control_max: float
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT
    pace: Pace = UNPACED
    antiwindup: AntiWindup = "back_calculation"
    deadband: float = 0.0

    @property
    def control_range(self) -> float:
        """From limit to limit; infinite without."""
        return self.control_max - self.control_min

    def room(self, control: float) -> tuple[float, float]:
        """Limits of the control, from a value of it."""
        return self.control_min - control, self.control_max - control

    @property
    def running(self) -> RunningDesign:
        """The gains with the filter and the weights they run with."""
        return RunningDesign(self.gains, self.filter, self.weights, self.pace, self.deadband)

    def saturated(self, control: float) -> bool:
        """Whether a control is at a limit."""
        return not self.control_min < control < self.control_max


def read_running_controller(client: ControllerClient) -> RunningController:
    """The running controller, which must be in automatic mode.

    Raises
    ------
    InputError
        If it does not answer, or is in manual mode.
    """
    *gains, sample_time, low, high, mode = client.get(*GAINS, "sample_time", "control_min", "control_max", "mode")
    order, time, proportional, derivative, *pace = client.get(*FILTER, *WEIGHTS, *PACE)
    antiwindup, deadband = client.get("antiwindup", DEADBAND)
    if mode != "auto":
        raise InputError(f"mode = {mode!r} of the controller; allowed: auto, since the loop stays closed")
    slow, weights = MeasurementFilter(order, time), SetpointWeights(proportional, derivative)
    return RunningController(Fopid(*gains), sample_time, low, high, slow, weights, Pace(*pace), antiwindup, deadband)


def integral_time(gains: Fopid) -> float:
    """The time scale that whoever chose these gains had in mind [s]; NaN where there is none.

    That is (kp/ki)^(1/lam), or 2 (kd/ki)^(1/(lam + mu)) where that is longer, as it is where kp is (nearly) 0: a PID
    whose Ti is 4 Td has both alike.

    Examples
    --------
    >>> integral_time(Fopid(2.0, 0.5, 2.0)), integral_time(Fopid(0.0, 0.5, 2.0))
    (4.0, 4.0)
    """
    if not (gains.ki and gains.lam):
        return math.nan
    by_gain = abs(gains.kp / gains.ki) ** (1.0 / gains.lam)
    by_derivative = 2.0 * abs(gains.kd / gains.ki) ** (1.0 / (gains.lam + gains.mu))
    return float(max(by_gain, by_derivative)) or math.nan
