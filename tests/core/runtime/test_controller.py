"""The running controller: exact where it can be, bumpless, limited, and light to import."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate

ITAE = Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074)
TABLE_3 = Fopid(0.9116, 0.2526, 0.2023, 1.1577, 0.9973)


def run(gains: Fopid, sample_time: float, horizon: float = 30.0, **controller: object):
    plant = Plant(PlantSettings(read_process("P1"), sample_time=sample_time))
    settings_ = ControllerSettings(gains, sample_time=sample_time, **controller)
    return simulate(FopidController(settings_), plant, round(horizon / sample_time), lambda _: 1.0)


def distance_from_exact(sample_time: float) -> float:
    trace = run(ITAE, sample_time)
    exact = step_response(Loop(read_process("P1"), ITAE), 30.0)
    return float(np.abs(np.interp(trace.time, exact.time, exact.output) - trace.measurement).max())


def test_closed_loop_is_near_the_exact_continuous_response() -> None:
    assert distance_from_exact(0.01) < 5e-3


def test_that_distance_shrinks_with_the_sample_time() -> None:
    coarse, fine = distance_from_exact(0.02), distance_from_exact(0.005)
    assert coarse / fine == pytest.approx(4.0, rel=0.2)


def test_integer_orders_are_the_classical_pid() -> None:
    h, pid = 0.05, Fopid(2.0, 0.7, 0.4)
    controller = FopidController(ControllerSettings(pid, sample_time=h))
    area = last = 0.0
    for measured in np.random.default_rng(3).normal(size=200):
        measured = float(measured) if area or last else 0.0  # signals count from the first measurement
        error = 1.0 - measured
        area += 0.5 * h * (last + error)
        expected = pid.kp * error + pid.ki * area + pid.kd * (error - last) / h
        assert controller.step(1.0, measured) == pytest.approx(expected, rel=1e-12)
        last = error


def gruenwald_letnikov(changes: dict[int, Fopid], errors: np.ndarray, h: float) -> np.ndarray:
    """Full-memory controller of first order whose five numbers change at given samples: the brute-force oracle."""

    def weights(order: float) -> np.ndarray:
        w = np.ones(len(errors))
        for j in range(1, len(errors)):
            w[j] = w[j - 1] * (1 - (order + 1) / j)
        return w * h**-order

    control = np.empty(len(errors))
    for k in range(len(errors)):
        if k in changes:
            gains = changes[k]
            integral, derivative = weights(-gains.lam), weights(gains.mu)
        past = errors[k::-1]
        control[k] = gains.kp * errors[k] + gains.ki * integral[: k + 1] @ past + gains.kd * derivative[: k + 1] @ past
    return control


def test_new_gains_without_bumpless_are_those_of_a_full_memory_controller() -> None:
    h, n = 0.01, 1500
    time = h * np.arange(n)
    errors = np.exp(-0.3 * time) * np.cos(time) * (1 - np.exp(-5 * time))  # smooth, so that GL's own error is small
    second = Fopid(1.2, 0.5, 0.6, 0.8, 0.4)
    third = Fopid(0.8, 0.3, 0.2, 1.0, 1.0)
    changes = {0: ITAE, 500: second, 900: third}
    expected = gruenwald_letnikov(changes, errors, h)
    config = ControllerSettings(ITAE, sample_time=h, bumpless=False)
    controller = FopidController(config)
    actual = np.empty(n)
    for k in range(n):
        if k in changes:
            controller.reconfigure(with_gains(config, changes[k]))
        actual[k] = controller.step(float(errors[k]), 0.0)
    # GL of first order is off by about order/2 * h * slope; the bank by 1 % of each part.
    assert np.abs(actual - expected)[10:].max() < 0.03
    assert abs(actual[500] - expected[500]) < 0.02
    assert abs(actual[900] - expected[900]) < 0.02


def test_new_gains_step_the_control_no_further_than_they_ask_for() -> None:
    h = 0.01
    measured = 1 - np.exp(-0.4 * h * np.arange(1200))
    config = ControllerSettings(TABLE_3, sample_time=h)
    changing, always_new = FopidController(config), FopidController(with_gains(config, ITAE))
    changed, reference = [], []
    for k, value in enumerate(measured):
        if k == 700:
            changing.reconfigure(with_gains(config, ITAE))
        changed.append(changing.step(1.0, float(value)))
        reference.append(always_new.step(1.0, float(value)))
    steps, would_be = np.diff(changed)[699:], np.diff(reference)[699:]
    np.testing.assert_allclose(steps, would_be, atol=1e-12)
    assert abs(steps[0]) < 0.05 < abs(reference[699] - changed[699])


gains = st.builds(
    Fopid, kp=st.floats(0, 5), ki=st.floats(0, 2), kd=st.floats(0, 1),
    lam=st.one_of(st.sampled_from([0.0, 1.0, 2.0]), st.floats(0, 2)),
    mu=st.one_of(st.sampled_from([0.0, 1.0, 2.0]), st.floats(0, 2)),
)  # fmt: skip


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(gains, st.integers(1, 30), st.floats(-10, 10)), min_size=1, max_size=8))
def test_any_sequence_of_changes_keeps_the_control_finite_and_within_limits(stretches: list) -> None:
    config = ControllerSettings(stretches[0][0], control_min=-3.0, control_max=4.0)
    controller = FopidController(config)
    for numbers, ticks, setpoint in stretches:
        controller.reconfigure(with_gains(config, numbers))
        for _ in range(ticks):
            control = controller.step(setpoint, 0.0)
            assert -3.0 <= control <= 4.0
            assert math.isfinite(controller.state.control_unlimited)


@pytest.mark.parametrize("antiwindup", ["back_calculation", "conditional_integration"])
def test_anti_windup_lets_go_of_the_limit_earlier(antiwindup: str) -> None:
    def overshoot(method: str) -> float:
        gains_ = Fopid(1.5, 0.6, 0.0, 0.9, 1.0)
        trace = run(gains_, 0.02, horizon=60.0, control_max=1.1, antiwindup=method)
        return float(trace.measurement.max()) - 1.0

    assert overshoot(antiwindup) < 0.5 * overshoot("none")


def test_rate_limit_bounds_every_step_from_the_first() -> None:
    trace = run(ITAE, 0.01, horizon=5.0, control_rate_max=2.0)
    assert np.abs(np.diff(trace.control, prepend=0.0)).max() <= 0.02 + 1e-12


def test_manual_to_automatic_is_bumpless_both_ways() -> None:
    controller = FopidController(ControllerSettings(ITAE))
    for _ in range(50):
        controller.step(1.0, 0.2)
    controller.set_mode("manual")
    for _ in range(50):
        assert controller.step(1.0, 0.2, manual=0.7) == 0.7
    controller.set_mode("auto")
    assert controller.step(1.0, 0.2) == pytest.approx(0.7, abs=0.02)


def test_a_signal_that_is_not_finite_is_refused_and_changes_nothing() -> None:
    controller, twin = (FopidController(ControllerSettings(ITAE)) for _ in range(2))
    for k in range(20):
        for bad in (math.nan, math.inf):
            with pytest.raises(InputError, match="measurement"):
                controller.step(1.0, bad)
        assert controller.step(1.0, 0.01 * k) == twin.step(1.0, 0.01 * k)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"sample_time": 0.0}, "sample_time = 0.0"),
        ({"sample_time": math.nan}, "sample_time = nan"),
        ({"control_min": 1.0, "control_max": 0.0}, "control_min = 1.0"),
        ({"control_rate_max": 0.0}, "control_rate_max = 0.0"),
        ({"setpoint_weight": 1.5}, "setpoint_weight = 1.5"),
        ({"antiwindup": "hope"}, "'hope'"),
        ({"control_min": 1.0}, "safe_control = 0.0"),
    ],
)
def test_bad_settings_are_named(changes: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        replace(ControllerSettings(ITAE), **changes)


def test_the_controllers_path_loads_neither_scipy_nor_control_nor_the_parser() -> None:
    code = "import sys, fopid_core.runtime.controller; print({'scipy', 'control', 'lark'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert told.stdout.strip() == "set()"
