"""The sampled operators: exact for signals that are linear between samples, constant in time and memory."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from fopid_core.runtime.filter_bank import Band, integral_weights
from fopid_core.runtime.operators import Operators
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
    for _ in range(100_000):
        made.push(0.0, 0.0)
        if made._ticks == 0:
            kept = np.abs(made._now[made._now != 0.0])
            assert kept.min() >= 1e-150
