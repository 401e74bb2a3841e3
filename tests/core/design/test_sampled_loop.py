"""The loop as it runs, against eigenvalues and responses of the loop put together from matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.defaults import MS_MAX
from fopid_core.design.sampled_loop import running, sampled_process
from fopid_core.design.tuner import WORSE, TuningRequest, tune, verify
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import ControllerSettings

THETA = np.geomspace(1e-3, 3.0, 40)


def held(numerator: list[float], denominator: list[float], h: float) -> tuple[np.ndarray, np.ndarray]:
    """The sampled process behind a hold as polynomials in z, by a matrix exponential."""
    num, den, _ = cont2discrete((numerator, denominator), h, "zoh")
    return np.ravel(num), den


@pytest.mark.parametrize("h", [0.01, 0.3])
@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [([1], [1, 1]), ([1, 2], [1, 0.01, 9]), ([1], [1, -1]), ([1], [1, 0, 0]), ([-1, 2], [1, 3, 3, 1])],
)
def test_the_sampled_process_is_that_of_a_matrix_exponential(numerator: list, denominator: list, h: float) -> None:
    num, den = held(numerator, denominator, h)
    z = np.exp(1j * THETA)
    process = Process.parse(f"({'+'.join(f'({c})s^{k}' for k, c in enumerate(numerator[::-1]))})"
                            f"/({'+'.join(f'({c})s^{k}' for k, c in enumerate(denominator[::-1]))})")  # fmt: skip
    expected = np.polyval(num, z) / np.polyval(den, z)
    assert sampled_process(process, h, THETA) == pytest.approx(expected, rel=1e-7, abs=1e-9 * abs(expected).max())


@pytest.mark.parametrize("delay", [0.6, 0.45])
def test_a_delay_of_whole_ticks_or_not_is_exact(delay: float) -> None:
    # The step response 1 - exp(-(t - delay)), sampled, is the sum of the pulse response.
    h, k = 0.3, np.arange(1, 400)
    step = np.where(k * h > delay, 1.0 - np.exp(-(k * h - delay)), 0.0)
    pulses = np.diff(step, prepend=0.0)
    expected = (pulses * np.exp(-1j * np.outer(THETA, k))).sum(axis=1)
    process = Process.parse(f"1/(s+1)*exp(-{delay}s)")
    assert sampled_process(process, h, THETA) == pytest.approx(expected, rel=3e-5)


def test_a_fractional_process_is_that_of_its_step_response() -> None:
    # 1/s^0.5 answers a step with 2 sqrt(t/pi); its pulses are summed with a factor that dies out, on |z| = e^r.
    h, r = 0.1, 0.02
    k = np.arange(1, 4000)
    pulses = np.diff(2.0 * np.sqrt(k * h / math.pi), prepend=0.0)
    expected = (pulses * np.exp(-np.outer(r + 1j * THETA, k))).sum(axis=1)
    process = Process.parse("1/s^0.5")
    shifted = [sampled_process(process, h, np.array([theta - 1j * r], dtype=complex))[0] for theta in THETA]
    assert np.array(shifted) == pytest.approx(expected, rel=1e-4)


def closed_loop_poles(numerator: list, denominator: list, gains: Fopid, h: float) -> np.ndarray:
    """Eigenvalues of plant and controller put together as matrices."""
    num, den = held(numerator, denominator, h)
    n = len(den) - 1
    a = np.zeros((n, n))
    a[0], a[1:, :-1] = -den[1:], np.eye(n - 1)
    c = num[1:]  # behind a hold nothing passes at once
    operators = FopidController(ControllerSettings(gains, h)).operators
    m, matrix = operators.size, operators.matrix
    of_error = matrix[:m, -2] + matrix[:m, -1]
    read = np.array([gains.ki, gains.kd]) @ matrix[-2:]
    direct = gains.kp + read[-2] + read[-1]
    whole = np.zeros((n + m, n + m))
    whole[n:, n:], whole[n:, :n] = matrix[:m, :m], -np.outer(of_error, c)
    whole[:n, :n] = a
    whole[0, :n] -= direct * c
    whole[0, n:] = read[:m]
    return np.linalg.eigvals(whole)


def random_loop(random: np.random.Generator) -> tuple[list, list, Fopid, float]:
    roots = -np.exp(random.uniform(-1.5, 1.5, random.integers(1, 4))) + 0j
    if random.random() < 0.3:
        w, damping = math.exp(random.uniform(-1, 1)), random.uniform(0.02, 0.7)
        roots = np.append(roots, w * np.exp(1j * math.acos(-damping) * np.array([1, -1])))
    if random.random() < 0.2:
        roots[0] = abs(roots[0].real)
    elif random.random() < 0.2:
        roots[0] = 0.0
    denominator = np.poly(roots).real.tolist()
    orders = random.choice([0.4, 0.8, 1.0, 1.2], 2)
    kp, ki, kd = np.exp(random.uniform(-2, 2, 3)) * (random.random(3) < 0.8)
    return [1.0], denominator, Fopid(kp, ki, kd, *orders), math.exp(random.uniform(-5, -1))


def agree(count: int, seed: int) -> int:
    """How many of ``count`` random loops are decided; each of them as its eigenvalues say."""
    random, decided = np.random.default_rng(seed), 0
    for _ in range(count):
        numerator, denominator, gains, h = random_loop(random)
        poles = np.abs(closed_loop_poles(numerator, denominator, gains, h))
        outside = int((poles > 1.0 + 1e-6).sum())
        process = Process.parse(f"1/({'+'.join(f'({c!r})s^{k}' for k, c in enumerate(denominator[::-1]) if c)})")
        found = running(process, gains, h)
        if found.stable is None:
            continue
        assert found.stable == (outside == 0), (process, gains, h, found, outside)
        decided += 1
    return decided


def test_stability_is_that_of_the_eigenvalues() -> None:
    assert agree(25, seed=1) > 20


@pytest.mark.long
def test_stability_is_that_of_the_eigenvalues_on_many_loops() -> None:
    assert agree(600, seed=2) > 500


def test_the_gain_margin_is_where_the_simulated_loop_begins_to_grow() -> None:
    process, h = read_process("1/(s+1)^3*exp(-0.23s)"), 0.2
    gains = Fopid(1.0, 0.4, 0.3, 0.9, 0.7)
    margin = running(process, gains, h).gain_margin

    def late_over_early(factor: float) -> float:
        controller = FopidController(ControllerSettings(gains, h))
        plant = Plant(PlantSettings(process.scaled(factor), h, delay_model="exact"))
        errors = []
        for _ in range(3000):
            errors.append(1.0 - plant.measurement)
            plant.step(controller.step(1.0, plant.measurement))
        return max(map(abs, errors[2500:])) / max(map(abs, errors[500:1000]))

    assert late_over_early(0.99 * margin) < 0.9
    assert late_over_early(1.01 * margin) > 1.1


def test_with_a_fast_tick_the_peak_is_that_of_the_ideal_loop() -> None:
    assert running(read_process("P1"), Fopid(kp=2.0), 1e-4).ms == pytest.approx(5.0 / 3.0, rel=1e-3)


def test_a_design_that_is_fine_without_ticks_and_not_with_them_is_not_handed_to_a_controller() -> None:
    wanted = TuningRequest(read_process("1/(s(0.5s+1))"), method="time", structure="pd", sample_time=0.15)
    fine = verify(wanted, Fopid(kp=5.26, kd=2.53))
    assert fine.achieved.ms < 1.1
    assert fine.running.ms > 4.0
    assert "as it runs, with ticks of 0.15 s, its Ms is" in fine.message
    assert "as it runs" in rejection_reason(fine, 0.15, ticks=0.0)


def test_a_search_goes_on_until_its_bound_on_ms_is_kept_as_the_design_runs() -> None:
    result = tune(TuningRequest(read_process("1/(s(0.5s+1))"), method="time", structure="pd", sample_time=0.15))
    assert result.success
    assert result.running.ms <= WORSE * MS_MAX


def test_a_rule_that_makes_an_unstable_sampled_loop_is_no_success() -> None:
    fast, slow = (
        tune(TuningRequest(read_process("1/(s+1)^3"), method="rule", rule="simc-pi", sample_time=h))
        for h in (0.01, 8.0)
    )
    assert (fast.success, fast.unmet) == (True, ())
    gains = slow.controller  # the lags have all but ended after one tick of 8 s: P(z) is 1 / z
    roots = np.abs(np.roots([1.0, gains.kp + 8.0 * gains.ki - 1.0, -gains.kp]))
    assert np.count_nonzero(roots > 1.0) == 1
    assert slow.running.stable is False
    assert not slow.success
    assert slow.unmet == ("stability as it runs, with ticks of 8 s: 1 unstable pole of the sampled loop",)


def test_what_is_not_known_has_its_reason_and_no_number() -> None:
    found = running(Process.parse("(s+2)/(s+1)"), Fopid(kp=1.0), 0.1)
    assert found.stable is None
    assert math.isnan(found.ms)
    assert "at once" in found.reason
