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
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from fopid_core.errors import InputError
from fopid_msgs.msg import FopidState, TuningResult
from fopid_msgs.srv import Tune
from fopid_ros.common.cdr import Layout
from fopid_ros.common.design_parameters import DESIGN, GAINS, PROVENANCE
from fopid_ros.common.diagnostics import diagnostic_array, diagnostic_status
from fopid_ros.common.guard import GuardedNode
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.common.parameters import Spec, declare, shown
from fopid_ros.common.signals import SignalType, signal_specs, signal_type
from fopid_ros.dashboard.autotuning import Autotuning
from fopid_ros.dashboard.health import Health
from fopid_ros.dashboard.history import History
from fopid_ros.dashboard.inputs import TUNER_DEFAULTS, autotuning_goal, number, text, tuning_request
from fopid_ros.dashboard.remote_parameters import LOOK_AGAIN, AllParameters, RefusedError, RemoteParameters, answer
from fopid_ros.dashboard.results import tuning_told
from fopid_ros.dashboard.undo import GainHistory, GainSet

SUBSCRIBED = ("setpoint", "measurement", "control")
PUBLISHED = ("setpoint", "manual_control")
STATE = Layout(FopidState)
OTHERS = ("controller", "tuner", "plant")

SPECS = (
    Spec("controller", "fopid_controller", "node name of the controller", read_only=True),
    Spec("tuner", "fopid_tuner", "node name of the tuner", read_only=True),
    Spec("plant", "plant_simulator", "node name of the plant; its parameters are shown if it has any", read_only=True),
    Spec("measurement.unit", "", "unit of measurement and setpoint, shown with their numbers", read_only=True),
    Spec("control.unit", "", "unit of the control, shown with its numbers", read_only=True),
    *(spec for name in (*SUBSCRIBED, "manual_control") for spec in signal_specs(name)),
)

KEPT_ROWS = 12_000  # two minutes at 100 Hz
MOST_MARKS = 50
ORIGIN = "dashboard: by hand"  # of gains that a person sets here
LOOK_PERIOD = 0.5  # [s] between two looks at who is there
MEETING_TIME = 1.0  # [s] a new publisher waits this long for somebody who listens
TUNING_TIME = 600.0  # [s] how long a tuning may take; the tuner has its own, shorter limit

# Never holds a publisher up: what a best-effort reader misses is not sent again.
LISTENING = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class DashboardNode(GuardedNode):
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
        self._gain_history = GainHistory()
        self._latest = dict.fromkeys(SUBSCRIBED, math.nan)
        self._instant: float | None = None
        self._gains_in_use: list[float] | None = None
        self._marks: deque[float] = deque(maxlen=MOST_MARKS)
        self._result: dict[str, Any] | None = None
        self._tuning_since: float | None = None
        names = {name: str(self.get_parameter(name).value) for name in OTHERS}
        followed = (*DESIGN, *PROVENANCE, "mode")
        self.controller = RemoteParameters(self, names["controller"], followed, self._gain_history.record)
        self.tuner = RemoteParameters(self, names["tuner"], TUNER_DEFAULTS)
        self.parameters = {name: AllParameters(self, given) for name, given in names.items()}
        self.health = Health(self.controller.name, self.tuner.name)
        self._tune = self.create_client(Tune, f"{names['tuner']}/tune")
        self._save = self.create_client(Trigger, f"{names['controller']}/save_gains")
        self.autotuning = Autotuning(self, names["tuner"], lambda: self._instant, self.health.tuner_is_alive)
        self.create_subscription(FopidState, f"{names['controller']}/state", self._on_state, LISTENING, raw=True)
        self.create_subscription(TuningResult, f"{names['tuner']}/result", self._on_result, latched_qos())
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, QoSProfile(depth=100))
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

    def _on_state(self, message: bytes) -> None:
        state = STATE.unpack(message)
        self.health.take_state(state)
        instant = self.history.add(
            state.stamp_ns,
            (state.setpoint, state.measurement, state.control, state.proportional, state.integral, state.derivative),
        )
        if instant == 0.0:  # a new record: the marks are of the one before
            self._marks.clear()
        self._instant = round(instant, 4)
        gains = [state.kp, state.ki, state.kd, state.lam, state.mu]
        if gains != self._gains_in_use:
            if self._gains_in_use is not None:
                self._marks.append(self._instant)
            self._gains_in_use = gains

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.health.take_diagnostics(message.status)

    def _listen_while_silent(self) -> None:
        """Read the loop's own topics only while no ~/state comes: each reader costs their publishers time."""
        if self.health.silent and not self._heard:
            self._heard = [
                self.create_subscription(kind.message_type, name, self._subscribe(name), LISTENING, raw=kind.raw)
                for name, kind in ((name, self._kinds[name]) for name in SUBSCRIBED)
            ]
        elif not self.health.silent:
            for subscription in self._heard:
                self.destroy_subscription(subscription)
            self._heard = []

    def _subscribe(self, name: str) -> Callable[[Any], None]:
        kind = self._kinds[name]

        def heard(message: Any) -> None:
            self._latest[name] = kind.read(message)
            self.health.take_signal(name, self._latest[name])
            if name == "measurement" and self.health.silent:
                stamp = kind.stamp_ns(message) or self.get_clock().now().nanoseconds
                self.history.add(stamp, (*self._latest.values(), math.nan, math.nan, math.nan))

        return heard

    def _on_result(self, result: TuningResult) -> None:
        self._result = tuning_told(result)

    # What is told.

    def status(self) -> dict[str, Any]:
        """Who is there, and what was found."""
        controller, tuner = self.controller, self.tuner
        busy = None if self._tuning_since is None else int(time.monotonic() - self._tuning_since)
        previous = self._gain_history.previous
        return {
            "controller": {
                "name": controller.name, "present": controller.present, "values": controller.values,
                "ranges": controller.ranges, "previous": dict(previous.gains) if previous else None,
            },
            "tuner": {"name": tuner.name, "present": tuner.present, "values": tuner.values, "busy": busy},
            "result": self._result,
            "marks": list(self._marks),
            "units": {name: self.get_parameter(f"{name}.unit").value for name in ("measurement", "control")},
        }  # fmt: skip

    def sections(self) -> dict[str, Callable[[], Any]]:
        """What the page is told when it has changed, by its name."""
        return {
            "status": self.status,
            "autotuning": self.autotuning.told,
            "gain_sets": self._gain_history.told,
            "diagnostics": self.health.diagnostics,
        }

    async def watch(self) -> None:
        """Keep an eye on controller, tuner and topics until cancelled."""
        while True:
            self._listen_while_silent()
            self.autotuning.look()
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
            raise InputError(f"parameters = {shown(sorted(values))}; allowed: {', '.join(GAINS)}, mode")
        numbers = {name: number(name, value) for name, value in values.items() if name != "mode"}
        mode = {"mode": text("mode", values["mode"])} if "mode" in values else {}
        if numbers:
            self._refuse_while_autotuning()
        await self.controller.set({**numbers, **mode, **({"gains.origin": ORIGIN} if numbers else {})})
        return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or f"mode = {values['mode']}"

    def _refuse_while_autotuning(self) -> None:
        if self.autotuning.active:
            raise RefusedError("an autotuning is under way; cancel it first, or wait for its end")

    async def roll_back(self) -> str:
        """Give the controller the gains it had before, with their filter and setpoint weights.

        Where they come from is not said: of gains that were in force before the controller knows it.

        Raises
        ------
        RefusedError
            If there are none, or with the controller's reason.
        """
        previous = self._gain_history.previous
        if previous is None:
            raise RefusedError("no earlier gains are known")
        return await self._bring_back(previous)

    async def bring_back(self, wanted: Any) -> str:
        """Give the controller the gain set of this number again.

        Raises
        ------
        InputError
            If there is none of this number.
        RefusedError
            With the controller's reason.
        """
        found = self._gain_history.find(wanted) if type(wanted) is int else None
        if found is None:
            raise InputError(f"gain set = {shown(wanted)}; allowed: the number of one in the list")
        return await self._bring_back(found)

    async def _bring_back(self, wanted: GainSet) -> str:
        self._refuse_while_autotuning()
        origin = wanted.origin if wanted.verified else f"dashboard: set {wanted.number} again"
        await self.controller.set({**wanted.parameters, "gains.origin": origin})
        return f"set {wanted.number}: " + ", ".join(f"{name} = {value:.6g}" for name, value in wanted.gains.items())

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
        self._refuse_while_autotuning()
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

    async def start_autotuning(self, fields: Mapping[str, Any]) -> str:
        """Have the running loop learnt and tuned; raises as ``tune`` does."""
        if self._tuning_since is not None:
            raise RefusedError("busy with another tuning")
        return await self.autotuning.start(autotuning_goal(fields))

    async def plan_autotuning(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """What an autotuning would do, and for how long; without a plan the message says why there is none."""
        try:
            return await self.autotuning.plan(autotuning_goal(fields))
        except (InputError, RefusedError) as error:
            return {"message": str(error), "plan": None, "duration": None}

    async def set_parameter(self, fields: Mapping[str, Any]) -> str:
        """Set any parameter of controller, tuner or plant.

        Raises
        ------
        InputError
            For another node, or what no parameter can be.
        RefusedError
            With the node's reason.
        """
        whose, name, value = (fields.get(part) for part in ("node", "name", "value"))
        if whose not in OTHERS:
            raise InputError(f"node = {shown(whose)}; allowed: {', '.join(OTHERS)}")
        if isinstance(value, (dict, type(None))):
            raise InputError(f"{shown(name)} = {shown(value)}; allowed: a number, a text, true, false, a list of texts")
        called = text("name", name)
        if whose == "controller" and called != "mode":
            self._refuse_while_autotuning()
        return await self.parameters[str(whose)].set(called, value)

    async def all_parameters(self) -> dict[str, Any]:
        """Of controller, tuner and plant; None for one that is not there."""
        told = {}
        for name, parameters in self.parameters.items():
            try:
                told[name] = {"name": parameters.name, "parameters": await parameters.read()}
            except RefusedError:
                told[name] = {"name": parameters.name, "parameters": None}
        return told

    async def save_gains(self) -> str:
        """Have the controller write its parameters to its own file.

        Raises
        ------
        RefusedError
            With the controller's reason.
        """
        if not self._save.service_is_ready():
            raise RefusedError(f"{self.controller.name} is not there")
        who, is_ready = self.controller.name, self._save.service_is_ready
        response = await answer(self._save.call_async(Trigger.Request()), who, TUNING_TIME, is_ready)
        if not response.success:
            raise RefusedError(response.message)
        return f"saved as {response.message}"

    async def publish_signal(self, name: str, value: Any) -> str:
        """Publish a setpoint or a control by hand.

        Raises
        ------
        InputError
            For another signal, and for what is not a number that its message can hold.
        """
        if name not in PUBLISHED:
            raise InputError(f"signal = {shown(name)}; allowed: {', '.join(PUBLISHED)}")
        wanted, kind = number(name, value), self._kinds[name]
        if not kind.low <= wanted <= kind.high:
            raise InputError(f"{name} = {shown(value)}; allowed: {kind.low:g} to {kind.high:g}")
        speaker = await self._publisher_of(name)
        speaker.publish(kind.writer()(wanted, self.get_clock().now().nanoseconds))
        return f"{name} = {wanted:.6g}"

    async def _publisher_of(self, name: str) -> Publisher:
        """The publisher of a signal, made when it is first needed: who only looks is no source of setpoints."""
        if name not in self._signal_publishers:
            self._signal_publishers[name] = self.create_publisher(self._kinds[name].message_type, name, latched_qos())
        speaker, deadline = self._signal_publishers[name], time.monotonic() + MEETING_TIME
        while not speaker.get_subscription_count() and time.monotonic() < deadline:
            await asyncio.sleep(LOOK_AGAIN)
        return speaker
