"""Samples at uneven intervals: what the controller makes of them, against the integrals and derivatives themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import gamma, hyp1f1

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.c_export import c_header
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.controller_bank import ControllerBank

H = 0.01
ORDERS = [(1.0, 1.0), (0.8, 0.6), (0.5, 0.9), (1.3, 1.4)]
TOLD = [
    (1.0, 1.0, 0.022, 0.068), (0.8, 0.6, 0.020, 0.091), (0.5, 0.9, 0.018, 0.11), (1.3, 1.4, 0.12, 1.5),
    (0.8, 1.8, 0.69, 5.6),
]  # fmt: skip
"""lam, mu, and what docs/variable_step.md tells of even and of uneven samples: the largest error in % of the largest
control, to two digits."""


def uneven(count: int, seed: int, jitter: float = 0.3, loss: float = 0.1) -> np.ndarray:
    """Instants on a grid of the sample time, each up to ``jitter`` of it early or late, some of them lost."""
    random = np.random.default_rng(seed)
    instants = (np.arange(count) + random.uniform(-jitter, jitter, count)) * H
    kept = instants[random.uniform(size=count) >= loss]
    return np.asarray(kept - kept[0])


def signal(t: float) -> float:
    return t * t * math.exp(-2.0 * t)


def exact(t: np.ndarray, lam: float, mu: float) -> np.ndarray:
    """signal + s^-lam signal + s^mu signal at instants, by Kummer's function.

    The integral of order a of t^2 e^-2t is 2 / gamma(3 + a) t^(2+a) 1F1(3; 3 + a; -2t) (Podlubny 1999, 2.2.4).
    """

    def integral(order: float) -> np.ndarray:
        return np.asarray(2.0 / gamma(3.0 + order) * t ** (2.0 + order) * hyp1f1(3.0, 3.0 + order, -2.0 * t))

    return np.asarray(t * t * np.exp(-2.0 * t) + integral(lam) + integral(-mu))


def answers(instants: np.ndarray, lam: float, mu: float, *, variable: bool) -> np.ndarray:
    controller = FopidController(ControllerSettings(Fopid(1.0, 1.0, 1.0, lam, mu), H, variable_step=variable))
    found, last = [], -H
    for t in instants.tolist():
        if variable:
            controller.set_interval(t - last)
        found.append(controller.step(signal(t), 0.0))
        last = t
    return np.array(found)


@pytest.mark.parametrize(("lam", "mu", "of_even", "of_uneven"), TOLD)
def test_with_jitter_and_loss_it_stays_as_near_to_the_exact_operators_as_is_told_at_every_sample(
    lam: float, mu: float, of_even: float, of_uneven: float
) -> None:
    """Orders of the derivative above 1 see the jitter in their differences."""

    def error(instants: np.ndarray, variable: bool) -> float:
        off = answers(instants, lam, mu, variable=variable) - exact(instants, lam, mu)
        return float(np.abs(off[20:]).max())

    even = H * np.arange(400)
    size = float(np.abs(exact(even, lam, mu)[20:]).max())
    assert 100.0 * error(even, variable=True) == pytest.approx(of_even * size, rel=0.05)
    jittered = [uneven(400, seed) for seed in range(8)]
    worst = max(error(each, variable=True) for each in jittered)
    assert 100.0 * worst == pytest.approx(of_uneven * size, rel=0.05)
    assert error(jittered[3], variable=False) > 5.0 * error(jittered[3], variable=True)


def test_of_order_one_the_integral_is_the_trapezoidal_one_over_the_true_instants() -> None:
    instants = uneven(300, seed=1)
    values = np.random.default_rng(2).normal(size=instants.size)
    controller = FopidController(ControllerSettings(Fopid(0.0, 1.0), H, variable_step=True))
    area, last_time, last = 0.0, -H, 0.0
    for t, value in zip(instants.tolist(), values.tolist(), strict=True):
        controller.set_interval(t - last_time)
        area += 0.5 * (t - last_time) * (last + value)
        assert controller.step(value, 0.0) == pytest.approx(area, abs=1e-9)
        last_time, last = t, value


def step_answer(instants: np.ndarray, *, variable: bool) -> np.ndarray:
    """Times and outputs of 1/(s+1) in a loop that gets these samples, shape (n, 2).

    With fixed steps the controller ticks evenly and takes the newest sample, as a timer does.
    """
    gains = Fopid(2.0, 3.0, 0.05, 0.9, 0.8)
    settings = ControllerSettings(gains, H, derivative_setpoint_weight=0.0, variable_step=variable)
    controller = FopidController(settings)
    end = float(instants[-1])
    ticks = instants if variable else np.arange(0.0, end, H)
    events, sampled, ticked = np.unique(np.concatenate([instants, ticks])), set(instants.tolist()), set(ticks.tolist())
    y = u = held = 0.0
    trace, last, last_tick = [], 0.0, -H
    for t in events.tolist():
        decay = math.exp(-(t - last))
        y, last = decay * y + (1.0 - decay) * u, t
        if t in sampled:
            held = y
        if t in ticked:
            if variable:
                controller.set_interval(t - last_tick)
            u, last_tick = controller.step(1.0, held), t
        trace.append((t, y))
    return np.array(trace)


def test_a_loop_with_jitter_and_loss_answers_as_the_even_one_nearer_than_with_fixed_steps() -> None:
    wanted = step_answer(H * np.arange(1001), variable=False)
    instants = uneven(1001, seed=5)
    instants = instants[instants < 10.0]

    def off(trace: np.ndarray) -> float:
        return float(np.abs(np.interp(trace[:, 0], *wanted.T) - trace[:, 1]).max())

    variable = off(step_answer(instants, variable=True))
    fixed = off(step_answer(instants, variable=False))
    assert variable < 2e-3  # what a control that is held for one to four ticks comes to
    assert fixed > 3.0 * variable


def test_limits_of_rates_are_per_second_whatever_the_interval() -> None:
    settings = ControllerSettings(Fopid(10.0), H, control_rate_max=2.0, variable_step=True)
    controller = FopidController(settings)
    controller.set_interval(0.03)
    assert controller.step(1.0, 0.0) == pytest.approx(0.06)
    assert controller.wait(0.0) == pytest.approx(0.06)
    controller.set_mode("manual")
    assert controller.wait(-1.0) == pytest.approx(0.04)


@pytest.mark.parametrize(("lam", "mu"), ORDERS)
def test_after_a_long_limit_the_control_leaves_it_as_with_even_samples(lam: float, mu: float) -> None:
    def left(instants: np.ndarray, variable: bool) -> float:
        gains = Fopid(1.0, 2.0, 0.02, lam, mu)
        controller = FopidController(ControllerSettings(gains, H, control_max=1.0, variable_step=variable))
        last = -H
        for t in instants.tolist():
            if variable:
                controller.set_interval(t - last)
            if controller.step(1.0 if t < 3.0 else -0.5, 0.0) < 0.0:
                return t
            last = t
        raise AssertionError("the control stays at its limit")

    assert left(uneven(800, seed=7), True) == pytest.approx(left(H * np.arange(800), False), abs=5 * H)


@pytest.mark.parametrize("interval", [0.0, 0.24 * H, 1001.0 * H, math.nan, math.inf, -H])
def test_an_interval_that_no_sample_can_have_is_refused_and_changes_nothing(interval: float) -> None:
    gains = Fopid(1.0, 1.0, 0.1, 0.9, 0.9)
    controller, twin = (FopidController(ControllerSettings(gains, H, variable_step=True)) for _ in range(2))
    with pytest.raises(InputError, match=r"interval = .*; allowed: 0\.0025 to 10"):
        controller.set_interval(interval)
    assert [controller.step(1.0, 0.0) for _ in range(5)] == [twin.step(1.0, 0.0) for _ in range(5)]


def test_fixed_steps_banks_and_c_take_no_interval() -> None:
    settings = ControllerSettings(Fopid(1.0, 1.0), H, variable_step=True)
    with pytest.raises(InputError, match="without variable_step"):
        FopidController(ControllerSettings(Fopid(1.0), H)).set_interval(H)
    with pytest.raises(InputError, match="variable_step = True in a bank"):
        ControllerBank([settings])
    with pytest.raises(InputError, match="variable_step = True; allowed in C: False"):
        c_header(settings)


def test_new_gains_between_uneven_samples_make_no_step() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0, 1.0, 0.1, 0.9, 0.9), H, variable_step=True))
    last = -H
    for t in uneven(200, seed=9).tolist():
        controller.set_interval(t - last)
        before = controller.step(1.0, 0.5)
        last = t
    controller.reconfigure(ControllerSettings(Fopid(3.0, 1.0, 0.3, 1.1, 0.5), H, variable_step=True))
    controller.set_interval(1.3 * H)
    assert controller.step(1.0, 0.5) == pytest.approx(before, abs=0.03)
