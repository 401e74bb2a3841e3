"""The verdict's figures from rows that are known, and a page that says what is in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fopid_core.study.verdict import figures
from fopid_core.study.verdict.columns import CONTROLLERS, SCHEMA
from fopid_core.study.verdict.page import percent, reductions_by_kind, verdict
from fopid_core.study.verdict.statistics import by_case, is_known, median, reductions


def row(case: int, controller: str, iae: float, **more: Any) -> dict[str, Any]:
    usual = {
        "case": case, "kind": ("lag", "swing")[case % 2], "controller": controller, "status": "ok", "final_error": 0.0,
        "iae_load": iae, "running_iae": 1.02 * iae, "running_ms": 1.7, "ms": 1.6, "running_stable": True, "lam": 1.0,
        "mu": 1.1,
    }  # fmt: skip
    return {**dict.fromkeys(SCHEMA.names), **usual, **more}


def survey(count: int) -> list[dict[str, Any]]:
    """FOPID a tenth better than PID on one kind, not at all on the other."""
    parts = {"pi": 2.0, "fopi": 2.0, "pid": 1.0, "high order": 0.8}
    rows = [row(case, name, iae) for case in range(count) for name, iae in parts.items()]
    return rows + [row(case, "fopid", 0.9 if case % 2 else 1.0) for case in range(count)]


def test_reductions_are_those_of_the_rows_and_of_no_design_that_breaks_something() -> None:
    rows = survey(20)
    rows.append(row(20, "pid", 1.0))
    rows += [row(20, name, 0.1, status="a bound broken") for name in CONTROLLERS if name != "pid"]
    cases = by_case(rows)
    assert sorted(reductions(cases, "fopid", "pid").round(9)) == [0.0] * 10 + [0.1] * 10
    assert {name: values.mean().round(9) for name, values in reductions_by_kind(cases).items()} == {
        "lag": 0.0,
        "swing": 0.1,
    }


def test_a_load_that_is_not_rejected_is_no_figure() -> None:
    assert is_known(row(0, "pid", 1.0))
    assert not is_known(row(0, "pid", 1.0, final_error=-0.5))
    assert not is_known(row(0, "pid", 1.0, status="no design", iae_load=None))


def test_the_interval_covers_the_true_median_nineteen_times_of_twenty() -> None:
    """The oracle knows the distribution the samples are from."""
    random = np.random.default_rng(1)
    found = [median(random.exponential(size=60)) for _ in range(40)]
    covered = np.mean([one.low <= math.log(2.0) <= one.high for one in found])
    assert covered >= 0.85  # three standard deviations of 40 draws below 0.95


def test_the_page_says_how_many_processes_it_has_and_what_they_show(tmp_path: Path) -> None:
    cases = by_case(survey(20))
    text = verdict(cases, 40, [], [])
    assert "**20 of the survey's 40 processes are in this page**" in text
    assert "| swing | 10 | 10.0 (10.0 to 10.0) |" in text
    assert "less than 1 %, on 50 % less than 5 %" in text
    figures.draw_reductions(reductions_by_kind(cases), tmp_path / "r.png")
    figures.draw_orders(cases, tmp_path / "o.png")
    assert (tmp_path / "r.png").stat().st_size > 5000 < (tmp_path / "o.png").stat().st_size


def test_a_limit_that_a_design_beats_would_be_told() -> None:
    limits = [{"limit": 0.5, "error": 0.1, "pi": 2.0, "pid": 1.0, "fopid": 0.9, "high order": None}] * 9
    limits.append({**limits[0], "fopid": 0.4})
    text = verdict(by_case(survey(4)), 4, limits, [])
    assert "Designs below it: 1." in text
    assert "FOPID closes 20.0 (20.0 to 20.0) %" in text


def test_few_values_have_no_interval() -> None:
    assert percent(median([0.1, 0.3])) == "20.0"
    assert percent(median([])) == "-"
    assert median([0.5] * 5).low == pytest.approx(0.5)
