"""A sensor that dies, or drops out for a tick now and then, in the middle of an experiment; and a hand at the gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from foreign_plants.gallery import GALLERY
from foreign_plants.heat import HeatExchanger
from foreign_plants.parts import Sensor
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import identify
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller

NEVER, DROP = 10**9, 3.0


class FaultySensor(Sensor):
    """That of the heat exchanger: from a sample on it tells the same, or each so manieth is far off."""

    dies, drops = NEVER, NEVER
    read_before, last = 0, 0.0

    def read(self, value: float, dt: float) -> float:
        self.read_before += 1
        if self.read_before < self.dies:
            self.last = super().read(value, dt)
        return self.last - DROP if self.read_before % self.drops == 0 else self.last


class FaultyExchanger(HeatExchanger):
    def make_sensor(self) -> Sensor:
        usual = super().make_sensor()
        return FaultySensor(usual.noise, usual.step, usual.drift)


def experiment(seed: int = 1, drops: int = NEVER) -> tuple[VirtualLoop, ClosedLoopExperiment]:
    """At rest."""
    exhibit = replace(GALLERY["heat_exchanger"], plant=FaultyExchanger)
    loop = VirtualLoop(exhibit, seed, longest=1e5)
    loop.plant.sensor.drops = drops
    loop.run(exhibit.horizon)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    made.measure()
    return loop, made


def test_a_sensor_that_dies_ends_it_before_the_plant_is_driven_away(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, made = experiment()
    moving = made._made_whole

    def dying(*until: object) -> object:
        loop.plant.sensor.dies = loop.plant.sensor.read_before + 40
        return moving(*until)

    monkeypatch.setattr(made, "_made_whole", dying)
    ended = made.excite()
    assert ended.startswith("the measurement has stood still at ")
    assert ended.endswith("is the sensor dead?")
    assert np.abs(np.array(loop.trace.true) - loop.setpoint).max() < 3.0 * made.loop.deviation_max


def test_one_that_drops_out_for_a_tick_now_and_then_does_not() -> None:
    usual, faulty = experiment(), experiment(drops=53)
    assert [made.excite() for _, made in (usual, faulty)] == ["", ""]
    assert faulty[1].loop.spikes > 0
    assert faulty[1].loop.deviation_max < 1.3 * usual[1].loop.deviation_max, "it is moved no further for that"


@pytest.mark.slow
def test_what_is_learnt_beside_such_samples_is_what_is_learnt_without_them() -> None:
    gains = []
    for drops in (NEVER, 53):
        loop, made = experiment(drops=drops)
        made.excite()
        record = loop.history.record(0.5 * loop.exhibit.horizon)
        found = identify(record, "foptd", noise=made.loop.unrest)
        assert found.success, found.message
        assert found.best is not None
        gains.append(found.best.parameters["K"])
    assert gains[1] == pytest.approx(gains[0], rel=0.1)


def test_gains_that_somebody_gives_meanwhile_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, made = experiment()
    moving = made._made_whole

    def meddled(*until: object) -> object:
        began, step = loop.time, loop.plant.step

        def stepping(control: float, dt: float) -> float:
            if 30.0 < loop.time - began < 30.0 + 1.5 * dt:
                loop.set(gains=replace(loop.gains(), kp=1.3 * loop.gains().kp))
            return float(step(control, dt))

        monkeypatch.setattr(loop.plant, "step", stepping)
        return moving(*until)

    monkeypatch.setattr(made, "_made_whole", meddled)
    assert made.excite() == "the controller was given other gains meanwhile"
