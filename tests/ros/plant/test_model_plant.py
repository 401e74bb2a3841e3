"""A model that somebody else wrote is the plant."""

from __future__ import annotations

import math
import sys
from types import ModuleType

import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_ros.plant.model_plant import ModelPlant

SETTINGS = PlantSettings(Process.parse("1/(s+1)"), sample_time=0.1)


class Lag:
    """1/(s+1), exactly."""

    def __init__(self) -> None:
        self.x = 0.0

    def step(self, u: float, dt: float) -> float:
        self.x = u + (self.x - u) * math.exp(-dt)
        return self.x


class Broken:
    def step(self, u: float, dt: float) -> float:
        return math.nan if u > dt else u


class Begun(Lag):
    output = 7.0


class NeedsMore(Lag):
    def __init__(self, more: float) -> None:
        super().__init__()
        self.x = more


@pytest.fixture(autouse=True)
def models(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("somebodys")
    for found in (Lag, Broken, Begun, NeedsMore):
        setattr(module, found.__name__, found)
    module.nothing = 3  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "somebodys", module)


def test_it_runs_as_the_process_it_is() -> None:
    plant, exact = ModelPlant("somebodys:Lag", SETTINGS), Plant(SETTINGS)
    for u in (1.0, -2.0, 0.5, 0.5):
        assert plant.step(u, 0.25) == pytest.approx(exact.step(u, 0.25), rel=1e-12)
    plant.reset()
    assert plant.measurement == 0.0
    assert ModelPlant("somebodys:Begun", SETTINGS).measurement == 7.0


def test_its_noise_is_that_of_the_seed() -> None:
    noisy = PlantSettings(SETTINGS.process, 0.1, noise_std=0.3, seed=5)
    plant, exact = ModelPlant("somebodys:Lag", noisy), Plant(noisy)
    assert [plant.step(1.0) for _ in range(5)] == pytest.approx([exact.step(1.0) for _ in range(5)], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("nowhere:Lag", "No module named 'nowhere'"),
        ("somebodys:Gone", "has no attribute 'Gone'"),
        ("somebodys", "allowed: package.module:Class"),
        (":Lag", "allowed: package.module:Class"),
        ("somebodys:nothing", "has no step"),
        ("somebodys:NeedsMore", "missing 1 required positional argument"),
    ],
)
def test_what_is_no_model_is_named(name: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        ModelPlant(name, SETTINGS)


def test_an_output_that_is_no_number_is_refused() -> None:
    plant = ModelPlant("somebodys:Broken", SETTINGS)
    with pytest.raises(InputError, match="gave nan"):
        plant.step(2.0)
