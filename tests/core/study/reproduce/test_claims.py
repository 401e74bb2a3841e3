"""The conclusions: figures of both kinds of design, and the verdicts that follow from them."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.integrate import trapezoid

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from fopid_core.study.reproduce.claims import Claim, claims, claims_table, compared_claims
from fopid_core.study.reproduce.conclusions import DesignFigures, Pair, design_figures, figures_table, printed_pairs

CLASSICAL = Fopid(2.0, 1.0, 0.5)


@pytest.mark.slow
def test_the_figures_are_those_of_python_control() -> None:
    found = design_figures("P1", CLASSICAL)
    s = control.tf("s")
    process, controller = 1 / (s + 1) ** 3, 2.0 + 1.0 / s + 0.5 * s
    loop = controller * process
    assert found.t_db == pytest.approx(20 * math.log10(abs(loop(10j) / (1 + loop(10j)))), abs=1e-9)
    assert found.s_db == pytest.approx(20 * math.log10(abs(1 / (1 + loop(0.01j)))), abs=1e-9)
    time = np.linspace(0.0, 50.0, 50_001)
    load = control.step_response(control.minreal(process / (1 + loop), verbose=False), time).outputs
    assert found.load_iae == pytest.approx(trapezoid(np.abs(load), time), rel=1e-4)
    for gain, overshoot in zip((0.5, 0.7, 1.0, 1.4, 2.0), found.overshoots, strict=True):
        closed = control.minreal(gain * loop / (1 + gain * loop), verbose=False)
        output = control.step_response(closed, time).outputs
        assert overshoot == pytest.approx(100.0 * (output.max() - 1.0), abs=0.01)


@pytest.mark.slow
def test_the_control_that_is_compared_is_the_peak_of_the_running_controller() -> None:
    designs = printed_pairs()[1]
    for figures_of in (designs.frequency, designs.time):
        controller = FopidController(ControllerSettings(figures_of.controller, sample_time=0.01))
        plant = Plant(PlantSettings(read_process("P2"), sample_time=0.01))
        run = simulate(controller, plant, 1000, lambda _: 1.0)
        peak = np.abs(run.control).max()
        assert figures_of.first_control == pytest.approx(peak, rel=1e-5)  # the controller fits its bank to its own band


def figures(**values: float) -> DesignFigures:
    plain = DesignFigures(CLASSICAL, (1.0, 1.0, 1.0, 1.0, 1.0), -30.0, -30.0, 10.0, 1.0, 1.2)
    return replace(plain, **values)


def verdicts(time_p2: DesignFigures) -> dict[str, Claim]:
    """With a time-domain design that attenuates noise worse everywhere, and another one for P2."""
    worse = figures(t_db=-10.0)
    pairs = tuple(Pair(p, figures(), time_p2 if p == "P2" else worse) for p in ("P1", "P2", "P3", "P4"))
    return {claim.text: claim for claim in compared_claims(pairs, pairs)}


def test_a_verdict_names_the_processes_it_does_not_hold_for() -> None:
    found = verdicts(figures(t_db=-50.0))
    (noise,) = [claim for text, claim in found.items() if "noise" in text]
    assert noise.holds == {"P1": True, "P2": False, "P3": True, "P4": True}
    assert noise.verdict == "not for P2"
    (control_needed,) = [claim for text, claim in found.items() if "less control" in text]
    assert control_needed.verdict == "does not hold"  # it is the same
    assert control_needed.ours == {}  # it is at its bound


def test_the_papers_claims_are_decided_as_its_own_designs_behave() -> None:
    pairs = printed_pairs()
    found = claims(pairs, pairs)
    assert [claim.verdict for claim in found] == [
        "holds",  # smaller spread of the overshoot
        "only for P3",  # the same overshoot
        "holds",  # noise
        "holds",  # control
        "not for P2",  # load
        "only for P2",  # slightly worse there
        "not for P2",  # |S| at low frequencies
        "does not hold",  # ITAE both low overshoot and fast
        "does not hold",  # ISE less overshoot than IAE
        "only for P3",  # ITAE settles sooner than IAE, ITSE than ISE
        "only for P2",  # the sum is worse than each
        "not for P4",  # NIOPTD-II the most accurate
        "holds",  # stable
    ]
    assert len(claims_table(found).rows) == len(found)
    rows = figures_table(pairs, pairs).records()
    assert len(rows) == 16
    p2 = {row["design"]: row for row in rows if row["process"] == "P2"}
    assert p2["paper, frequency"]["IAE of a load step"] < p2["paper, time"]["IAE of a load step"]
