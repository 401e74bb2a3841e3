"""A good sensor behind dry friction: within forty noises nothing moves; as far as people bump a loop it does."""

from __future__ import annotations

import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

from fopid_core.model.fopid import Fopid
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import BUMP_SHARE, MOST_WIDER, LoopBaseline
from fopid_ros.tuner.learning.reach import NOT_MOVED, Reach
from fopid_ros.tuner.learning.running_controller import read_running_controller

EXHIBIT = GALLERY["level_tank"]
UNSTABLE = Fopid(*(50.0 * gain for gain in EXHIBIT.gains))


def measured(
    settings: ExperimentSettings | None = None, before: Reach = NOT_MOVED
) -> tuple[VirtualLoop, ClosedLoopExperiment]:
    """An experiment on the level tank, whose loop has been found at rest."""
    loop = VirtualLoop(EXHIBIT, 1)
    baseline = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
    experiment = ClosedLoopExperiment(loop, loop, baseline, settings or ExperimentSettings(), before)  # type: ignore[arg-type]
    experiment.measure()
    return loop, experiment


def test_a_further_experiment_may_go_as_far_as_a_bump_test_once() -> None:
    _, experiment = measured()
    controller, before = experiment.loop.controller, experiment.loop.deviation_max
    assert experiment.widen()
    band = controller.control_range / abs(controller.gains.kp)
    allowed = experiment.loop.deviation_max
    assert allowed == pytest.approx(min(BUMP_SHARE * band, MOST_WIDER * before))
    assert allowed > 1.5 * before
    assert not experiment.widen()
    assert experiment.loop.deviation_max == allowed


@pytest.mark.parametrize(
    ("settings", "before"),
    [
        (ExperimentSettings(deviation_max=0.05), NOT_MOVED),
        (ExperimentSettings(amplitude=0.5), NOT_MOVED),
        (ExperimentSettings(), Reach(0.01, 0.05, 0.5)),
    ],
)
def test_not_where_somebody_has_said_how_far_or_it_was_found_before(
    settings: ExperimentSettings, before: Reach
) -> None:
    _, experiment = measured(settings, before)
    allowed = experiment.loop.deviation_max
    assert not experiment.widen()
    assert experiment.loop.deviation_max == allowed


def test_a_loop_that_was_taken_a_little_too_far_comes_back() -> None:
    loop, experiment = measured()
    loop.plant.load = 0.02 * EXHIBIT.load
    loop.run(20.0 * EXHIBIT.sample_time)
    assert experiment.comes_back()


def test_a_loop_that_runs_off_is_not_waited_for() -> None:
    loop, experiment = measured()
    loop.set(gains=UNSTABLE)
    loop.setpoint += 0.5 * experiment.loop.deviation_max
    begun = loop.time
    assert not experiment.comes_back()
    assert loop.time - begun < 0.1 * experiment.duration


def escaped(settings: ExperimentSettings | None = None) -> tuple[VirtualLoop, ClosedLoopExperiment]:
    """The same, once a move has taken the measurement out of its band."""
    loop, experiment = measured(settings)
    experiment.escaped = "measurement 1.1 left the band"
    return loop, experiment


def test_a_band_that_nobody_asked_for_is_widened_where_the_loop_left_it_and_stays_within_a_bump() -> None:
    """A level behind a valve that sticks swings by itself once it is moved, further than forty noises."""
    loop, experiment = escaped()
    before, bump = experiment.loop.deviation_max, experiment.loop.bump
    loop.plant.load = 0.05 * EXHIBIT.load
    assert experiment.widen_after_escape()
    assert experiment.loop.deviation_max == bump > before


def test_not_where_it_runs_off_nor_where_somebody_has_said_how_far() -> None:
    loop, experiment = escaped()
    before = experiment.loop.deviation_max
    loop.setpoint += 1.5 * experiment.loop.bump
    assert not experiment.widen_after_escape()
    assert experiment.loop.deviation_max == before
    _, asked = escaped(ExperimentSettings(deviation_max=0.05))
    assert not asked.widen_after_escape()
    _, inside = measured()
    assert not inside.widen_after_escape()
