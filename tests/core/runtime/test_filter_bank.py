"""The bank of lags is s^-lam and s^mu on its band, and exact for signals that are linear between samples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.runtime.filter_bank import Band, FilterBank, Reading, derivative_reading, integral_reading

ORDERS = [0.0, 0.05, 0.3, 0.5, 0.77, 0.95, 0.999, 1.0, 1.001, 1.05, 1.3, 1.5, 1.72, 1.95, 2.0]
DECIBEL, DEGREE = 0.1, 0.5


def response(reading: Reading, band: Band, s: np.ndarray) -> np.ndarray:
    lags = sum(weight / (s + pole) for weight, pole in zip(reading.lags, band.lag_poles(), strict=True))
    return reading.integrator / s + lags + reading.direct + reading.slope * s + reading.curvature * s**2


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("sample_time", [0.001, 0.01, 1.0])
def test_default_band_is_met_edge_to_edge(order: float, sample_time: float) -> None:
    band = Band.for_sample_time(sample_time)
    s = 1j * np.geomspace(band.low, band.high, 701)
    for reading, ideal in ((integral_reading(band, order), s**-order), (derivative_reading(band, order), s**order)):
        ratio = response(reading, band, s) / ideal
        assert np.abs(20 * np.log10(np.abs(ratio))).max() < DECIBEL
        assert np.abs(np.degrees(np.angle(ratio))).max() < DEGREE


@pytest.mark.parametrize("order", [order for order in ORDERS if order > 0])
def test_integral_of_any_order_has_a_true_integrator(order: float) -> None:
    assert integral_reading(Band.for_sample_time(0.01), order).integrator > 0.0


@pytest.mark.parametrize("order", [0.2, 0.5, 0.9, 1.0, 1.4, 1.9])
def test_ramp_is_integrated_and_differentiated_as_in_the_books(order: float) -> None:
    # D^-a t = t^(1+a) / Gamma(2+a), D^a t = t^(1-a) / Gamma(2-a); the ramp is linear between samples, so that what is
    # left is the fit's 0.1 dB = 1.2 % on its band.
    h, n = 0.01, 2000
    band = Band.for_sample_time(h)
    bank = FilterBank(band, h)
    time = h * np.arange(1, n + 1)
    outputs = np.empty((n, 2))
    integral, derivative = bank.bound(integral_reading(band, order)), bank.bound(derivative_reading(band, order))
    for k, t in enumerate(time):
        bank.push(t)
        outputs[k] = bank.read(integral), bank.read(derivative)
    late = time > 1.0
    exact = time ** (1 + order) / math.gamma(2 + order)
    assert np.abs(outputs[late, 0] / exact[late] - 1).max() < 0.012
    if order < 1.0:
        exact = time ** (1 - order) / math.gamma(2 - order)
        assert np.abs(outputs[late, 1] / exact[late] - 1).max() < 0.012


def test_integer_orders_are_plain_integral_and_difference() -> None:
    h = 0.02
    band = Band.for_sample_time(h)
    bank = FilterBank(band, h)
    signal = np.random.default_rng(1).normal(size=300)
    area = last = 0.0
    for value in signal:
        bank.push(value)
        area += 0.5 * h * (last + value)
        assert bank.read(bank.bound(integral_reading(band, 1.0))) == pytest.approx(area, abs=1e-12)
        assert bank.read(bank.bound(derivative_reading(band, 1.0))) == pytest.approx((value - last) / h, rel=1e-12)
        assert bank.read(bank.bound(integral_reading(band, 0.0))) == value
        last = value


@pytest.mark.parametrize(
    ("arguments", "named"),
    [((1.0, 0.5, 10), "low"), ((0.0, 1.0, 10), "low"), ((1.0, math.inf, 10), "high"), ((1.0, 2.0, 1), "poles")],
)
def test_bad_bands_are_named(arguments: tuple, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Band(*arguments)
