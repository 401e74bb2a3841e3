"""The argument principle on quasi-polynomials, held against roots: counts, margins, and what is left undecided."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.model import winding
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.winding import LARGEST_LOG, Zeros, count_zeros, right_half_plane_zeros


def zeros_of(*terms: tuple[float, float, float]) -> Zeros:
    """Of the sum of c s^q exp(-d s), given as (q, d, c)."""
    return right_half_plane_zeros(QuasiPolynomial.of(Term(*term) for term in terms))


def of_polynomials(rows: list[list[float]]) -> Zeros:
    """Of many polynomials at once, highest power first; zeros in front make them of lower order."""
    coefficients = np.array(rows)
    orders = np.broadcast_to(np.arange(coefficients.shape[1] - 1.0, -1.0, -1.0), coefficients.shape)
    return count_zeros(coefficients, orders, np.zeros(coefficients.shape[1]))


def test_polynomials_of_mixed_order_and_sign_counted_together_are_counted_each_by_their_roots() -> None:
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(400, 7)) * 10.0 ** rng.uniform(-3.0, 3.0, (400, 7))
    rows[rng.random((400, 7)) < 0.15] = 0.0
    rows[:, 3] += rows[:, 3] == 0.0  # none is zero everywhere
    found = of_polynomials(rows.tolist())
    for k, row in enumerate(rows):
        roots = np.roots(row)
        lowest = len(row) - 1 - int(np.flatnonzero(row)[-1])
        assert found.origin_order[k] == lowest
        roots = roots[np.argsort(np.abs(roots))][lowest:]
        if found.decided[k]:
            assert found.count[k] == np.sum(roots.real > 0.0), row
        else:
            assert np.min(np.abs(roots.real) / np.abs(roots)) < 1e-6, row
        assert found.all_left[k] == (bool(found.decided[k]) and lowest == 0 and not np.any(roots.real > 0.0))
    assert np.mean(found.decided) > 0.98
    assert np.all(found.within_reach)
    assert np.all(found.neutral_gain == 0.0)


def test_the_margin_is_the_smallest_value_on_the_axis_over_the_sum_of_sizes() -> None:
    w = np.geomspace(1e-4, 1e4, 400_001)
    for row in ([1.0, 0.5, 2.0, 0.3], [1.0, -1.0, 4.0], [3.0, 1.0], [1.0, 0.01, 1.0]):
        s = np.array([w**power for power in range(len(row) - 1, -1, -1)])
        turned = (1j ** np.arange(len(row) - 1, -1, -1)) @ (np.array(row)[:, None] * s)
        true = np.min(np.abs(turned) / (np.abs(row) @ s))
        found = of_polynomials([row])
        assert true <= found.margin[0] * (1.0 + 1e-6) <= 1.2 * true  # on a grid
        assert found.decided[0]


@pytest.mark.parametrize("damping", [1e-2, 1e-4, 1e-6])
def test_beside_a_lightly_damped_resonance_the_margin_is_that_of_the_resonance(damping: float) -> None:
    # s^2 + d s + 3 at its resonance: d sqrt(3) over 6 + d sqrt(3)
    found = of_polynomials([[1.0, damping, 3.0]])
    assert found.margin[0] == pytest.approx(damping * math.sqrt(3.0) / (6.0 + damping * math.sqrt(3.0)), rel=0.01)


def test_the_grid_is_dense_where_a_zero_is_near_the_axis_ascending_and_never_where_powers_overflow() -> None:
    damped, peaked = of_polynomials([[1.0, 2.0, 1.0]]), of_polynomials([[1.0, 2e-6, 1.0]])
    near = [np.min(np.diff(one.log_frequency)) for one in (damped, peaked)]
    assert near[1] < 1e-2 * near[0]
    assert np.min(np.abs(peaked.log_frequency)) < 1e-5  # ln of the resonance, 1 rad/s
    assert np.all(np.diff(peaked.log_frequency) > 0.0)
    wide = zeros_of((0.0, 0.0, 1e-250), (2.0, 0.0, 1.0))
    assert np.all(np.abs(wide.log_frequency) < LARGEST_LOG / 4.0)


@pytest.mark.parametrize(("kd", "gain"), [(0.5, 0.5), (-0.5, 0.5), (0.999, 0.999), (1.001, 1.001), (3.0, 3.0)])
def test_the_neutral_gain_is_that_of_the_delayed_leading_terms(kd: float, gain: float) -> None:
    found = zeros_of((1.0, 0.0, 2.0), (0.0, 0.0, 1.0), (1.0, 0.3, 2.0 * kd))
    assert found.neutral_gain[0] == pytest.approx(gain)
    assert bool(found.decided[0]) == (gain < 1.0)
    assert found.count[0] == (0 if gain < 1.0 else -1)
    assert (found.margin[0] > 0.0) == (gain < 1.0)


def test_delayed_leading_terms_are_taken_with_the_worst_signs_and_an_advanced_type_is_infinite() -> None:
    both = zeros_of((1.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.3, 0.6), (1.0, 0.7, -0.6))
    assert both.neutral_gain[0] == pytest.approx(1.2)
    assert zeros_of((1.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.1, 0.3, 0.01)).neutral_gain[0] == math.inf
    later = zeros_of((1.0, 0.4, 1.0), (0.0, 0.4, 1.0), (1.0, 0.7, 0.5))  # a common delay moves no zero
    assert (later.neutral_gain[0], later.count[0]) == (0.5, 0)


def test_orders_whose_balance_lies_beyond_all_frequencies_are_out_of_reach_and_not_decided() -> None:
    found = zeros_of((0.0, 0.0, 1.0), (1e-9, 0.0, 2.0), (1.0, 0.0, 1.0))
    assert (bool(found.within_reach[0]), bool(found.decided[0]), int(found.count[0])) == (False, False, -1)


@pytest.mark.parametrize(("rate", "count"), [(0.49, 0), (0.51, 2), (2.49, 2), (2.51, 4), (40.49, 40), (40.51, 42)])
def test_zeros_of_a_delayed_feedback_cross_one_pair_after_the_other(rate: float, count: int) -> None:
    # s + k exp(-L s): pairs reach the axis at k L = (2 m + 1/2) pi
    for delay in (1e-3, 1.0, 1e3):
        found = zeros_of((1.0, 0.0, 1.0), (0.0, delay, rate * math.pi / delay))
        assert (bool(found.decided[0]), int(found.count[0])) == (True, count)


@pytest.mark.parametrize("first", [0.0, 0.5])
def test_two_delays_are_counted_as_the_sum_of_two_factors_zeros(first: float) -> None:
    # (s + a exp(-0.7 s)) (s + b exp(-1.1 s)): each factor by the rule above
    for a, b, count in ((1.0, 1.0, 0), (2.5, 1.0, 2), (2.5, 2.0, 4), (12.0, 2.0, 6)):
        product = ((2.0, first, 1.0), (1.0, first + 0.7, a), (1.0, first + 1.1, b), (0.0, first + 1.8, a * b))
        found = zeros_of(*product)
        assert (bool(found.decided[0]), int(found.count[0])) == (True, count)


def test_with_fewer_intervals_allowed_more_is_left_undecided_and_nothing_is_said_wrongly() -> None:
    terms = ((1.0, 0.0, 1.0), (0.0, 0.0, 0.5), (0.0, 300.0, 2.0))
    rows = [[np.array([[value[k] for value in terms]]) for k in (2, 0)], np.array([term[1] for term in terms])]
    (coefficients, orders), delays = rows
    few, many = (count_zeros(coefficients, orders, delays, limit) for limit in (3, 30_000))
    assert (bool(few.decided[0]), int(few.count[0])) == (False, -1)
    assert bool(many.decided[0])
    assert int(many.count[0]) > 100


def test_intervals_that_are_open_after_the_last_halving_leave_it_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    assert of_polynomials([[1.0, 2e-6, 1.0]]).decided[0]
    monkeypatch.setattr(winding, "_MOST_HALVINGS", 2)
    found = of_polynomials([[1.0, 2e-6, 1.0], [1.0, 2.0, 1.0]])
    assert found.decided.tolist() == [False, True]
    assert found.count.tolist() == [-1, 0]


Terms = list[tuple[float, float, float]]


def certified(terms: Terms, first: float, last: float) -> tuple[bool, float]:
    """Whether the sum of c s^q exp(-d s), given as (q, d, c), is called certain between two ln w, and the turn told."""
    orders, delays, coefficients = (np.array(column) for column in zip(*terms, strict=True))
    family = winding._Family.of(coefficients[None], orders[None], delays)
    ends = (winding._Points.of(family, np.zeros(1, np.intp), np.array([z])) for z in (first, last))
    certain, turn = winding._certificate(family, np.zeros(1, np.intp), *ends)
    return bool(certain[0]), float(turn[0])


def true_turn(terms: Terms, first: float, last: float, samples: int = 2001) -> float:
    """By dense sampling: the angle by which the curve turns between two ln w."""
    s = 1j * np.exp(np.linspace(first, last, samples))
    values = np.sum([c * s**q * np.exp(-d * s) for q, d, c in terms], axis=0)
    steps = np.angle(values[1:] / values[:-1])
    assert np.max(np.abs(steps)) < 2.0, "too few samples to know the turn"
    return float(np.sum(steps))


def test_what_is_called_certain_turns_as_a_dense_sampling_of_the_curve_does() -> None:
    rng = np.random.default_rng(12)
    checked = outweighed = 0
    for _ in range(800):
        k = int(rng.integers(2, 6))
        orders = rng.uniform(0.0, 3.0, k) * (rng.random(k) < 0.8)
        delays = rng.choice([0.0, 0.1, 1.0, 4.0], k) * (rng.random() < 0.7)
        orders, delays = orders - orders.min(), delays - delays.min()  # a common power or delay is left out
        coefficients = rng.normal(size=k) * 10.0 ** rng.uniform(-2.0, 1.0, k)
        terms = list(zip(orders.tolist(), delays.tolist(), coefficients.tolist(), strict=True))
        first = rng.uniform(-2.0, 1.5)
        last = first + 10.0 ** rng.uniform(-2.0, 0.3)
        certain, turn = certified(terms, first, last)
        if certain:
            assert turn == pytest.approx(true_turn(terms, first, last), abs=1e-7), terms
            checked += 1
            outweighed += abs(turn) > math.pi
    assert checked > 200
    assert outweighed > 3


def double_zero(orders: list[float], delays: list[float]) -> Terms:
    """Coefficients, for five terms, with which the curve comes to zero at w = 1 and turns back there."""
    q, d = np.array(orders), np.array(delays)
    values = 1j**q * np.exp(-1j * d)
    slopes = values * (q - 1j * d)
    coefficients = np.linalg.svd(np.array([values.real, values.imag, slopes.real, slopes.imag]))[2][-1]
    return list(zip(orders, delays, coefficients.tolist(), strict=True))


@pytest.mark.parametrize("half", [0.3, 0.1, 0.03, 0.01])
def test_an_interval_in_which_the_curve_touches_zero_is_never_called_certain(half: float) -> None:
    rng = np.random.default_rng(3)
    for delays in ([0.0, 0.0, 0.3, 0.3, 0.0], [0.0, 0.1, 0.2, 0.5, 0.0], [0.0, 1.0, 1.0, 2.0, 0.0]):
        for _ in range(100):
            terms = double_zero([*rng.uniform(0.0, 3.0, 4).tolist(), 0.0], delays)
            assert not certified(terms, -half, half)[0], terms


@pytest.mark.parametrize("order", [2.0, 6.0])
def test_the_bound_is_nearly_attained_by_a_double_zero_and_still_is_one(order: float) -> None:
    # (1 + s^q)^2: from -h to h the chord is sinh(h)^2 from zero, and h^2 exp(2 h) bounds what the curve leaves it by
    touching = [(0.0, 0.0, 1.0), (order, 0.0, 2.0), (2.0 * order, 0.0, 1.0)]
    for half in (0.1, 0.01, 0.001):
        assert not certified(touching, -half / order, half / order)[0]
        kept_away = [(0.0, 0.0, 1.0), (order, 0.0, 2.0 - 0.5 * half**2), (2.0 * order, 0.0, 1.0)]
        assert true_turn(kept_away, -half / order, half / order) == pytest.approx(0.0, abs=1e-9)
    assert certified(kept_away, -half / order, half / order)[0]


@pytest.mark.parametrize("half", [1.0, 2.0, 3.0, 5.0])
def test_a_wide_interval_in_which_slow_terms_turn_by_more_than_the_chord_is_not_called_certain(half: float) -> None:
    slow = [(0.0, 0.0, 1.0), (0.05, 0.0, -2.0), (0.1, 0.0, 1.0)]  # (1 - s^0.05)^2: zeros at s = 1, not on the axis
    assert not certified(slow, -half, half)[0]


@pytest.mark.parametrize("delayed", [0.1, 0.9, 0.99, 1.01, 10.0])
def test_where_one_term_outweighs_the_others_any_interval_is_certain_and_the_turn_is_that_of_the_curve(
    delayed: float,
) -> None:
    terms = [(0.0, 0.0, 1.0), (0.0, 30.0, delayed)]
    for first, last in ((-1.0, 2.0), (-3.0, 0.0), (0.5, 0.6)):
        certain, turn = certified(terms, first, last)
        assert certain
        assert turn == pytest.approx(true_turn(terms, first, last, samples=40_001), abs=1e-7)


def test_terms_of_one_delay_that_go_through_zero_outweigh_nothing() -> None:
    weak = 0.01  # (s^2 + 1) (1 + weak exp(-3 s)) is zero at w = 1
    through = [(2.0, 0.0, 1.0), (0.0, 0.0, 1.0), (2.0, 3.0, weak), (0.0, 3.0, weak)]
    for first, last in ((-0.1, 0.15), (-0.3, 0.3), (-0.02, 0.01)):
        assert not certified(through, first, last)[0]


@pytest.mark.parametrize("gain", [0.0, 0.5, 0.9, 0.99])
def test_above_the_last_point_the_leading_term_outweighs_all_others_together(gain: float) -> None:
    # k lower terms, each as large as it may be where the grid ends
    for lower in (1, 3, 8):
        coefficients = np.array([[1.0, gain, *(lower * [2.0])]])
        orders = np.array([[1.0, 1.0, *(lower * [0.0])]])
        delays = np.array([0.0, 0.3, *range(1, lower + 1)])
        end = float(winding._Family.of(coefficients, orders, delays).end[0])
        assert gain + lower * 2.0 * math.exp(-end) < 1.0
