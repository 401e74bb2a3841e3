"""What the tuner hears: nothing is lost while it looks now and then only, and an experiment sees each tick at once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.tuner.learning.loop_tap import REPEAT_PERIOD, LoopTap, Tick
from fopid_ros.tuner.node import TunerNode

from ...conftest import own_domain

PERIOD = 0.005


class Bench:
    """A tuner, and a loop that is played to it."""

    def __init__(self) -> None:
        self.tuner, self.tester = TunerNode(), Node("tester")
        self.executor = EventsExecutor()
        for node in (self.tuner, self.tester):
            self.executor.add_node(node)
        self.tuner.start()
        tap = self.tuner._tap
        assert tap is not None
        self.tap: LoopTap = tap
        names = ("measurement", "control")
        self.publishers = [self.tester.create_publisher(ScalarStamped, name, QoSProfile(depth=1000)) for name in names]
        self.until(lambda: all(publisher.get_subscription_count() for publisher in self.publishers))

    def spin(self, seconds: float) -> None:
        self.executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def until(self, ready: Callable[[], Any]) -> None:
        deadline = time.monotonic() + 20.0
        while not ready():
            assert time.monotonic() < deadline
            self.spin(0.01)

    def play(self, ticks: range, apart: float = 0.0) -> None:
        """Publish measurement k and control -k, stamped PERIOD apart, as fast as it goes or so far apart [s]."""
        for k in ticks:
            for value, publisher in zip((k, -k), self.publishers, strict=True):
                message = ScalarStamped(value=float(value))
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(k * PERIOD * 1e9), 10**9)
                publisher.publish(message)
                time.sleep(apart)


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    """Makes a bench, with parameters as a command line has them."""
    made: list[Bench] = []

    def one(*parameters: str) -> Bench:
        given = [word for parameter in parameters for word in ("-p", parameter)]
        rclpy.init(args=["--ros-args", *given], domain_id=domain)
        made.append(Bench())
        return made[-1]

    with own_domain() as domain:
        try:
            yield one
        finally:
            for bench in made:
                bench.tuner.stop()
                bench.tuner.destroy_node()
                bench.tester.destroy_node()
                bench.executor.shutdown()
            rclpy.try_shutdown()


def test_an_idle_tuner_misses_nothing_of_what_comes_between_two_looks(make: Callable[..., Bench]) -> None:
    bench = make()
    assert not [each for each in bench.tuner.subscriptions if each.topic_name in ("/measurement", "/control")]
    bench.play(range(1, 301))
    bench.until(lambda: bench.tap.history.newest("control") == -300.0)
    record = bench.tap.history.record()
    assert list(record.control) == [-float(k) for k in range(1, 301)]
    assert list(record.measurement) == [float(k) for k in range(1, 301)]
    assert record.time == pytest.approx([k * PERIOD for k in range(300)])


def test_a_hook_sees_each_tick_at_once_with_the_measurement_it_answers(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.play(range(1, 11))
    bench.until(lambda: bench.tap.history.newest("control") == -10.0)
    bench.tap.history.add("setpoint", 0.0, 0.0)
    ticks: list[tuple[Tick, float]] = []
    bench.tap.set_tick_hook(lambda tick: ticks.append((tick, time.monotonic())))
    bench.spin(3.0 * REPEAT_PERIOD)
    sent = []
    for k in range(11, 31):
        sent.append(time.monotonic())
        bench.play(range(k, k + 1))
        bench.until(lambda: len(ticks) == len(sent))
    assert [(tick.measurement, tick.control) for tick, _ in ticks] == [(float(k), -float(k)) for k in range(11, 31)]
    took = sorted(seen - at for (_, seen), at in zip(ticks, sent, strict=True))
    assert took[len(took) // 2] < 0.5 * REPEAT_PERIOD  # looking now and then would take all of it
    bench.tap.set_tick_hook(None)
    bench.spin(3.0 * REPEAT_PERIOD)
    bench.play(range(31, 34))
    bench.until(lambda: bench.tap.history.newest("control") == -33.0)
    assert len(ticks) == 20


def test_after_a_halt_each_tick_is_seen_with_the_measurement_it_answered(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.play(range(1, 11))
    bench.until(lambda: bench.tap.history.newest("control") == -10.0)
    bench.tap.history.add("setpoint", 0.0, 0.0)
    ticks: list[Tick] = []
    bench.tap.set_tick_hook(ticks.append)
    bench.spin(3.0 * REPEAT_PERIOD)
    bench.play(range(11, 61), apart=0.005)  # nobody reads meanwhile
    bench.until(lambda: len(ticks) == 50)
    assert [(tick.measurement, tick.control) for tick in ticks] == [(float(k), -float(k)) for k in range(11, 61)]
    ages = [tick.age for tick in ticks]
    assert 0.3 < ages[0] - ages[-1] < 5.0
    assert ages == sorted(ages, reverse=True)


@pytest.mark.parametrize("parameter", ["use_sim_time:=true", "angle_wraparound:=true"])
def test_where_the_order_of_topics_counts_each_message_is_read_as_it_comes(
    make: Callable[..., Bench], parameter: str
) -> None:
    bench = make(parameter)
    assert len([each for each in bench.tuner.subscriptions if each.topic_name in ("/measurement", "/control")]) == 2


def test_a_control_that_comes_while_the_tuner_is_cleaned_up_does_no_harm(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.tap.set_tick_hook(lambda _: None)
    bench.spin(3.0 * REPEAT_PERIOD)
    bench.play(range(1, 51))
    time.sleep(0.1)  # they are there, and the executor has not looked yet
    bench.tuner.trigger_deactivate()
    bench.tuner.trigger_cleanup()
    bench.spin(0.1)
    assert bench.tuner.guard.count == 0, bench.tuner.guard.last


def test_since_when_the_controller_is_the_same_is_noted(make: Callable[..., Bench]) -> None:
    bench = make()
    topic = f"{bench.tuner.get_parameter('controller').value}/state"
    publisher = bench.tester.create_publisher(FopidState, topic, QoSProfile(depth=10))
    bench.until(publisher.get_subscription_count)
    changes, regained = [], []
    for k, said in enumerate(
        ({"kp": 1.0}, {"kp": 1.0}, {"kp": 2.0}, {"kp": 2.0}, {"kp": 2.0, "mode": FopidState.MANUAL})
    ):
        message = FopidState(setpoint=1.0, **said)
        message.header.stamp.sec = 100 + k
        publisher.publish(message)
        bench.spin(3.0 * REPEAT_PERIOD)
        changes.append(bench.tap.history.changed)
        regained.append(bench.tap.history.regained)
    assert changes == [100.0, 100.0, 102.0, 102.0, 104.0]
    assert regained == [-math.inf, -math.inf, 102.0, 102.0, 102.0]


def test_what_comes_in_place_of_a_measurement_is_told(make: Callable[..., Bench]) -> None:
    tap, stale = make().tap, FopidState(stale=True, measurement_age=1e3)
    told = []
    for value in (math.nan, 1.0):
        tap._heard("measurement", 1.0, value)
        tap._note_open_loop(stale)
        told.append(tap.open_loop(0.0)[1])
    usual = "waits for a fresh measurement: the newest is 1e+03 s old"
    assert told == [f"{usual}, and nan comes now", usual]
