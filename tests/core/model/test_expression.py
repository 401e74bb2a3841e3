"""A process text is read as people mean it, and refused where it has no or more than one meaning."""

from __future__ import annotations

import cmath
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import ExpressionError, InputError
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

S = 0.3 + 0.7j


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1/(s+1)^3", 1 / (S + 1) ** 3),
        ("9/((s+1)(s^2+2s+9))", 9 / ((S + 1) * (S**2 + 2 * S + 9))),
        ("1/((0.2s+1)(s+1)^2)", 1 / ((0.2 * S + 1) * (S + 1) ** 2)),
        ("3.13/(433.33s+1)*exp(-50s)", 3.13 / (433.33 * S + 1) * cmath.exp(-50 * S)),
        ("1/(0.8s^2.2+0.5s^0.9+1)", 1 / (0.8 * S**2.2 + 0.5 * S**0.9 + 1)),
        ("-2 e^(-0.5s)/(s+1)", -2 * cmath.exp(-0.5 * S) / (S + 1)),
        ("2e-3s/(s+1)^2", 0.002 * S / (S + 1) ** 2),
        ("1/(s+1)exp(-s)", cmath.exp(-S) / (S + 1)),
        ("1/s - 1/(s+1)", 1 / S - 1 / (S + 1)),
        ("2*-1/(s+1)", -2 / (S + 1)),
        ("s^-0.5", S**-0.5),
        ("1/s**(1/2)", S**-0.5),
        ("(s+1)^-2", (S + 1) ** -2),
        ("1·2/(s+1)", 2 / (S + 1)),
        ("2^3/(s+1)", 8 / (S + 1)),
        ("1/(1-exp(-2s)/(s+2))", 1 / (1 - cmath.exp(-2 * S) / (S + 2))),
        ("exp(-s/2)/(s+1)", cmath.exp(-S / 2) / (S + 1)),
        ("1/(s+1)*2(s+3)/(s+5)", 2 * (S + 3) / ((S + 1) * (S + 5))),
    ],
)
def test_a_text_means_its_formula(text: str, value: complex) -> None:
    assert complex(Process.parse(text)(S)) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "position", "reason"),
    [
        ("2.5.1/s", 3, "does not fit"),
        ("2 3/s", 2, "does not fit"),
        ("s2/(s+1)", 1, "does not fit"),
        ("1/(s+1)(s+2)", 7, "read in two ways"),
        ("1/(s", 4, "ends too soon"),
        ("1/(s+1))", 7, "does not fit"),
        ("1/(s+1)$", 7, "has no meaning"),
        ("", 0, "empty"),
        ("1/0", 2, "division by zero"),
        ("2^s", 2, "exponent contains s"),
        ("exp(s)/(s+1)", 0, "future"),
        ("exp(-s^2)", 0, "constant times s"),
        ("exp(-s^0.5)", 0, "as of diffusion, is no ratio"),
        ("1/(sqrt(s)+1)", 3, "a square root is a power here"),
        ("(s+1)^0.5/(s+1)", 0, "only s and numbers"),
        ("1e999/s", 0, "not finite"),
        ("exp(1000)/s", 0, "not finite"),
        ("99^99*99^99/s", 6, "not finite"),
        ("1/s^101", 2, "too high"),
        ("1/((s+1)^100)^100", 2, "too high"),
        ("((s^0.01+s^0.0123+s^.3+s^.11+exp(-s)+1)^90)/s^99", 1, "too many terms"),
        ("(" * 500 + "s" + ")" * 500, 30, "too many parentheses"),
        ("s+" * 1500 + "1", 40, "3001 characters"),
    ],
)
def test_an_error_points_at_the_character(text: str, position: int, reason: str) -> None:
    with pytest.raises(ExpressionError, match=reason) as caught:
        Process.parse(text)
    assert caught.value.position == position
    assert "\n" not in str(caught.value)


def test_a_long_flat_sum_is_read() -> None:
    assert Process.parse("1/(s+" + "+".join(["1"] * 900) + ")").steady_state_gain == pytest.approx(1 / 900)


@pytest.mark.parametrize("text", ["((s+1)^100)^100", "1/" + "(s^0.1+s^0.23+exp(-s)+1)" * 80, "-" * 2000, "(" * 2000])
def test_a_monstrous_text_is_refused_at_once(text: str) -> None:
    start = time.process_time()
    with pytest.raises(InputError):
        Process.parse(text)
    assert time.process_time() - start < 2.0


coefficients = st.floats(1e-9, 1e9) | st.floats(-1e9, -1e-9) | st.integers(-9, 9).filter(bool).map(float)
delays = st.sampled_from([0.0]) | st.floats(1e-6, 1e3)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    st.lists(st.tuples(st.floats(0.0, 2.0), delays, coefficients), min_size=1, max_size=3),
    st.lists(st.tuples(st.floats(0.0, 3.0), delays, coefficients), max_size=3),
    coefficients,
)
def test_every_process_reads_back_from_its_own_text(
    over: list[tuple[float, float, float]], under: list[tuple[float, float, float]], lead: float
) -> None:
    numerator = QuasiPolynomial.of(Term(*t) for t in over)
    process = Process(numerator, QuasiPolynomial.of([Term(3.5, 0.0, lead), *(Term(*t) for t in under)]))
    assert Process.parse(str(process)) == process


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.text(alphabet="s0123456789.+-*/^() expe", max_size=30))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    process, message = read_or_refuse(text)
    assert "\n" not in message
    if process:
        assert Process.parse(str(process)) == process


def read_or_refuse(text: str) -> tuple[Process | None, str]:
    try:
        return Process.parse(text), ""
    except InputError as error:
        return None, str(error)
