"""The verdict on a loop is right wherever an independent test exists, and withheld on the border.

Three oracles share no code with the argument principle: the roots of the characteristic polynomial at integer orders,
Matignon's sector at commensurate orders, and the direct method of Walton and Marshall (1987) for one delay: poles
cross the axis only at the frequencies where abs(L) = 1, at delays that follow from the phase there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.stability import process_stability, stability, stable_mask

from ...share import share_of

NEAR = 1e-6  # closer to the axis than this, relative to its size, an oracle's root proves nothing
Case = tuple[Loop, int, bool]
"""A loop, its number of unstable poles, and whether that is beyond doubt."""


def polynomial_process(numerator: np.ndarray, denominator: np.ndarray, delay: float = 0.0) -> Process:
    over, under = QuasiPolynomial.polynomial(numerator), QuasiPolynomial.polynomial(denominator)
    return Process(over.shifted(delay=delay), under)


def random_polynomials(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Strictly proper; poles and zeros of either sign, real and complex, at times an integrator or two."""

    def roots(count: int) -> list[complex]:
        found: list[complex] = []
        while len(found) < count:
            size, side = 10.0 ** rng.uniform(-1.5, 1.5), -1.0 if rng.random() < 0.8 else 1.0
            if count - len(found) >= 2 and rng.random() < 0.4:
                angle = rng.uniform(0.1, 1.5)
                found += [side * size * np.exp(1j * angle), side * size * np.exp(-1j * angle)]
            else:
                found.append(0.0 if rng.random() < 0.1 else side * size)
        return found

    order = int(rng.integers(1, 6))
    denominator = np.poly(roots(order)).real
    gain = 10.0 ** rng.uniform(-1.0, 1.0) * rng.choice([1.0, 1.0, -1.0])
    return gain * np.atleast_1d(np.poly(roots(int(rng.integers(0, order))))).real, denominator


def random_gains(rng: np.random.Generator) -> tuple[float, float, float]:
    kp, ki, kd = 10.0 ** rng.uniform(-1.5, 1.5, 3) * rng.choice([0.0, 1.0, 1.0, 1.0, -1.0], 3)
    return float(kp), float(ki), float(kd)


def count_right(roots: np.ndarray, angle: float = 0.5 * math.pi) -> tuple[int, bool]:
    """Roots within ``angle`` of the positive real axis, and whether none is near the sector's edge or the origin."""
    size = np.abs(roots)
    clear = bool(np.all(np.abs(np.abs(np.angle(roots)) - angle) > NEAR * 10.0) and np.all(size > NEAR))
    return int(np.sum(np.abs(np.angle(roots)) < angle)), clear


def integer_order_cases(rng: np.random.Generator) -> Iterator[Case]:
    while True:
        numerator, denominator = random_polynomials(rng)
        kp, ki, kd = random_gains(rng)
        forward = np.polymul([kd, kp, ki] if ki else [kd, kp], numerator)
        closed = np.polyadd(np.append(denominator, 0.0) if ki else denominator, forward)
        yield Loop(polynomial_process(numerator, denominator), Fopid(kp, ki, kd)), *count_right(np.roots(closed))


def commensurate_cases(rng: np.random.Generator) -> Iterator[Case]:
    """All orders multiples of q: poles are roots in s^q within q pi / 2 of the positive real axis (Matignon 1996)."""
    while True:
        q = float(rng.choice([0.2, 0.25, 0.5, 0.4, 0.8]))
        over, under = random_polynomials(rng)
        kp, ki, kd = random_gains(rng)
        lam, mu = (int(n) for n in rng.integers(1, int(2.0 / q) + 1, 2))
        numerator = QuasiPolynomial.polynomial(over)
        denominator = QuasiPolynomial.polynomial(under)
        process = Process(
            QuasiPolynomial.of(Term(q * t.order, 0.0, t.coefficient) for t in numerator.terms),
            QuasiPolynomial.of(Term(q * t.order, 0.0, t.coefficient) for t in denominator.terms),
        )
        shift = lam if ki else 0
        controller = np.zeros(shift + mu + 1)
        controller[0] += kd
        controller[mu] += kp
        if ki:
            controller[-1] += ki
        closed = np.polyadd(np.append(under, np.zeros(shift)), np.polymul(controller, over))
        unstable, clear = count_right(np.roots(closed), 0.5 * math.pi * q)
        yield Loop(process, Fopid(kp, ki, kd, q * lam, q * mu)), unstable, clear


def delay_cases(rng: np.random.Generator) -> Iterator[Case]:
    while True:
        numerator, denominator = random_polynomials(rng)
        kp, ki, kd = random_gains(rng)
        kd = kd if len(denominator) - len(numerator) >= 2 else 0.0
        if kp == ki == kd == 0.0:
            continue
        over = np.trim_zeros(np.polymul([kd, kp, ki] if ki else [kd, kp], numerator), "f")
        under = np.append(denominator, 0.0) if ki else denominator
        delay = 10.0 ** rng.uniform(-2.0, 1.0)
        unstable, clear = walton_marshall(over, under, delay)
        yield Loop(polynomial_process(numerator, denominator, delay), Fopid(kp, ki, kd)), unstable, clear


def walton_marshall(over: np.ndarray, under: np.ndarray, delay: float) -> tuple[int, bool]:
    unstable, clear = count_right(np.roots(np.polyadd(under, over)))
    excess = np.polysub(squared_gain(under), squared_gain(over))
    squares = np.roots(excess)
    real = np.abs(squares.imag) < 1e-7 * np.abs(squares)
    clear &= bool(np.all(real == (np.abs(squares.imag) < 1e-4 * np.abs(squares))))
    for square in squares[real & (squares.real > 0.0)].real:
        w = math.sqrt(square)
        phase = np.angle(-np.polyval(over, 1j * w) / np.polyval(under, 1j * w)) % (2.0 * math.pi)
        crossings = (w * delay - phase) / (2.0 * math.pi)
        slope = np.polyval(np.polyder(excess), square)
        unstable += 2 * int(np.sign(slope)) * max(math.floor(crossings) + 1, 0)
        clear &= abs(crossings - round(crossings)) > 1e-5 and phase > 1e-5
    return unstable, clear


def squared_gain(polynomial: np.ndarray) -> np.ndarray:
    """Coefficients of abs(p(jw))^2 in w^2, highest first."""
    n = len(polynomial) - 1
    reflected = polynomial * (-1.0) ** (n - np.arange(n + 1))
    return np.polymul(polynomial, reflected)[::2] * (-1.0) ** np.arange(n, -1, -1)


FAMILIES: dict[str, tuple[int, Callable[[np.random.Generator], Iterator[Case]]]] = {
    "integer orders: roots": (11, integer_order_cases),
    "commensurate orders: Matignon's sector": (12, commensurate_cases),
    "delay: Walton and Marshall": (13, delay_cases),
}


def check_agreement(family: str, wanted: int) -> None:
    seed, cases = FAMILIES[family]
    checked = undecided = 0
    for loop, unstable, clear in cases(np.random.default_rng(seed)):
        if not clear:
            continue
        verdict = stability(loop)
        checked += 1
        if verdict.decided:
            assert (verdict.unstable_poles, verdict.stable) == (unstable, unstable == 0), (loop, verdict)
        undecided += not verdict.decided
        if checked == wanted:
            break
    assert undecided <= wanted // 500


@pytest.mark.parametrize("family", FAMILIES)
def test_the_verdict_agrees_with_an_independent_test(family: str) -> None:
    check_agreement(family, 500)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("family", FAMILIES)
def test_the_verdict_agrees_on_ten_thousand_loops_of_each_kind(family: str) -> None:
    check_agreement(family, share_of(10_000))


@pytest.mark.parametrize(("kp", "unstable"), [(8.0 - 1e-5, 0), (8.0 + 1e-5, 2)])
def test_just_beside_the_border_the_verdict_is_certain(kp: float, unstable: int) -> None:
    verdict = stability(Loop(read_process("P1"), Fopid(kp)))  # (s + 1)^3 + kp has the roots +- j sqrt(3) at kp = 8
    assert verdict.decided
    assert verdict.unstable_poles == unstable


@pytest.mark.parametrize(
    ("process", "gains"),
    [("P1", (8.0, 0.0, 0.0, 1.0, 1.0)), ("1/s^2", (1.0, 0.0, 0.0, 1.0, 1.0)), ("1/(s^2+1)", (2.0, 0.0, 0.0, 1.0, 1.0))],
)
def test_on_the_border_it_is_too_close_to_call(process: str, gains: tuple[float, ...]) -> None:
    verdict = stability(Loop(read_process(process), Fopid(*gains)))
    assert not verdict.decided
    assert not verdict.stable
    assert verdict.unstable_poles == -1
    assert "too close" in verdict.reason


@pytest.mark.parametrize("factor", [0.999, 1.001])
@pytest.mark.parametrize("alpha", [0.6, 1.0, 1.4])
def test_a_fractional_lag_with_delay_turns_unstable_at_its_known_delay(alpha: float, factor: float) -> None:
    # abs(L) = 1 for K / (s^a + 1): w^(2a) + 2 w^a cos(a pi/2) + 1 = K^2, a quadratic in w^a
    gain, cosine = 3.0, math.cos(0.5 * math.pi * alpha)
    w = (-cosine + math.sqrt(cosine**2 - 1.0 + gain**2)) ** (1.0 / alpha)
    delay = (math.pi - np.angle((1j * w) ** alpha + 1.0)) / w * factor
    process = Process.parse(f"{gain}/(s^{alpha}+1)").delayed(delay)
    assert stability(Loop(process, Fopid(1.0))).unstable_poles == (0 if factor < 1.0 else 2)


@pytest.mark.parametrize(("kd", "stable"), [(0.99, True), (1.01, False), (-0.99, True), (-1.01, False)])
def test_a_neutral_loop_is_stable_only_below_gain_one_at_infinity(kd: float, stable: bool) -> None:
    verdict = stability(Loop(Process.parse("1/(s+1)*exp(-0.1s)"), Fopid(0.1, 0.0, kd)))
    assert verdict.decided
    assert verdict.stable == stable
    assert ("infinitely many" in verdict.reason) != stable
    assert (verdict.margin == 0.0) != stable


def test_a_neutral_loop_at_gain_one_is_too_close_to_call() -> None:
    verdict = stability(Loop(Process.parse("1/(s+1)*exp(-0.1s)"), Fopid(0.1, 0.0, 1.0)))
    assert not verdict.decided
    assert verdict.reason == "the delayed loop gain at high frequency is 1: too close to the border to call"


def test_a_loop_whose_return_difference_is_zero_everywhere_has_no_poles_to_count() -> None:
    verdict = stability(Loop(Process.parse("-(s+1)/(s+1)"), Fopid(1.0)))
    assert (verdict.stable, verdict.unstable_poles, verdict.decided, verdict.margin) == (False, -1, True, 0.0)
    assert verdict.reason == "1 + L(s) is zero everywhere"


def test_of_a_delay_with_too_many_turns_nothing_is_said() -> None:
    verdict = stability(Loop(Process.parse("1/(s+1)*exp(-1e7s)"), Fopid(3.0)))
    assert (verdict.stable, verdict.unstable_poles, verdict.decided) == (False, -1, False)
    assert verdict.reason == "not decided: too many poles near the imaginary axis to count"


def test_a_loop_gain_that_grows_behind_a_delay_is_never_stable() -> None:
    verdict = stability(Loop(Process.parse("1/(s+1)*exp(-0.1s)"), Fopid(0.1, 0.0, 0.01, 1.0, 1.2)))
    assert (verdict.stable, verdict.decided, verdict.unstable_poles) == (False, True, -1)


def test_a_cancelled_unstable_pole_still_counts() -> None:
    verdict = stability(Loop(Process.parse("(s-1)/((s-1)(s+1))"), Fopid(1.0)))
    assert verdict.unstable_poles == 1


@pytest.mark.parametrize(("process", "gains"), [("s/(s+1)^2", (1, 1, 0, 1, 1)), ("1/s", (0, 0, 0, 1, 1))])
def test_a_pole_at_the_origin_is_not_stable(process: str, gains: tuple[float, ...]) -> None:
    verdict = stability(Loop(Process.parse(process), Fopid(*gains)))
    assert (verdict.stable, verdict.decided, verdict.margin, verdict.reason) == (
        False,
        True,
        0.0,
        "a pole at the origin",
    )


def test_constants_that_cancel_at_zero_only_are_a_pole_at_the_origin() -> None:
    verdict = process_stability(Process.parse("1/(s+1-exp(-0.5s))"))  # no power of s can be taken out
    assert (verdict.stable, verdict.decided, verdict.reason) == (False, True, "a pole at the origin")


def test_of_many_candidates_every_row_has_its_verdict() -> None:
    gains = np.zeros((600, 5))
    gains[:, 0], gains[:, 3:] = np.where(np.arange(600) % 2 == 0, 7.9, 8.1), 1.0  # Routh: a gain of 8 is the border
    assert np.array_equal(stable_mask(read_process("P1"), gains), gains[:, 0] < 8.0)


@pytest.mark.parametrize(
    ("text", "unstable"),
    [
        ("1/(s+1)^3", 0),
        ("1/(s^2-s+1)", 2),
        ("1/(s^1.2+0.1)", 0),
        ("1/(s^0.5-2)", 1),
        ("1/(s+1+2exp(-0.1s))", 0),
        ("1/(s+2exp(-0.7s))", 0),  # s + k exp(-L s) is stable for k L < pi/2
        ("1/(s+2exp(-0.8s))", 2),
        ("1/(s-1+0.5exp(-s))", 1),
    ],
)
def test_the_poles_of_a_process_are_counted_delays_inside_it_too(text: str, unstable: int) -> None:
    assert process_stability(Process.parse(text)).unstable_poles == unstable


def test_many_unstable_poles_of_a_long_delay_are_all_counted() -> None:
    # with N = w_c L / (2 pi) turns of the delay below the crossover, s + 1 + k exp(-L s) has 2 ceil(N - ...) zeros
    gain, delay = 20.0, 30.0
    w = math.sqrt(gain**2 - 1.0)
    phase = (math.pi - math.atan(w)) % (2.0 * math.pi)
    expected = 2 * (math.floor((w * delay - phase) / (2.0 * math.pi)) + 1)
    assert stability(Loop(Process.parse("1/(s+1)").delayed(delay), Fopid(gain))).unstable_poles == expected


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.sampled_from(["P1", "P4", "1/(s+1)*exp(-0.5s)", "2/(s^1.3-1)", "1/(s(s+2))", "(1-s)/(s+1)^2"]),
    st.tuples(st.floats(-5, 20), st.floats(-2, 5), st.floats(-2, 5), st.floats(0.05, 2.0), st.floats(0.05, 2.0)),
    st.floats(1e-3, 1e3),
)
def test_the_unit_of_time_does_not_change_the_verdict(process: str, gains: tuple[float, ...], unit: float) -> None:
    original, controller = read_process(process), Fopid(*gains)
    scaled = Process(in_unit(original.numerator, unit), in_unit(original.denominator, unit))
    rescaled = Fopid(
        controller.kp, controller.ki * unit**-controller.lam, controller.kd * unit**controller.mu, *gains[3:]
    )
    first, second = stability(Loop(original, controller)), stability(Loop(scaled, rescaled))
    assert first.decided
    assert second.decided
    assert first.unstable_poles == second.unstable_poles


def in_unit(function: QuasiPolynomial, unit: float) -> QuasiPolynomial:
    """The function of s * unit."""
    return QuasiPolynomial.of(Term(t.order, t.delay * unit, t.coefficient * unit**t.order) for t in function.terms)


@pytest.mark.parametrize("process", ["P1", "P4", "1/(s+1)*exp(-0.5s)", "2/(s-1)*exp(-0.1s)", "1/(s^1.7+0.2s^0.4)"])
def test_of_many_candidates_at_once_only_stable_ones_pass_and_hardly_one_is_missed(process: str) -> None:
    rng = np.random.default_rng(7)
    lows, highs = [-2, -1, -1, 0, 0], [20, 10, 3, 2, 2]
    candidates = rng.uniform(lows, highs, (300, 5)) * np.append(rng.choice([0.0, 1.0], (300, 3)), np.ones((300, 2)), 1)
    alone = [stability(Loop(read_process(process), Fopid(*row))) for row in candidates]
    mask = stable_mask(read_process(process), candidates)
    assert not np.any(mask & [not verdict.stable for verdict in alone])
    assert mask.sum() >= 0.99 * sum(verdict.stable for verdict in alone)


@pytest.mark.parametrize("order", [1, 2])
def test_candidates_may_each_have_a_filter_of_the_measurement(order: int) -> None:
    # 1 + T s + (T s)^2 / 2 below the process does the same to the loop
    rng = np.random.default_rng(8)
    gains = np.column_stack((rng.uniform(0.0, 12.0, (40, 3)), rng.uniform(0.5, 1.5, (40, 2))))
    times = 10.0 ** rng.uniform(-2.0, 1.0, 40)
    slow = [f"({0.5 * t * t * (order == 2):.17g}s^2+{t:.17g}s+1)" for t in times]
    loops = [Loop(Process.parse(f"1/((s+1)^3*{text})"), Fopid(*row)) for text, row in zip(slow, gains, strict=True)]
    alone = [stability(loop).stable for loop in loops]
    assert 5 < sum(alone) < 35
    assert stable_mask(read_process("P1"), gains, times, order).tolist() == alone


@pytest.mark.parametrize("gains", [[[1, 2, 3]], [[1, 0, 0, 1, math.nan]], np.zeros((2, 2, 5))])
def test_candidates_must_be_rows_of_five_finite_numbers(gains: object) -> None:
    with pytest.raises(InputError, match="one row KP,KI,KD,LAM,MU"):
        stable_mask(read_process("P1"), gains)  # type: ignore[arg-type]


def test_the_margin_is_the_relative_change_of_the_coefficients_that_destabilises() -> None:
    # the characteristic polynomial is s + 0.5, and abs(jw + 0.5) / (w + 0.5) is smallest at w = 0.5
    verdict = stability(Loop(Process.parse("1/(s+1)"), Fopid(-0.5)))
    assert verdict.margin == pytest.approx(math.sqrt(0.5), rel=0.01)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_verdict_does_not_depend_on_the_unit_of_time(scale: float) -> None:
    process = Process.parse(f"1/({scale:g}s+1)^3")
    for kp, stable in ((7.9, True), (8.1, False)):  # Routh: a gain of 8 is the border
        verdict = stability(Loop(process, Fopid(kp)))
        assert verdict.decided
        assert verdict.stable is stable
        assert verdict.unstable_poles == (0 if stable else 2)


@pytest.mark.parametrize("text", ["(1-exp(-2s))/(2s)", "(1-exp(-2s))/(2s(s+1))"])
def test_a_moving_average_has_no_pole_at_the_origin_and_is_not_decided(text: str) -> None:
    process = Process.parse(text)
    for verdict in (process_stability(process), stability(Loop(process, Fopid(0.5, 0.3)))):
        assert not verdict.decided
        assert verdict.reason.endswith("both vanish at s = 0")
