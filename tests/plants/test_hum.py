"""What a measurement does at rest that is no white noise, a hum, a neighbour or steps: moved by more, not refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from compare import autotuned
from foreign_plants.gallery import GALLERY, Exhibit
from foreign_plants.parts import Actuator, Plant, Sensor, State
from judging import judge
from virtual_loop import VirtualLoop

from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import MOST_UNREST, NOISES, LoopBaseline, quieter
from fopid_ros.tuner.learning.rest import TICKS_HEARD
from fopid_ros.tuner.learning.running_controller import read_running_controller

HUM, PERIOD, NOISE = 0.5, 7.0, 0.1


class HummingSensor(Sensor):
    """With a sinusoid on top."""

    hum = HUM

    def begin(self, seed: int) -> None:
        super().begin(seed)
        self._time = 0.0

    def read(self, value: float, dt: float) -> float:
        self._time += dt
        return super().read(value + self.hum * math.sin(2.0 * math.pi * self._time / PERIOD), dt)


class Heater(Plant):
    """Two lags, 90 and 20 s, 1.2 K for each percent."""

    control_at_rest, rest, substep = 40.0, (48.0, 48.0), 0.5

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0)

    def make_sensor(self) -> Sensor:
        return HummingSensor(noise=NOISE, step=0.05)

    def slopes(self, x: State, u: float) -> State:
        return ((1.2 * u - x[0]) / 90.0, (x[0] - x[1]) / 20.0)

    def output(self, x: State) -> float:
        return x[1]


class StrongHum(Heater):
    """Three times as strong."""

    def make_sensor(self) -> Sensor:
        sensor = HummingSensor(noise=NOISE, step=0.05)
        sensor.hum = 3.0 * HUM
        return sensor


class AnalysingSensor(Sensor):
    """Reads once in 30 s, and says it 30 s later."""

    interval = 30.0

    def begin(self, seed: int) -> None:
        super().begin(seed)
        self._waited, self._said = 0.0, math.nan

    def read(self, value: float, dt: float) -> float:
        self._waited += dt
        if math.isnan(self._said):
            self._said = self._next = value
        elif self._waited > self.interval - 1e-9:
            self._waited -= self.interval
            self._said, self._next = self._next, super().read(value, self.interval)
        return self._said


class Column(Plant):
    """Purity [%] by reflux [%]: three lags, and less gain the purer it gets."""

    control_at_rest, rest, substep = 50.0, (90.0, 90.0, 90.0), 1.0

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0, rate=5.0)

    def make_sensor(self) -> Sensor:
        return AnalysingSensor(noise=0.02, step=0.01)

    def slopes(self, x: State, u: float) -> State:
        top = 90.0 + 0.1 * (u - 50.0) - 0.0005 * (u - 50.0) ** 2
        return ((top - x[0]) / 200.0, (x[0] - x[1]) / 60.0, (x[1] - x[2]) / 30.0)

    def output(self, x: State) -> float:
        return x[2]


class QuietHeater(Heater):
    """Without the hum."""

    def make_sensor(self) -> Sensor:
        return Sensor(noise=NOISE, step=0.05)


class NeighbouredHeater(QuietHeater):
    """Beside another loop that cycles slowly."""

    strength, period = 3.0, 150.0

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self._time = 0.0

    def input(self, felt: float, dt: float) -> float:
        self._time += dt
        return super().input(felt, dt) + self.strength * math.sin(2.0 * math.pi * self._time / self.period)


def exhibit(plant: type[Plant]) -> Exhibit:
    return Exhibit(plant, 1.0, (1.0, 0.01, 0.0), 5.0, 10.0, 800.0, (0.0, 120.0))


ANALYSED = Exhibit(Column, 5.0, (5.0, 0.015, 0.0), 1.0, 10.0, 4000.0, (70.0, 100.0))


def at_rest(plant: type[Plant], deviation_max: float = 0.0) -> LoopBaseline:
    loop = VirtualLoop(exhibit(plant), 1)
    loop.run(200.0)
    wanted = ExperimentSettings(deviation_max=deviation_max)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), wanted)
    made.measure()
    return made.loop


def test_a_short_rest_is_heard_together_with_what_came_before_it() -> None:
    """Of 30 ticks a hum was taken for white noise of a third."""
    quick = replace(exhibit(Heater), gains=(1.0, 0.1, 0.0))
    loop = VirtualLoop(quick, 1)
    loop.run(400.0)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    assert made.rest_window == 30.0
    began = loop.time
    made.measure()
    assert loop.time - began < 40.0, "those before count"
    assert made.loop.samples >= TICKS_HEARD
    assert made.loop.coloured is not None
    assert made.loop.sensor.level == pytest.approx(math.hypot(NOISE, HUM / math.sqrt(2.0)), rel=0.2)


def test_a_tuner_that_has_just_begun_to_listen_waits_for_a_hundred_ticks() -> None:
    loop = VirtualLoop(replace(exhibit(Heater), gains=(1.0, 0.1, 0.0)), 1)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    made.measure()
    assert TICKS_HEARD <= loop.time < TICKS_HEARD + 2.0 * made.rest_window
    assert made.loop.coloured is not None


def test_of_two_rests_the_quieter_one_counts_unless_it_was_far_shorter() -> None:
    baseline = at_rest(QuietHeater)
    quiet, loud = replace(baseline, noise=0.1, samples=100), replace(baseline, noise=0.2, samples=150)
    assert quieter(loud, quiet) is quiet
    longer = replace(loud, samples=200)
    assert quieter(quiet, longer) is longer


def test_all_that_the_measurement_does_at_rest_counts_and_white_noise_as_before() -> None:
    quiet, humming = at_rest(QuietHeater), at_rest(Heater)
    assert quiet.unrest == quiet.noise == pytest.approx(NOISE, rel=0.2)
    rms = math.hypot(HUM / math.sqrt(2.0), NOISE)
    assert humming.unrest == pytest.approx(rms, rel=0.1)
    assert humming.noise < 0.5 * rms  # what is white of it
    assert humming.unrest <= MOST_UNREST * humming.noise
    assert humming.deviation_max == pytest.approx(NOISES * humming.unrest)
    assert at_rest(Heater, 3.0).deviation_max == 3.0  # a band that somebody asks for stays


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("seen", "load", "setpoint"),
    [
        pytest.param(exhibit(StrongHum), 0.4, 0.7, id="strong hum"),
        pytest.param(ANALYSED, 0.4, 0.7, id="analyser"),
        pytest.param(exhibit(Heater), 0.4, 0.7, id="hum"),
        pytest.param(exhibit(NeighbouredHeater), 0.6, 0.95, id="neighbour"),  # both hold what the neighbour does
    ],
)  # fmt: skip
def test_gains_are_found_and_they_are_better_than_those_that_ran(
    seen: Exhibit, load: float, setpoint: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(GALLERY, "it", seen)
    before, tuned = judge("it", {}), autotuned("it")
    assert tuned.label == "autotune", tuned.note
    assert tuned.seen.safe
    assert tuned.seen.load < load * before.load
    assert tuned.seen.mean("setpoint") < setpoint * before.mean("setpoint")
