"""Indices are the integrals of eqs. (24) to (30); step measures are read off as people read a plot."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.indices import (
    INDEX_NAMES,
    Indices,
    first_crossing,
    indices,
    overshoot_pct,
    peak,
    rise_time,
    rise_time_to_100,
    settling_time,
    total_variation,
)

time = np.linspace(0.0, 60.0, 600_001)
DAMPING, FREQUENCY = 0.3, 2.0


def second_order() -> np.ndarray:
    damped = FREQUENCY * math.sqrt(1.0 - DAMPING**2)
    decay = np.exp(-DAMPING * FREQUENCY * time)
    return 1.0 - decay * (np.cos(damped * time) + DAMPING * FREQUENCY / damped * np.sin(damped * time))


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.floats(0.5, 2.0), st.floats(-3.0, 3.0))
def test_the_indices_of_an_exponential_are_known(rate: float, size: float) -> None:
    found = indices(time, size * np.exp(-rate * time))
    # integral of t^n exp(-a t) = n! / a^(n+1)
    assert found.iae == pytest.approx(abs(size) / rate, rel=1e-6)
    assert found.itae == pytest.approx(abs(size) / rate**2, rel=1e-6)
    assert found.ise == pytest.approx(size**2 / (2 * rate), rel=1e-6)
    assert found.itse == pytest.approx(size**2 / (2 * rate) ** 2, rel=1e-6)
    assert found.istse == pytest.approx(2 * size**2 / (2 * rate) ** 3, rel=1e-6)
    assert found.istes == pytest.approx(24 * size**2 / (2 * rate) ** 5, rel=1e-6)


def test_uneven_instants_are_weighted_by_their_spacing() -> None:
    uneven = np.concatenate((np.linspace(0.0, 1.0, 5001), np.linspace(1.0, 60.0, 20001)[1:]))
    assert indices(uneven, np.exp(-uneven)).iae == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("power", [0.1, 0.34, 0.6])
def test_an_error_that_begins_at_infinity_has_an_integral_up_to_some_power(power: float) -> None:
    """t^-p exp(-t), against the gamma function."""
    time = np.concatenate([[0.0], np.geomspace(1e-8, 40.0, 40001)])
    with np.errstate(divide="ignore"):
        found = indices(time, -(time**-power) * np.exp(-time))
    assert found.iae == pytest.approx(math.gamma(1.0 - power), rel=1e-5)
    assert found.itae == pytest.approx(math.gamma(2.0 - power), rel=1e-5)
    assert found.itse == pytest.approx(math.gamma(2.0 - 2.0 * power) / 2.0 ** (2.0 - 2.0 * power), rel=1e-5)
    assert found.istes == pytest.approx(math.gamma(5.0 - 2.0 * power) / 2.0 ** (5.0 - 2.0 * power), rel=1e-5)
    square = math.gamma(1.0 - 2.0 * power) / 2.0 ** (1.0 - 2.0 * power) if power < 0.5 else math.inf
    assert found.ise == pytest.approx(square, rel=1e-4)


def test_the_sum_takes_weights_and_only_known_ones() -> None:
    found = Indices(1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    assert found.weighted_sum() == 63.0
    for name in INDEX_NAMES:
        assert found.weighted_sum({name: 1.0}) == getattr(found, name)
    with pytest.raises(InputError, match="weight of 'ice'"):
        found.weighted_sum({"ice": 1.0})


def test_the_overshoot_of_a_second_order_lag_is_known() -> None:
    exact = 100.0 * math.exp(-math.pi * DAMPING / math.sqrt(1.0 - DAMPING**2))
    assert overshoot_pct(second_order()) == pytest.approx(exact, rel=1e-6)
    assert overshoot_pct(1.0 - np.exp(-time)) == 0.0
    assert overshoot_pct(-second_order(), setpoint=-1.0) == pytest.approx(exact, rel=1e-6)


def test_the_rise_times_of_lags_are_known() -> None:
    assert rise_time(time, 1.0 - np.exp(-time)) == pytest.approx(math.log(9.0), abs=1e-6)
    damped = FREQUENCY * math.sqrt(1.0 - DAMPING**2)
    assert rise_time_to_100(time, second_order()) == pytest.approx((math.pi - math.acos(DAMPING)) / damped, abs=1e-6)
    assert math.isnan(rise_time_to_100(time, 0.8 * (1.0 - np.exp(-time))))
    assert math.isnan(rise_time(time, 0.8 * (1.0 - np.exp(-time))))


def test_the_settling_time_is_when_the_output_enters_the_band_for_good() -> None:
    assert settling_time(time, 1.0 - np.exp(-time)) == pytest.approx(math.log(50.0), abs=1e-6)
    output = second_order()
    settled = settling_time(time, output)
    assert np.all(np.abs(output[time > settled] - 1.0) <= 0.02)
    assert np.any(np.abs(output[(time > settled - 0.01) & (time < settled)] - 1.0) > 0.02)
    assert math.isnan(settling_time(time, 0.9 * (1.0 - np.exp(-time))))
    assert settling_time([0.0, 1.0], [1.0, 1.0]) == 0.0


def test_a_crossing_lies_between_samples() -> None:
    assert first_crossing([0.0, 1.0, 2.0], [0.0, 0.5, 1.5], 1.0) == 1.5
    assert first_crossing([0.0, 1.0], [2.0, 3.0], 1.0) == 0.0


def test_total_variation_adds_rises_and_falls() -> None:
    assert total_variation([0.0, 2.0, -1.0, 0.0]) == 6.0
    assert total_variation([math.inf, 1.0]) == math.inf


def test_a_peak_is_the_largest_size() -> None:
    assert peak([1.0, -3.0, 2.0]) == 3.0
    assert peak([math.inf, 1.0]) == math.inf
