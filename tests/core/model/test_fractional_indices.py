"""Indices, peaks and margins of fractional loops, with delay and without, are as exact as they say."""

from __future__ import annotations

from .index_campaign import judged, loops


def test_a_fractional_loop_with_delay_is_as_exact_as_it_says() -> None:
    row = judged(loops(3, 4)[3])  # neutral
    assert (row["wrong"], row["told"]) == ([], 6)
