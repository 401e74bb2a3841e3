"""Tables 1 and 2: the printed models' errors, and ours."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.integrate import quad

from fopid_core.data import paper_tables
from fopid_core.model.process import Process
from fopid_core.study.reproduce.facts import printed_model, printed_models
from fopid_core.study.reproduce.model_table import h2_error, h2_error_of, model_row, model_table


def test_the_h2_error_of_rational_models_is_that_of_state_space() -> None:
    s = control.tf("s")
    difference = 1 / (s + 1) ** 3 - 0.5 / (s**2 + 1.3 * s + 0.5)
    expected = control.norm(control.ss(difference), 2)  # by the Lyapunov equation
    found = h2_error(Process.parse("1/(s+1)^3"), Process.parse("0.5/(s^2+1.3s+0.5)"))
    assert found == pytest.approx(expected, rel=1e-6)


def test_the_h2_error_of_a_fractional_model_is_the_integral() -> None:
    def squared(w: float) -> float:
        s = 1j * w
        process = 1 / (s + 1) ** 3
        model = 0.42456 / (s**2.109 + 1.2157 * s**1.015 + 0.42515) * np.exp(-0.2694 * s)
        return abs(process - model) ** 2

    pieces = [quad(squared, a, b, limit=500)[0] for a, b in ((0, 1), (1, 10), (10, 100), (100, 2000))]
    assert h2_error_of(printed_model("P1", "nioptd2")) == pytest.approx(np.sqrt(sum(pieces) / np.pi), rel=1e-4)


def test_the_errors_are_those_of_the_data() -> None:
    for printed, row in zip(printed_models(), paper_tables()["table1_table2"], strict=True):
        # the data have five decimals
        assert h2_error_of(printed) == pytest.approx(row["exact_H2_error_of_paper_model"], abs=1.5e-5)


def test_a_row_holds_an_optimum_that_is_better_and_says_so() -> None:
    row = model_row(printed_model("P4", "nioptd2"))
    assert row.best.h2_error == pytest.approx(0.0047, rel=1e-3)
    assert "0.73 times the norm" in row.remark
    assert "2.90 times the least" in row.remark
    assert "worse than SOPTD" in row.remark
    (record,) = model_table((row,)).records()
    assert record["printed J"] == 0.0099
    assert record["printed model / ours"] == pytest.approx(2.9, abs=0.01)
