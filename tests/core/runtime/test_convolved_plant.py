"""A process of any order runs exactly: against closed forms and the plant with a state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import fftconvolve
from scipy.special import erfcx

from fopid_core.errors import InputError
from fopid_core.model.process import Process, read_process
from fopid_core.runtime.convolved_plant import FIRST, MOST, ConvolvedPlant, plant_of
from fopid_core.runtime.plant import Plant, PlantSettings


def run(plant: Plant | ConvolvedPlant, inputs: np.ndarray) -> np.ndarray:
    return np.array([plant.step(float(u)) for u in inputs])


@pytest.mark.parametrize(
    ("process", "step"),
    [
        ("1/(s^0.5+1)", lambda t: 1.0 - erfcx(np.sqrt(t))),
        ("3/s^0.5", lambda t: 6.0 * np.sqrt(t / math.pi)),
        # The first sample behind the delay comes after a thousandth of a tick, where the response is steepest.
        (
            "1/(s^0.5+1)*exp(-0.2999s)",
            lambda t: np.where(t > 0.2999, 1.0 - erfcx(np.sqrt(np.maximum(t - 0.2999, 0.0))), 0.0),
        ),
        ("1/(s^0.5+1)*exp(-0.33s)", lambda t: np.where(t > 0.33, 1.0 - erfcx(np.sqrt(np.maximum(t - 0.33, 0.0))), 0.0)),
    ],
)
def test_a_fractional_process_answers_as_its_closed_form(process: str, step: object) -> None:
    plant = ConvolvedPlant(PlantSettings(Process.parse(process), sample_time=0.1))
    inputs = np.random.default_rng(1).normal(size=300)
    moves = np.diff(inputs, prepend=0.0)
    time = 0.1 * np.arange(1, 301)
    exact = [float(moves[: k + 1] @ step(time[k] - 0.1 * np.arange(k + 1))) for k in range(300)]  # type: ignore[operator]
    assert run(plant, inputs) == pytest.approx(np.array(exact), abs=1e-6)
    assert plant.accuracy < 1e-6


@pytest.mark.parametrize("process", ["P1", "1/((s+1e-5)(s+1e5))", "1/(s(s+1))*exp(-0.27s)", "(2s+1)/(s+1)"])
def test_a_rational_one_as_with_its_state(process: str) -> None:
    settings = PlantSettings(read_process(process), sample_time=0.05, delay_model="exact", noise_std=0.1, seed=4)
    inputs = np.sin(np.arange(200.0))
    expected = run(Plant(settings), inputs)
    assert run(ConvolvedPlant(settings), inputs) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize(
    ("process", "step"),
    [
        ("1/s^0.5", lambda t: 2.0 * np.sqrt(t / math.pi)),
        (
            "1/(s^0.5+1)*exp(-100s)",
            lambda t: np.where(t > 100.0, 1.0 - erfcx(np.sqrt(np.maximum(t - 100.0, 0.0))), 0.0),
        ),
        ("(1-exp(-90s))/s", lambda t: np.minimum(t, 90.0)),
        ("1/(s^2+0.2s+1.01)*(s^0.5+1)/(s^0.5+1)", lambda t: _ringing(t)),
    ],
)
def test_it_goes_on_for_as_long_as_one_likes(process: str, step: object) -> None:
    plant = ConvolvedPlant(PlantSettings(Process.parse(process), sample_time=0.01))
    time = 0.01 * np.arange(1, 6 * FIRST)
    inputs = 1.0 + np.random.default_rng(2).normal(size=time.size)
    exact = fftconvolve(np.diff(inputs, prepend=0.0), step(time))[: time.size]  # type: ignore[operator]
    assert run(plant, inputs) == pytest.approx(exact, abs=1e-7 * np.max(np.abs(exact)))


def _ringing(time: np.ndarray) -> np.ndarray:
    return (1.0 - np.exp(-0.1 * time) * (np.cos(time) + 0.1 * np.sin(time))) / 1.01


def test_what_winds_for_too_long_is_refused() -> None:
    plant = ConvolvedPlant(PlantSettings(Process.parse("1/(s^2+1)"), sample_time=0.01))
    plant._remember(2 * MOST)
    plant._count = 2 * MOST
    with pytest.raises(InputError, match=r"still winds .* allowed: a sample time longer than 0\.01 s"):
        plant.step(1.0)


def test_it_rests_at_its_initial_output_and_begins_anew() -> None:
    plant = plant_of(PlantSettings(Process.parse("2/(s^1.5+1)"), initial_output=3.0))
    assert run(plant, np.full(50, 1.5)) == pytest.approx(3.0)
    plant.reset()
    assert plant.measurement == 3.0


def test_what_it_cannot_do_is_named() -> None:
    with pytest.raises(InputError, match="no other point of rest"):
        plant_of(PlantSettings(Process.parse("(1-exp(-s))/s"), initial_output=1.0))
    with pytest.raises(InputError, match="control = inf"):
        plant_of(PlantSettings(Process.parse("1/(s^0.5+1)"))).step(math.inf)
