"""Tables 4 to 7: the paper's way gives the paper's figures, with exceptions that are named."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.study.reproduce.facts import printed_tuning, printed_tunings
from fopid_core.study.reproduce.time_table import (
    StepFigures,
    compared_table,
    exact_figures,
    gl_figures,
    outside,
    rounding_effect,
    time_row,
    tuned_table,
)

ROWS = [pytest.param(t, id=f"{t.process} {t.index}") for t in printed_tunings()]
OTHER_OVERSHOOT = {("P2", "IAE"), ("P3", "ITAE")}
OTHER_RISE = {("P2", "IAE"), ("P2", "ISE"), ("P3", "ISTSE"), ("P4", "ISTES"), ("P4", "ISTSE")}


@functools.cache
def gl(process: str, index: str) -> StepFigures:
    return gl_figures(printed_tuning(process, index).loop, index)


@pytest.mark.parametrize("printed", ROWS)
def test_gl_gives_the_printed_index_within_the_stated_tolerance(printed) -> None:
    value = gl(printed.process, printed.index).value
    if (printed.process, printed.index) == ("P4", "SUM"):
        assert value == pytest.approx(0.4071, abs=1e-4)  # 12 % below what is printed
    else:
        tight = printed.process == "P1" and printed.index != "SUM"
        assert value == pytest.approx(printed.value, rel=0.003 if tight else 0.025)


@pytest.mark.parametrize("printed", ROWS)
def test_gl_gives_overshoot_and_rise_time_to_the_printed_digits_but_for_named_rows(printed) -> None:
    row, found = (printed.process, printed.index), gl(printed.process, printed.index)
    assert (f"{found.overshoot_pct:.1f}" == f"{printed.overshoot_pct:.1f}") == (row not in OTHER_OVERSHOOT)
    assert (f"{found.rise_time:.2f}" == f"{printed.rise_time:.2f}") == (row not in OTHER_RISE)
    assert found.rise_time == pytest.approx(printed.rise_time, abs=0.055)


@pytest.mark.slow
def test_a_row_that_agrees_and_one_that_does_not_are_told_apart() -> None:
    rows = tuple(time_row(printed_tuning("P3", index)) for index in ("IAE", "ITAE"))
    good, bad = compared_table(6, rows).records()
    assert "overshoot" not in good["what it means"]
    assert "overshoot 0.9 % for 9.0 %" in bad["what it means"]
    assert "index +1.03 % (rounding explains 0.17 %)" in bad["what it means"]
    assert outside(rows) == (
        "GL misses the index within 2.5 % for none; the overshoot to the digit for P3 ITAE; "
        "the rise time to the digit for none."
    )


@pytest.mark.slow
def test_our_tuning_is_better_within_the_printed_controllers_own_bounds() -> None:
    row = time_row(printed_tuning("P1", "ITAE"))
    assert row.beaten
    assert row.within.achieved.ms <= row.ms * 1.0001
    ours = exact_figures(Loop(row.printed.loop.process, row.within.controller), "ITAE")
    assert ours.value == pytest.approx(row.within.cost, rel=2e-3)  # the search's own accuracy is 1e-3
    assert ours.value < 0.5 * row.exact.value
    (record,) = tuned_table(4, (row,)).records()
    assert record["ours / printed"] == pytest.approx(row.within.cost / row.exact.value)


def test_the_effect_of_rounding_bounds_what_rounding_does() -> None:
    def value(gains: Fopid) -> float:
        return gains.kp * gains.ki + gains.mu**2

    printed = Fopid(2.0, 3.0, 0.0, 1.0, 0.5)
    bound = rounding_effect(printed, value)
    rng = np.random.default_rng(0)
    for change in rng.uniform(-5e-5, 5e-5, (50, 5)):
        moved = value(Fopid(*(np.array(printed.gains) + change)))
        assert abs(moved - value(printed)) <= bound * (1.0 + 1e-4)  # first order
