"""The table that compares runs: phases of one name below each other, with differences to the first run."""

from __future__ import annotations

import re
from dataclasses import replace

from fopid_core.model.fopid import Fopid
from fopid_core.study.reports.parts import comparison_table
from fopid_core.study.reports.segments import Segment

STEP = Segment("step", "start", Fopid(2.0, 0.5), 0.0, 10.0, 4.0, 1.0, 3.0, 0.8, 0.5, 1.0, 2.0, 1.5, 1.0)
LOAD = replace(STEP, name="load", overshoot_pct=float("nan"))


def rows(table: str) -> list[list[str]]:
    """The cells' texts, a difference in brackets."""
    body = re.search(r"<tbody>(.*)</tbody>", table, re.DOTALL)[1]
    marked = body.replace("<small>", " (").replace("</small>", ")")
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", marked, re.DOTALL)]


def cell(table: str, row: int, heading: str) -> str:
    headings = [re.sub("<small>.*?</small>", "", head) for head in re.findall(r"<th[^>]*>(.*?)</th>", table)]
    return rows(table)[row][headings.index(heading)]


def test_a_difference_is_a_share_of_the_first_runs_value_or_in_per_cent_and_degrees_itself() -> None:
    other = replace(STEP, gains=Fopid(2.5, 0.5), overshoot_pct=3.0, iae=0.6, phase_margin=1.1)
    table = comparison_table([[STEP], [other]], ["a", "b"])
    assert cell(table, 1, "kp") == "2.5 (+25 %)"
    assert cell(table, 1, "ki") == "0.5"  # the same
    assert cell(table, 1, "overshoot") == "3.0 (−1)"
    assert cell(table, 1, "IAE") == "0.6 (−25 %)"
    assert cell(table, 1, "phase margin") == "63 (+5.7)"
    assert cell(table, 0, "kp") == "2"


def test_from_nothing_the_difference_is_in_its_own_unit_and_to_nothing_there_is_none() -> None:
    other = replace(STEP, gains=Fopid(2.0, 0.5, 0.7), ms=float("nan"))
    table = comparison_table([[STEP], [other]], ["a", "b"])
    assert (cell(table, 1, "kd"), cell(table, 1, "Ms")) == ("0.7 (+0.7)", "–")


def test_phases_are_matched_by_name_and_those_of_one_run_alone_stand_alone() -> None:
    again = replace(STEP, iae=1.6)
    table = comparison_table([[STEP, LOAD, STEP], [STEP, again]], ["a", "b"])
    assert [(row[0], row[1]) for row in rows(table)] == [
        ("step", "a"),
        ("", "b"),
        ("load", "a"),
        ("step", "a"),
        ("", "b"),
    ]
    assert cell(table, 4, "IAE") == "1.6 (+100 %)"
    assert cell(table, 1, "IAE") == "0.8"


def test_what_only_a_later_run_has_has_no_difference() -> None:
    table = comparison_table([[STEP], [replace(LOAD, iae=3.0)]], ["a", "b"])
    assert [(row[0], row[1]) for row in rows(table)] == [("step", "a"), ("load", "b")]
    assert cell(table, 1, "IAE") == "3"
