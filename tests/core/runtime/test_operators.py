"""The sampled operators: exact for signals that are linear between samples, constant in time and memory."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from fopid_core.runtime.filter_bank import Band, integral_weights
from fopid_core.runtime.operators import TICKS_BETWEEN_SWEEPS, Operators
from fopid_core.runtime.sampled_derivative import derivative_weights

H = 0.01
BAND = Band.for_sample_time(H)


def operators(lam: float, mu: float, filter_time: float = 0.0) -> Operators:
    made = Operators(BAND, H, filter_time)
    made.set_weights(integral_weights(BAND, lam), derivative_weights(BAND, mu, H, filter_time))
    return made


def transfer(made: Operators, output: int, theta: float) -> complex:
    """From the ``output``-th signal to the ``output``-th reading at z = exp(j theta)."""
    n = made.size
    a, b = made.matrix[:n, :n], made.matrix[:n, output]
    z = np.exp(1j * theta)
    return complex(made.matrix[output, :n] @ np.linalg.solve(z * np.eye(n) - a, b) + made.matrix[output, output])


def ideal_of_interpolated(order: float, theta: float) -> complex:
    """What s^-order makes of the linearly interpolated samples exp(j theta k), at the samples.

    The interpolated signal has the lines (theta + 2 pi m) / h with heights 4 sin^2(theta/2) / (theta + 2 pi m)^2.
    """
    share = theta / (2 * math.pi)
    above = mpmath.zeta(2 + order, share) * mpmath.mpc(0, 1) ** -order
    below = mpmath.zeta(2 + order, 1 - share) * mpmath.mpc(0, -1) ** -order
    size = 4 * math.sin(theta / 2) ** 2 * H**order * (2 * math.pi) ** (-2 - order)
    return complex(size * (above + below))


@pytest.mark.parametrize("order", [0.1, 0.5, 0.9, 1.0, 1.3, 1.8])
def test_the_sampled_integral_is_the_ideal_one_of_the_interpolated_signal(order: float) -> None:
    made = operators(order, 1.0)
    for theta in np.geomspace(3e-5, 3.0, 25):
        ratio = transfer(made, -2, theta) / ideal_of_interpolated(order, theta)
        assert abs(20 * math.log10(abs(ratio))) < 0.1
        assert abs(math.degrees(np.angle(ratio))) < 0.5


@pytest.mark.parametrize("order", [0.2, 0.5, 0.9, 1.0, 1.4, 1.9])
def test_ramp_is_integrated_and_differentiated_as_in_the_books(order: float) -> None:
    # D^-a t = t^(1+a) / Gamma(2+a), D^a t = t^(1-a) / Gamma(2-a); the ramp is linear between samples, so that what is
    # left is the fit's 0.02 dB = 0.25 %.
    made = operators(order, order)
    time = H * np.arange(1, 2001)
    outputs = np.array([made.push(t, t) for t in time])
    late = time > 1.0
    assert np.abs(outputs[late, 0] * math.gamma(2 + order) / time[late] ** (1 + order) - 1).max() < 2.5e-3
    if order < 1.0:
        assert np.abs(outputs[late, 1] * math.gamma(2 - order) / time[late] ** (1 - order) - 1).max() < 2.5e-3


def test_order_one_is_the_trapezoidal_integral() -> None:
    made = operators(1.0, 1.0)
    area = last = 0.0
    for value in np.random.default_rng(1).normal(size=300):
        area += 0.5 * H * (last + value)
        assert made.push(value, value)[0] == pytest.approx(area, abs=1e-10)
        last = value


def test_the_filter_is_a_first_order_lag() -> None:
    # Of a ramp: t - T (1 - exp(-t/T)).
    time_constant = 0.07
    made = operators(1.0, 0.0, time_constant)
    for k in range(1, 100):
        t = k * H
        _, filtered = made.push(0.0, t)
        assert filtered == pytest.approx(t + time_constant * math.expm1(-t / time_constant), rel=1e-10)


def test_reading_by_other_orders_and_back_changes_nothing() -> None:
    made, twin = operators(0.7, 0.6), operators(0.7, 0.6)
    for k in range(200):
        value = math.sin(0.1 * k)
        made.set_weights(integral_weights(BAND, 1.4), derivative_weights(BAND, 2.0, H))
        made.set_weights(integral_weights(BAND, 0.7), derivative_weights(BAND, 0.6, H))
        assert made.push(value, value) == twin.push(value, value)


def test_what_decays_comes_to_zero_and_never_to_numbers_that_are_slow() -> None:
    made = operators(0.6, 0.6)
    made.push(1.0, 1.0)
    made.push(0.0, 0.0)
    smallest, ticks = [], 100_000
    for _ in range(ticks):
        made.push(0.0, 0.0)
        if made._ticks == 0:  # swept just now
            smallest.append(np.abs(made._now[made._now != 0.0]).min())
    assert min(smallest) >= 1e-150
    assert len(smallest) == (ticks + 2) // TICKS_BETWEEN_SWEEPS


def pushed(made: Operators, seed: int = 3, count: int = 50) -> Operators:
    """The same, after some samples of both signals."""
    for integrated, differentiated in np.random.default_rng(seed).normal(size=(count, 2)):
        made.push(integrated, differentiated)
    return made


def test_reset_is_as_new_and_nothing_is_corrected_before_it_is_said_how() -> None:
    made = pushed(operators(0.7, 0.6))
    assert made.read() != [0.0, 0.0]
    before = made.read()
    made.correct(5.0)
    assert made.read() == before
    made.reset()
    assert made.read() == [0.0, 0.0]
    assert made.push(2.0, 3.0) == operators(0.7, 0.6).push(2.0, 3.0)


def test_a_unit_of_error_adds_what_a_sample_of_one_in_both_signals_adds() -> None:
    made = pushed(operators(0.7, 0.6))
    remembered = made.matrix[: made.size, : made.size] @ made._now[: made.size]
    made.push(1.5, 1.5)
    assert made._now[: made.size] == pytest.approx(remembered + 1.5 * made.of_error, rel=1e-12, abs=1e-12)


def test_a_correction_before_a_tick_is_the_same_as_one_with_it() -> None:
    before, within = pushed(operators(0.7, 0.6)), pushed(operators(0.7, 0.6))
    correction = np.random.default_rng(4).normal(size=before.size)
    for made in (before, within):
        made.set_correction(correction)
    read = before.read()
    before.correct(0.3)
    assert np.subtract(before.read(), read) == pytest.approx(0.3 * before.weights @ correction, rel=1e-9)
    assert before.push(1.0, -1.0) == pytest.approx(within.push(1.0, -1.0, 0.3), rel=1e-9)
    assert before.push(0.0, 2.0) == pytest.approx(within.push(0.0, 2.0), rel=1e-9)  # of one tick only


def test_a_copy_goes_on_as_the_other_once_the_signal_is_lowered_by_what_the_filter_was_behind() -> None:
    filtered, plain = pushed(operators(0.7, 0.6, 0.03)), operators(0.7, 0.6)
    unfiltered, behind = filtered._now[filtered.size - 1], plain.copy_state(filtered)
    assert plain._now[plain.size - 1] == pytest.approx(unfiltered - behind)
    assert plain.push(0.5, unfiltered - behind)[0] == pytest.approx(filtered.push(0.5, 0.0)[0])
    settled = operators(0.7, 0.6, 0.03)
    for _ in range(200):
        settled.push(0.0, 2.0)
    assert operators(0.7, 0.6).copy_state(settled) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("lam", [0.5, 1.0, 1.5])
def test_one_tick_after_a_step_the_integral_is_that_of_the_step_held(lam: float) -> None:
    made = operators(lam, 1.0)
    stepped = operators(lam, 1.0)
    stepped._now[stepped.integrated - 1] = 1.0  # the signal has just become 1
    assert made.integral_after_one_tick() == pytest.approx(stepped.push(1.0, 0.0)[0], rel=1e-12)
    if lam == 1.0:
        assert made.integral_after_one_tick() == pytest.approx(H)


def test_operators_that_live_in_the_rows_of_a_bank_go_on_unchanged() -> None:
    kept, twin = pushed(operators(0.7, 0.6)), pushed(operators(0.7, 0.6))
    size = kept.size + 3
    matrices, memory = np.zeros((2, size, size)), np.zeros((2, size))
    kept.keep_in(matrices[1], memory[1])
    assert kept.read() == twin.read()
    assert np.array_equal(memory[1, : kept.size], twin._now[: kept.size])
    kept.set_weights(integral_weights(BAND, 1.2), derivative_weights(BAND, 0.4, H))
    twin.set_weights(integral_weights(BAND, 1.2), derivative_weights(BAND, 0.4, H))
    assert matrices[1] == pytest.approx(twin.matrix, rel=1e-12)
    for value in (1.0, 2.0, 0.5):
        assert kept.push(value, -value) == pytest.approx(twin.push(value, -value), rel=1e-9)
