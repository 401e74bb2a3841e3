"""A model that somebody else wrote is the plant."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_ros.plant.model_plant import ModelPlant
from fopid_ros.plant.node import PlantSimulator

from ..conftest import Graph

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


class BegunAsArray(Lag):
    def __init__(self) -> None:
        super().__init__()
        self.measurement = np.array([2.0], dtype=np.float32)


class Unlicensed(Lag):
    def __init__(self) -> None:
        raise RuntimeError("licence not found")


class NoSensor(Lag):
    @property
    def measurement(self) -> float:
        raise RuntimeError("sensor off")


class NoTime(Lag):
    def step(self, u: float) -> float:  # type: ignore[override]
        return u


class Fails(Lag):
    def step(self, u: float, dt: float) -> float:
        return 10.0 * dt / u


class Exits(Lag):
    def step(self, u: float, dt: float) -> float:
        raise SystemExit(3 + int(u * dt))


class Text(Lag):
    def step(self, u: float, dt: float) -> str:  # type: ignore[override]
        return f"{u * dt}"


class OnTheInstance:
    def __init__(self) -> None:
        self.step = lambda u, dt: u + dt


class Odd(Lag):
    """Gives what only looks like a number."""

    def __init__(self) -> None:
        super().__init__()
        self.made = iter((Tensor(), 10**400, np.ma.masked, list(range(100_000)), Unspeakable()))

    def step(self, *_: float) -> object:  # type: ignore[override]
        return next(self.made)


class Tensor:
    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise RuntimeError("it wants its gradient")


class Unspeakable:
    def __repr__(self) -> str:
        raise RuntimeError("no words")


@pytest.fixture(autouse=True)
def models(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("somebodys")
    for found in (Lag, *Lag.__subclasses__(), Broken, OnTheInstance):
        setattr(module, found.__name__, found)
    module.nothing, module.stepless, module.made = 3, object, lambda: Lag()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "somebodys", module)


def test_it_runs_as_the_process_it_is() -> None:
    plant, exact = ModelPlant("somebodys:Lag", SETTINGS), Plant(SETTINGS)
    for u in (1.0, -2.0, 0.5, 0.5):
        assert plant.step(u, 0.25) == pytest.approx(exact.step(u, 0.25), rel=1e-12)
    plant.reset()
    assert plant.measurement == 0.0
    assert ModelPlant("somebodys:Begun", SETTINGS).measurement == 7.0
    assert ModelPlant("somebodys:BegunAsArray", SETTINGS).measurement == 2.0


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
        ("somebodys:nothing", "is no class"),
        ("somebodys:stepless", "has no step"),
        ("somebodys:NeedsMore", "missing 1 required positional argument"),
        ("somebodys:Unlicensed", "the class: RuntimeError: licence not found; allowed: package.module:Class"),
        ("somebodys:NoSensor", "measurement: RuntimeError: sensor off; allowed"),
        ("somebodys:NoTime", "too many positional arguments; allowed"),
    ],
)
def test_what_is_no_model_is_named(name: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        ModelPlant(name, SETTINGS)


@pytest.mark.parametrize("body", ["1 +", "raise OSError('no disk')", "raise SystemExit(7)"])
def test_a_module_that_cannot_be_read_is_named(body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "somebodys_broken.py").write_text(body)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"model = 'somebodys_broken:Lag': .*; allowed: package.module:Class"):
        ModelPlant("somebodys_broken:Lag", SETTINGS)


@pytest.mark.parametrize(
    ("name", "u", "named"),
    [
        ("Broken", 2.0, "gave nan; allowed: a finite number"),
        ("Text", 2.0, "gave '0.2'; allowed: a finite number"),
        ("Fails", 0.0, r"step\(0, 0.1\): ZeroDivisionError: float division by zero; allowed"),
        ("Exits", 0.0, "SystemExit: 3; allowed"),
    ],
)
def test_a_step_that_gives_no_number_is_named(name: str, u: float, named: str) -> None:
    plant = ModelPlant(f"somebodys:{name}", SETTINGS)
    with pytest.raises(InputError, match=named):
        plant.step(u)


def test_whatever_makes_a_model_will_do() -> None:
    assert ModelPlant("somebodys:OnTheInstance", SETTINGS).step(2.0) == 2.1
    assert ModelPlant("somebodys:made", SETTINGS).step(1.0) == pytest.approx(-math.expm1(-0.1))


def test_what_only_looks_like_a_number_is_none_and_told_in_short() -> None:
    plant = ModelPlant("somebodys:Odd", SETTINGS)
    for _ in range(5):
        with pytest.raises(InputError, match="allowed: a finite number") as told:
            plant.step(1.0)
        assert len(str(told.value)) < 250


@pytest.mark.ros
def test_a_model_that_fails_is_told_and_the_node_goes_on(graph: Graph) -> None:
    """Once in ten seconds in the log, in its diagnostics for as long as it fails; no measurement is made up."""
    context = Context()
    arguments = ["--ros-args", "-p", "model:='somebodys:Fails'", "-p", "sample_time:=0.1"]
    rclpy.init(args=arguments, context=context, domain_id=graph.domain)
    node = PlantSimulator(context=context)
    try:
        for _ in range(3):
            node._tick()
        assert node.time == 0.0
        [(level, told)] = node.health()[1]
        assert level == DiagnosticStatus.ERROR
        assert "ZeroDivisionError" in told
        assert node.health()[2]["failures of the plant"] == 3
        assert node.guard.count == 0
        node._control = 2.0
        node._tick()
        assert node.health()[1] == []
        assert node._plant.measurement == 0.5
        node._control = 0.0
    finally:
        node.destroy_node()
        context.shutdown()
