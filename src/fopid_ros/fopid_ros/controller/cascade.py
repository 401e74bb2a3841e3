"""Both ends of a cascade in a controller node: what it tells the controller above it, and hears from the one below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fopid_core.errors import InputError
from fopid_core.runtime.cascade import TrackingInput, realisable_setpoint
from fopid_core.runtime.controller import FopidController
from fopid_msgs.msg import ScalarStamped
from fopid_ros.common.endpoints import Endpoints
from fopid_ros.common.inputs import Input, is_number
from fopid_ros.common.managed_node import loop_qos
from fopid_ros.common.parameters import Spec
from fopid_ros.common.signals import SignalType

CASCADE_SPECS = (
    Spec("back_calculation.enabled", False, "publish the setpoint that could be followed on the topic "
         "back_calculation, for the tracking input of a controller whose control is the setpoint here",
         at_configure=True),
    Spec("tracking.required", False, "do not control without tracking: an outer controller stands still without the "
         "inner one (on_stale)", at_configure=True),
)  # fmt: skip


def check_cascade(values: Mapping[str, Any]) -> None:
    """Raise InputError for an outer controller that does not listen to the inner one."""
    if values["tracking.required"] and not values["tracking.enabled"]:
        raise InputError("tracking.required = True, tracking.enabled = False; allowed: both, or tracking.enabled alone")


class CascadeLink:
    """Publishes ``back_calculation`` where asked, and reads ``tracking``.

    Parameters
    ----------
    endpoints : Endpoints
    values : mapping
        The node's parameters.
    tracking : Input

    Attributes
    ----------
    in_use : bool
        Whether any of both is asked for.
    """

    def __init__(self, endpoints: Endpoints, values: Mapping[str, Any], tracking: Input) -> None:
        self._tracking, self._input = tracking, TrackingInput()
        self._taken_back = 0.0
        self._publisher = None
        self.in_use = values["back_calculation.enabled"] or values["tracking.enabled"]
        if values["back_calculation.enabled"]:
            qos = loop_qos(lockstep=values["trigger"] == "lockstep")
            self._publisher = endpoints.publisher(ScalarStamped, "back_calculation", qos)
            self._write = SignalType().writer()

    def limit(self, now_ns: int, last: float) -> float | None:
        """What the inner loop, or the actuator, was limited to; None while it follows, or nothing is heard of it.

        Parameters
        ----------
        now_ns : int
            On the clock of the ticks.
        last : float
            The control of the last tick.
        """
        limit = self._input.limit(self._tracking.value) if self._tracking.usable(now_ns) else None
        self._taken_back = 0.0 if limit is None else limit - last
        return limit

    def tell(self, controller: FopidController, measurement: float | None, control: float, stamp_ns: int) -> None:
        """After a tick: remember the control, and tell which setpoint could be followed.

        ``measurement`` is what the loop has reached when the setpoint had no say at this tick, else None.
        """
        self._input.sent(control)
        if self._publisher is None:
            return
        possible = realisable_setpoint(controller, self._taken_back) if measurement is None else measurement
        if is_number(possible):
            self._publisher.publish(self._write(possible, stamp_ns))
