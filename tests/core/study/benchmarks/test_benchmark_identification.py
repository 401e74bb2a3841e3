"""The program that identification is measured against is right, so that the comparison means something."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from fopid_core.design.identification.record import Record
from fopid_core.study.benchmarks.identification import curve_fit_nioptd2, simulate


def test_the_simulation_of_the_baseline_is_that_of_two_lags_at_integer_orders() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    u = (t >= 1.0).astype(float)
    found = simulate(t, u, 2.0, 1.5, 0.8, 2.0, 1.0, 0.3)
    expected = lsim(([2.0], [1.0, 1.5, 0.8]), (t >= 1.3).astype(float), t)[1]
    assert np.abs(found - expected).max() < 0.02  # of first order in the sample time


@pytest.mark.slow
def test_the_baseline_finds_the_numbers_of_a_fractional_process() -> None:
    t = np.arange(0.0, 15.0, 0.05)
    u = (t >= 1.0).astype(float)
    numbers = (0.8, 1.5, 0.8, 1.7, 0.9, 0.4)
    found, simulations = curve_fit_nioptd2(Record(t, u, simulate(t, u, *numbers)))
    assert found == pytest.approx(numbers, rel=0.05)
    assert simulations > 20
