"""A process of any order runs exactly: against closed forms and the plant with a state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import erfcx

from fopid_core.errors import InputError
from fopid_core.model.process import Process, read_process
from fopid_core.runtime.convolved_plant import FIRST, ConvolvedPlant, plant_of
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


def test_it_goes_on_when_the_first_samples_are_used_up() -> None:
    plant = ConvolvedPlant(PlantSettings(Process.parse("1/(10s^0.8+1)"), sample_time=0.01))
    last = run(plant, np.ones(FIRST + 100))
    again = ConvolvedPlant(PlantSettings(Process.parse("1/(10s^0.8+1)"), sample_time=0.02))
    assert last[1::2][-1] == pytest.approx(run(again, np.ones(FIRST // 2 + 50))[-1], rel=1e-6)


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
