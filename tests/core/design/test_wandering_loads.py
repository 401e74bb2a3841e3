"""A quiet loop, one step of its setpoint, and a load that wanders all the while: no gains that let the process go."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from fopid_core.design.identification import refusal
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.design.sampled_loop import running
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.simulation import simulate
from fopid_core.study.records import read_record

from .identification.recorded import plant

DAYS = Path(__file__).with_name("days")


MOVES = {
    "one step": lambda k: 4.0 * (k >= 60),
    "two steps": lambda k: 1.0 * (k >= 60) + 1.0 * (k >= 60 + k.size // 2),
    "a pulse": lambda k: 4.0 * ((k >= 60) & (k < 80)),
    "ramps": lambda k: np.interp(k, [60, 100, 200, 250], [0.0, 4.0, 4.0, 1.0]),
    "at every tick": lambda k: np.cumsum(0.3 * np.random.default_rng(0).standard_normal(k.size) * (k >= 60)),
}


def day(seed: int, wander: float, moves: str = "one step", noisy: float = 0.01) -> tuple[Record, str]:
    """Two lags behind a delay under a PI, of 1 s ticks; and the process."""
    rng = np.random.default_rng(seed)
    slow, delay = float(rng.uniform(8.0, 40.0)), int(rng.integers(1, 10))
    quick = slow * float(rng.uniform(0.1, 0.9))
    lags = slow + quick
    samples = min(round(60.0 + 3.0 * (delay + 4.0 * lags)), 900)
    a, b, c, _, _ = cont2discrete(tf2ss([1.0], np.polymul([slow, 1.0], [quick, 1.0])), 1.0)
    kp = 0.15 * lags / (delay + 0.5 + 0.2 * lags)
    load = wander * np.cumsum(rng.standard_normal(samples))
    noise, setpoint = noisy * rng.standard_normal(samples), MOVES[moves](np.arange(samples))
    state, integral, waiting, rows = np.zeros((2, 1)), 0.0, [0.0] * delay, []
    for k in range(samples):
        measured = (c @ state).item() + noise[k]
        integral += kp / lags * (setpoint[k] - measured)
        control = kp * (setpoint[k] - measured) + integral
        rows.append((control, measured))
        waiting.append(control + load[k])
        state = a @ state + b * waiting.pop(0)
    control, measured = np.array(rows).T
    process = f"1/(({slow!r}*s+1)*({quick!r}*s+1))*exp(-{delay}*s)"
    return Record(np.arange(float(samples)), control, measured, setpoint), process


@pytest.mark.slow
def test_a_day_whose_load_wandered_gives_no_gains() -> None:
    """Gains came with "stable on all 56 possible processes, worst max |S| 1.81", unstable on the plant.

    It was 0.66702/(2250.0s^2+96.617s+1)*exp(-25s) at 5 s.
    """
    found = tune_recorded(read_record(DAYS / "walk_336.csv"), "time", {"structure": "pid"})
    assert not found.success
    assert "what the model leaves is no noise, and what the setpoint has moved" in found.message


@pytest.mark.slow
def test_another_such_day_gives_gains_that_hold_the_plant() -> None:
    """1.02392/(167.92s^2+27.361s+1)*exp(-4.25s) at 1 s; without the loads in the model its gains let it go."""
    found = tune_recorded(read_record(DAYS / "walk_429.csv"), "time", {"structure": "pid"})
    assert found.success, found.message
    assert found.tuned is not None
    design, s = found.tuned.tuning, 1j * np.geomspace(1e-6, np.pi, 20_000)
    assert design is not None
    assert design.controller is not None
    plant_and_hold = 1.02392 / (167.92 * s**2 + 27.361 * s + 1.0) * np.exp(-4.75 * s) * np.sinc(s.imag / (2.0 * np.pi))
    loop = 1.0 + design.controller(s) * design.filter(s) * plant_and_hold
    assert np.abs(1.0 / loop).max() < 1.8
    turned = np.unwrap(np.angle(loop))
    assert turned[-1] - turned[0] == pytest.approx(0.5 * np.pi * design.controller.lam, abs=0.5)  # stable


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "wander"), [(0, 0.0), (1, 0.0), (2, 0.0), (4, 0.05)])
def test_without_it_or_with_little_gains_come_and_hold(seed: int, wander: float) -> None:
    record, process = day(seed, wander)
    found = tune_recorded(record, "time", {"structure": "pid"})
    assert found.success, found.message
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    assert found.tuned.tuning.controller is not None
    runs = running(read_process(process), found.tuned.tuning.controller, 1.0, found.tuned.tuning.filter)
    assert runs.stable
    assert runs.ms < 2.0 if not wander else runs.ms < 2.5


@pytest.mark.parametrize("template", ["foptd", "nioptd2"])
@pytest.mark.parametrize("moves", list(MOVES))
def test_what_a_simple_model_leaves_of_a_loop_without_noise_is_no_load(moves: str, template: str) -> None:
    """Ramps were refused, and two steps far apart: "what the setpoint has moved drowns in that"."""
    record, _ = day(1, 0.0, moves, noisy=0.0)
    found = identify(record, template)
    assert found.success, found.message


@pytest.mark.parametrize(("most", "said"), [(2.0, "the control was at 2 for"), (50.0, "larger moves of the setpoint")])
def test_a_control_at_its_limit_is_named_where_the_setpoints_answer_is_missed(
    most: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("REMEMBERS", "MOST_MISSED"):  # as if it were
        monkeypatch.setattr(refusal, name, -1.0)
    controller = FopidController(ControllerSettings(Fopid(3.0, 1.0), sample_time=0.1, control_max=most))
    held = plant("1/((s+1)(0.2s+1))", 0.1, 0.01)
    trace = simulate(controller, held, 400, lambda k: (0.0, 1.5, 0.3, 1.8)[k // 100], lambda _: 0.0)
    record = Record(trace.time, trace.control, trace.measurement, trace.setpoint)
    best = identify(record, "soptd").best
    assert best is not None
    assert said in refusal.refusal_beside_the_setpoint(record, best)
