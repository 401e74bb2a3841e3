"""An experiment that ends once enough is known is shorter, as safe, and over before it was said to be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from foreign_plants.gallery import GALLERY, Exhibit
from foreign_plants.parts import Actuator, Plant, Sensor, State
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import identify
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.model.process import Process
from fopid_ros.tuner.learning.announcement import WORKED_OUT
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import (
    ClosedLoopExperiment,
    ExperimentSettings,
    _not_overtaken,
)
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, Outcome
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.rest import RestingLoop
from fopid_ros.tuner.learning.running_controller import read_running_controller

STICKING = ("motor_position", "mujoco_cart")
"""No process shows in their small moves, or another than in a longer record."""


def experiment(name: str, seed: int, until_known: bool = True) -> tuple[VirtualLoop, ClosedLoopExperiment, float]:
    """The loop after one experiment, and when it began."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(0.3 * exhibit.horizon)
    baseline = LoopBaseline(read_running_controller(loop))
    made = ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings(until_known=until_known))
    made.measure()
    began = loop.history.whole_since = loop.history.newest_time("control")
    sufficiency = Sufficiency("all", made.loop.noise, exhibit.sample_time)
    assert not made.excite(lambda: sufficiency.look(loop.history.record(began), made.content))
    return loop, made, began


def is_safe(name: str, loop: VirtualLoop, made: ClosedLoopExperiment, began: float) -> bool:
    """Within what is safe all along, and within what is allowed from the beginning of the experiment on."""
    low, high = GALLERY[name].unsafe
    ticks = zip(loop.trace.time, loop.trace.true, strict=True)
    far = max(abs(y - loop.setpoint) for time, y in ticks if time >= began)
    return low < min(loop.trace.true) <= max(loop.trace.true) < high and far < 1.2 * made.loop.deviation_max


class TwoLags(Plant):
    """0.6 s and 0.1 s, fast beside the controller: two holds of its experiment are 20 ticks."""

    rest = (0.0, 0.0)
    substep = 0.01

    def make_actuator(self) -> Actuator:
        return Actuator(-math.inf, math.inf)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.002)

    def slopes(self, x: State, u: float) -> State:
        return ((u - x[0]) / 0.6, (x[0] - x[1]) / 0.1)

    def output(self, x: State) -> float:
        return x[1]


def test_a_look_waits_for_a_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no probes come before it, since an amplitude was asked for, 22 ticks "allowed: 30" ended all of it."""
    monkeypatch.setattr(Autotuner, "_learn", lambda *_: Outcome(message="its record is learnt from"))
    loop = VirtualLoop(Exhibit(TwoLags, 0.05, (2.0, 4.0, 0.0), 1.0, 0.5, 10.0, (-5.0, 5.0)), 1)
    loop.run(10.0)
    criteria = AcceptanceCriteria(TuningRequest(Process.parse("1/(s+1)")), RobustLimits(), 2.0)
    request = AutotuneRequest(ExperimentSettings(amplitude=0.2, deviation_max=0.8), "foptd", criteria, True)
    outcome = Autotuner(loop, loop, request, loop).run()  # type: ignore[arg-type]
    assert outcome.message.startswith("its record is learnt from")


class SlowlyLookedAt:
    """An excitation of which so much has been made, each time somebody looks, while it was looked before."""

    def __init__(self, *made: float) -> None:
        self._made = iter(made)

    @property
    def progress(self) -> float:
        return next(self._made)


def test_a_look_that_takes_long_is_followed_by_the_newest_that_is_due() -> None:
    looks = (0.1, 0.2, 0.3, 0.4)
    assert list(_not_overtaken(SlowlyLookedAt(0.0, 0.12, 0.22, 0.32), looks)) == list(looks)  # type: ignore[arg-type]
    assert list(_not_overtaken(SlowlyLookedAt(0.0, 0.35, 0.35, 0.9), looks)) == [0.1, 0.3, 0.4]  # type: ignore[arg-type]


class Limited(TwoLags):
    """It has limits, which say how far it may be moved."""

    def make_actuator(self) -> Actuator:
        return Actuator(-2.0, 2.0)


def test_a_rest_that_is_waited_for_for_long_is_no_reason_to_end_later(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = VirtualLoop(Exhibit(Limited, 0.05, (2.0, 4.0, 0.0), 1.0, 0.5, 10.0, (-5.0, 5.0)), 1)
    loop.run(10.0)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    began, length = loop.time, made.length
    wait, waits = RestingLoop.is_over, length.rest + 0.1 * length.experiment
    monkeypatch.setattr(RestingLoop, "is_over", lambda seen, far: wait(seen, far) and loop.time - began > waits)
    made.measure()
    assert loop.time - began > waits
    assert not made.excite(lambda: math.isinf(made.content))  # when due
    assert loop.time - began <= 1.5 * length.experiment


class ByException(Sensor):
    """Tells what is a fiftieth away from what it told last."""

    told = 0.0

    def read(self, value: float, dt: float) -> float:
        read = super().read(value, dt)
        self.told = read if abs(read - self.told) >= 0.02 else self.told
        return self.told


class ToldByException(TwoLags):
    """It stands still at rest: no noise is heard there."""

    def make_sensor(self) -> Sensor:
        return ByException(noise=0.002)


def test_a_sensor_that_tells_changes_only_has_noise_once_it_was_moved() -> None:
    loop = VirtualLoop(Exhibit(ToldByException, 0.05, (2.0, 4.0, 0.0), 1.0, 0.5, 10.0, (-5.0, 5.0)), 1)
    loop.run(10.0)
    baseline = LoopBaseline(read_running_controller(loop))
    made = ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings(amplitude=0.2, deviation_max=0.8))
    made.measure()
    assert made.loop.noise == 0.0
    assert not made.excite()
    assert made.loop.noise == pytest.approx(0.02 / math.sqrt(12.0), rel=0.1)


@pytest.mark.slow
def test_it_is_shorter_and_what_is_learnt_is_what_the_whole_experiment_shows() -> None:
    short, made, began = experiment("quadruple_tank", 1)
    whole, _, whole_began = experiment("quadruple_tank", 1, until_known=False)
    assert short.time - began < 0.6 * (whole.time - whole_began)
    assert is_safe("quadruple_tank", short, made, began)
    learnt, all_there_is = (
        identify(loop.history.record(begin), "all", noise=made.loop.noise).best
        for loop, begin in ((short, began), (whole, whole_began))
    )
    assert learnt is not None
    assert all_there_is is not None
    s = 1j * all_there_is.crossover * np.geomspace(0.1, 1.0, 10)
    assert np.max(np.abs(learnt.process(s) / all_there_is.process(s) - 1.0)) < 0.15


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", GALLERY)
def test_it_is_safe_on_all_plants_and_over_in_time(name: str) -> None:
    loop, made, began = experiment(name, 2)
    assert is_safe(name, loop, made, began)
    said, took = loop.stages[0].remaining - WORKED_OUT, loop.time - 0.3 * GALLERY[name].horizon
    assert said / 2.0 <= took <= (3.1 if name in STICKING else 1.5) * said, "of what is said first"
