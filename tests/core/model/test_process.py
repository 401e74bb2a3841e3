"""A process is proper and causal, composes as block diagrams do, and knows what it is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.process import TEST_BENCH, Process, read_process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

S = np.array([0.1 + 0.2j, 1.0 + 3.0j, 4.0 - 1.0j])

processes = st.sampled_from(
    ["1/(s+1)", "2/(s^1.5+1)", "(s+3)/(s+1)^2", "exp(-0.3s)/(s+2)", "-1/s", "1/(s-1)", "(2-s)/(s^2+s+1)*exp(-s)"]
).map(Process.parse)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(processes, processes)
def test_connections_are_those_of_block_diagrams(p: Process, q: Process) -> None:
    assert (p * q)(S) == pytest.approx(p(S) * q(S))
    assert (p + q)(S) == pytest.approx(p(S) + q(S))
    assert (-p)(S) == pytest.approx(-p(S))
    assert p.feedback(q)(S) == pytest.approx(p(S) / (1 + p(S) * q(S)))
    if p != q:
        assert (p - q)(S) == pytest.approx(p(S) - q(S))


@settings(derandomize=True, deadline=None, max_examples=20)
@given(processes, st.floats(0.1, 10.0))
def test_numbers_connect_as_gains(p: Process, k: float) -> None:
    assert (k * p)(S) == pytest.approx(k * p(S))
    assert (p + k)(S) == pytest.approx(p(S) + k)
    assert (k - p)(S) == pytest.approx(k - p(S))
    assert p.feedback(k)(S) == pytest.approx(p(S) / (1 + k * p(S)))


@settings(derandomize=True, deadline=None, max_examples=20)
@given(processes)
def test_the_logarithmic_derivative_is_that_of_the_response(p: Process) -> None:
    h = 1e-6
    assert p.logarithmic_derivative(S) == pytest.approx((np.log(p(S + h)) - np.log(p(S - h))) / (2 * h), rel=1e-6)


def test_a_process_is_divided_by_another_where_that_leaves_one() -> None:
    lag, late, s = Process.parse("1/(s+1)"), Process.parse("2/(s+3)*exp(-0.1s)"), 0.7 + 1.3j
    assert complex((late / lag)(s)) == pytest.approx(complex(late(s)) / complex(lag(s)))
    assert str(lag / 2.0) == "0.5/(s + 1)"
    with pytest.raises(InputError, match=r"exp\(0.1s\) looks into the future"):
        lag / late
    with pytest.raises(TypeError, match="'Process' and 'str'"):
        lag / "2"  # type: ignore[operator]


@pytest.mark.parametrize(
    ("name", "formula"),
    [
        ("P1", lambda s: 1 / (s + 1) ** 3),
        ("P2", lambda s: 9 / ((s + 1) * (s**2 + 2 * s + 9))),
        ("P3", lambda s: 1 / (s + 1) ** 4),
        ("P4", lambda s: 1 / ((s + 1) * (0.2 * s + 1) * (0.04 * s + 1) * (0.008 * s + 1))),
    ],
)
def test_the_test_bench_is_the_papers(name: str, formula: object) -> None:
    assert read_process(name)(S) == pytest.approx(formula(S))  # type: ignore[operator]
    assert read_process(f" {name} ") == Process.parse(TEST_BENCH[name])


def test_a_process_knows_what_it_is() -> None:
    process = Process.parse("2(s+1)/(s(s+3)^2)*exp(-0.5s)")
    assert (process.delay, process.relative_degree, process.integrating_order) == (0.5, 2.0, 1.0)
    assert process.steady_state_gain == math.inf
    assert process.is_rational
    assert not Process.parse("1/(s^0.5+1)").is_rational
    assert not Process.parse("1/(s+exp(-s))").is_rational
    assert Process.parse("(s+3)/(2s+2)").steady_state_gain == 1.5


def test_polynomials_are_those_of_a_rational_process() -> None:
    numerator, denominator, delay = Process.parse("(s+2)/(s+1)^2*exp(-3s)").polynomials()
    assert (numerator.tolist(), denominator.tolist(), delay) == ([1.0, 2.0], [1.0, 2.0, 1.0], 3.0)
    with pytest.raises(InputError, match="not rational"):
        Process.parse("1/(s^0.5+1)").polynomials()


def test_a_delay_can_be_taken_out_and_added() -> None:
    process = Process.parse("1/(s+1)*exp(-2s)")
    assert process.without_delay() == Process.parse("1/(s+1)")
    assert process.without_delay().delayed(2.0) == process
    with pytest.raises(InputError, match="future"):
        process.delayed(-3.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("s", "not proper"),
        ("(s^1.5+1)/(s+1)", "not proper"),
        ("0/(s+1)", "numerator 0"),
        ("1/(s-s)", "division by zero"),
        ("1/(1+s*exp(-s))", "advanced type"),
        ("1/(s*exp(-s)+exp(-s))", "future"),
    ],
)
def test_what_is_no_process_is_refused_with_the_reason(text: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        Process.parse(text)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_refused(bad: float) -> None:
    one = QuasiPolynomial.constant(1.0)
    for term in (Term(0.0, 0.0, bad), Term(0.0, bad, 1.0)):
        with pytest.raises(InputError, match=r"finite|future"):
            Process(QuasiPolynomial((term,)), one)


def test_a_process_can_come_from_a_yaml_file(tmp_path: Path) -> None:
    file = tmp_path / "tank.yaml"
    file.write_text("process: 3/(10s+1)\n", encoding="utf-8")
    assert read_process(str(file)) == Process.parse("3/(10s+1)")


@pytest.mark.parametrize(
    ("content", "reason"),
    [("plant: P1", "no text under the key"), ("process: [1, 2]", "no text"), ("a: [", "cannot be read")],
)
def test_a_bad_file_is_refused_with_its_name(tmp_path: Path, content: str, reason: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=reason) as caught:
        read_process(str(file))
    assert "bad.yaml" in str(caught.value)


def test_a_missing_file_and_a_file_that_names_a_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_process(str(tmp_path / "none.yaml"))
    file = tmp_path / "loop.yaml"
    file.write_text("process: loop.yaml", encoding="utf-8")
    with pytest.raises(InputError, match="names the file"):
        read_process(str(file))
