"""The line to the right of all poles is found to two per cent."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.spectral_abscissa import spectral_abscissa_bound

roots = st.lists(st.complex_numbers(min_magnitude=0.05, max_magnitude=20.0), min_size=1, max_size=3).filter(
    lambda found: max(r.real for r in found) > 0.1
)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(roots)
def test_for_a_polynomial_it_is_the_rightmost_root(found: list[complex]) -> None:
    polynomial = QuasiPolynomial.polynomial(np.poly(found + [r.conjugate() for r in found]).real)
    exact = max(r.real for r in found)
    assert exact * (1.0 - 1e-6) <= spectral_abscissa_bound(polynomial, 100.0) <= exact * 1.021


@pytest.mark.parametrize("gain", [2.0, 5.0, 50.0])
def test_for_a_delayed_loop_it_is_the_lambert_function(gain: float) -> None:
    # s + gain exp(-s) = 0 has the rightmost roots W(-gain)
    exact = float(max(mp.lambertw(-gain, k).real for k in (-1, 0, 1)))
    function = QuasiPolynomial.of([Term(1.0, 0.0, 1.0), Term(0.0, 1.0, gain)])
    assert exact <= spectral_abscissa_bound(function, 100.0) <= exact * 1.021


def test_for_a_neutral_loop_it_is_the_logarithm_of_its_gain() -> None:
    # s (1 + 3 exp(-s)) + 0.001: zeros near ln 3 + j (2 k + 1) pi
    function = QuasiPolynomial.of([Term(1.0, 0.0, 1.0), Term(1.0, 1.0, 3.0), Term(0.0, 0.0, 1e-3)])
    assert spectral_abscissa_bound(function, 100.0) == pytest.approx(math.log(3.0), rel=0.03)


def test_beyond_the_largest_growth_it_gives_up() -> None:
    assert spectral_abscissa_bound(QuasiPolynomial.polynomial([1.0, -200.0]), 100.0) == math.inf
