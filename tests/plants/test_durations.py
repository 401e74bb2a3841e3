"""What is told of an experiment's length is what it took, by the loop's own clock."""

from __future__ import annotations

import durations
import numpy as np
import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop


def test_a_time_constant_is_that_of_the_loop_without_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    exhibit = GALLERY["van_de_vusse"]
    loop = VirtualLoop(exhibit)
    loop.plant.sensor.noise = loop.plant.sensor.step = 0.0
    loop.setpoint += exhibit.move
    loop.run(exhibit.horizon)
    _, setpoint, true, _ = loop.trace.part(0)
    alone = exhibit.sample_time * int(np.argmax(true > setpoint - 0.368 * exhibit.move))
    monkeypatch.setattr(durations, "SEEDS", (11, 12))
    assert durations.time_constant("van_de_vusse") == pytest.approx(alone, rel=0.05)


def test_a_length_is_that_of_the_loop_and_one_that_ended_early_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    took, said = durations.duration("van_de_vusse", 1)
    assert 10.0 < took < 1.5 * said < 60.0
    monkeypatch.setattr(durations.ClosedLoopExperiment, "excite", lambda *_: "refused")
    early, told = durations.duration("van_de_vusse", 1)
    assert np.isnan(early)
    assert told <= said
