"""The dashboard's node: listens to the loop, hands changes to controller and tuner."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fopid_core.errors import InputError
from fopid_core.runtime.settings import LARGEST, LOWEST
from fopid_msgs.msg import FopidState, TuningResult
from fopid_msgs.srv import Tune
from fopid_ros.common.diagnostics import diagnostic_array, diagnostic_status
from fopid_ros.common.guard import GuardedNode
from fopid_ros.common.inputs import is_number
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.common.parameters import Spec, declare
from fopid_ros.common.signals import SignalType, signal_specs, signal_type
from fopid_ros.dashboard.history import History
from fopid_ros.dashboard.remote_parameters import LOOK_AGAIN, RefusedError, RemoteParameters, answer
from fopid_ros.dashboard.undo import Undo

GAINS = ("kp", "ki", "kd", "lam", "mu")
DESIGN = (*GAINS, "measurement_filter_order", "measurement_filter_time", "setpoint_weight",
          "derivative_setpoint_weight")  # fmt: skip
"""What a tuning may change: undone together."""
TUNER_DEFAULTS = ("process", "method", "phase_margin", "crossover", "index", "ms_max", "u_max")
TUNING_FIELDS = (*TUNER_DEFAULTS, "apply")
SUBSCRIBED = ("setpoint", "measurement", "control")
PUBLISHED = ("setpoint", "manual_control")

SPECS = (
    Spec("controller", "fopid_controller", "node name of the controller", read_only=True),
    Spec("tuner", "fopid_tuner", "node name of the tuner", read_only=True),
    *(spec for name in (*SUBSCRIBED, "manual_control") for spec in signal_specs(name)),
)

KEPT_ROWS = 12_000  # two minutes at 100 Hz
MOST_MARKS = 50
ORIGIN = "dashboard: by hand"  # of gains that a person sets here
LONGEST_SHOWN = 80  # characters of what was sent, in a message about it
LOOK_PERIOD = 0.5  # [s] between two looks at who is there
MEETING_TIME = 1.0  # [s] a new publisher waits this long for somebody who listens
TUNING_TIME = 600.0  # [s] how long a tuning may take; the tuner has its own, shorter limit
SILENCE = 1.0  # [s] without ~/state after which the topics are shown themselves
MISSED_TICKS = 3.0  # the same for a slow controller, in ticks

# Never holds a publisher up: what a best-effort reader misses is not sent again.
LISTENING = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def _plain(value: float) -> float | None:
    """For JSON, which has no NaN."""
    return value if math.isfinite(value) else None


class DashboardNode(GuardedNode, Node):
    """Listens to setpoint, measurement, control, the controller's ~/state and the tuner's ~/result.

    Attributes
    ----------
    history : History
        The signals.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__("dashboard", context=context)
        declare(self, {spec.name: spec for spec in SPECS})
        self.history = History(KEPT_ROWS)
        self._undo = Undo()
        self._latest = dict.fromkeys(SUBSCRIBED, math.nan)
        self._facts: dict[str, Any] | None = None
        self._gains_in_use: list[float] | None = None
        self._marks: deque[float] = deque(maxlen=MOST_MARKS)
        self._last_state, self._patience = -math.inf, SILENCE
        self._result: dict[str, Any] | None = None
        self._tuning_since: float | None = None
        names = {name: self.get_parameter(name).value for name in ("controller", "tuner")}
        self.controller = RemoteParameters(self, names["controller"], (*DESIGN, "mode"), self._on_parameters)
        self.tuner = RemoteParameters(self, names["tuner"], TUNER_DEFAULTS)
        self._tune = self.create_client(Tune, f"{names['tuner']}/tune")
        self.create_subscription(FopidState, f"{names['controller']}/state", self._on_state, LISTENING)
        self.create_subscription(TuningResult, f"{names['tuner']}/result", self._on_result, latched_qos())
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._open_signals()

    def _publish_diagnostics(self) -> None:
        problems, facts = self.guard.health_problems(), self.guard.facts()
        status = diagnostic_status(self.get_fully_qualified_name(), "listening", problems, facts)
        self._diagnostics.publish(diagnostic_array(status, self))

    def _open_signals(self) -> None:
        self._kinds = {name: self._signal_type(name) for name in (*SUBSCRIBED, "manual_control")}
        self._heard: list[Subscription] = []
        self._signal_publishers: dict[str, Publisher] = {}

    def _signal_type(self, name: str) -> SignalType:
        parts = ("type", "field", "scale", "offset")
        return signal_type({f"{name}.{part}": self.get_parameter(f"{name}.{part}").value for part in parts}, name)

    # What is heard.

    def _on_state(self, state: FopidState) -> None:
        self._last_state = time.monotonic()
        self._patience = max(SILENCE, MISSED_TICKS * state.sample_interval)
        stamp = state.header.stamp
        instant = self.history.add(
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            (state.setpoint, state.measurement, state.control, state.proportional, state.integral, state.derivative),
        )
        if instant == 0.0:  # a new record: the marks are of the one before
            self._marks.clear()
        self._facts = {
            "saturated": state.saturated,
            "overruns": state.overruns,
            "interval": _plain(state.sample_interval),
        }
        gains = [state.kp, state.ki, state.kd, state.lam, state.mu]
        if gains != self._gains_in_use:
            if self._gains_in_use is not None:
                self._marks.append(round(instant, 4))
            self._gains_in_use = gains

    @property
    def _silent(self) -> bool:
        return time.monotonic() - self._last_state > self._patience

    def _listen_while_silent(self) -> None:
        """Read the loop's own topics only while no ~/state comes: each reader costs their publishers time."""
        if self._silent and not self._heard:
            self._heard = [
                self.create_subscription(self._kinds[name].message_type, name, self._subscribe(name), LISTENING)
                for name in SUBSCRIBED
            ]
        elif not self._silent:
            for subscription in self._heard:
                self.destroy_subscription(subscription)
            self._heard = []

    def _subscribe(self, name: str) -> Callable[[Any], None]:
        kind = self._kinds[name]

        def heard(message: Any) -> None:
            self._latest[name] = kind.read(message)
            if name == "measurement" and self._silent:
                stamp = kind.stamp_ns(message) or self.get_clock().now().nanoseconds
                self.history.add(stamp, (*self._latest.values(), math.nan, math.nan, math.nan))

        return heard

    def _on_parameters(self, values: Mapping[str, Any]) -> None:
        self._undo.record({name: values[name] for name in DESIGN if name in values})

    def _on_result(self, result: TuningResult) -> None:
        achieved = result.achieved
        measures = ("phase_margin", "crossover", "gain_margin_db", "ms", "mt")
        self._result = {
            "stamp": result.header.stamp.sec + result.header.stamp.nanosec * 1e-9,
            "method": result.method, "process": result.process, "message": result.message, "unmet": list(result.unmet),
            "success": result.success, "applied": result.applied, "elapsed": _plain(result.elapsed),
            "gains": {name: _plain(getattr(result.gains, name)) for name in GAINS}, "stable": achieved.stable,
            "achieved": {name: _plain(getattr(achieved, name)) for name in measures},
        }  # fmt: skip

    # What is told.

    def status(self) -> dict[str, Any]:
        """Everything but the signals, as the page shows it."""
        controller, tuner = self.controller, self.tuner
        busy = None if self._tuning_since is None else int(time.monotonic() - self._tuning_since)
        return {
            "controller": {
                "name": controller.name, "present": controller.present, "values": controller.values,
                "ranges": controller.ranges, "previous": self._undo.previous,
            },
            "tuner": {"name": tuner.name, "present": tuner.present, "values": tuner.values, "busy": busy},
            "result": self._result,
            "marks": list(self._marks),
        }  # fmt: skip

    def facts(self) -> dict[str, Any] | None:
        """What the controller said of its last tick."""
        return self._facts

    async def watch(self) -> None:
        """Keep an eye on controller, tuner and topics until cancelled."""
        while True:
            self._listen_while_silent()
            await asyncio.gather(self.controller.poll(), self.tuner.poll())
            await asyncio.sleep(LOOK_PERIOD)

    # What is done.

    async def set_parameters_of_controller(self, values: Mapping[str, Any]) -> str:
        """Hand gains or the mode to the controller, all or none; what to tell the person.

        Raises
        ------
        InputError
            For something that is neither a gain nor the mode, and for gains that are no numbers.
        RefusedError
            With the controller's reason.
        """
        unknown = set(values) - {*GAINS, "mode"}
        if unknown or not values:
            raise InputError(f"parameters = {_shown(sorted(values))}; allowed: {', '.join(GAINS)}, mode")
        numbers = {name: _number(name, value) for name, value in values.items() if name != "mode"}
        mode = {"mode": _text("mode", values["mode"])} if "mode" in values else {}
        await self.controller.set({**numbers, **mode, **({"gains.origin": ORIGIN} if numbers else {})})
        return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or f"mode = {values['mode']}"

    async def roll_back(self) -> str:
        """Give the controller the gains it had before, with their filter and setpoint weights.

        Where they come from is not said: of gains that were in force before the controller knows it.

        Raises
        ------
        RefusedError
            If there are none, or with the controller's reason.
        """
        previous = self._undo.previous
        if previous is None:
            raise RefusedError("no earlier gains are known")
        await self.controller.set(previous)
        return ", ".join(f"{name} = {previous[name]:.6g}" for name in GAINS)

    async def tune(self, fields: Mapping[str, Any]) -> str:
        """Have the tuner work the gains out; its message, whatever the tuning came to.

        Raises
        ------
        InputError
            For a field that cannot be used.
        RefusedError
            If the tuner is busy or away, or does not accept what is asked for.
        """
        request = tuning_request(fields)
        if self._tuning_since is not None:
            raise RefusedError("busy with another tuning")
        if not self._tune.service_is_ready():
            raise RefusedError(f"{self.tuner.name} is not there")
        self._tuning_since = time.monotonic()
        try:
            response = await answer(
                self._tune.call_async(request), self.tuner.name, TUNING_TIME, self._tune.service_is_ready
            )
        finally:
            self._tuning_since = None
        if not response.success and response.elapsed == 0.0:  # it did not begin
            raise RefusedError(response.message)
        return str(response.message)

    async def publish_signal(self, name: str, value: Any) -> str:
        """Publish a setpoint or a control by hand.

        Raises
        ------
        InputError
            For another signal, and for what is not a number that its message can hold.
        """
        if name not in PUBLISHED:
            raise InputError(f"signal = {_shown(name)}; allowed: {', '.join(PUBLISHED)}")
        number, kind = _number(name, value), self._kinds[name]
        if not kind.low <= number <= kind.high:
            raise InputError(f"{name} = {_shown(value)}; allowed: {kind.low:g} to {kind.high:g}")
        speaker = await self._publisher_of(name)
        speaker.publish(kind.writer()(number, self.get_clock().now().nanoseconds))
        return f"{name} = {number:.6g}"

    async def _publisher_of(self, name: str) -> Publisher:
        """The publisher of a signal, made when it is first needed: who only looks is no source of setpoints."""
        if name not in self._signal_publishers:
            self._signal_publishers[name] = self.create_publisher(self._kinds[name].message_type, name, latched_qos())
        speaker, deadline = self._signal_publishers[name], time.monotonic() + MEETING_TIME
        while not speaker.get_subscription_count() and time.monotonic() < deadline:
            await asyncio.sleep(LOOK_AGAIN)
        return speaker


def _number(name: str, value: Any) -> float:
    if type(value) not in (int, float) or not is_number(value):
        raise InputError(f"{name} = {_shown(value)}; allowed: a number, {LOWEST:g} to {LARGEST:g}")
    return float(value)


def _text(name: str, value: Any) -> str:
    """A text that a message can hold."""
    if not isinstance(value, str) or not value.isprintable():
        raise InputError(f"{name} = {_shown(value)}; allowed: a text of printable characters")
    return value


def _shown(value: Any) -> str:
    """A value in a message, cut to a length that can be read."""
    text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}... ({len(text)} characters)"


def tuning_request(fields: Mapping[str, Any]) -> Tune.Request:
    """A request to the tuner from named fields; angles in rad, as in the service.

    Raises
    ------
    InputError
        For a field that the page does not have, or of the wrong kind.

    Examples
    --------
    >>> tuning_request({"method": "frequency", "crossover": 0.3}).crossover
    0.3
    """
    request = Tune.Request()
    for name, value in fields.items():
        if name not in TUNING_FIELDS:
            raise InputError(f"field = {_shown(name)}; allowed: {', '.join(TUNING_FIELDS)}")
        wanted = type(getattr(request, name))
        if wanted is float:
            setattr(request, name, _number(name, value))
        elif wanted is str:
            setattr(request, name, _text(name, value))
        elif type(value) is wanted:
            setattr(request, name, value)
        else:
            raise InputError(f"{name} = {_shown(value)}; allowed: true or false")
    return request
