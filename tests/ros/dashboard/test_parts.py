"""What the live page is made of: what it keeps, whom it lets in, how it goes back."""

from __future__ import annotations

import asyncio
import doctest
import importlib
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.task import Future

from fopid_core.errors import InputError
from fopid_ros.dashboard.history import Cursor, History, thinned
from fopid_ros.dashboard.inputs import tuning_request
from fopid_ros.dashboard.remote_parameters import RefusedError, answer
from fopid_ros.dashboard.undo import MOST_SETS, GainHistory

MODULES = ("history", "main", "node", "health", "inputs", "live", "remote_parameters", "undo", "web")
derandomized = settings(derandomize=True, deadline=None, max_examples=60)
values = st.floats(-1e6, 1e6) | st.just(math.nan)


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_the_documentation_hold(name: str) -> None:
    module = importlib.import_module(f"fopid_ros.dashboard.{name}")
    assert doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE).failed == 0


@derandomized
@given(st.lists(st.tuples(values, values), max_size=60))
def test_thinning_loses_no_extreme_and_invents_nothing(pairs: list[tuple[float, float]]) -> None:
    rows = [(float(time), *pair) for time, pair in enumerate(pairs)]
    kept = thinned(rows)
    assert [row for row in rows if row in kept] == kept
    assert len(kept) <= 2 * 3 + 2
    for column in (1, 2):
        before = [row[column] for row in rows if not math.isnan(row[column])]
        after = [row[column] for row in kept if not math.isnan(row[column])]
        assert bool(before) == bool(after)
        if before:
            assert (min(before), max(before)) == (min(after), max(after))
    assert kept[:1] == rows[:1]
    assert kept[-1:] == rows[-1:]


@derandomized
@given(st.lists(st.sampled_from(["sample", "settle", "read"]), max_size=80))
def test_a_reader_gets_every_row_once_and_in_order(steps: list[str]) -> None:
    history, place, got, sent = History(1000), Cursor(), [], 0
    for step in [*steps, "settle", "read"]:
        if step == "sample":
            history.add(sent * 10_000_000, (float(sent),))
            history.settle()
            sent += 1
        elif step == "settle":
            history.settle()
        else:
            rows, place = history.since(place)
            got += [row[1] for row in rows]
    assert got == [float(k) for k in range(sent)]


def test_a_late_reader_gets_what_is_kept_and_no_more() -> None:
    history = History(size=10)
    for k in range(25):
        history.add(k * 1_000_000_000, (float(k),))
        history.settle()
    rows, place = history.since(Cursor())
    assert [row[1] for row in rows] == [float(k) for k in range(15, 25)]
    assert history.since(place)[0] == []


def test_many_samples_between_two_messages_stay_few_and_keep_their_peak() -> None:
    history = History(1000)
    for k in range(5000):
        history.add(k * 1_000_000, (math.sin(k), 99.0 if k == 1234 else 0.0))
    history.settle()
    rows, _ = history.since(Cursor())
    assert len(rows) <= 8
    assert (1.234, 99.0) in [(row[0], row[2]) for row in rows]


def test_time_that_falls_back_begins_a_new_record() -> None:
    history = History(100)
    for second in (5, 6, 7):
        history.add(second * 1_000_000_000, (0.0,))
    history.settle()
    _, place = history.since(Cursor())
    history.add(0, (1.0,))
    history.settle()
    rows, now = history.since(place)
    assert rows == [(0.0, 1.0)]
    assert now.record == place.record + 1


def test_what_comes_a_little_late_is_left_out() -> None:
    history = History(100)
    for instant in (1_000_000_000, 2_000_000_000, 1_900_000_000, 2_000_000_000, 2_100_000_000):
        history.add(instant, (0.0,))
        history.settle()
    rows, place = history.since(Cursor())
    assert [row[0] for row in rows] == pytest.approx([0.0, 1.0, 1.1], abs=1e-12)
    assert place.record == 1


def test_of_two_rows_of_one_instant_the_later_one_is_kept() -> None:
    history = History(100)
    for instant, value in ((1, 0.0), (2, 1.0), (2, 2.0), (3, 3.0)):
        history.add(instant * 1_000_000_000, (value,))
    history.settle()
    assert [row[1] for row in history.since(Cursor())[0]] == [0.0, 3.0]
    history.add(4_000_000_000, (1.0,))
    history.add(4_000_000_000, (2.0,))
    history.settle()
    assert [row[1] for row in history.since(Cursor())[0]] == [0.0, 3.0, 2.0]


@derandomized
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20, unique=True))
def test_going_back_again_and_again_passes_all_gains_in_reverse(kps: list[float]) -> None:
    undo, passed = GainHistory(), []
    for kp in kps:
        undo.record({"kp": kp})
        undo.record({"kp": kp})  # told twice, as a restart of the page would
    while (previous := undo.previous) is not None:
        passed.append(previous.gains["kp"])
        undo.record(previous.gains)
    assert passed == kps[-2::-1]


def test_no_more_than_two_hundred_sets_are_remembered_and_the_verified_one_always() -> None:
    history = GainHistory(lambda: 0.0)
    history.record({"kp": -1.0, "gains.status": "verified"})
    for kp in range(500):
        history.record({"kp": float(kp), "gains.status": "set"})
    assert len(history.sets) == MOST_SETS
    assert history.last_verified.gains == {"kp": -1.0}
    assert [one.gains["kp"] for one in history.sets[1:]] == [float(kp) for kp in range(500 - MOST_SETS + 1, 500)]
    assert history.find(history.present.number) is history.present


def test_a_trial_is_told_as_one_and_what_it_came_to() -> None:
    history = GainHistory(lambda: 7.0)
    for kp, status in ((1.0, "set"), (2.0, "trial"), (2.0, "verified"), (3.0, "trial"), (2.0, "verified")):
        history.record({"kp": kp, "gains.status": status, "gains.origin": "/fopid_tuner"})
    assert [(one["gains"]["kp"], one["status"], one["ended"]) for one in history.told()] == [
        (2.0, "verified", ""), (3.0, "trial", "taken back"), (2.0, "verified", "kept"), (1.0, "set", ""),
    ]  # fmt: skip
    assert [one["present"] for one in history.told()] == [True, False, False, False]


def test_gains_that_are_held_back_later_are_the_same_gains_and_come_back_held() -> None:
    history = GainHistory()
    for pace in (math.inf, 0.5):
        history.record({"kp": 1.0, "gains.status": "verified", "control_rate_max": pace})
    history.record({"kp": 2.0, "gains.status": "set", "control_rate_max": math.inf})
    assert history.previous.parameters["control_rate_max"] == 0.5
    assert len(history.sets) == 2


@pytest.mark.parametrize(("seconds", "is_there"), [(0.0, True), (60.0, False)])
def test_an_answer_that_does_not_come_is_not_waited_for(seconds: float, is_there: bool) -> None:
    with pytest.raises(RefusedError, match=r"^/fopid_tuner does not answer$"):
        asyncio.run(answer(Future(), "/fopid_tuner", seconds, lambda: is_there))


def test_an_answer_is_taken_when_it_is_there() -> None:
    future = Future()
    future.set_result(7)
    assert asyncio.run(answer(future, "/fopid_tuner", 0.0)) == 7


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"crossover": "0.3"}, "crossover = '0.3'; allowed: a number"),
        ({"crossover": math.nan}, "crossover = nan"),
        ({"crossover": True}, "crossover = True"),
        ({"method": 3}, "method = 3; allowed: a text"),
        ({"apply": 1}, "apply = 1; allowed: true or false"),
        ({"timeout": 1e9}, "field = 'timeout'"),
        ({"phase_margin_deg": 200}, "phase margin = 200 deg; allowed: up to 180"),
    ],
)
def test_fields_of_a_tuning_are_checked(fields: dict, named: str) -> None:
    with pytest.raises(InputError) as told:
        tuning_request(fields)
    assert named in str(told.value)
