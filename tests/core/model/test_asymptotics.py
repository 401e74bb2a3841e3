"""Transforms expand at infinity as long division says, and the sudden part of a signal is its Laplace original."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.asymptotics import SingularPart, expansion_at_infinity, fast_rate
from fopid_core.model.quasipolynomial import Points, QuasiPolynomial, Term

ONE = QuasiPolynomial.constant(1.0)
denominators = st.lists(
    st.builds(
        Term,
        st.sampled_from([0.0, 0.4, 0.9, 1.5]),
        st.sampled_from([0.0, 0.5]),
        st.integers(-30, 30).map(lambda n: n / 10),
    ),
    max_size=3,
).map(lambda terms: QuasiPolynomial.of([Term(2.0, 0.0, 1.0), *terms]))


@settings(derandomize=True, deadline=None, max_examples=40)
@given(denominators)
def test_what_is_left_of_an_expansion_falls_faster_than_its_last_power(denominator: QuasiPolynomial) -> None:
    lowest = -6.0
    expansion = expansion_at_infinity(ONE, denominator, lowest, 100.0, max(fast_rate(denominator), 1.0))
    s = 1e3 * np.exp(1j * np.linspace(-1.5, 1.5, 9))  # |s| = 1000; far to the right of the axis or not
    rest = np.abs(1.0 / denominator(s) - expansion(s))
    echoes = np.exp(-0.5 * s.real)
    assert np.all(rest < 1e4 * np.abs(s) ** lowest * np.maximum(1.0, 1.0 / np.maximum(echoes, 1.0)) + 1e-11)


def test_a_delay_beyond_the_horizon_is_left_out() -> None:
    denominator = QuasiPolynomial.of([Term(1.0, 0.0, 1.0), Term(1.0, 1.0, 0.5)])  # s (1 + exp(-s) / 2)
    expansion = expansion_at_infinity(ONE, denominator, -2.0, 2.5, 1.0)
    assert [(t.delay, t.coefficient) for t in expansion.terms] == [(0.0, 1.0), (1.0, -0.5), (2.0, 0.25)]


@pytest.mark.parametrize(("power", "delay"), [(0.5, 0.0), (1.0, 0.0), (1.3, 0.7), (2.0, 0.2), (3.6, 0.0)])
def test_a_sudden_part_is_the_laplace_original_of_its_transform(power: float, delay: float) -> None:
    part = SingularPart.of(QuasiPolynomial.monomial(2.0, order=-power, delay=delay), rate=3.0, highest_power=power)
    for time in (0.4, 1.1, 2.0):
        elapsed = time - delay
        exact = 0.0
        if elapsed > 0.0:
            exact = float(mp.invertlaplace(lambda s: 2 * (s + 3) ** -mp.mpf(power), mp.mpf(elapsed), method="talbot"))
        assert part.signal(np.array([time]))[0] == pytest.approx(exact, abs=1e-9)


def test_its_transform_and_its_terms_agree() -> None:
    part = SingularPart.of(QuasiPolynomial.of([Term(-0.5, 0.3, 2.0), Term(-1.0, 0.0, 1.0)]), 2.0, 1.4)
    s = np.array([1.0 + 2.0j])
    assert part.transform(Points(s)) == pytest.approx(2.0 * (s + 2.0) ** -0.5 * np.exp(-0.3 * s) + 1.0 / (s + 2.0))


def test_powers_of_s_are_rewritten_in_s_plus_rate() -> None:
    part = SingularPart.of(QuasiPolynomial.monomial(1.0, order=-1.5), rate=1.0, highest_power=9.5)
    s = np.array([50.0 + 20.0j])
    assert part.transform(Points(s)) == pytest.approx(s**-1.5, rel=1e-9)


def test_limits_from_the_right_are_jumps_or_infinite() -> None:
    def start(order: float, coefficient: float = 1.0) -> float:
        part = SingularPart.of(QuasiPolynomial.monomial(coefficient, order=order), 1.0, 2.0)
        return float(part.signal(np.array([0.0]))[0])

    assert (start(-1.0), start(-0.5), start(-0.5, -1.0), start(-1.5)) == (1.0, math.inf, -math.inf, 0.0)
    assert start(0.4) == -math.inf  # t^-1.4 / Gamma(-0.4) < 0


def test_the_unit_of_time_does_not_change_an_expansion() -> None:
    def terms(unit: float) -> list[float]:
        denominator = QuasiPolynomial.of([Term(1.7, 0.0, unit**1.7), Term(0.4, 0.0, 3.0 * unit**0.4)])
        expansion = expansion_at_infinity(ONE, denominator, -8.0, 0.0, 2.0 / unit)
        return [t.coefficient * unit**-t.order for t in expansion.terms]

    assert terms(1e-12) == pytest.approx(terms(1.0))


@settings(derandomize=True, deadline=None, max_examples=40)
@given(denominators)
def test_beyond_the_fast_rate_the_leading_term_outweighs_the_rest(function: QuasiPolynomial) -> None:
    rate = fast_rate(function)
    lower = [t for t in function.terms if t.order < 2.0]
    undelayed = sum(abs(t.coefficient) * rate**t.order for t in lower if t.delay == 0.0) / rate**2 if rate else 0.0
    delayed = sum(abs(t.coefficient) * rate**t.order for t in lower if t.delay > 0.0) / rate**2 if rate else 0.0
    assert undelayed <= 0.5 * (1.0 + 1e-6)
    assert delayed <= 1.0 + 1e-6
    assert not lower or undelayed > 0.5 * (1.0 - 1e-6) or delayed > 1.0 - 1e-6
