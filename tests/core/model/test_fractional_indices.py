"""Indices, peaks and margins of fractional loops, with delay and without, are as exact as they say."""

from __future__ import annotations

import os

import pytest

from .index_campaign import judged, loops

LOOPS = int(os.environ.get("FOPID_LOOPS", "40"))


def misses(seed: int, count: int) -> tuple[list[str], int]:
    rows = [judged(case) for case in loops(seed, count)]
    return [f"{row['loop']}: {row['wrong']}" for row in rows if row["wrong"]], sum(row["told"] for row in rows)


def test_a_fractional_loop_with_delay_is_as_exact_as_it_says() -> None:
    row = judged(loops(3, 4)[3])  # neutral
    assert (row["wrong"], row["told"]) == ([], 6)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_fractional_loops_and_those_with_delay_are_as_exact_as_they_say() -> None:
    wrong, told = misses(20261124, LOOPS)
    assert wrong == []
    assert told > 3 * LOOPS
