"""Checks of what is wrong in the paper's equations, models and Table 3."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.study.reproduce import printed_formulas
from fopid_core.study.reproduce.facts import (
    HORIZON,
    PROCESSES,
    S_MAX,
    T_MAX,
    PrintedDesign,
    PrintedModel,
    PrintedTuning,
    printed_design,
    printed_designs,
    printed_model,
    printed_models,
    printed_tunings,
)
from fopid_core.study.reproduce.frequency_table import loop_at_crossover, phase_margin_at
from fopid_core.study.reproduce.model_table import h2_error_of
from fopid_core.study.reproduce.time_table import exact_figures, rounding_effect


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes
    ----------
    says : str
        The figures, in a sentence or two.
    confirmed : bool
        Whether they show the error.
    """

    says: str
    confirmed: bool


def controller_formulas() -> Finding:
    """|C| and arg C at the crossover of P1's design, by eqs. (20) to (22) and by complex arithmetic."""
    design = printed_design("P1")
    w, controller = design.crossover, design.controller
    value = complex(controller(1j * w))
    slope = float((1j * controller.derivative(1j * w) / controller(1j * w)).imag)
    printed = (
        printed_formulas.controller_gain(controller, w),
        math.degrees(printed_formulas.controller_phase(controller, w)),
        printed_formulas.controller_phase_slope(controller, w),
    )
    right = abs(value), math.degrees(cmath.phase(value)), slope
    gain = abs(value * design.model(1j * w).item())
    says = (
        f"C(0.3j) of P1's design by eqs. (20) to (22): gain {printed[0]:.3f}, phase {printed[1]:.1f}°, slope "
        f"{printed[2]:.2f} rad·s; by complex arithmetic: {right[0]:.3f}, {right[1]:.1f}°, {right[2]:.2f} rad·s. "
        f"Table 3 was computed with the sine: with it |L| at the crossover is {gain:.3f}, with the cosine "
        f"{gain * printed[0] / right[0]:.3f}."
    )
    return Finding(says, abs(printed[0] / right[0] - 1.0) > 0.01 and abs(gain - 1.0) < 1e-3)


def model_phase_slope() -> Finding:
    """The slope of the model's phase at the crossover of Table 3, by eq. (19) and from P'(s)/P(s)."""
    parts, confirmed = [], True
    for design in printed_designs():
        printed = printed_model(design.process, "nioptd2")
        wrong = printed_formulas.model_phase_slope(printed.parameters, design.crossover)
        right = float(printed.model.logarithmic_derivative(1j * design.crossover).real)
        parts.append(f"{design.process} {wrong:.3f} for {right:.3f}")
        confirmed &= abs(wrong - right) > 0.1 * abs(right)
    slopes = [loop_at_crossover(d.model, d).slope for d in printed_designs()]
    says = (
        f"d arg P/dω [rad·s] at the crossover by eq. (19), for the true one: {', '.join(parts)}. Table 3 was computed "
        f"with the right signs: its loops have |ω·d arg L/dω| ≤ {max(map(abs, slopes)):.4f} rad there."
    )
    return Finding(says, confirmed)


def arctangent() -> Finding:
    """The phase of P1's model above the frequency where its denominator's real part changes sign."""
    printed = printed_model("P1", "nioptd2")
    w = np.geomspace(1e-3, 10.0, 2001)
    right = math.degrees(np.unwrap(np.angle(printed.model(1j * w)))[-1])
    wrong = math.degrees(printed_formulas.model_phase(printed.parameters, 10.0))
    says = f"Phase of P1's NIOPTD-II at 10 rad/s: {wrong:.1f}° by eq. (18), {right:.1f}° in truth."
    return Finding(says, abs(abs(wrong - right) - 180.0) < 1e-6)


def objective_of_table_1() -> Finding:
    """Table 1's J over the H2 error, and over the largest error at any frequency, of the model that Table 2 prints."""
    h2 = [printed.objective / h2_error_of(printed) for printed in printed_models()]
    largest = [printed.objective / _largest_error(printed) for printed in printed_models()]
    says = (
        f"J over the H2 norm of the printed model's error lies between {min(h2):.2f} and {max(h2):.2f} over the 16 "
        f"models, J over its H∞ norm between {min(largest):.2f} and {max(largest):.2f}: J is no multiple of either."
    )
    return Finding(says, max(h2) > 2.0 * min(h2) and max(largest) > 2.0 * min(largest))


def _largest_error(printed: PrintedModel) -> float:
    s = 1j * np.logspace(-4.0, 4.0, 8001)
    return float(np.abs(read_process(printed.process)(s) - printed.model(s)).max())


def nioptd2_of_p4() -> Finding:
    """NIOPTD-II contains SOPTD, so its optimum cannot be worse."""
    soptd, nioptd2 = (h2_error_of(printed_model("P4", name)) for name in ("soptd", "nioptd2"))
    says = f"H2 error of the printed models of P4: SOPTD {soptd:.5f}, NIOPTD-II {nioptd2:.5f}."
    return Finding(says, nioptd2 > soptd)


def phase_margins() -> Finding:
    """Phase margins of Table 3 on the models it was designed on, and how far from 80° plus w L taken as degrees."""
    margins, parts, confirmed = [], [], True
    for design in printed_designs():
        model, delay_phase = design.model, design.crossover * design.model.delay
        margins.append(math.degrees(phase_margin_at(model, design.controller, design.crossover)))
        above = math.degrees(phase_margin_at(model.without_delay(), design.controller, design.crossover)) - 80.0
        rounding = _margin_rounding(design)
        parts.append(f"{design.process} {above:.3f} (±{rounding:.3f}) and {delay_phase:.3f}")
        confirmed &= abs(above - delay_phase) <= rounding < above
    found = ", ".join(f"{p} {m:.1f}°" for p, m in zip(PROCESSES, margins, strict=True))
    says = (
        f"Phase margins at the crossover: {found}. Without the delay they are a little above 80°, and that little, in "
        f"degrees, is ωL, in radians, within the rounding of the gains: {', '.join(parts)}."
    )
    return Finding(says, confirmed and max(margins) < 78.0)


def _margin_rounding(design: PrintedDesign) -> float:
    model = design.model.without_delay()

    def margin(controller: Fopid) -> float:
        return math.degrees(phase_margin_at(model, controller, design.crossover))

    return rounding_effect(design.controller, margin)


def bounds_of_table_3() -> Finding:
    """|T(10j)| and |S(0.01j)| of Table 3 on the models it was designed on."""
    parts, broken = [], 0
    for design in printed_designs():
        found = loop_at_crossover(design.model, design)
        broken += (found.t_db > T_MAX.db) + (found.s_db > S_MAX.db)
        parts.append(f"{design.process} {found.t_db:.1f} and {found.s_db:.1f} dB")
    says = (
        f"Largest |T| from 10 rad/s up and largest |S| up to 0.01 rad/s: {', '.join(parts)}; {broken} of the 8 are "
        "above −40 dB."
    )
    return Finding(says, broken > 0)


def diverging_indices() -> Finding:
    """Which integrals to infinity exist: e(t) falls off as t^-lam when lam is not a whole number."""
    diverging = [t for t in printed_tunings() if _diverges(t.controller.lam, t.index)]
    worst = max(diverging, key=_growth)
    says = (
        f"{len(diverging)} of the 28 integrals are infinite: the error falls off as t^−λ only (λ not whole). From 50 s "
        f"to 500 s {worst.index} of {worst.process}, with the controller tuned for it, grows {_growth(worst):.0f}-fold."
    )
    return Finding(says, len(diverging) > 0)


_POWERS = {
    "IAE": (0, 1),
    "ISE": (0, 2),
    "ITAE": (1, 1),
    "ITSE": (1, 2),
    "ISTES": (4, 2),
    "ISTSE": (2, 2),
    "SUM": (4, 2),
}
"""Powers of t and of e in the index; the fastest growing one for the sum."""


def _diverges(lam: float, index: str) -> bool:
    of_time, of_error = _POWERS[index]
    return lam != round(lam) and of_time - of_error * lam >= -1.0


def _growth(tuning: PrintedTuning) -> float:
    """The index up to ten times the horizon over that up to the horizon."""
    longer, usual = (exact_figures(tuning.loop, tuning.index, horizon) for horizon in (10.0 * HORIZON, HORIZON))
    return longer.value / usual.value


def minimum_phase_bench() -> Finding:
    """Zeros and delays of the test bench."""
    counts = {p: sum(t.order > 0.0 for t in read_process(p).numerator.terms) for p in PROCESSES}
    says = f"Powers of s in the numerators of P1 to P4: {sum(counts.values())}; delays: {_delays():g} s."
    return Finding(says, sum(counts.values()) == 0)


def _delays() -> float:
    return sum(read_process(p).delay for p in PROCESSES)
