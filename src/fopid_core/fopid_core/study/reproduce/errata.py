"""What is wrong in the paper: where, what is printed, what is right, and a check that shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from fopid_core.study.reproduce import errata_equations as equations
from fopid_core.study.reproduce import errata_tables as tables
from fopid_core.study.reproduce.errata_equations import Finding
from fopid_core.study.reproduce.table import minus_signs


@dataclass(frozen=True)
class Erratum:
    """A misprint or an error of method.

    Attributes
    ----------
    key : str
        Its name.
    place : str
        Where in the paper.
    printed, right : str
    check : callable
        Finds the figures that show it.
    """

    key: str
    place: str
    printed: str
    right: str
    check: Callable[[], Finding]

    @cached_property
    def finding(self) -> Finding:
        """What the check found."""
        return self.check()


ERRATA = (
    Erratum(
        "controller-cosine", "Eqs. (20) to (22)",
        "The imaginary part of C(jω) is Kd ω^μ sin(μπ/2) − Ki ω^−λ cos(λπ/2).",
        "− Ki ω^−λ sin(λπ/2), in all three. A misprint.",
        equations.controller_formulas,
    ),
    Erratum(
        "phase-slope-signs", "Eq. (19)",
        "The second and the third term of the numerator are subtracted.",
        "They are added: the slope is −L − (2ζωₙ(α−β)ω^(α+β−1) sin((α−β)π/2) + αωₙ²ω^(α−1) sin(απ/2) + "
        "2βζωₙ³ω^(β−1) sin(βπ/2)) / (…). A misprint.",
        equations.model_phase_slope,
    ),
    Erratum(
        "arctangent", "Eqs. (18) and (21)",
        "The phase is an arctangent of a quotient.",
        "With α above 1 the quotient's denominator changes sign as ω grows, and the phase needs the quadrant as well "
        "(atan2); otherwise it jumps by 180°.",
        equations.arctangent,
    ),
    Erratum(
        "table-1-objective", "Table 1",
        "The minima of J = ‖P − P̃‖₂, eqs. (10) and (11).",
        "They are not the H2 norms of the printed models' errors; what they are we have not found.",
        equations.objective_of_table_1,
    ),
    Erratum(
        "table-1-p4", "Tables 1 and 2, P4",
        "NIOPTD-II has the smaller error (0.0099 against 0.0137 of SOPTD).",
        "In the norm of eq. (10) the printed NIOPTD-II is the worse of the two. Its optimum cannot be, because SOPTD "
        "is one of its cases (α = 2, β = 1): what is printed is no optimum of eq. (11).",
        equations.nioptd2_of_p4,
    ),
    Erratum(
        "table-3-delay", "Table 3",
        "A phase margin of 80° on all four processes.",
        "73° to 77°. The delay's phase ωL, in radians, was subtracted from a phase in degrees.",
        equations.phase_margins,
    ),
    Erratum(
        "table-3-bounds", "Section 3.3 and Table 3",
        "The five equations (1) to (5) are solved, with |T(10j)| = −40 dB and |S(0.01j)| = −40 dB.",
        "Only (2) and (3) are met (and (1), but for the delay). No controller with gains of one sign meets all five "
        "for P1, P3 and P4, as the table of our designs shows; and (4) and (5) are inequalities over whole bands, "
        "which equations at the bands' edges do not ensure.",
        equations.bounds_of_table_3,
    ),
    Erratum(
        "finite-difference", "Tables 4 to 7",
        "Indices, overshoot and rise time; how the responses were computed is not said.",
        "They are those of first-order Grünwald-Letnikov differences in steps of 0.01 s, and err by as much as these.",
        tables.first_order_differences,
    ),
    Erratum(
        "double-precision", "Tables 4 and 6",
        "Indices to four decimals.",
        "Those that weight late errors hold rounding errors. In steps of h a difference of order α has the factor "
        "h^−α, up to 10^10 for P3, and so have the last bits of the output.",
        tables.rounding_errors,
    ),
    Erratum(
        "p4-ise", "Table 7, ISE",
        "Overshoot 4.5 %, rise time 0.02 s, J = 0.0101.",
        "The loop is faster than the step it was computed with: what is printed is the response of the difference "
        "equation, not of the loop.",
        tables.step_of_p4_ise,
    ),
    Erratum(
        "p4-iae-sum", "Table 7, IAE and the sum",
        "Overshoot 1.6 % and 1.8 %.",
        "The same error, smaller.",
        tables.overshoots_of_p4,
    ),
    Erratum(
        "p3-itae", "Table 6, ITAE",
        "Overshoot 9.0 %.",
        "0.9 %. A misprint.",
        tables.overshoot_of_p3_itae,
    ),
    Erratum(
        "p4-sum", "Table 7, the sum",
        "J = 0.4637.",
        "Not the sum of the indices of that controller, by the paper's own method either.",
        tables.sum_of_p4,
    ),
    Erratum(
        "indices-of-other-gains", "Tables 4 to 7",
        "The minima and the gains that have them.",
        "Most of those below do not belong together: the index is that of other gains. So have overshoot and rise time "
        "of P2 IAE.",
        tables.rows_not_reproduced,
    ),
    Erratum(
        "sum-below-parts", "Tables 4 and 7, the sum",
        "The smallest sum of all indices.",
        "It is smaller than the printed minima of the six indices together, so some of those are no minima.",
        tables.sums_below_their_parts,
    ),
    Erratum(
        "no-minima", "Tables 4 to 7",
        "The global minimum of each index.",
        "Most are not even the smallest of the seven in their own table.",
        tables.minima_beaten_in_their_own_table,
    ),
    Erratum(
        "search-interval", "Section 4.1",
        "Kp, Ki and Kd are searched in [1, 500].",
        "Most of the results lie outside; perhaps [0, 500] was meant.",
        tables.gains_outside_the_box,
    ),
    Erratum(
        "infinite-horizon", "Section 4.1, eqs. (24) to (29)",
        "Integrals to infinity, which become independent of the upper limit.",
        "With λ not whole the error falls off as t^−λ, and most of these integrals do not exist. An index means "
        "something only together with its horizon, here 50 s.",
        equations.diverging_indices,
    ),
    Erratum(
        "rise-time", "Tables 4 to 7",
        "A rise time tᵣ that is not defined.",
        "It is the time of first reaching the setpoint, not that from 10 to 90 %.",
        tables.rise_times,
    ),
    Erratum(
        "infinite-control", "Section 5.2 and Fig. 10",
        "Control signals are compared by their size.",
        "After a setpoint step the control of an ideal derivative is infinite: the peak in the figure is that of the "
        "step it was computed with. Peaks can be compared for one stated sample time only.",
        tables.infinite_control,
    ),
    Erratum(
        "minimum-phase", "Abstract and section 1",
        "For minimum and non-minimum phase processes.",
        "None of the four has a zero or a delay, so nothing is shown for non-minimum phase.",
        equations.minimum_phase_bench,
    ),
)  # fmt: skip
"""All that was found, in the order of the paper but for its abstract."""

WORDING = (
    "Section 5.1 refers to Fig. 1 for overshoot that stays constant; that is Fig. 2.",
    "Section 4.1 calls MATLAB's fmincon a Nelder-Mead simplex; that is fminsearch.",
)
"""Slips with nothing to compute."""


def errata_markdown(errata: tuple[Erratum, ...] = ERRATA) -> str:
    """The page ``docs/errata.md``."""
    head = """# Errata of the paper

S. Das, S. Saha, S. Das, A. Gupta, *On the selection of tuning methodology of FOPID controllers for the control of
higher order processes*, ISA Transactions 50(3), 2011.

Each entry: what is printed, what is right, and what a check of our own finds (`fopid_core.study.reproduce`). This page
is written by `fopid reproduce`, which leaves it in its folder as `errata.md`.
"""
    parts = [head]
    for number, erratum in enumerate(errata, 1):
        parts.append(
            f"## {number}. {erratum.place}\n\n- **Printed:** {erratum.printed}\n- **Right:** {erratum.right}\n"
            f"- **Check** (`{erratum.key}`): {minus_signs(erratum.finding.says)}\n"
        )
    parts.append("## Slips of wording\n\n" + "\n".join(f"- {text}" for text in WORDING) + "\n")
    return "\n".join(parts)
