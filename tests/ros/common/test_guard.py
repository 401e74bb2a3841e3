"""Whatever a callback of a node raises, the node goes on, answers, logs a traceback and counts it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import DescribeParameters, GetParameters, GetParameterTypes, ListParameters
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from fopid_ros.common.background import Later
from fopid_ros.common.guard import INTERNAL_ERROR, LOG_PERIOD, Guard
from fopid_ros.common.managed_node import ManagedNode
from fopid_ros.common.parameters import Spec

from ..conftest import own_domain


def too_deep() -> None:
    too_deep()


def too_much() -> None:
    raise MemoryError


ERRORS: dict[str, Callable[[], Any]] = {
    "ZeroDivisionError": lambda: 1 / 0, "RecursionError": too_deep, "MemoryError": too_much,
    "KeyError": lambda: {}["nothing"], "UnicodeDecodeError": lambda: b"\xff".decode(),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_what_a_callback_raises_is_counted_logged_and_answered(name: str) -> None:
    lines: list[str] = []
    guard = Guard(lines.append)
    assert guard.wrap("request", ERRORS[name], lambda: "answer")() == "answer"
    assert guard.count == 1
    assert guard.last.startswith(f"request: {name}")
    assert "Traceback" in lines[0]
    assert name in lines[0]


def test_the_same_error_again_is_counted_but_not_logged_at_every_tick() -> None:
    lines: list[str] = []
    now = [0.0]
    guard = Guard(lines.append, lambda: now[0])
    for k in range(1000):
        now[0] = 0.01 * k
        guard.wrap("tick", ERRORS["KeyError"])()
    assert guard.count == 1000
    assert len(lines) == 1
    now[0] = LOG_PERIOD + 1.0
    guard.wrap("tick", ERRORS["KeyError"])()
    assert len(lines) == 2


def test_refusals_of_one_topic_do_not_silence_those_of_another() -> None:
    now = [0.0]
    guard = Guard(lambda _: None, lambda: now[0])
    told: list[tuple[int, str]] = []
    for k in range(25):
        now[0] = 0.1 * k
        told += [(k, topic) for topic in ("measurement", "state") if guard.is_due((topic,), 0.95)]
    assert told == [(k, topic) for k in (0, 10, 20) for topic in ("measurement", "state")]


def test_an_error_is_one_report_long_an_error_and_then_a_warning() -> None:
    guard = Guard(lambda _: None)
    assert guard.health_problems() == []
    guard.note("x", ValueError("y"))
    assert [level for level, _ in guard.health_problems()] == [DiagnosticStatus.ERROR]
    assert [level for level, _ in guard.health_problems()] == [DiagnosticStatus.WARN]


class Faulty(ManagedNode):
    """Each of its callbacks fails."""

    NAME = "faulty"
    SPECS = (Spec("gain", 1.0, "a number; 13 fails", 0.0, 100.0), Spec("other", 1.0, "another", 0.0, 100.0))

    def __init__(self, context: Context) -> None:
        super().__init__(context=context)
        self.applied: list[float] = []
        self.fail_deactivate = False

    def apply(self, values: dict[str, Any]) -> None:
        self.applied.append(values["gain"])
        if values["gain"] == 13.0:
            raise ZeroDivisionError("13")

    def open(self, _: dict[str, Any]) -> None:
        self.open_diagnostics()
        self.create_subscription(Float64, "in", self._fail, 1)
        self.create_service(Trigger, "~/fail", self._fail)
        self.background.may_answer_later(self.create_service(Trigger, "~/later", self._later))

    def on_deactivate(self, state: Any) -> Any:
        if self.fail_deactivate:
            raise ValueError("deactivate")
        return super().on_deactivate(state)

    def _fail(self, *_: Any) -> None:
        raise IndexError("fail")

    def _later(self, _: Trigger.Request, response: Trigger.Response) -> Later:
        later = Later(self.background)

        def work() -> None:
            time.sleep(0.2)
            response.success, response.message = True, "in time"
            later.give(response)
            later.give(Trigger.Response(message="once more"))

        self.background.start("work", work)
        return later


class Bench:
    def __init__(self, context: Context) -> None:
        self.faulty, self.tester = Faulty(context), Node("tester", context=context)
        self.executor = EventsExecutor(context=context)
        for node in (self.faulty, self.tester):
            self.executor.add_node(node)
        self.faulty.start()
        self.parameters = AsyncParameterClient(self.tester, "faulty")

    def until(self, ready: Callable[[], Any]) -> None:
        deadline = time.monotonic() + 20.0
        while not ready():
            assert time.monotonic() < deadline
            self.executor.spin_until_future_complete(Future(), timeout_sec=0.01)

    def result(self, future: Future) -> Any:
        self.until(future.done)
        return future.result()

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.tester.create_client(kind, name)
        self.until(client.service_is_ready)
        return self.result(client.call_async(request))


@pytest.fixture
def bench() -> Iterator[Bench]:
    with own_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        bench = Bench(context)
        yield bench
        for node in (bench.faulty, bench.tester):
            node.destroy_node()
        bench.executor.shutdown()
        rclpy.shutdown(context=context)


def test_no_callback_of_a_node_ends_it(bench: Bench) -> None:
    heard: list[DiagnosticArray] = []
    bench.tester.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    assert bench.call(Trigger, "faulty/fail", Trigger.Request()) == Trigger.Response(message=INTERNAL_ERROR)
    publisher = bench.tester.create_publisher(Float64, "in", 1)
    bench.until(publisher.get_subscription_count)
    before = bench.faulty.guard.count
    publisher.publish(Float64())
    bench.until(lambda: bench.faulty.guard.count > before)
    bench.until(lambda: any("internal error" in m.status[0].message for m in heard))
    facts = {value.key: value.value for value in heard[-1].status[0].values}
    assert "IndexError: fail" in facts["last internal error"]
    assert bench.call(Trigger, "faulty/later", Trigger.Request()).message == "in time"


def test_parameters_whose_use_fails_are_put_back(bench: Bench) -> None:
    bench.until(bench.parameters.services_are_ready)
    assert bench.faulty.set_parameters_atomically([Parameter("gain", value=2.0)]).successful
    changes = [Parameter("other", value=7.0), Parameter("gain", value=13.0)]
    result = bench.result(bench.parameters.set_parameters_atomically(changes)).result
    assert not result.successful
    assert result.reason == INTERNAL_ERROR
    assert (bench.faulty.values()["gain"], bench.faulty.values()["other"]) == (2.0, 1.0)
    assert bench.faulty.applied[-1] == 2.0


@pytest.mark.parametrize(
    ("kind", "name", "field"),
    [(ListParameters, "list_parameters", "prefixes"), (GetParameters, "get_parameters", "names"),
     (DescribeParameters, "describe_parameters", "names"), (GetParameterTypes, "get_parameter_types", "names")],
)  # fmt: skip
def test_who_asks_for_a_million_parameters_holds_nobody_up(bench: Bench, kind: Any, name: str, field: str) -> None:
    def count(names: list[str]) -> int:
        answer = bench.call(kind, f"faulty/{name}", kind.Request(**{field: names}))
        answer = getattr(answer, "result", answer)
        return len(getattr(answer, next(each for each in ("names", "values", "descriptors", "types")
                                        if hasattr(answer, each))))  # fmt: skip

    assert count(["gain"]) == 1
    assert count(["gain", "other"]) == 2
    began = time.monotonic()
    assert count(["x"] * 200_000 + ["gain"]) == 0
    assert time.monotonic() - began < 10.0
    assert count(["gain"]) == 1


def test_a_transition_that_fails_is_answered_and_counted(bench: Bench) -> None:
    bench.faulty.fail_deactivate = True
    request = ChangeState.Request()
    request.transition.label = "deactivate"
    assert not bench.call(ChangeState, "faulty/change_state", request).success
    assert "ValueError: deactivate" in bench.faulty.guard.last
    assert bench.faulty._state_machine.current_state[0] == State.PRIMARY_STATE_UNCONFIGURED


def test_an_error_in_what_follows_an_error_does_not_end_the_node_either() -> None:
    guard = Guard([].append)
    assert guard.wrap("tick", lambda: 1 / 0, otherwise=lambda: [][1])() is None
    assert (guard.count, guard.last) == (2, "what follows an error of tick: IndexError: list index out of range")
