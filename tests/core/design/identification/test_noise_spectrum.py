"""What noise that is not white makes of the control is foretold by its spectrum at rest, not by its level alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.identification.noise import sensor_noise
from fopid_core.design.identification.noise_spectrum import noise_spectrum
from fopid_core.design.identification.record import Record
from fopid_core.design.loop_worth import noise_gain
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.two_degrees import WHOLE_SETPOINT, MeasurementFilter
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import as_designed

from .recorded import open_loop, plant

PROCESS, H, LEVEL, REST = "2/(s+1)^2", 0.05, 0.02, 1000
GAINS = {"PI": Fopid(0.8, 0.5), "PID": Fopid(1.2, 0.8, 0.4)}
SLOW = MeasurementFilter(2, 0.1)


def memory(white: np.ndarray) -> np.ndarray:
    """An autoregression of the first order."""
    return math.sqrt(1.0 - 0.9**2) * lfilter([1.0], [1.0, -0.9], white)


def hum(white: np.ndarray, angle: float) -> np.ndarray:
    """A single frequency beside a tenth of white noise."""
    return math.sqrt(2.0) * np.sin(angle * np.arange(white.size) + 1.0) + 0.1 * white


NOISES = {"memory": memory, "slow hum": lambda white: hum(white, 0.15), "quick hum": lambda white: hum(white, 2.5)}


def recorded(kind: str, seed: int) -> Record:
    """A rest, then a step."""
    control = (np.arange(REST + 500) >= REST).astype(float)
    answer = open_loop(PROCESS, control, H)
    noise = NOISES[kind](np.random.default_rng(seed).standard_normal(control.size))
    return Record(answer.time, control, answer.measurement + LEVEL * noise)


def moved(kind: str, gains: Fopid, samples: int = 20_000) -> float:
    """Standard deviation of the control of the running loop, whose measurement has that noise."""
    controller = FopidController(as_designed(gains, H, SLOW, WHOLE_SETPOINT))
    running = plant(PROCESS, H)
    noise = LEVEL * NOISES[kind](np.random.default_rng(99).standard_normal(samples))
    control = np.empty(samples)
    for k in range(samples):
        control[k] = controller.step(0.0, running.measurement + noise[k])
        running.step(control[k])
    return float(np.std(control[samples // 10 :]))


@pytest.mark.parametrize(
    ("kind", "structure"),
    [("memory", "PID"), *(pytest.param(k, s, marks=pytest.mark.slow) for k, s in (
        ("memory", "PI"), ("slow hum", "PI"), ("slow hum", "PID"), ("quick hum", "PI"), ("quick hum", "PID")))],
)  # fmt: skip
def test_the_control_moves_as_the_spectrum_foretells(kind: str, structure: str) -> None:
    """A level from so many samples with a memory of 19 is known to some 7 %, from a record's rest each."""
    loop = Loop(read_process(PROCESS), GAINS[structure], SLOW)
    found = [sensor_noise(recorded(kind, seed)) for seed in range(6)]
    told = [sensor.level * noise_gain(loop, H, sensor.spectrum) for sensor in found]
    true = moved(kind, GAINS[structure])
    assert told == pytest.approx([true] * 6, rel=0.25)
    assert np.mean(told) == pytest.approx(true, rel=0.1)
    white = LEVEL * noise_gain(loop, H)
    assert not 0.7 < white / true < 1.4


def test_white_noise_stays_white_and_its_level_that_of_the_third_differences() -> None:
    control = (np.arange(1500) >= REST).astype(float)
    answer = open_loop(PROCESS, control, H, LEVEL, seed=3)
    found = sensor_noise(answer)
    assert found.spectrum is None
    assert found.level == pytest.approx(LEVEL, rel=0.1)


def test_a_slower_controller_sees_it_folded_and_a_faster_one_is_not_told() -> None:
    """A hum of 50 rad/s at ticks of 0.1 s: 5 rad, that is 1.283."""
    rest = hum(np.random.default_rng(0).standard_normal(2000), 50.0 * H)
    seen = noise_spectrum(rest, H)
    assert seen is not None
    folded = seen.angles(0.1)
    assert folded is not None
    assert folded[int(np.argmax(seen.share))] == pytest.approx(2.0 * math.pi - 5.0, abs=0.01)
    assert seen.angles(0.9 * H) is None


@pytest.mark.parametrize("kind", ["a drift", "a tail", "a record that swings throughout", "a stuck sensor"])
def test_what_is_no_noise_has_no_spectrum(kind: str) -> None:
    signals = recorded("memory", 0)
    time = signals.time
    measurement = {
        "a drift": signals.measurement + 0.02 * time,
        "a tail": 1e-3 * signals.measurement + np.exp(-time / (0.2 * time[REST])),
        "a record that swings throughout": np.sin(time),
        "a stuck sensor": np.where(time < time[REST], 1.0, signals.measurement),
    }[kind]
    control = np.cos(time) if "swings" in kind else signals.control
    assert sensor_noise(Record(time, control, measurement)).spectrum is None
