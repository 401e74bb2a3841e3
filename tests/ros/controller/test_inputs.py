"""The inputs of a controller, how they age, refuse and wait: the logic, without processes and without a wire."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from fopid_msgs.msg import ScalarStamped
from fopid_ros.common.diagnostics import TickCounts
from fopid_ros.common.inputs import Input
from fopid_ros.common.pending_values import PendingValues
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.inputs import LoopInputs, timeouts

S = 1_000_000_000
VALUES = {
    "measurement_timeout": -1.0, "tracking_timeout": -1.0, "feedforward_timeout": -1.0, "setpoint_timeout": 0.0,
    "manual_control_timeout": 0.0, "sample_time": 0.01, "trigger": "realtime", "clock_skew_max": 0.0,
    "tracking.required": False,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (
            {},
            {"measurement": 0.1, "tracking": 0.1, "feedforward": 0.5, "setpoint": math.inf, "manual_control": math.inf},
        ),
        ({"sample_time": 0.02}, {"measurement": 0.1}),
        ({"sample_time": 0.04}, {"measurement": 0.2, "tracking": 0.2, "feedforward": 0.5}),
        ({"sample_time": 0.2}, {"measurement": 1.0, "feedforward": 1.0}),
        ({"trigger": "lockstep"}, {"measurement": 0.1, "tracking": 0.1, "feedforward": 100.0}),
        ({"measurement_timeout": 0.0}, {"measurement": math.inf, "tracking": 0.1}),
        ({"measurement_timeout": 0.03, "setpoint_timeout": 2.0}, {"measurement": 0.03, "setpoint": 2.0}),
        ({"trigger": "lockstep", "feedforward_timeout": 3.0}, {"feedforward": 3.0}),
        ({"manual_control_timeout": 4.0}, {"manual_control": 4.0}),
    ],
)
def test_a_timeout_is_five_ticks_and_no_less_than_an_operating_system_holds_up_unless_it_is_given(
    changed: dict[str, Any], expected: dict[str, float]
) -> None:
    found = timeouts({**VALUES, **changed})
    assert {name: found[name] for name in expected} == pytest.approx(expected)


class Alone:
    """Stands for the node: its clock, its log, and the subscriptions, by topic."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.told: list[str] = []
        self.said: list[str] = []
        self.topics: dict[str, Any] = {}
        self.endpoints = self

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value={"use_sim_time": True}[name])

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda text, **_: self.told.append(text), info=self.said.append)

    def subscription(self, _kind: type, topic: str, callback: Any, _qos: Any, **_: Any) -> Any:
        self.topics[topic] = callback
        return SimpleNamespace(topic_name=topic)


class Heard:
    """The inputs of a controller whose time the test moves."""

    def __init__(self, setpoint: float = math.nan, begin_ns: int = 0, **changed: Any) -> None:
        self.node, self.counts, self.loop_ns = Alone(), TickCounts(), begin_ns
        types = dict.fromkeys(
            ("setpoint", "measurement", "feedforward", "manual_control", "tracking", "scheduling_variable"),
            SignalType("fopid_msgs/msg/ScalarStamped", "value"),
        )
        node: Any = self.node
        self.inputs = LoopInputs(node, {**VALUES, **changed}, types, self.counts, lambda: self.loop_ns, setpoint)

    def at(self, seconds: float) -> int:
        """Let both clocks stand there [s]; the same in [ns]."""
        self.loop_ns = self.node.now_ns = round(seconds * S)
        return self.loop_ns

    def measure(self, value: float, stamp: float = 0.0) -> None:
        self.inputs.take_measurement(message(value, stamp))


def message(value: float, stamp: float = 0.0) -> ScalarStamped:
    made = ScalarStamped(value=value)
    made.header.stamp.sec, made.header.stamp.nanosec = divmod(round(stamp * S), S)
    return made


def test_what_is_there_at_the_start_is_new_then_and_an_addend_is_none() -> None:
    heard = Heard(setpoint=2.0, begin_ns=9 * S, setpoint_timeout=1.0)
    assert heard.inputs.setpoint.usable(10 * S)
    assert not heard.inputs.setpoint.usable(10 * S + 1)
    assert heard.inputs.feedforward.value == 0.0
    assert heard.inputs.manual.missing


def test_a_kept_setpoint_counts_until_one_is_sent_and_not_when_it_comes_from_the_future(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept: list[Any] = []
    stopped: list[bool] = []

    def keeps(_node: Any, _endpoints: Any, _kind: type, take: Any) -> Any:
        kept.append(take)
        return SimpleNamespace(stop=lambda: stopped.append(True))

    monkeypatch.setattr("fopid_ros.controller.inputs.KeptSetpoint", keeps)
    heard = Heard()
    heard.at(5.0)
    heard.inputs.listen(tracking=False, scheduling=False)
    (take,) = kept
    take(message(3.0, stamp=9.0))
    assert heard.inputs.setpoint.missing
    take(message(3.0, stamp=4.0))
    assert (heard.inputs.setpoint.value, heard.inputs.setpoint.received_ns) == (3.0, 5 * S)
    assert heard.node.said == ["setpoint = 3, as its publisher has kept it"]
    heard.node.topics["feedforward"](message(1.0))
    assert not stopped
    heard.node.topics["setpoint"](message(4.0))
    assert stopped


def test_a_measurement_is_usable_until_its_time_is_over_and_not_a_nanosecond_longer() -> None:
    heard = Heard()
    heard.inputs.take(heard.inputs.setpoint, 1.0, 0)
    assert heard.inputs.unusable(0, "auto") == [heard.inputs.measurement]
    came = heard.at(2.0)
    heard.measure(0.5)
    assert heard.inputs.measurement.value == 0.5
    assert heard.inputs.unusable(came + S // 10, "auto") == []
    assert heard.inputs.unusable(came + S // 10 + 1, "auto") == [heard.inputs.measurement]


def test_the_same_sample_again_is_as_old_as_it_was() -> None:
    heard = Heard()
    came = heard.at(2.0)
    heard.measure(0.5, stamp=2.0)
    heard.at(2.09)
    heard.measure(0.5, stamp=2.0)
    assert heard.inputs.measurement.received_ns == came
    assert heard.counts.backward_time_jumps == 0
    heard.measure(0.5, stamp=2.05)
    assert heard.inputs.measurement.received_ns == heard.loop_ns


def test_a_sample_was_taken_when_its_stamp_says_or_else_when_it_came() -> None:
    heard = Heard()
    heard.at(2.0)
    heard.measure(0.5, stamp=1.97)
    assert heard.inputs.sampled_ns == round(1.97 * S)
    heard.measure(math.nan, stamp=1.98)  # refused: the last good one counts
    assert heard.inputs.sampled_ns == round(1.97 * S)
    came = heard.at(2.02)
    heard.measure(0.6)
    assert heard.inputs.sampled_ns == came


def test_gains_that_follow_a_variable_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fopid_ros.controller.inputs.KeptSetpoint", lambda *_: None)
    heard = Heard()
    assert heard.inputs.scheduling.without == "the gains stay as they are"
    heard.inputs.take(heard.inputs.setpoint, 1.0, 0)
    heard.inputs.take(heard.inputs.measurement, 1.0, 0)
    assert heard.inputs.unusable(0, "auto") == []
    heard.inputs.listen(tracking=False, scheduling=True)
    assert heard.inputs.unusable(0, "auto") == [heard.inputs.scheduling]
    heard.inputs.take(heard.inputs.scheduling, 0.5, 0)
    assert heard.inputs.unusable(0, "auto") == []


def test_a_straggler_is_refused_once_and_a_clock_that_was_set_back_is_followed() -> None:
    heard = Heard()
    heard.at(10.0)
    for value, stamp in ((0.5, 10.0), (0.6, 9.0)):
        heard.measure(value, stamp)
    assert heard.inputs.measurement.value == 0.5
    assert heard.counts.backward_time_jumps == 1
    assert "ran backwards" in heard.node.told[-1]
    heard.measure(0.7, 9.01)
    assert heard.inputs.measurement.value == 0.7
    assert heard.counts.backward_time_jumps == 1
    heard.measure(0.8, 10.0)
    heard.inputs.begin()
    heard.measure(0.9, 5.0)  # the order of the samples before is forgotten
    assert heard.inputs.measurement.value == 0.9


@pytest.mark.parametrize(("skew", "allowed"), [(0.0, 0.01), (0.5, 0.51)])
def test_a_stamp_more_than_a_tick_and_the_skew_ahead_is_refused_and_counted(skew: float, allowed: float) -> None:
    heard = Heard(clock_skew_max=skew)
    heard.at(100.0)
    heard.measure(0.5, stamp=100.0 + allowed)
    assert (heard.inputs.measurement.value, heard.counts.stamps_ahead) == (0.5, 0)
    heard.measure(0.9, stamp=100.0 + allowed + 1e-6)
    assert heard.inputs.measurement.value == 0.5
    assert (heard.counts.stamps_ahead, heard.counts.refused_values, heard.inputs.measurement.refused) == (1, 1, 1)
    assert f"allowed: {allowed:g} s" in heard.node.told[-1]
    heard.inputs.take_settings({**VALUES, "clock_skew_max": 1.0})
    heard.measure(0.9, stamp=101.0)
    assert heard.inputs.measurement.value == 0.9


class Clocks:
    """The steady and the system's clock [ns], as the test sets them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.steady, self.system = 100 * S, 1000 * S
        told = SimpleNamespace(monotonic_ns=lambda: self.steady, time_ns=lambda: self.system)
        monkeypatch.setattr("fopid_ros.controller.stamps.time", told)


@pytest.mark.parametrize(
    ("set_by", "expected"), [(0.0, 0.003), (3600.0, 0.004), (-3600.0, 0.0)]
)  # [s]; it came 1 ms after the last look, and was read 3 ms later
def test_a_measurement_is_as_old_as_it_waited_for_its_tick_whatever_the_system_clock_is_set_to(
    monkeypatch: pytest.MonkeyPatch, set_by: float, expected: float
) -> None:
    clocks = Clocks(monkeypatch)
    heard = Heard()
    heard.inputs.stamps.looked()
    came = clocks.system + S // 1000
    clocks.steady += 4 * S // 1000
    clocks.system += 4 * S // 1000 + round(set_by * S)
    now = heard.at(2.0)
    heard.inputs.take_measurement(message(0.5), {"received_timestamp": came})
    assert heard.inputs.measurement.age(now) == pytest.approx(expected, abs=1e-9)


def test_a_stamp_is_judged_by_when_its_sample_came_and_not_by_when_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    heard = Heard()
    clocks.steady += S
    heard.at(100.0)
    for waited, refused in ((0.0, 0), (0.005, 1)):
        info = {"received_timestamp": clocks.system - round(waited * S)}
        heard.inputs.take_measurement(message(0.5, stamp=100.008), info)  # a tick is 0.01 s
        assert heard.counts.stamps_ahead == refused


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.1e100])
def test_a_value_that_is_no_number_is_refused_counted_and_told_and_the_last_one_ages_on(value: float) -> None:
    heard = Heard()
    came = heard.at(1.0)
    heard.measure(0.5)
    heard.at(1.05)
    heard.measure(value)
    one = heard.inputs.measurement
    assert (one.value, one.received_ns, one.refused, heard.counts.refused_values) == (0.5, came, 1, 1)
    assert heard.counts.stamps_ahead == 0
    assert f"measurement = {value}" in heard.node.told[-1]
    assert ("at 'value'" in heard.node.told[-1]) == math.isnan(value)
    assert heard.inputs.facts(heard.loop_ns)["refused of the measurement"] == 1
    assert heard.inputs.facts(heard.loop_ns)["age of the measurement [s]"] == pytest.approx(0.05)


def test_a_manual_control_counts_in_manual_mode_only_and_only_once_it_came() -> None:
    heard = Heard(manual_control_timeout=1.0)
    inputs = heard.inputs
    inputs.take(inputs.setpoint, 1.0, 0)
    inputs.take(inputs.measurement, 0.5, 9 * S)
    assert inputs.unusable(9 * S, "manual") == []  # a control that never came: the loop's own stays
    inputs.take(inputs.manual, 0.3, 0)
    assert inputs.unusable(S, "manual") == []
    inputs.take(inputs.measurement, 0.5, 9 * S)
    assert inputs.unusable(9 * S, "manual") == [inputs.manual]
    assert inputs.unusable(9 * S, "auto") == []


def test_what_the_loop_can_do_without_is_dropped_when_it_is_old() -> None:
    inputs = Heard().inputs
    assert inputs.dropped(100 * S) == []
    inputs.take(inputs.feedforward, 0.2, S)
    inputs.take(inputs.tracking, 0.2, S)
    assert inputs.dropped(S + S // 10) == []
    assert inputs.dropped(S + S // 10 + 1) == [inputs.tracking]
    assert inputs.dropped(2 * S) == [inputs.feedforward, inputs.tracking]
    inputs.take(inputs.feedforward, 0.0, S)  # nothing that could be missed
    assert inputs.dropped(2 * S) == [inputs.tracking]
    inputs.begin_anew(2 * S)
    assert inputs.dropped(2 * S) == []


def test_tracking_that_is_required_is_not_done_without() -> None:
    inputs = Heard(**{"tracking.required": True}).inputs
    for one in (inputs.setpoint, inputs.measurement):
        inputs.take(one, 1.0, S)
    assert inputs.unusable(S, "auto") == [inputs.tracking]
    inputs.take(inputs.tracking, 0.2, S)
    assert inputs.unusable(S + S // 10, "auto") == []
    assert inputs.tracking in inputs.unusable(S + S // 10 + 1, "auto")
    assert inputs.dropped(2 * S) == []


def test_an_addend_fades_in_a_straight_line_within_another_timeout() -> None:
    addend = Input("feedforward", 0.0)
    addend.timeout_ns = 100
    addend.take(0.8, 1000)
    found = [addend.faded(1000 + age) for age in (0, 100, 101, 125, 150, 200, 500)]
    assert found == pytest.approx([0.8, 0.8, 0.792, 0.6, 0.4, 0.0, 0.0])


@pytest.mark.parametrize("value", [-1e100, 1e100])
def test_the_largest_values_are_taken_and_an_input_without_a_timeout_never_ages(value: float) -> None:
    one = Input("measurement")
    assert one.take(value, 5)
    assert one.usable(10**30)
    assert not one.stale(10**30)
    assert Input("measurement").received_ns == 0


def test_only_what_came_can_be_stale_and_has_an_age() -> None:
    one = Input("setpoint", 1.0)
    one.timeout_ns = 100
    assert not one.stale(10_000)
    assert not one.missing
    assert math.isnan(one.age(10_000))
    one.take(2.0, 10_000)
    assert (one.stale(10_100), one.stale(10_101)) == (False, True)
    assert one.age(10_100) == pytest.approx(1e-7)
    assert Input("setpoint").missing


@pytest.mark.parametrize("tracking", [False, True])
def test_each_topic_has_its_input_and_tracking_is_heard_only_where_it_is_wanted(tracking: bool) -> None:
    heard = Heard(trigger="lockstep")
    heard.inputs.listen(tracking=tracking, scheduling=False)
    expected = {"setpoint": "setpoint", "feedforward": "feedforward", "manual_control": "manual"}
    expected |= {"tracking": "tracking"} if tracking else {}
    assert heard.node.topics.keys() == expected.keys()
    for value, (topic, name) in enumerate(expected.items(), 1):
        heard.loop_ns = value
        heard.node.topics[topic](message(float(value)))
        one = getattr(heard.inputs, name)
        assert (one.value, one.received_ns) == (float(value), value)


def test_in_lockstep_a_value_waits_for_the_sample_it_is_stamped_with(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[str] = []
    monkeypatch.setattr(
        "fopid_ros.controller.inputs.take_pending_messages", lambda subscription: taken.append(subscription.topic_name)
    )
    heard = Heard(trigger="lockstep")
    heard.inputs.listen(tracking=False, scheduling=False)
    setpoint = heard.inputs.setpoint
    for value, stamp in ((1.0, 0.02), (2.0, 0.04)):
        heard.node.topics["setpoint"](message(value, stamp))
    seen = []
    for sample in range(6):
        heard.inputs.take_due(sample * S // 100)
        seen.append(setpoint.value)
    assert seen[2:] == [1.0, 1.0, 2.0, 2.0]
    assert taken == 6 * ["setpoint", "feedforward", "manual_control"]  # what had come already counts for the sample
    assert all(map(math.isnan, seen[:2]))
    assert setpoint.received_ns == 4 * S // 100
    heard.node.topics["setpoint"](message(3.0, 0.01))  # its time is over: it counts at once
    assert setpoint.value == 3.0


def test_in_real_time_every_input_refuses_a_stamp_ahead() -> None:
    heard = Heard()
    heard.at(50.0)
    for one in (heard.inputs.setpoint, heard.inputs.feedforward, heard.inputs.manual):
        heard.inputs._listen(one, PendingValues())
    for topic, arrived in heard.node.topics.items():
        arrived(message(8.0, 50.0 + 3600.0))
        arrived(message(7.0, 49.0))
        assert heard.counts.stamps_ahead == list(heard.node.topics).index(topic) + 1
    assert {one.value for one in (heard.inputs.setpoint, heard.inputs.feedforward, heard.inputs.manual)} == {7.0}


def test_what_waits_for_a_run_that_has_ended_is_forgotten_and_the_rest_comes_by_its_stamps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without that a setpoint of the former run came at 60 s of the new one, and held all others up until then."""
    monkeypatch.setattr("fopid_ros.controller.inputs.take_pending_messages", lambda _: None)
    heard = Heard(trigger="lockstep")
    heard.inputs.listen(tracking=False, scheduling=False)
    heard.inputs.take_due(10 * S)
    heard.node.topics["setpoint"](message(9.0, 60.0))
    heard.inputs.take_due(0)  # the plant has begun anew
    for value, stamp in ((2.0, 2.0), (1.0, 1.0)):
        heard.node.topics["setpoint"](message(value, stamp))
    seen = []
    for second in (1, 2, 61):
        heard.inputs.take_due(second * S)
        seen.append(heard.inputs.setpoint.value)
    assert seen == [1.0, 2.0, 2.0]


def test_more_values_ahead_than_can_wait_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fopid_ros.common.pending_values.MOST", 3)
    heard = Heard(trigger="lockstep")
    heard.inputs.listen(tracking=False, scheduling=False)
    for stamp in range(1, 6):
        heard.node.topics["setpoint"](message(1.0, float(stamp)))
    assert heard.inputs.setpoint.refused == 2


def test_a_sample_that_is_older_stays_refused_when_it_comes_again() -> None:
    heard = Heard()
    heard.at(50.0)
    for value, stamp in ((1.0, 49.0), (-99.0, 48.0), (-99.0, 48.0), (-99.0, 48.0)):
        heard.inputs.take_measurement(message(value, stamp))
    assert heard.inputs.measurement.value == 1.0
    heard.inputs.take_measurement(message(3.0, 48.5))  # after older ones the next newer one counts
    assert heard.inputs.measurement.value == 3.0
