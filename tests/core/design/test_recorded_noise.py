"""Gains from noisy records of slow loops hold the process, although how late it answers hardly shows there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import RecordedTuning, tune_recorded
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import ControllerSettings, as_designed

EVERY = 2.0


@dataclass(frozen=True)
class NoisyLoop:
    """A lag behind a dead time, under a slow PI, in noise and beside a load that forgets."""

    gain: float
    lag: float
    delay: float
    gains: Fopid
    slowness: float
    noise: float
    load: float
    memory: float
    every: float = EVERY
    most_samples: int = 3000

    @staticmethod
    def drawn(draw: np.random.Generator) -> NoisyLoop:
        """One by chance."""
        lag, delay, gain = draw.uniform(2.0, 30.0), draw.uniform(8.0, 60.0), draw.uniform(0.3, 2.0)
        noise, memory, load = gain * draw.uniform(0.1, 0.5), draw.uniform(20.0, 100.0), draw.uniform(0.0, 0.5)
        delay = round(delay / EVERY) * EVERY
        slowness = draw.uniform(2.0, 8.0) * (lag + delay)
        gains = Fopid(0.2 / gain * draw.uniform(0.5, 2.0), 1.0 / gain / slowness)
        return NoisyLoop(gain, lag, delay, gains, slowness, noise, load, memory)

    @staticmethod
    def with_a_load_that_walks(draw: np.random.Generator) -> NoisyLoop:
        """One by chance, in next to no noise: a short record, in which one lag and a delay may pass for two lags."""
        lag, delay, gain = draw.uniform(20.0, 60.0), round(draw.uniform(5.0, 20.0)), draw.uniform(0.5, 2.0)
        noise, walk = gain * 10.0 ** draw.uniform(-3.0, -2.0), 10.0 ** draw.uniform(-3.3, -2.3)
        slowness, memory = draw.uniform(2.0, 4.0) * (lag + delay), 1e5
        gains = Fopid(0.2 / gain, 1.0 / gain / slowness)
        load = walk * np.sqrt(0.5 * memory)
        return NoisyLoop(gain, lag, delay, gains, slowness, noise, load, memory, every=1.0, most_samples=600)

    @property
    def process(self) -> Process:
        """What is controlled."""
        return Process.parse(f"{self.gain}/({self.lag}s+1)*exp(-{self.delay}s)")

    @property
    def plant(self) -> Plant:
        """It, at rest."""
        return Plant(PlantSettings(self.process, self.every, "exact"))

    def record(self, draw: np.random.Generator) -> Record:
        """Three setpoints long."""
        plant = self.plant
        controller = FopidController(ControllerSettings(self.gains, self.every, control_min=-50.0, control_max=50.0))
        count = min(int(18.0 * self.slowness / self.every), self.most_samples)
        setpoint = self.gain * np.repeat([0.0, 2.0, 0.6], [count // 4, count // 2, count - count // 4 - count // 2])
        measurement, control, load, keeps = np.empty(count), np.empty(count), 0.0, np.exp(-self.every / self.memory)
        for k in range(count):
            measurement[k] = plant.output + self.noise * draw.standard_normal()
            control[k] = controller.step(setpoint[k], measurement[k])
            load = keeps * load + self.load * np.sqrt(1.0 - keeps**2) * draw.standard_normal()
            plant.step(control[k], load)
        time = self.every * np.arange(count)
        return Record(time, control, measurement, setpoint, control_min=-50.0, control_max=50.0)

    def peak(self, controller: FopidController) -> float:
        """max |S| as it runs: the spectrum of the measurement after a pulse in it, by the lag's exact difference."""
        keeps, waiting, output, seen = np.exp(-self.every / self.lag), [0.0] * round(self.delay / self.every), 0.0, []
        controller.step(0.0, 0.0)  # its filter begins at the first measurement
        for k in range(20_000):
            seen.append(output + (k == 0))
            waiting.append(controller.step(0.0, seen[-1]))
            output = keeps * output + (1.0 - keeps) * self.gain * waiting.pop(0)
        assert abs(output) < 1e-6
        return float(np.abs(np.fft.rfft(seen)).max())

    def holds(self, found: RecordedTuning) -> bool:
        """Whether the loop with gains from a record comes to rest at another setpoint."""
        assert found.tuned is not None
        tuning = found.tuned.tuning
        assert tuning is not None
        assert tuning.controller is not None
        controller = FopidController(as_designed(tuning.controller, self.every, tuning.filter, tuning.weights))
        plant, errors = self.plant, []
        for _ in range(int(60.0 * (self.lag + self.delay + self.slowness) / self.every)):
            errors.append(abs(1.0 - plant.output))
            plant.step(controller.step(1.0, plant.output))
        return max(errors) < 5.0 and max(errors[-len(errors) // 4 :]) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 22, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(100, 106))])
def test_gains_from_such_a_record_hold_the_process_or_there_are_none(seed: int) -> None:
    """With those of seeds 7 and 22 the loop ran away: 54 and 18 s of dead time were learnt as lags."""
    draw = np.random.default_rng(seed)
    loop = NoisyLoop.drawn(draw)
    found = tune_recorded(loop.record(draw), "time", {"input": "both"})
    assert not found.success or loop.holds(found), found.message


@pytest.mark.slow
@pytest.mark.parametrize("seed", [17, *(pytest.param(seed, marks=pytest.mark.long) for seed in (22, 31))])
def test_two_lags_are_not_believed_where_one_and_a_delay_are_as_likely(seed: int) -> None:
    """Gains with a derivative left max |S| at 4.8, 4.4 and 8.4 as they run: beyond the record one lag falls less.

    Within 2.2 on all that is possible, and the process is no better known than by its likeliest models.
    """
    draw = np.random.default_rng(seed)
    loop = NoisyLoop.with_a_load_that_walks(draw)
    found = tune_recorded(loop.record(draw), "time", {"input": "both"})
    assert found.success, found.message
    assert found.tuned is not None
    tuning = found.tuned.tuning
    assert tuning is not None
    assert tuning.controller is not None
    assert loop.peak(FopidController(as_designed(tuning.controller, loop.every, tuning.filter, tuning.weights))) < 2.7


def test_the_loops_that_made_the_records_hold_it() -> None:
    draw = np.random.default_rng(7)
    loop = NoisyLoop.drawn(draw)
    quiet = replace(loop, noise=0.0, load=0.0).record(draw)
    assert np.abs(quiet.measurement[-100:] - 0.6 * loop.gain).max() < 0.05 * loop.gain
