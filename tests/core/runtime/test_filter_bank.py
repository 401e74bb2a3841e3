"""The readings of the bank are s^-lam on its band, for every order and every width of the band."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.runtime.filter_bank import (
    Band,
    IntegralWeights,
    integral_weights,
)

NEAR = [1e-9, 1e-6, 1e-4]
ORDERS = np.unique(
    [*np.linspace(0, 2, 101), *NEAR, *(1 - x for x in NEAR), *(1 + x for x in NEAR), *(2 - x for x in NEAR)]
)
DECIBEL, DEGREE = 0.045, 0.175  # edge to edge, as the module says


def of_integral(reading: IntegralWeights, band: Band, s: np.ndarray) -> np.ndarray:
    lags = (reading.lags / (s[:, np.newaxis] + band.lag_poles())).sum(axis=1)
    return reading.integrator / s + lags + reading.direct


@pytest.mark.parametrize(
    ("sample_time", "horizon"),
    [(0.01, 0.0), (1e-6, 0.0), (1e3, 0.0), (0.01, 0.1), (0.01, 1.0), (0.01, 50.0), (0.01, 1e4), (1e-3, 1e6)],
)
def test_every_order_is_met_over_the_whole_band_whatever_its_width(sample_time: float, horizon: float) -> None:
    every_order_is_met(Band.for_sample_time(sample_time, horizon))


@pytest.mark.parametrize("edges", [(1e-7, 0.0), (1.0, 10.0)])
def test_a_band_of_given_edges_has_poles_for_its_own_width(edges: tuple[float, float]) -> None:
    low, high = edges
    band = Band.for_sample_time(0.01, low=low, high=high)
    every_order_is_met(band)
    assert (low or band.low, high or band.high) == (band.low, band.high)
    assert Band.for_sample_time(0.01, low=low, high=high, poles=30) == Band(band.low, band.high, 30)


def every_order_is_met(band: Band) -> None:
    s = 1j * np.geomspace(band.low, band.high, 601)
    for order in ORDERS:
        integral = of_integral(integral_weights(band, order), band, s) / s**-order
        assert np.abs(20 * np.log10(np.abs(integral))).max() < DECIBEL, order
        assert np.abs(np.degrees(np.angle(integral))).max() < DEGREE, order


@pytest.mark.parametrize("horizon", [0.0, 1.0, 1e6])
def test_integral_of_any_order_has_a_true_integrator(horizon: float) -> None:
    band = Band.for_sample_time(0.01, horizon)
    assert all(integral_weights(band, order).integrator > 0.0 for order in ORDERS[1:])


@pytest.mark.parametrize("horizon", [5.0, 300.0])
@pytest.mark.parametrize("order", [0.2, 0.5, 0.9, 1.4, 1.9])
def test_the_integral_of_a_step_is_right_up_to_the_horizon(order: float, horizon: float) -> None:
    # D^-a 1 = t^a / Gamma(1+a); the bank's 0.02 dB are 0.25 %.
    band = Band.for_sample_time(0.01, horizon)
    reading, p = integral_weights(band, order), band.lag_poles()
    t = np.geomspace(0.1, horizon, 50)
    lags = (reading.lags / p * -np.expm1(-t[:, np.newaxis] * p)).sum(axis=1)
    ours = reading.integrator * t + lags + reading.direct
    assert np.abs(ours * math.gamma(1 + order) / t**order - 1.0).max() < 2.5e-3


def test_the_band_reaches_from_the_nyquist_frequency_to_the_horizon_with_poles_for_its_width() -> None:
    short, long = Band.for_sample_time(0.01, 10.0), Band.for_sample_time(0.01, 1000.0)
    assert (short.low, long.low) == (pytest.approx(0.1), pytest.approx(0.001))
    assert short.high == long.high == pytest.approx(math.pi / 0.01)
    assert long.poles - short.poles == 4
    assert Band.for_sample_time(0.01).low == pytest.approx(math.pi / 0.01 * 1e-6)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((1.0, 0.5, 10), "low"),
        ((0.0, 1.0, 10), "low"),
        ((1.0, math.inf, 10), "high"),
        ((1.0, 1.0, 10), "low"),
        ((1.0, 2.0, 1), "poles"),
        ((1.0, 2.0, 61), "poles"),
        ((1e-6, 1e5, 24), "high up to 1e\\+10 times low"),
    ],
)
def test_bad_bands_are_named(arguments: tuple, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Band(*arguments)


@pytest.mark.parametrize("horizon", [-1.0, 0.05, 1e9, math.nan, math.inf])
def test_a_horizon_that_no_bank_reaches_is_named(horizon: float) -> None:
    with pytest.raises(InputError, match="horizon = "):
        Band.for_sample_time(0.01, horizon)


def test_the_bounds_themselves_are_allowed_and_left_out_numbers_are_those_documented() -> None:
    assert [Band(1.0, 1e10, poles).poles for poles in (2, 60)] == [2, 60]
    assert Band(1.0, 10.0).poles == Band.for_sample_time(0.01).poles == 14
    assert Band.for_sample_time(1.0, 1e9).low == pytest.approx(1e-9)


@pytest.mark.parametrize("sample_time", [0.0, -1.0, math.inf, math.nan])
def test_a_sample_time_that_is_none_is_named(sample_time: float) -> None:
    with pytest.raises(InputError, match="sample_time = "):
        Band.for_sample_time(sample_time)


def test_the_integral_of_order_one_is_an_integrator_and_nothing_else() -> None:
    reading = integral_weights(Band(1e-3, 1e3), 1.0)
    assert (reading.integrator, reading.direct, np.any(reading.lags)) == (1.0, 0.0, False)
