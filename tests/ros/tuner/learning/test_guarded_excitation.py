"""What is added to a running loop shrinks before a bound is reached, and ends when nothing can be judged any more."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.excitation import Excitation, ExcitationSettings
from fopid_ros.tuner.learning.guarded_excitation import SHRINKS_MAX, GuardedExcitation
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.running_controller import RunningController

DT = 0.1


def guarded(enough: float = math.inf, hold: float = 10.0, rest: Sequence[float] = ()) -> GuardedExcitation:
    loop = LoopBaseline(RunningController(Fopid(1.0, 1.0), DT, -5.0, 5.0), setpoint=2.0, deviation_max=1.0)
    if rest:
        loop.measure([Tick(DT * k, 2.0, 2.0 + d, 0.0) for k, d in enumerate(rest)], 1.0, 0.0)
    settings = ExcitationSettings("step", 0.5, 1.0, 3.0, hold, acts_on="control")
    return GuardedExcitation(Excitation(settings), loop, foresight=1.0, enough=enough)


def fed(guard: GuardedExcitation, *deviations: float, control: float = 0.0, age: float = 0.0) -> list[float]:
    begin = getattr(guard, "fed", 0)
    guard.fed = begin + len(deviations)  # type: ignore[attr-defined]
    return [guard.step(Tick(DT * (begin + k), 2.0, 2.0 + d, control, age)) for k, d in enumerate(deviations)]


def test_adds_what_it_is_told_while_all_is_well() -> None:
    assert fed(guarded(), *[0.0] * 20) == [0.5] * 20


def test_adds_nothing_while_the_measurement_runs_for_the_edge_and_is_smaller_afterwards() -> None:
    guard = guarded()
    added = fed(guard, *(0.02 * k for k in range(40)))
    assert 0.0 in added  # long before the edge of 1.0
    assert not guard.finished
    back = fed(guard, *[0.0] * 60)
    assert back[-1] == 0.25


def test_adds_nothing_while_the_control_is_at_its_limit() -> None:
    guard = guarded()
    assert fed(guard, 0.0, 0.0, 0.0, control=5.0) == [0.0, 0.0, 0.0]
    assert fed(guard, 0.0)[-1] == 0.25


def test_a_control_that_answers_lone_samples_is_no_reason_to_shrink() -> None:
    """Up, and down again at the next tick, as a derivative does; the sample itself is within half of the band."""
    guard = guarded(hold=1e3)
    for _ in range(3 * SHRINKS_MAX):
        fed(guard, 0.0, control=5.0)
        fed(guard, 0.0, control=-5.0)
        assert fed(guard, 0.0, 0.0)[-1] == 0.5
    assert not guard.finished


def test_gives_up_when_that_goes_on_and_on() -> None:
    guard = guarded(hold=1e3)
    for _ in range(SHRINKS_MAX + 1):
        fed(guard, 0.0, 0.0, 0.0, control=5.0)
        fed(guard, 0.0)
    assert guard.finished
    assert not guard.excitation.completed
    assert "again and again" in guard.excitation.reason


@pytest.mark.parametrize(
    ("tick", "reason"),
    [
        (Tick(0.1, 2.0, 3.1, 0.0), "left the band"),
        (Tick(0.1, 2.5, 2.0, 0.0), "the setpoint was changed from 2 to 2.5"),
        (Tick(0.1, 2.0, 2.0, 0.0, age=0.7), "0.7 s old"),
    ],
    ids=["outside", "setpoint", "old"],
)
def test_ends_at_once(tick: Tick, reason: str) -> None:
    guard = guarded()
    fed(guard, 0.65)
    assert guard.step(tick) == 0.0
    assert guard.finished
    assert not guard.excitation.completed
    assert reason in guard.excitation.reason


def test_comes_to_its_end_when_the_measurement_has_moved_enough() -> None:
    guard = guarded(enough=0.2)
    fed(guard, *[0.0] * 5, *[0.3] * 30)
    assert guard.finished
    assert guard.excitation.completed
    assert 0.5 < guard.answer_time < 2.0


def test_a_sensor_that_drops_out_for_a_tick_now_and_then_ends_nothing() -> None:
    guard = guarded(hold=1e3)
    for _ in range(20):
        fed(guard, 0.0, 0.01, -0.01)
        fed(guard, -2.0, control=-5.0)  # and the control goes with it
    assert fed(guard, 0.0) == [0.5]
    fed(guard, -2.0, -2.0)
    assert "left the band" in guard.excitation.reason, "two in a row are the plant"


def waving(count: int, noise: float = 0.01) -> list[float]:
    return [noise * math.sin(10.0 * k) for k in range(count)]


def test_ends_when_the_measurement_stands_still_while_the_control_moves() -> None:
    guard = guarded(hold=8.0, rest=waving(100))
    fed(guard, *waving(60))
    fed(guard, *[0.3] * 100)
    assert "has stood still at 2.3 for" in guard.excitation.reason
    assert guard.excitation.reason.endswith("is the sensor dead?")
    assert not guard.excitation.completed


@pytest.mark.parametrize("step", [0.0, 0.25])
def test_a_sensor_of_coarse_steps_may_stand_still(step: float) -> None:
    guard = guarded(hold=8.0, rest=[step * (k % 40 == 0) for k in range(200)])
    fed(guard, *[0.25] * 150)
    assert guard.excitation._elapsed > 14.0
    assert not guard.finished


def test_ends_when_the_control_stays_at_a_limit() -> None:
    guard = guarded(hold=1e3)
    fed(guard, *[0.1] * 105, control=5.0)
    assert guard.excitation.reason.startswith("the control has been at its limit, 5, for 10.")
