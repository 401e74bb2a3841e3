"""Each erratum is shown by its check, and the checks would not show an error that is not there."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest

from fopid_core.data import paper_tables
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.fopid import Fopid
from fopid_core.study.reproduce import errata_equations, errata_tables, printed_formulas
from fopid_core.study.reproduce.errata import ERRATA, errata_markdown
from fopid_core.study.reproduce.facts import printed_designs, printed_model, printed_tuning

DOCS = Path(__file__).parents[4] / "docs" / "errata.md"
MODEL = printed_model("P1", "nioptd2").parameters


LONG = ("indices-of-other-gains", "double-precision")  # seconds each


@pytest.mark.parametrize(
    "erratum",
    [pytest.param(erratum, id=erratum.key, marks=[pytest.mark.slow] * (erratum.key in LONG)) for erratum in ERRATA],
)
def test_the_check_finds_the_error_and_gives_a_figure(erratum) -> None:
    assert erratum.finding.confirmed, erratum.finding.says
    assert re.search(r"\d", erratum.finding.says)


def test_names_are_unique() -> None:
    assert len({erratum.key for erratum in ERRATA}) == len(ERRATA)


@pytest.mark.slow
def test_the_page_in_the_docs_is_written_from_the_same_data() -> None:
    assert DOCS.read_text(encoding="utf-8") == errata_markdown(), "copy errata.md from the folder of `fopid reproduce`"


def test_eqs_20_to_22_are_right_where_sine_and_cosine_are_the_same() -> None:
    w, controller = 0.7, Fopid(1.5, 0.8, 0.4, 0.5, 0.9)  # cos = sin at lam = 1/2
    value = complex(controller(1j * w))
    assert printed_formulas.controller_gain(controller, w) == pytest.approx(abs(value), rel=1e-12)
    assert printed_formulas.controller_phase(controller, w) == pytest.approx(np.angle(value), rel=1e-12)
    slope = mpmath.diff(lambda x: mpmath.arg(1.5 + 0.8 * (1j * x) ** -0.5 + 0.4 * (1j * x) ** 0.9), w)
    assert printed_formulas.controller_phase_slope(controller, w) == pytest.approx(float(slope), rel=1e-9)


def true_slope(w: float) -> float:
    def phase(x):
        s = mpmath.mpc(0, x)
        denominator = s ** MODEL["alpha"] + MODEL["a1"] * s ** MODEL["beta"] + MODEL["a0"]
        return -x * MODEL["L"] - mpmath.arg(denominator)

    return float(mpmath.diff(phase, w))


def test_eq_18_is_right_below_the_frequency_where_its_quotient_changes_sign() -> None:
    s = 0.3j
    value = MODEL["K"] * np.exp(-MODEL["L"] * s)
    value /= s ** MODEL["alpha"] + MODEL["a1"] * s ** MODEL["beta"] + MODEL["a0"]
    assert printed_formulas.model_phase(MODEL, 0.3) == pytest.approx(np.angle(value), rel=1e-12)


def test_eq_19_is_right_once_its_signs_are() -> None:
    w, a, c = 0.3, MODEL["a0"], MODEL["a1"]
    alpha, beta = MODEL["alpha"], MODEL["beta"]
    minus = alpha * a * w ** (alpha - 1) * math.sin(alpha * math.pi / 2)
    minus += beta * c * a * w ** (beta - 1) * math.sin(beta * math.pi / 2)
    denominator = abs((1j * w) ** alpha + c * (1j * w) ** beta + a) ** 2
    mended = printed_formulas.model_phase_slope(MODEL, w) - 2.0 * minus / denominator
    assert mended == pytest.approx(true_slope(w), rel=1e-9)
    assert f"P1 1.327 for {true_slope(w):.3f}" in errata_equations.model_phase_slope().says


def test_right_formulas_would_not_be_taken_for_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(printed_formulas, "controller_gain", lambda c, w: abs(complex(c(1j * w))))
    assert not errata_equations.controller_formulas().confirmed
    monkeypatch.setattr(
        printed_formulas,
        "model_phase_slope",
        lambda parameters, w: next(
            float(d.model.logarithmic_derivative(1j * w).real)
            for d in printed_designs()
            if printed_model(d.process, "nioptd2").parameters == parameters
        ),
    )
    assert not errata_equations.model_phase_slope().confirmed


def test_designs_with_the_right_margin_would_not_be_taken_for_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    right = tuple(
        replace(
            d, controller=tune(TuningRequest(d.model, phase_margin=d.phase_margin, crossover=d.crossover)).controller
        )
        for d in printed_designs()
    )
    monkeypatch.setattr(errata_equations, "printed_designs", lambda: right)
    assert not errata_equations.phase_margins().confirmed


def test_the_delay_left_out_altogether_would_not_explain_table_3() -> None:
    for design in printed_designs():
        model = design.model.without_delay()
        s = 1j * design.crossover
        margin = 180.0 + math.degrees(np.angle(complex(design.controller(s) * model(s))))
        assert margin - 80.0 > 0.05  # degrees; the rounding of the gains is worth 0.023 at most


def test_sums_below_their_parts_need_the_printed_figures_only() -> None:
    printed = {(row["process"], row["index"]): row["paper"]["J"] for row in paper_tables()["table4_to_7"]}
    below = {
        p
        for p in ("P1", "P2", "P3", "P4")
        if printed[p, "SUM"] < sum(j for (q, i), j in printed.items() if (q, i) != (p, "SUM") and q == p)
    }
    assert below == {"P1", "P4"}
    says = errata_tables.sums_below_their_parts().says
    assert {p for p in ("P1", "P2", "P3", "P4") if p in says} == below


def test_the_error_falls_off_as_the_power_that_the_divergence_rests_on() -> None:
    tuning = printed_tuning("P2", "ITSE")  # lam = 0.8415
    lam, ki = tuning.controller.lam, tuning.controller.ki

    def transform(s):
        c = tuning.controller
        process = 9 / ((s + 1) * (s**2 + 2 * s + 9))
        return 1 / (s * (1 + (c.kp + c.ki * s**-lam + c.kd * s**c.mu) * process))

    time = 2000.0
    error = float(mpmath.invertlaplace(transform, time, method="talbot"))
    expected = time**-lam / (ki * math.gamma(1.0 - lam))
    assert error == pytest.approx(expected, rel=0.02)  # the next term is 1 / (ki t^lam) smaller
    assert errata_equations._diverges(lam, "ITSE")
    assert not errata_equations._diverges(lam, "ISE")
    assert not errata_equations._diverges(1.0, "ISTES")
