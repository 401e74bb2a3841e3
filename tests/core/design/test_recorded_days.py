"""Days under a cautious PI with plants that no structure here is: what is handed out does on them what was said."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest

from fopid_core.design import recorded_reach as recorded_reach_module
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_reach import FASTER, recorded_reach
from fopid_core.design.recorded_tuning import RecordedTuning, tune_recorded
from fopid_core.model.indices import overshoot_pct
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import as_designed

FINER = 2
"""Steps of a plant in a tick."""


@dataclass
class Lags:
    """Two lags behind a delay, Euler's way; what comes out may come back late; the actuator may be slow."""

    h: float
    gain: float
    first: float
    second: float
    delay: float
    back: float = 0.0
    back_delay: float = 0.0
    rate: float = np.inf
    inner: float = 0.0
    outer: float = 0.0
    stem: float = 0.0
    waiting: deque[float] = field(default_factory=deque)
    returning: deque[float] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.waiting.extend([0.0] * round(FINER * self.delay / self.h))
        self.returning.extend([0.0] * round(FINER * self.back_delay / self.h))

    def step(self, control: float) -> None:
        dt = self.h / FINER
        for _ in range(FINER):
            self.stem += float(np.clip(control - self.stem, -self.rate * dt, self.rate * dt))
            self.waiting.append(self.stem)
            self.returning.append(self.inner)
            felt = self.gain * self.waiting.popleft() + self.back * self.returning.popleft()
            self.inner += dt / self.first * (felt - self.inner)
            self.outer += dt / self.second * (self.inner - self.outer)


def day(plant: Lags, kp: float, ki: float, levels: list[float], samples: int, noise: float, seed: int) -> Record:
    """Of setpoints, with limits of 40 to either side."""
    random = np.random.default_rng(seed)
    setpoint, integral, rows = np.repeat(levels, samples // len(levels)), 0.0, []
    for wanted in setpoint:
        measured = plant.outer + noise * random.standard_normal()
        integral += ki * plant.h * (wanted - measured)
        control = kp * (wanted - measured) + integral
        rows.append((control, measured))
        plant.step(control)
    control, measured = np.array(rows).T
    time = plant.h * np.arange(control.size)
    return Record(time, control, measured, setpoint, control_min=-40.0, control_max=40.0)


def lived(found: RecordedTuning, plant: Lags, step: float, samples: int) -> np.ndarray:
    """What the plant does with the design after a step of the setpoint, shape (samples,)."""
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    tuning = found.tuned.tuning
    assert tuning.controller is not None
    settings = as_designed(tuning.controller, plant.h, tuning.filter, tuning.weights)
    controller, seen = FopidController(settings), []
    controller.step(0.0, 0.0)
    for _ in range(samples):
        seen.append(plant.outer)
        plant.step(float(np.clip(controller.step(step, plant.outer), -40.0, 40.0)))
    return np.array(seen)


def recycle() -> Lags:
    return Lags(1.0, 0.5, 12.0, 4.0, 8.0, back=0.75, back_delay=60.0)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_where_a_recycle_hides_the_delay_no_gains_come_out_that_let_the_loop_go(seed: int) -> None:
    """Its model has no delay, and the response without one ends where the loop gain was 3: all three ran away."""
    record = day(recycle(), 0.5, 0.5 / 60.0, [0.0, 3.0, -2.0, 1.0], 1800, 0.05, seed)
    found = tune_recorded(record, "time")
    if found.success:
        late = lived(found, recycle(), 5.0, 3000)[-500:]
        assert np.ptp(late) < 0.5, found.message


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_delay_gets_no_kick_that_an_index_does_not_count(seed: int) -> None:
    """It overshot by 170 %, for a tenth of a second, which ITAE hardly sees."""
    record = day(Lags(0.2, 2.0, 0.4, 0.1, 6.0), 0.1, 0.07, [0.0, 4.0, -2.0, 2.0], 1500, 0.2, seed)
    found = tune_recorded(record, "time")
    assert found.success, found.message
    reached = lived(found, Lags(0.2, 2.0, 0.4, 0.1, 6.0), 6.0, 600)
    assert overshoot_pct(reached / 6.0) < 30.0, found.message
    assert reached[-100:] == pytest.approx(6.0, abs=0.1)


def slow() -> Lags:
    """Behind an actuator that moves by half a unit a second."""
    return Lags(0.5, 1.5, 5.0, 2.0, 1.0, rate=0.5)


def day_behind_slow() -> Record:
    return day(slow(), 0.3, 0.05, [0.0, 6.0, -4.0, 3.0, 0.0], 1500, 0.05, 0)


@pytest.mark.slow
def test_an_actuator_that_is_slow_is_learnt_and_kept_to() -> None:
    """A step as large as the record's overshot by 25 % where 0.001 was said."""
    found = tune_recorded(day_behind_slow(), "time")
    assert found.success, found.message
    assert "the actuator may be as slow as 0.4" in found.message or "as slow as 0.5" in found.message
    assert overshoot_pct(lived(found, slow(), 10.0, 600) / 10.0) < 6.0


@pytest.mark.slow
def test_a_method_that_cannot_keep_to_a_slow_actuator_says_that_it_is_slow() -> None:
    found = tune_recorded(day_behind_slow(), "frequency")
    assert re.search(r"no more than 0\.[45]\d* a second, which tune frequency does not keep to", found.message)


@pytest.mark.long
def test_a_record_of_a_slow_loop_answers_for_no_loop_that_is_far_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a recycle gains came twelve times as large as those that ran, and cycled from limit to limit."""
    record = day(Lags(0.5, 1.5, 5.0, 2.0, 1.0), 0.05, 0.01, [0.0, 6.0, -4.0, 3.0, 0.0], 1500, 0.3, 0)
    learnt = identify(record).best
    assert learnt is not None
    w = np.geomspace(1e-3, 6.0, 2000)
    s = 1j * w
    gain = np.abs((0.05 + 0.01 / s) * 1.5 / ((5.0 * s + 1.0) * (2.0 * s + 1.0)))
    reach = recorded_reach(record, learnt)
    assert reach.frequency >= 0.9 * FASTER * w[gain >= 1.0][-1]
    assert reach.frequency < 0.2

    def refused() -> str:
        found = tune_recorded(record, "time")
        assert found.success, found.message
        assert found.tuned is not None
        assert found.tuned.tuning is not None
        return reach.refusal(found.tuned.tuning.controller, found.tuned.tuning.filter)

    assert refused() == ""
    monkeypatch.setattr(recorded_reach_module, "FASTER", 1e3)
    assert "far faster than the loop that ran" in refused(), "without it others would come out here"
