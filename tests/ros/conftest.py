"""A loop of real nodes in processes of their own, on a ROS domain that nobody else uses."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rclpy
from domain_coordinator import domain_id
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.task import Future

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_msgs.srv import Advance
from fopid_ros.experiment.child_processes import ros_arguments

from ..patience import FACTOR
from .node_process import NodeProcess

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `make` sets it; before the first numpy of a node

BIN = Path(sys.executable).parent
# Each of pytest's processes has domains of its own: what a neighbour's test killed is announced there for a while.
_WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_DOMAINS = itertools.islice(itertools.cycle(range(1 + _WORKER, 101, _WORKERS)), os.getpid() % 100, None)
PATIENCE = 60.0 * FACTOR
SETTLE = 0.3  # [s] a server may find a new client a little later than the client finds it; its answer would be lost
DEEP = QoSProfile(depth=100_000)


def own_domain() -> AbstractContextManager[int]:
    """A ROS domain that nobody else uses, nor the test before: what was killed there is announced for a while yet."""
    return domain_id(lambda: next(_DOMAINS))


MALFORMED = (
    b"\0", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 5, b"\0\1\0\0" + bytes(8) + b"\xff\xff\xff\xff",
    b"\0\0\0\0\1", b"\0\0\0\0" + bytes(8) + b"\x7f\xff\xff\xff", b"\7\7\0\0\1",
)  # fmt: skip
"""Bytes that are no message of the loop: cut short, with lengths beyond their end, of either byte order, of none.

Not none at all: of a publisher of those a reliable reader of Fast DDS hears nothing more.
"""


def without_middleware(text: str) -> str:
    """A log without what Fast DDS tells by itself.

    Its shared memory is numbered over all domains of the machine, so it tells, and waits, when a neighbour was killed
    or stopped in the middle of making some.
    """
    return "".join(line for line in text.splitlines(keepends=True) if "RTPS_" not in line)


def only_line(text: str) -> str:
    """The one line that a log is."""
    told = without_middleware(text)
    assert told.count("\n") == 1, told
    return told.strip()


class Graph:
    """Starts nodes, talks to them, ends them."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "OPENBLAS_NUM_THREADS": "1",
        }
        self.domain = domain
        self._folder = folder
        self._processes: list[NodeProcess] = []
        self._strangers: list[subprocess.Popen[bytes]] = []
        self._clients: dict[str, Any] = {}
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("tester", context=self.context)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)

    def start(self, executable: str, parameters: Mapping[str, object], *more: str) -> NodeProcess:
        """Start an executable; its output goes to a file that ``logs`` reads.

        A controller may start without gains here: many tests are about something else.
        """
        if executable == "fopid_controller":
            parameters = {"allow_zero_gains": True, **parameters}
        log = self._folder / f"{executable}-{len(self._processes)}.log"
        process = NodeProcess(executable, [*ros_arguments(parameters), *more], self.environment, log)
        self._processes.append(process)
        return process

    def run_script(self, script: Path, *arguments: str) -> subprocess.Popen[bytes]:
        """Run a Python script that is none of our nodes; it ends with the test."""
        self._strangers.append(subprocess.Popen([sys.executable, str(script), *arguments], env=self.environment))
        return self._strangers[-1]

    def spin(self, seconds: float) -> None:
        self.executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def until(self, ready: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not ready():
            assert time.monotonic() < deadline, f"{what} within {patience} s; logs: {self.logs()}"
            self.spin(0.02)

    def logs(self) -> str:
        return "\n".join(process.log.read_text() for process in self._processes)

    def result(self, future: Future, patience: float = PATIENCE) -> Any:
        self.until(future.done, "an answer", patience)
        return future.result()

    def client(self, kind: type, name: str) -> Any:
        return self._settled(
            name, partial(self.node.create_client, kind, name), "service_is_ready", f"the service {name}"
        )

    def _settled(self, name: str, create: Callable[[], Any], ready: str, what: str) -> Any:
        """A client whose server knows it too: a new one is often ready at once, for the server was heard of before."""
        new = name not in self._clients
        if new:
            self._clients[name] = create()
        client = self._clients[name]
        if new or not getattr(client, ready)():
            self.until(getattr(client, ready), what)
            self.spin(SETTLE)
        return client

    def call(self, kind: type, name: str, request: Any = None, patience: float = PATIENCE) -> Any:
        client = self.client(kind, name)
        return self.result(client.call_async(request if request is not None else kind.Request()), patience)

    def listen(self, kind: type, topic: str, qos: QoSProfile = DEEP) -> list[Any]:
        """All messages of a topic from now on, newest last."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def changes(self, controller: str) -> list[dict[str, Any]]:
        """What is told of changes of its parameters from now on; nothing is missed, for one change has been heard."""
        heard, told = [], []

        def arrived(event: ParameterEvent) -> None:
            if event.node == f"/{controller}" and event.changed_parameters:  # others tell of parameters that are new
                changed = {one.name: parameter_value_to_python(one.value) for one in event.changed_parameters}
                (heard if set(changed) == {"trial_timeout"} else told).append(changed)

        self.node.create_subscription(ParameterEvent, "/parameter_events", arrived, DEEP)
        (usual,) = self.get(controller, "trial_timeout")
        self.until(lambda: self.set(controller, trial_timeout=usual) and heard, "a parameter event")
        return told

    def listen_once(self, kind: type, topic: str) -> list[Any]:
        """The same, but of messages with one stamp the first: in lockstep what is late to be answered is sent again."""
        messages: list[Any] = []

        def arrived(message: Any) -> None:
            if not messages or message.header.stamp != messages[-1].header.stamp:
                messages.append(message)

        self.node.create_subscription(kind, topic, arrived, DEEP)
        return messages

    def parameters(self, node: str) -> AsyncParameterClient:
        create = partial(AsyncParameterClient, self.node, node)
        return self._settled(node, create, "services_are_ready", f"parameters of {node}")

    def await_restarted(self, node: str) -> None:
        """Wait until the process that followed a killed one answers.

        The killed one is listed, and ready, for some 20 s yet, so readiness says nothing of the new one, and what is
        asked before that is found (0.3 s to 3 s) reaches nobody: ask again, of the last service that a node makes.
        """
        asked: list[Future] = []

        def answered() -> bool:
            asked.append(self.parameters(node).list_parameters())
            self.executor.spin_until_future_complete(asked[-1], timeout_sec=0.5)
            return any(future.done() for future in asked)

        self.until(answered, f"an answer of the new {node}")

    def set(self, node: str, **values: object) -> Any:
        """Set parameters atomically; dots in names are written as two underscores."""
        changes = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        return self.result(self.parameters(node).set_parameters_atomically(changes)).result

    def get(self, node: str, *names: str) -> list[Any]:
        answer = self.result(self.parameters(node).get_parameters(list(names)))
        return [parameter_value_to_python(value) for value in answer.values]

    def close(self) -> None:
        processes = [*self._processes, *self._strangers]
        for process in processes:
            if process.poll() is None:
                process.terminate()
        for process in processes:
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)


def stamp(message: Any) -> float:
    """Of its header [s]."""
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


class LockstepLoop:
    """Plant and controller in lockstep; time stands still except in ``advance``."""

    def __init__(self, graph: Graph, process: str, gains: Mapping[str, float], sample_time: float = 0.01,
                 plant: Mapping[str, object] | None = None, controller: Mapping[str, object] | None = None,
                 namespace: str = "") -> None:  # fmt: skip
        self.graph, self.prefix = graph, f"/{namespace}/" if namespace else "/"
        self._sample_time = sample_time
        remap = ["-r", f"__ns:=/{namespace}", "-r", "/clock:=clock"] if namespace else []
        common = {"trigger": "lockstep", "sample_time": sample_time}
        node = graph.node
        self.measurements = graph.listen_once(ScalarStamped, f"{self.prefix}measurement")
        self.controls = graph.listen_once(ScalarStamped, f"{self.prefix}control")
        self.states = graph.listen(FopidState, f"{self.prefix}fopid_controller/state")
        self._setpoint = node.create_publisher(ScalarStamped, f"{self.prefix}setpoint", 1)
        self._disturbance = node.create_publisher(ScalarStamped, f"{self.prefix}disturbance", 1)
        plant_parameters = {**common, "process": process, "advance_until": 0.0, **(plant or {})}
        self.plant = graph.start("plant_simulator", plant_parameters, *remap)
        self.controller = graph.start("fopid_controller", {**common, **gains, **(controller or {})}, *remap)
        self._advance = graph.client(Advance, f"{self.prefix}plant_simulator/advance")
        graph.until(self._setpoint.get_subscription_count, "the controller")
        graph.until(self._disturbance.get_subscription_count, "the plant")
        graph.until(lambda: graph.node.count_publishers(f"{self.prefix}control"), "the controller")
        graph.spin(0.3)

    def publish(self, signal: str, value: float) -> None:
        from rclpy.duration import Duration

        publisher = self._setpoint if signal == "setpoint" else self._disturbance
        publisher.publish(ScalarStamped(value=value))
        assert publisher.wait_for_all_acked(Duration(seconds=5))

    def advance(self, until: float) -> None:
        def reached() -> bool:
            answer = self.graph.result(self._advance.call_async(Advance.Request(until=until)))
            return answer.success

        self.graph.until(reached, f"the loop at {until} s")
        last = until - 1.5 * self._sample_time  # what is lost on the way comes once more, but not at once
        for what, heard in (("measurement", self.measurements), ("control", self.controls)):
            self.graph.until(lambda heard=heard: heard and stamp(heard[-1]) > last, f"the {what} at {until} s")
        heard = -1
        while heard != (heard := len(self.measurements) + len(self.controls) + len(self.states)):
            self.graph.spin(0.2)


@contextmanager
def own_graph(folder: Path) -> Iterator[Graph]:
    """A graph on a domain of its own, with logs in a folder; what it started has ended when it is left."""
    with own_domain() as domain:
        graph = Graph(domain, folder)
        try:
            yield graph
        finally:
            graph.close()


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    with own_graph(tmp_path) as graph:
        yield graph
