"""A table is the same on the page, as CSV and as records."""

from __future__ import annotations

import csv
import io

import pytest

from fopid_core.study.reproduce.table import Column, Table, minus_signs

TABLE = Table(
    "t", "title", "note",
    (Column("tuned for"), Column("rise", "s", ".2f"), Column("meaning", under=True)),
    (("IAE", 1.234567, "a < b, -3 dB"), ("ISE", float("inf"), "none")),
)  # fmt: skip


def test_csv_reads_back_with_all_digits() -> None:
    rows = list(csv.reader(io.StringIO(TABLE.csv())))
    assert rows == [["tuned for", "rise [s]", "meaning"], ["IAE", "1.234567", "a < b, -3 dB"], ["ISE", "inf", "none"]]


def test_records_are_named_by_column() -> None:
    assert TABLE.records()[0] == {"tuned for": "IAE", "rise [s]": 1.234567, "meaning": "a < b, -3 dB"}


def test_the_page_shows_rounded_numbers_and_the_meaning_below_its_row() -> None:
    html = TABLE.html()
    assert "<td>1.23</td>" in html
    assert "<td>∞</td>" in html
    assert "meaning" not in html  # one line below needs no name
    assert 'colspan="2"' in html
    assert html.index("1.23") < html.index("a &lt; b, −3 dB") < html.index("ISE")


def test_several_lines_below_are_named() -> None:
    columns = (Column("a"), Column("first", under=True), Column("second", under=True))
    html = Table("t", "", "", columns, (("x", "y", "z"),)).html()
    assert "<span>first</span> y" in html
    assert "<span>second</span> z" in html


@pytest.mark.parametrize(
    ("text", "shown"),
    [("-1", "−1"), ("a -1.5, (-2)", "a −1.5, (−2)"), ("1e-3", "1e-3"), ("x^-2", "x^−2"), ("NIOPTD-2", "NIOPTD-2")],
)
def test_only_signs_of_numbers_become_minus_signs(text: str, shown: str) -> None:
    assert minus_signs(text) == shown
