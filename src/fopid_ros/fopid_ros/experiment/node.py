"""The node that leads a loop through the phases of an experiment."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from fopid_core.errors import InputError
from fopid_core.study.experiments.experiment import SOURCES, Experiment, Phase
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_msgs.msg import ExperimentPhase, ScalarStamped
from fopid_msgs.srv import Advance, Tune
from fopid_ros.common.managed_node import LOCKSTEP_DEPTH, latched_qos
from fopid_ros.common.rivals import refuse_other_loops
from fopid_ros.common.signals import header_stamp
from fopid_ros.experiment.recording import RECORDER_NODE

DISCOVERY_TIME = 15.0  # how long the other nodes may take to appear [s]
LEAD = LOCKSTEP_DEPTH // 2  # samples the loop may be ahead of the recorder
DRAIN_TIME = 0.3  # [s] without a message after which none is on its way
SLICE = 0.02  # [s] between two looks at the loop
HEARING_TIME = 0.1  # between two tries to be heard by a node [s]
STALL_TIME = 10.0  # lockstep without progress for this long has stalled [s]
TUNING_TIME = 120.0  # how long a tuning may take [s]
ANSWER_TIME = 30.0  # how long a node may take to answer [s]
ASK_AGAIN = 2.0  # the first answer is lost when a node does not know the asking client yet [s]
LOOKAHEAD = LOCKSTEP_DEPTH // 2
"""Values of a profile that are sent ahead at once; each end of the topic has room for more."""

NS = 1_000_000_000
Progress = Callable[[float], None]
"""Called with the loop's time [s]."""


def ask_for_prompt_acknowledgements() -> None:
    """Before ROS starts: have Fast DDS collect acknowledgements at once; a user's own profile file stands."""
    names = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # of older and of newer releases
    if not any(name in os.environ for name in names):
        os.environ.update(dict.fromkeys(names, str(Path(__file__).with_name("experiment_dds.xml"))))


class StopRequestedError(Exception):
    """Ctrl-C or a request to terminate."""


class ExperimentNode(Node):
    """Publishes setpoint and disturbance, changes parameters, calls the tuner, lets the plant advance in lockstep.

    In lockstep the values of a profile go ahead of the loop, each stamped with the sample it counts from; the loop
    then runs through them at full speed.
    """

    def __init__(self, experiment: Experiment) -> None:
        lockstep = experiment.trigger == "lockstep"
        use_sim_time = Parameter("use_sim_time", value=lockstep)
        super().__init__("experiment", parameter_overrides=[use_sim_time])
        self.experiment = experiment
        self.lockstep = lockstep
        self._period_ns = round(experiment.sample_time * NS)
        qos = latched_qos(depth=LOCKSTEP_DEPTH if lockstep else 1)
        self._sources = {name: self.create_publisher(ScalarStamped, name, qos) for name in SOURCES}
        self._values = {name: experiment.signal(name) for name in SOURCES}
        self._changes = {name: np.flatnonzero(np.diff(v, prepend=np.nan)) for name, v in self._values.items()}
        self._phase = self.create_publisher(ExperimentPhase, "experiment/phase", latched_qos(depth=100))
        self._advance = self.create_client(Advance, "plant_simulator/advance")
        self._tune = self.create_client(Tune, "fopid_tuner/tune")
        self._nodes = {name: AsyncParameterClient(self, name) for name in ("plant_simulator", "fopid_controller")}
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        self._interrupted = False
        self.not_applied: list[str] = []
        self._sample = 0
        self._begun: float | None = None
        # What the recorder has come to [ns], and whether it hears all topics, when there is one.
        self.recorded: Callable[[], float] = lambda: math.inf
        self.listening: Callable[[], bool] = lambda: True

    def interrupt(self) -> None:
        """Leave at the next look at the loop."""
        self._interrupted = True

    def spin(self, seconds: float, future: Future | None = None) -> bool:
        """Serve messages for a while, or until a future is done; whether it is."""
        future = future or Future()
        self._executor.spin_until_future_complete(future, timeout_sec=seconds)
        if self._interrupted:
            raise StopRequestedError
        return bool(future.done())

    def _call(
        self, ask: Callable[[], Future], what: str, timeout: float = ANSWER_TIME, again: float = ASK_AGAIN
    ) -> Any:
        """The answer to a request that may be asked again, after ``again`` seconds, because that changes nothing."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            future, until = ask(), min(time.monotonic() + again, deadline)
            while time.monotonic() < until:
                if self.spin(SLICE, future):
                    return future.result()
        raise InputError(f"{what} did not answer within {timeout:g} s")

    def find_loop(self) -> None:
        """Wait for the nodes that the experiment needs.

        Raises
        ------
        InputError
            Naming the node that is not there.
        """
        wanted = {
            "no plant answers: nobody publishes 'measurement'; start plant_simulator, or give --start-nodes":
                lambda: self.count_publishers("measurement") > 0,
            "no controller to talk to: nobody publishes 'control'; start fopid_controller, or give --start-nodes":
                lambda: self.count_publishers("control") > 0 and self._setpoint_is_subscribed(),
        }  # fmt: skip
        if self.lockstep:
            wanted["the plant is not in lockstep: no service plant_simulator/advance"] = self._advance.service_is_ready
        if any(phase.tune for phase in self.experiment.phases):
            wanted["no tuner answers: no service fopid_tuner/tune; start fopid_tuner"] = self._tune.service_is_ready
        deadline = time.monotonic() + DISCOVERY_TIME
        for missing, is_there in wanted.items():
            while not is_there():
                if time.monotonic() > deadline:
                    raise InputError(f"{missing} (domain {self.context.get_domain_id()})")
                self.spin(SLICE)
        self.refuse_other_loops()
        while not self.listening():
            self.spin(SLICE)
        if self.lockstep:
            for node, parameter in (("plant_simulator", "advance_until"), ("fopid_controller", "bumpless")):
                self._await_recorder_matched(node, parameter)

    def refuse_other_loops(self) -> None:
        """A second loop may be found seconds after the first, on a busy machine: looked for before each phase.

        Raises
        ------
        InputError
            If there is one, naming its nodes.
        """
        refuse_other_loops(self, allowed=1)

    def _await_recorder_matched(self, node: str, parameter: str) -> None:
        """Wait until a node knows of the recorder's subscriptions, so that nothing it publishes is missed.

        A node learns of subscriptions in the order in which they were made: when its parameter event comes in
        here, on the last one, it knows them all. A parameter is set to the value it has, to cause that event.
        """
        heard, name = Future(), f"{self.get_namespace().rstrip('/')}/{node}"

        def listen(event: ParameterEvent) -> None:
            if event.node == name and not heard.done():
                heard.set_result(None)

        last = self.create_subscription(ParameterEvent, "/parameter_events", listen, 100)
        answer = self._call(lambda: self._nodes[node].get_parameters([parameter]), node)
        value = parameter_value_to_python(answer.values[0])
        deadline = time.monotonic() + DISCOVERY_TIME
        while not heard.done():
            self._set(node, {parameter: value})
            self.spin(HEARING_TIME, heard)
            if time.monotonic() > deadline:
                raise InputError(f"{node} does not see who records within {DISCOVERY_TIME:g} s")
        self.destroy_subscription(last)

    def _setpoint_is_subscribed(self) -> bool:
        """By anybody else than who records."""
        publisher = self._sources["setpoint"]
        infos = self.get_subscriptions_info_by_topic(publisher.topic_name)
        recorders = sum(info.node_name in (self.get_name(), RECORDER_NODE) for info in infos)
        return bool(publisher.get_subscription_count() > recorders)

    def begin_phase(self, phase: Phase) -> None:
        """Make the changes a phase starts with; in lockstep all are in place before the loop goes on."""
        self.refuse_other_loops()
        if phase.tune is not None:
            self.tune(phase.tune)
        if phase.changes:
            self._set("fopid_controller", phase.changes)
        if phase.gain_factor is not None:
            self._set("plant_simulator", {"gain_factor": phase.gain_factor})
        marker = ExperimentPhase(name=phase.name, description=describe(phase))
        self._stamp(marker, self._sample)
        self._phase.publish(marker)

    def _set(self, node: str, changes: dict[str, Any]) -> None:
        parameters = [Parameter(name, value=value) for name, value in changes.items()]
        answer = self._call(lambda: self._nodes[node].set_parameters_atomically(parameters), node)
        if not answer.result.successful:
            raise InputError(f"{node} refused a change: {answer.result.reason}")

    def _stamp(self, message: Any, sample: int) -> None:
        now = sample * self._period_ns if self.lockstep else self.get_clock().now().nanoseconds
        header_stamp(message.header, now)

    def tune(self, call: TuneCall) -> None:
        """Have the tuner tune and apply; when it does not, the loop goes on with the gains it has."""
        request = tune_request(call)
        response: Tune.Response = self._call(
            lambda: self._tune.call_async(request), "fopid_tuner", TUNING_TIME, again=TUNING_TIME
        )
        if not response.applied:
            self.not_applied.append(f"tuning by {call.method}: {'; '.join([response.message, *response.unmet])}")

    def run_phase(self, first: int, end: int, progress: Progress) -> None:
        """Let the loop run through the samples ``first`` to ``end`` - 1."""
        if not self.lockstep:
            self._run_realtime(end, progress)
            return
        while first < end:
            stop = self._publish_lookahead(first, end)
            self._advance_until(stop, progress)
            first = stop

    def _publish_lookahead(self, first: int, end: int) -> int:
        """Publish the values that change from ``first`` on; the sample up to which that is done."""
        changes = {name: at[(at >= first) & (at < end)] for name, at in self._changes.items()}
        stop = min([end, *(int(at[LOOKAHEAD]) for at in changes.values() if len(at) > LOOKAHEAD)])
        for name, at in changes.items():
            publisher = self._sources[name]
            for sample in at[at < stop].tolist():
                self._publish(name, sample)
            if not publisher.wait_for_all_acked(Duration(seconds=ANSWER_TIME)):
                raise InputError(f"{publisher.topic_name} was not taken by all who listen within {ANSWER_TIME:g} s")
        return stop

    def _publish(self, name: str, sample: int) -> None:
        message = ScalarStamped(value=float(self._values[name][sample]))
        self._stamp(message, sample)
        self._sources[name].publish(message)

    def _advance_until(self, sample: int, progress: Progress) -> None:
        last, last_moved = -1.0, time.monotonic()
        end, until = sample * self._period_ns, -1.0
        while True:
            # Never further ahead of the recorder than the publishers can remember.
            recorded = min(self.recorded(), max(last * NS, self._sample * self._period_ns))
            before, until = until, min(end, recorded + LEAD * self._period_ns)
            if until == before:
                self.spin(SLICE)
            request = Advance.Request(until=until / NS)
            answer = self._call(partial(self._advance.call_async, request), "plant_simulator")
            progress(answer.time)
            if answer.success and until == end:
                self._sample = sample
                return
            if answer.time > last:
                last, last_moved = answer.time, time.monotonic()
            elif time.monotonic() - last_moved > STALL_TIME:
                raise InputError(
                    f"the loop stands still at {answer.time:g} s, {answer.message}: does the controller answer?"
                )

    def _run_realtime(self, end: int, progress: Progress) -> None:
        """Publish each change when its time has come; of several that are due, the newest."""
        self._begun = self._begun if self._begun is not None else time.monotonic()
        h = self.experiment.sample_time
        while (elapsed := time.monotonic() - self._begun) < end * h:
            progress(elapsed)
            now = int(elapsed / h)
            for name, at in self._changes.items():
                due = at[(at >= self._sample) & (at <= now)]
                if due.size:
                    self._publish(name, int(due[-1]))
            self._sample = now + 1
            coming = min((int(at[at > now][0]) for at in self._changes.values() if at[-1] > now), default=end)
            self.spin(min(SLICE, max(min(coming, end) * h - (time.monotonic() - self._begun), 0.0) + 1e-4))

    def drain(self, end: int) -> None:
        """Serve what is still on its way: in lockstep until sample ``end`` - 1 is recorded, or nothing more comes.

        On a busy machine a message that got lost is sent again seconds later.
        """
        self.spin(DRAIN_TIME)
        last = (end - 1) * self._period_ns
        newest, moved = self.recorded(), time.monotonic()
        while self.lockstep and newest < last and time.monotonic() - moved < STALL_TIME:
            self.spin(SLICE)
            if self.recorded() > newest:
                newest, moved = self.recorded(), time.monotonic()


def tune_request(call: TuneCall) -> Tune.Request:
    """What is asked of ~/tune."""
    same = {name: value for name, value in asdict(call).items() if name != "phase_margin_deg"}
    return Tune.Request(phase_margin=math.radians(call.phase_margin_deg), apply=True, **same)


def describe(phase: Phase) -> str:
    """What a phase starts with, for people."""
    parts = [f"tune by {phase.tune.method}"] if phase.tune else []
    for name in (*SOURCES, "gain_factor"):
        value = getattr(phase, name)
        if value is not None:
            what = f"{value:g}" if isinstance(value, float) else f"({type(value).__name__.lower()})"
            parts.append(f"{name.replace('_', ' ')} {what}")
    parts += [f"{name} {value}" for name, value in phase.changes.items()]
    return ", ".join(parts)
