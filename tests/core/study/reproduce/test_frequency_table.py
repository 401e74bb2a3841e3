"""Table 3: what the printed designs meet, and what can be met."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.data import paper_tables
from fopid_core.study.reproduce.facts import printed_design, printed_designs
from fopid_core.study.reproduce.frequency_table import loop_at_crossover, our_designs, our_table, printed_table


@pytest.mark.parametrize("process", ["P1", "P2", "P3", "P4"])
def test_the_measures_are_those_of_complex_arithmetic(process: str) -> None:
    tables = paper_tables()
    row = next(r for r in tables["table3"] if r["process"] == process)
    model = next(
        r["paper_model"] for r in tables["table1_table2"] if (r["process"], r["template"]) == (process, "NIOPTD-II")
    )

    def opened(w: float, delay: float) -> complex:
        s = 1j * w
        controller = row["kp"] + row["ki"] * s ** -row["lam"] + row["kd"] * s ** row["mu"]
        reduced = model["K"] / (s ** model["alpha"] + model["a1"] * s ** model["beta"] + model["a0"])
        return controller * reduced * np.exp(-delay * s)

    w = row["crossover"]
    printed = printed_design(process)
    found = loop_at_crossover(printed.model, printed)
    assert found.gain == pytest.approx(abs(opened(w, model["L"])), rel=1e-12)
    for margin, delay in ((found.phase_margin, model["L"]), (found.phase_margin_without_delay, 0.0)):
        assert margin == pytest.approx(math.pi + np.angle(opened(w, delay)), rel=1e-12)
    change = np.angle(opened(w * (1 + 1e-6), model["L"]) / opened(w * (1 - 1e-6), model["L"])) / 2e-6
    assert found.slope == pytest.approx(change, abs=1e-8)  # central differences
    assert found.t_db == pytest.approx(row["exact_on_paper_model"]["T_at_10_dB"], abs=0.006)
    assert found.s_db == pytest.approx(row["exact_on_paper_model"]["S_at_0p01_dB"], abs=0.006)


def test_the_table_says_by_how_much_the_specification_is_missed() -> None:
    records = printed_table().records()
    assert len(records) == 8
    assert records[0]["what it means"] == "4.5° short of the phase margin; |S| 5.7 dB above its bound"
    assert all("short of the phase margin" in record["what it means"] for record in records)


@pytest.mark.slow
def test_our_designs_have_the_margin_and_say_which_bounds_cannot_be_met() -> None:
    designs = tuple(design for printed in printed_designs() for design in our_designs(printed))
    assert len(designs) == 12
    met = {(d.printed.process, d.made_on) for d in designs if d.bounded and d.result.success}
    assert met == {("P2", "paper's model"), ("P2", "process")}
    assert all(d.result.success for d in designs if not d.bounded)
    for record in our_table(designs).records():
        assert record["phase margin [°]"] == pytest.approx(80.0, abs=1e-6)
        assert (record["what can be met"] == "all met") or "dB" in record["what can be met"]
