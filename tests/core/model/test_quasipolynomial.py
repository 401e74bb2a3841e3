"""Quasi-polynomials form a ring, and their values are what the terms say."""

from __future__ import annotations

import cmath
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

terms = st.lists(
    st.builds(
        Term,
        st.sampled_from([0.0, 0.3, 0.5, 1.0, 1.7, 2.0]),
        st.sampled_from([0.0, 0.2, 1.0]),
        st.floats(-5.0, 5.0, allow_subnormal=False),
    ),
    max_size=4,
)
functions = terms.map(QuasiPolynomial.of)
points = st.complex_numbers(min_magnitude=0.1, max_magnitude=5.0).filter(lambda s: s.real > 0.0)


def value(function: QuasiPolynomial, s: complex) -> complex:
    return sum((t.coefficient * s**t.order * cmath.exp(-t.delay * s) for t in function.terms), 0j)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(functions, functions, points)
def test_sums_and_products_are_those_of_the_values(a: QuasiPolynomial, b: QuasiPolynomial, s: complex) -> None:
    assert complex((a + b)(s)) == pytest.approx(value(a, s) + value(b, s), abs=1e-9)
    assert complex((a * b)(s)) == pytest.approx(value(a, s) * value(b, s), rel=1e-9, abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(functions, points)
def test_its_derivative_is_the_limit_of_difference_quotients(a: QuasiPolynomial, s: complex) -> None:
    h = 1e-5 * abs(s)
    quotient = (value(a, s + h) - value(a, s - h)) / (2.0 * h)
    size = sum(abs(t.coefficient) * abs(s) ** t.order * (1.0 + t.delay) ** 3 for t in a.terms)
    assert complex(a.derivative(s)) == pytest.approx(quotient, abs=1e-7 * (1.0 + size))


def test_like_terms_merge_and_cancel() -> None:
    s = QuasiPolynomial.monomial(1.0, order=1.0)
    assert (s - s).is_zero
    assert QuasiPolynomial.of([Term(0.1 + 0.2, 0.0, 1.0), Term(0.3, 0.0, 1.0)]).terms == (Term(0.3, 0.0, 2.0),)


def test_a_power_is_a_repeated_product() -> None:
    base = QuasiPolynomial.polynomial([1.0, 2.0])
    assert (base**3).coefficients().tolist() == np.poly([-2.0, -2.0, -2.0]).tolist()
    assert base**0 == QuasiPolynomial.constant(1.0)


def test_only_ordinary_polynomials_have_coefficients() -> None:
    with pytest.raises(ValueError, match="not an ordinary polynomial"):
        QuasiPolynomial.monomial(1.0, order=0.5).coefficients()


def test_the_text_shows_signs_orders_and_delays() -> None:
    function = QuasiPolynomial.of([Term(1.5, 0.0, -1.0), Term(0.0, 0.25, 2.0), Term(0.0, 0.0, -3.0)])
    assert str(function) == "-s^1.5 - 3 + 2 exp(-0.25s)"
    assert str(QuasiPolynomial.of([replace(function.terms[0], coefficient=0.0)])) == "0"
