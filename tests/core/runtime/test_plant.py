"""The plant is exact for a held input, whatever its delay."""

from __future__ import annotations

from collections import deque

import control
import mpmath
import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import read_process
from fopid_core.runtime.plant import Plant, PlantSettings

H = 0.01


def run(process: str, inputs: np.ndarray, **settings: object) -> np.ndarray:
    """Outputs at samples 0 ... n, the input k held from k to k+1."""
    plant = Plant(PlantSettings(read_process(process), sample_time=H, **settings))
    return np.array([plant.measurement, *(plant.step(float(u)) for u in inputs)])


PROCESSES = ["P1", "P2", "P3", "P4", "1/(s(s+1))", "1/(s-0.5)", "(1-0.3s)/(s^2+0.2s+4)", "(2s+1)/(s+1)"]


@pytest.mark.parametrize("process", PROCESSES)
def test_a_held_input_is_answered_exactly(process: str) -> None:
    inputs = np.repeat([1.0, -0.5, 2.0], 100)
    numerator, denominator, _ = read_process(process).polynomials()
    discrete = control.c2d(control.ss(control.tf(numerator, denominator)), H, "zoh")
    a, b, c, d = discrete.A, discrete.B[:, 0], discrete.C[0], float(discrete.D[0, 0])
    x, expected = np.zeros(len(a)), [0.0]
    for u in inputs:
        x = a @ x + b * u
        expected.append(float(c @ x) + d * u)
    np.testing.assert_allclose(run(process, inputs), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("lags", "h", "samples"),
    [
        ((1e-12, 1e3, 1e4), 0.01, 100_000),
        ((1e-12, 1e3), 1.0, 10_000),
        ((1e-9, 999.0, 1001.0), 1.0, 10_000),
        ((1e-6, 1e-3, 1.0, 1e3, 1e6), 0.01, 100_000),
        ((1e-8, 1e6), 1e-5, 100_000),
    ],
)
def test_poles_up_to_fifteen_decades_apart(lags: tuple[float, ...], h: float, samples: int) -> None:
    """By partial fractions in 60 digits."""
    process = read_process("1/(" + "".join(f"({lag!r}s+1)" for lag in lags) + ")")
    plant = Plant(PlantSettings(process, h))
    found = np.array([plant.step(1.0) for _ in range(samples)])
    with mpmath.workdps(60):
        exact_lags = [mpmath.mpf(repr(lag)) for lag in lags]
        weights = [mpmath.fprod(a / (a - b) for b in exact_lags if b != a) for a in exact_lags]
        for k in (1, 2, 10, 100, samples // 10, samples):
            waves = (w * mpmath.exp(-k * mpmath.mpf(repr(h)) / a) for w, a in zip(weights, exact_lags, strict=True))
            assert found[k - 1] == pytest.approx(float(1 - mpmath.fsum(waves)), abs=1e-11 * found[-1]), k


def test_a_plant_that_runs_away_stops_before_its_numbers_end() -> None:
    plant = Plant(PlantSettings(read_process("1/(s-1)"), 1.0))
    with pytest.raises(InputError, match=r"process 1/\(s - 1\): its output has grown beyond all numbers; allowed: a"):
        deque((plant.step(1.0) for _ in range(1000)), maxlen=0)
    before = plant.measurement
    assert np.isfinite(before)
    assert before > 1e300
    with pytest.raises(InputError, match="beyond all numbers"):
        plant.step(1.0)
    assert plant.measurement == before


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.01, 0.0137, 0.25, 0.2549])
def test_exact_delay_of_any_length(delay: float) -> None:
    inputs = np.repeat([1.0, -1.0], 60)
    out = run(f"1/(s+1)*exp(-{delay}s)", inputs, delay_model="exact")
    time = H * np.arange(len(inputs) + 1)

    def step(t: np.ndarray) -> np.ndarray:
        return np.where(t > 0, 1 - np.exp(-np.maximum(t, 0)), 0.0)

    np.testing.assert_allclose(out, step(time - delay) - 2 * step(time - delay - 0.6), atol=1e-12)


def test_pade_delay_is_that_of_python_control() -> None:
    numerator, denominator = control.pade(0.5, 3)
    series = control.c2d(control.ss(control.tf(numerator, denominator) * control.tf([1], [1, 1])), H, "zoh")
    inputs = np.ones(300)
    _, expected = control.forced_response(series, H * np.arange(301), np.ones(301))
    np.testing.assert_allclose(run("1/(s+1)*exp(-0.5s)", inputs), expected, atol=1e-9)


def test_disturbance_adds_to_the_control_and_the_gain_factor_scales_both() -> None:
    plant, twin = (Plant(PlantSettings(read_process("P1"))) for _ in range(2))
    plant.gain_factor = 2.0
    for _ in range(100):
        assert plant.step(0.5, 0.25) == pytest.approx(twin.step(1.5), rel=1e-12, abs=1e-15)


def test_the_same_seed_gives_the_same_noise_of_the_stated_size() -> None:
    zero = np.zeros(4000)
    first, second = (run("P1", zero, noise_std=0.3, seed=5) for _ in range(2))
    other = run("P1", zero, noise_std=0.3, seed=6)
    assert (first == second).all()
    assert (first != other).any()
    assert first.std() == pytest.approx(0.3, rel=0.05)  # 4,000 samples: 1.1 % standard error


@pytest.mark.parametrize("process", ["P1", "3/(s+1)*exp(-0.4s)", "1/(s(s+1))"])
def test_the_initial_output_is_a_point_of_rest(process: str) -> None:
    gain = read_process(process).steady_state_gain
    held = 2.0 / gain if np.isfinite(gain) else 0.0
    out = run(process, np.full(200, held), initial_output=2.0)
    np.testing.assert_allclose(out, 2.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("process", "settings", "named"),
    [
        ("1/(s^0.5+1)", {}, "not rational"),
        ("1/(s+exp(-s))", {}, "not rational"),
        ("P1", {"sample_time": 0.0}, "sample_time = 0.0"),
        ("P1", {"pade_order": 11}, "pade_order = 11"),
        ("P1", {"noise_std": float("nan")}, "noise_std = nan"),
        ("P1", {"delay_model": "none"}, "'none'"),
        ("s/(s+1)", {"initial_output": 1.0}, "initial_output = 1.0"),
    ],
)
def test_bad_settings_are_named(process: str, settings: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Plant(PlantSettings(read_process(process), **settings))


def test_an_input_that_is_not_finite_is_refused_and_changes_nothing() -> None:
    plant = Plant(PlantSettings(read_process("P1")))
    plant.step(1.0)
    before = plant.measurement
    with pytest.raises(InputError, match="control = nan"):
        plant.step(float("nan"))
    assert plant.measurement == before


@pytest.mark.parametrize(("order", "lag", "delay"), [(3, 0.5, 5.0), (5, 2.0, 3.0), (1, 4.0, 1.0)])
def test_it_says_by_how_much_pades_delay_is_off(order: int, lag: float, delay: float) -> None:
    """By python-control's approximation and the exponential written out."""
    instants = 0.01 * np.arange(round(4.0 * delay / 0.01) + 1)
    approximate = control.forced_response(
        control.tf(*control.pade(delay, order)) * control.tf([1.0], [lag, 1.0]), instants, np.ones_like(instants)
    ).outputs
    exact = -np.expm1(-np.maximum(instants - delay, 0.0) / lag)
    off = np.abs(approximate - exact).max() / exact.max()
    process = read_process(f"1/({lag}s+1)*exp(-{delay}s)")
    assert Plant(PlantSettings(process, 0.01, pade_order=order)).accuracy == pytest.approx(off, rel=0.02)
    assert Plant(PlantSettings(process, 0.01, delay_model="exact")).accuracy == 0.0


def test_of_a_response_that_is_over_between_two_samples_all_that_pade_makes_is_error() -> None:
    assert Plant(PlantSettings(read_process("s*exp(-s)/(0.001s+1)"), 0.1)).accuracy == 1.0
