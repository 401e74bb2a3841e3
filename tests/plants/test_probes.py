"""Probes wait for an answer that comes late: behind a delay, or after one that goes the other way at first."""

from __future__ import annotations

import math
from collections import deque

import pytest
from foreign_plants.gallery import GALLERY, Exhibit
from foreign_plants.parts import Actuator, Plant, Sensor, State
from virtual_loop import VirtualLoop

from fopid_core.runtime.excitation import Excitation
from fopid_ros.tuner.learning import closed_loop_experiment
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.guarded_excitation import GuardedExcitation
from fopid_ros.tuner.learning.loop_baseline import NOISES, LoopBaseline
from fopid_ros.tuner.learning.reach import NOT_MOVED, Reach
from fopid_ros.tuner.learning.running_controller import read_running_controller


class CoatingLine(Plant):
    """Coating [g/m2] by the pressure of an air knife [mbar], with the gauge 36 s further on."""

    delay = 36.0
    control_at_rest = 300.0
    rest = (300.0, 100.0)
    substep = 1.0

    def __init__(self, seed: int = 0) -> None:
        self._on_the_way = deque([self.control_at_rest] * round(self.delay / self.substep))
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(100.0, 600.0, rate=20.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.5, step=0.1)

    def input(self, felt: float, dt: float) -> float:
        del dt
        self._on_the_way.append(felt + self.load)
        return self._on_the_way.popleft()

    def slopes(self, x: State, u: float) -> State:
        pressure, seen = x
        return ((u - pressure) / 4.0, (100.0 * (max(pressure, 50.0) / 300.0) ** -0.6 - seen) / 8.0)

    def output(self, x: State) -> float:
        return x[1]


class WaterTurbine(Plant):
    """Power [MW] by the gate [%]: the water column makes it fall first."""

    control_at_rest = 60.0
    rest = (60.0, 0.6, 60.0)
    substep = 0.05

    def make_actuator(self) -> Actuator:
        return Actuator(5.0, 100.0, rate=15.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.2, step=0.05)

    def slopes(self, x: State, u: float) -> State:
        gate, flow, seen = x
        head = (flow / max(0.01 * gate, 0.03)) ** 2
        return ((u - gate) / 0.4, (1.0 - head) / 1.8, (100.0 * flow * head - seen) / 0.3)

    def output(self, x: State) -> float:
        return x[2]


# The integral time of the first is SIMC's, a third of its delay; that of the second is a twentieth of its loop's time.
LINE = Exhibit(CoatingLine, 1.0, (-0.69, -0.057, 0.0), 5.0, 20.0, 600.0, (70.0, 130.0))
TURBINE = Exhibit(WaterTurbine, 0.05, (0.05, 0.1, 0.0), 5.0, 5.0, 40.0, (20.0, 90.0))
SEEDS = range(1, 10)


def experiment(exhibit: Exhibit, seed: int, before: Reach = NOT_MOVED) -> ClosedLoopExperiment:
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(0.5 * exhibit.horizon)
    made = ClosedLoopExperiment(
        loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings(), before  # type: ignore[arg-type]
    )  # fmt: skip
    made.measure()
    return made


@pytest.mark.parametrize("exhibit", [LINE, TURBINE])
def test_an_experiment_on_a_late_process_comes_to_its_end(exhibit: Exhibit, monkeypatch: pytest.MonkeyPatch) -> None:
    assert [experiment(exhibit, seed).excite() for seed in SEEDS] == [""] * len(SEEDS)
    monkeypatch.setattr(closed_loop_experiment, "PROBE_SHARE_MOST", closed_loop_experiment.PROBE_SHARE_UNTIL_KNOWN)
    assert any(experiment(exhibit, seed).excite() for seed in SEEDS), "without it nothing would be late here"


def test_a_loop_that_rests_less_is_allowed_no_wider_a_band() -> None:
    exhibit = GALLERY["level_tank"]
    first = experiment(exhibit, 1)
    first.excite()
    restless = LoopBaseline(first.loop.controller, deviation_least=first.reach.allowed, deviation_most=first.reach.most)
    assert restless.deviation_most == first.loop.deviation_max
    restless.unrest = 10.0 * first.loop.deviation_max / NOISES
    assert restless._chosen_deviation(0.0) == first.loop.deviation_max


def test_another_goal_may_find_the_loop_changed() -> None:
    remembered = Reach(0.01, 0.05, 0.5)
    assert math.isinf(remembered.most)
    assert experiment(GALLERY["level_tank"], 1, remembered).loop.deviation_max >= remembered.allowed


def test_no_probe_is_smaller_than_what_noise_makes_of_the_control(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of the first probes were lost in a control that moved by more all the time."""
    made = experiment(GALLERY["coupled_heaters"], 1)
    moves = made.loop.control_spread
    assert made._first_amplitude() == moves
    monkeypatch.setattr(made.loop, "control_spread", 0.0)
    assert made._first_amplitude() < moves


def test_the_way_back_of_a_loop_that_swings_is_no_late_answer() -> None:
    """On a drum each of five probes was held twice as long: the largest deviation came after the move was over."""
    made = experiment(GALLERY["boiler_drum"], 1)
    holds: list[float] = []
    run = made._run_excitation

    def watched(excitation: Excitation, *args: object, **asked: object) -> GuardedExcitation:
        holds.append(excitation.settings.hold)
        return run(excitation, *args, **asked)  # type: ignore[arg-type]

    made._run_excitation = watched  # type: ignore[method-assign]
    assert not made.excite(lambda: True)
    assert len(set(holds[:-1])) == 1
