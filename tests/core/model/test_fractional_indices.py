"""Indices, peaks and margins of fractional loops, with delay and without, are as exact as they say."""

from __future__ import annotations

from fractions import Fraction

from .index_campaign import judged, loops
from .random_loops import RandomLoop


def test_a_fractional_loop_with_delay_is_as_exact_as_it_says() -> None:
    row = judged(loops(3, 4)[3])  # neutral
    assert (row["wrong"], row["told"]) == ([], 6)


def test_a_cusp_between_two_samples_deceives_no_index() -> None:
    """Both rules of Simpson agreed there: IAE was off by 6e-7 and said 2e-7."""
    half, one = Fraction(1, 2), Fraction(1)
    gains = (Fraction("0.1196"), Fraction("0.06137"), Fraction("0.03964"), half, half)
    case = RandomLoop("cusp", (), ({one: Fraction("0.5995"), Fraction(0): one},), Fraction("2.635"), gains, 3.296)
    row = judged(case)
    assert (row["wrong"], row["told"]) == ([], 6)
