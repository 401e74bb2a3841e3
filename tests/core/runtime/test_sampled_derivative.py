"""The running derivative is s^mu up to a tenth of the Nyquist frequency, for every order, sample time and band."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from fopid_core.runtime.filter_bank import Band, integral_weights
from fopid_core.runtime.operators import Operators
from fopid_core.runtime.sampled_derivative import derivative_weights

ORDERS = [1e-6, 0.1, 0.35, 0.5, 0.7, 0.9, 1.0 - 1e-6, 1.0, 1.0 + 1e-6, 1.2, 1.35, 1.5, 1.7, 1.9, 2.0 - 1e-6, 2.0]
DECIBEL, DEGREE = 0.1, 1.0


def operators(mu: float, h: float, band: Band, filter_time: float = 0.0, lam: float = 1.0) -> Operators:
    made = Operators(band, h, filter_time)
    made.set_weights(integral_weights(band, lam), derivative_weights(band, mu, h, filter_time))
    return made


def running_gain(made: Operators, output: int, theta: np.ndarray) -> np.ndarray:
    """What the recursion makes of exp(j theta k) in the end: x = A x / z + b, read by c and d. shape (n,)."""
    n, matrix, z = made.size, made.matrix, np.exp(1j * theta)[:, np.newaxis, np.newaxis]
    state = np.linalg.solve(z * np.eye(n) - matrix[:n, :n], matrix[np.newaxis, :n, [output]])
    return (matrix[output, :n] @ state)[:, 0] + matrix[output, output]


def is_met(gain: np.ndarray, ideal: np.ndarray) -> None:
    ratio = gain / ideal
    assert np.abs(20.0 * np.log10(np.abs(ratio))).max() < DECIBEL
    assert np.abs(np.degrees(np.angle(ratio))).max() < DEGREE


@pytest.mark.parametrize("mu", ORDERS)
@pytest.mark.parametrize(
    ("h", "horizon"), [(0.01, 0.0), (1e-6, 0.0), (1e3, 0.0), (0.01, 0.1), (0.01, 0.3), (0.01, 1.0), (0.05, 60.0)]
)
def test_every_order_is_within_a_tenth_of_a_decibel_and_a_degree_up_to_a_tenth_of_nyquist(
    mu: float, h: float, horizon: float
) -> None:
    band = Band.for_sample_time(h, horizon)
    theta = np.geomspace(band.low * h, 0.1 * math.pi, 50)
    is_met(running_gain(operators(mu, h, band), -1, theta), (1j * theta / h) ** mu)


@pytest.mark.parametrize("lam", ORDERS)
def test_the_integral_holds_the_same_figure(lam: float) -> None:
    h, band = 0.01, Band.for_sample_time(0.01)
    theta = np.geomspace(band.low * h, 0.1 * math.pi, 50)
    is_met(running_gain(operators(1.0, h, band, lam=lam), -2, theta), (1j * theta / h) ** -lam)


@pytest.mark.parametrize("mu", [0.3, 1.0, 1.6, 2.0])
@pytest.mark.parametrize("ticks", [0.1, 1.0, 10.0, 1e4])
def test_with_a_filter_it_is_the_ideal_operator_times_the_ideal_filter(mu: float, ticks: float) -> None:
    h, band = 0.02, Band.for_sample_time(0.02)
    theta = np.geomspace(1e-4, 0.1 * math.pi, 50)  # far below, a second derivative is lost in 16 digits
    s = 1j * theta / h
    is_met(running_gain(operators(mu, h, band, ticks * h), -1, theta), s**mu / (1.0 + ticks * h * s))


@pytest.mark.parametrize("time", [5e-324, 1e-300, 1e-14, 2e-14])
def test_a_filter_far_shorter_than_a_sample_is_none(time: float) -> None:
    none, short = (derivative_weights(Band(1e-3, 1e3, 14), 0.7, 0.01, each) for each in (0.0, time))
    assert short.washouts == pytest.approx(none.washouts, rel=1e-6, abs=1e-9)
    assert short.differences == pytest.approx(none.differences, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    "band", [Band(1.0, 10.0, 4), Band(1e-2, 1e5, 16), Band(1e-7, 300.0, 22), Band(1e-3, 300.0, 30)]
)
def test_a_band_of_ones_own_is_met_as_far_as_it_reaches(band: Band) -> None:
    h = 0.01
    theta = np.geomspace(max(band.low * h, 1e-4), min(0.1 * math.pi, band.high * h), 50)
    for mu in (0.4, 1.0, 1.3, 1.8, 2.0):
        is_met(running_gain(operators(mu, h, band), -1, theta), (1j * theta / h) ** mu)


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0, 1.25, 1.5, 1.75, 2.0])
def test_in_time_it_is_the_derivative_of_a_pulse(mu: float) -> None:
    # D^mu of t^3 e^-t by its series, in 30 digits: sum of (-1)^k / k! Gamma(k + 4) / Gamma(k + 4 - mu) t^(k + 3 - mu).
    h = 0.05
    made = operators(mu, h, Band.for_sample_time(h))
    with mpmath.workdps(30):
        off, size = 0.0, 0.0
        for tick in range(1, 161):
            t = mpmath.mpf(tick) * h
            found = made.push(0.0, float(t**3 * mpmath.exp(-t)))[1]
            if tick % 20:
                continue
            exact = mpmath.nsum(
                lambda k, t=t: (-1) ** int(k) * mpmath.rf(k + 1, 3) * mpmath.rgamma(k + 4 - mu) * t ** (k + 3 - mu),
                [0, 80],
                method="direct",
            )
            off, size = max(off, abs(found - float(exact))), max(size, abs(float(exact)))
    assert off < 0.012 * size  # 0.1 dB


@pytest.mark.parametrize(("mu", "of_ramp"), [(1.0, 1.0), (2.0, 0.0)])
def test_constants_and_ramps_are_differentiated_as_in_the_books(mu: float, of_ramp: float) -> None:
    h = 0.1
    made = operators(mu, h, Band.for_sample_time(h))
    signal = [5.0] * 300 + [5.0 + k * h for k in range(300)]
    outputs = [made.push(0.0, value)[1] for value in signal]
    assert outputs[299] == pytest.approx(0.0, abs=1e-9)
    assert outputs[-1] == pytest.approx(of_ramp, abs=1e-9)


def white_noise(gain: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.abs(gain) ** 2)))


@pytest.mark.parametrize(("mu", "price"), [(0.5, 1.25), (1.0, 1.36), (1.5, 2.2), (2.0, 2.95)])
def test_what_it_costs_in_noise(mu: float, price: float) -> None:
    # Against (1 - 1/z)^mu / h^mu, the plain difference, whose lag at a tenth of Nyquist is 9 mu deg.
    h, theta = 0.01, np.linspace(0.0, math.pi, 2001)[1:]
    plain = white_noise((-np.expm1(-1j * theta) / h) ** mu)
    ours = white_noise(running_gain(operators(mu, h, Band.for_sample_time(h)), -1, theta))
    assert 1.0 < ours / plain < price


@pytest.mark.parametrize("mu", [0.0, 0.4, 1.0, 1.3, 2.0])
def test_an_order_that_moves_a_little_moves_the_reading_a_little(mu: float) -> None:
    h, step, theta = 0.01, 1e-7, np.geomspace(1e-4, math.pi, 100)
    band = Band.for_sample_time(h)
    gains = [running_gain(operators(order, h, band), -1, theta) for order in (max(mu - step, 0.0), min(mu + step, 2.0))]
    assert np.abs(gains[1] / gains[0] - 1.0).max() < 1e-4
