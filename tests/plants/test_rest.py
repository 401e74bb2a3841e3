"""A loop that was heard at rest before anybody asked is not waited for as long again."""

from __future__ import annotations

from dataclasses import replace

import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.rest import LIVE_SHARE, TICKS_HEARD, heard_before, usual_rest
from fopid_ros.tuner.learning.running_controller import read_running_controller

NAME, SEED = "furnace", 1
LOOKED = 0.1
"""Of the time it is waited for, so much later it may be seen."""


def waited(loop: VirtualLoop) -> tuple[float, ClosedLoopExperiment]:
    """How long, over the time in which rest is judged; and the experiment that waited."""
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())  # type: ignore[arg-type]
    began = loop.time
    made.measure()
    return (loop.time - began) / made.rest_window, made


@pytest.fixture
def resting() -> VirtualLoop:
    loop = VirtualLoop(GALLERY[NAME], SEED)
    loop.run(0.3 * GALLERY[NAME].horizon)
    return loop


def test_a_quarter_is_waited_for_where_it_was_heard_at_rest(resting: VirtualLoop) -> None:
    share, made = waited(resting)
    assert LIVE_SHARE <= share < LIVE_SHARE + LOOKED + 0.01
    fresh, whole = waited(VirtualLoop(GALLERY[NAME], SEED))
    assert 1.0 <= fresh < 1.0 + LOOKED + 0.01
    assert made.loop.figures.duration == pytest.approx(whole.loop.figures.duration, rel=0.01), "looked at for as long"


def test_all_of_it_is_waited_for_after_other_gains(resting: VirtualLoop) -> None:
    resting.set(gains=resting.gains())
    assert waited(resting)[0] >= 1.0


def test_all_of_it_is_waited_for_after_a_move_of_the_setpoint(resting: VirtualLoop) -> None:
    resting.setpoint += 1e-3 * GALLERY[NAME].move
    resting.run(resting.sample_time)
    assert waited(resting)[0] >= 1.0


def test_what_came_before_a_silence_is_left_out(resting: VirtualLoop) -> None:
    gap = 20.0 * resting.sample_time
    heard = heard_before(resting.history, 1e9, gap)
    assert len(heard) == round(0.3 * GALLERY[NAME].horizon / resting.sample_time)
    assert (heard[-1].time, heard[-1].control) == (resting.trace.time[-1], resting.trace.control[-1])
    resting._ticks += 30
    resting.run(10.0 * resting.sample_time)
    assert len(heard_before(resting.history, 1e9, gap)) == 10


def test_with_slow_ticks_those_before_count_beyond_what_is_kept() -> None:
    """Of 10 s ticks the tuner keeps 60, which are no hundred: a whole length was waited for, an hour."""
    exhibit = replace(GALLERY[NAME], sample_time=10.0)
    loop = VirtualLoop(exhibit, SEED)
    loop.run(700.0)
    heard = loop.history.unmoved(TICKS_HEARD).size
    assert 60 <= heard < TICKS_HEARD
    began = loop.time
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())  # type: ignore[arg-type]
    usual = usual_rest(made.loop, loop.history, made.rest_window)
    assert usual == pytest.approx((TICKS_HEARD - heard) * exhibit.sample_time)
    made.measure()
    assert loop.time - began == pytest.approx(usual, abs=LOOKED * made.rest_window + exhibit.sample_time)
