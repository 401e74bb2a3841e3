"""The table holds every measure, in units people read, at any width."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.study.reports.segment_table import COLUMNS, NOTHING, number, segment_table
from fopid_core.study.reports.segments import Segment

SEGMENT = Segment(
    name="step", method="frequency", gains=Fopid(1.2345, 0.5, 0.25, 0.9, 1.1), start=0.0, end=10.0, overshoot_pct=4.56,
    rise_time=1.5, settling_time=math.nan, iae=2.0, itae=3.25, error_peak=1.0, control_peak=12345.6, ms=math.inf,
    phase_margin=math.pi / 3,
)  # fmt: skip
TEXTS = [
    "step",
    "frequency",
    "1.23",
    "0.5",
    "0.25",
    "0.9",
    "1.1",
    "4.6",
    "1.5",
    NOTHING,
    "2",
    "3.25",
    "1",
    "12346",
    "∞",
    "60",
]


def test_every_column_has_its_text() -> None:
    assert [column.text(SEGMENT) for column in COLUMNS] == TEXTS


@pytest.mark.parametrize("count", [1, 5, 12])
@pytest.mark.parametrize("width", [40, 80, 120])
def test_no_number_is_cut_or_left_out(count: int, width: int) -> None:
    rows = [replace(SEGMENT, name=f"step {i}") for i in range(count)]
    text = segment_table(rows, width)
    assert max(map(len, text.splitlines())) <= width
    for value in TEXTS[2:]:
        assert text.count(value) >= count, value
    for column in COLUMNS:
        assert all(word in text for word in column.heading.split()), column.heading


def test_a_segment_with_unknown_gains_shows_dashes() -> None:
    unknown = replace(SEGMENT, gains=None, method="")
    assert [column.text(unknown) for column in COLUMNS][1:7] == [NOTHING] * 6


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-0.001234, "-0.00123"), (999.4, "999"), (123456.0, "123456"), (1e7, "1e+07"), (-math.inf, "−∞")],
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text
