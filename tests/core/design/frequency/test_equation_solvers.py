"""The paper's five equations and Monje's constrained optimisation, and what they are worth here."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.data import paper_tables
from fopid_core.design.frequency.equation_solvers import optimise_constrained, solve_equations
from fopid_core.design.frequency.exact_gains import exact_gains
from fopid_core.design.specification import Bound, FrequencySpecification
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.templates import TEMPLATES


def solvable(process: Process) -> tuple[Fopid, FrequencySpecification]:
    """A specification that a known controller meets to the letter: its own margin, crossover, |T| and |S|."""
    controller = Fopid(*exact_gains(process, 1.2, 0.5, [1.1], [0.9])[0])
    loop = Loop(process, controller)
    t_db, s_db = (
        20 * math.log10(abs(complex(f(1j * w))))
        for f, w in ((loop.complementary_sensitivity, 10.0), (loop.sensitivity, 0.01))
    )
    return controller, FrequencySpecification(1.2, 0.5, Bound(t_db, 10.0), Bound(s_db, 0.01))


def test_five_equations_with_a_solution_are_solved() -> None:
    process = read_process("P1")
    known, specification = solvable(process)
    design = solve_equations(process, specification)
    assert design.unmet == ()
    assert design.controller is not None
    assert design.controller.gains == pytest.approx(known.gains, rel=1e-5)


def test_constrained_optimisation_meets_constraints_that_can_be_met() -> None:
    process = read_process("P1")
    _, specification = solvable(process)
    design = optimise_constrained(process, specification)
    assert design.controller is not None
    left = design.residuals
    assert max(abs(left.phase_margin), abs(left.slope)) < 1e-4
    assert max(left.t_db, left.s_db) < 1e-3
    assert abs(left.gain_db) < 0.05


@pytest.mark.parametrize("row", paper_tables()["table3"], ids=lambda row: row["process"])
def test_the_papers_specifications_have_no_exact_solution_in_its_box(row: dict[str, float | str]) -> None:
    """On the paper's own NIOPTD-II models: an equation stays off, and it is said which, or a gain is negative."""
    models = {m["process"]: m["paper_model"] for m in paper_tables()["table1_table2"] if m["template"] == "NIOPTD-II"}
    process = TEMPLATES["nioptd2"].process(models[str(row["process"])])
    specification = FrequencySpecification(
        math.radians(float(row["phase_margin_deg"])), float(row["crossover"]), Bound(-40.0, 10.0), Bound(-40.0, 0.01)
    )
    design = solve_equations(process, specification)
    in_the_box = design.controller is not None and min(design.controller.gains[:3]) > 0.0
    assert design.unmet or not in_the_box
    assert all("off" in text or "allowed" in text for text in design.unmet)


def test_residuals_are_those_of_the_loop() -> None:
    process = read_process("P2")
    _, specification = solvable(process)
    design = optimise_constrained(process, specification)
    assert design.controller is not None
    loop = Loop(process, design.controller)
    wc = specification.crossover
    assert design.residuals.gain_db == pytest.approx(20 * math.log10(abs(complex(loop(1j * wc)))), abs=1e-9)
    turn = np.angle(complex(loop(1j * wc * 1.00001)) / complex(loop(1j * wc * 0.99999))) / 2e-5
    assert design.residuals.slope == pytest.approx(turn, abs=1e-5)


def test_five_equations_need_both_bounds() -> None:
    with pytest.raises(InputError, match="s_max"):
        solve_equations(read_process("P1"), FrequencySpecification(1.0, 1.0, t_max=Bound(-20.0, 10.0)))
