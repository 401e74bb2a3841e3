"""The paper's claims, each decided for each process by exact simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fopid_core.model.indices import overshoot_pct, settling_time
from fopid_core.model.response import Response, step_response
from fopid_core.model.stability import stability
from fopid_core.study.reproduce.conclusions import FREQUENCY, LONG_HORIZON, TIME, DesignFigures, Pair
from fopid_core.study.reproduce.facts import (
    INDICES,
    PROCESSES,
    printed_design,
    printed_model,
    printed_tuning,
)
from fopid_core.study.reproduce.model_table import h2_error_of
from fopid_core.study.reproduce.table import Column, Table
from fopid_core.study.reproduce.time_table import StepFigures, exact_figures

SAME_LEVEL = 2.0
"""Overshoots within so many points count as the same."""
SLIGHTLY = 1.5
"""Up to this ratio a figure is slightly worse."""
BETTER_HALF = 3
"""A rank among the seven controllers of a table that counts as low."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, and for which processes it holds.

    ``ours`` is the same between our designs, empty where the claim is about the paper's alone; ``says`` holds the
    figures.
    """

    text: str
    place: str
    holds: Mapping[str, bool]
    ours: Mapping[str, bool]
    says: str

    @property
    def verdict(self) -> str:
        """In words."""
        return _count(self.holds)


def _count(holds: Mapping[str, bool]) -> str:
    holding = [process for process, held in holds.items() if held]
    failing = [process for process, held in holds.items() if not held]
    if not (holding and failing):
        return "holds" if holding else "does not hold"
    return f"not for {', '.join(failing)}" if len(holding) >= len(failing) else f"only for {', '.join(holding)}"


def claims(printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> tuple[Claim, ...]:
    """All claims, decided by exact simulation."""
    return (
        *compared_claims(printed, ours), _best_index(), _powers(), _time_weights(), _sum(), _accurate(), _stable(),
    )  # fmt: skip


def compared_claims(printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> tuple[Claim, ...]:
    """Those that compare the two kinds of design."""
    robust, *others, load, low = (_compared(comparison, printed, ours) for comparison in _COMPARISONS)
    return (robust, _same_overshoot(printed, ours), *others, load, _slightly_poorer(printed, ours), low)


@dataclass(frozen=True)
class _Comparison:
    """A claim that one kind of design has less of something than the other.

    ``bounded`` where our designs have the same bound on it, so that comparing them says nothing.
    """

    text: str
    place: str
    less: str
    measure: Callable[[DesignFigures], float]
    form: str
    bounded: bool = False


_COMPARISONS = (
    _Comparison(
        "Frequency-domain designs are more robust to the loop gain (×0.5 to ×2): smaller spread of the overshoot.",
        "Sections 5.1 and 6", FREQUENCY, lambda d: d.spread, "{:.1f} points",
    ),
    _Comparison(
        "Frequency-domain designs attenuate high-frequency noise better: smaller |T(10j)|.",
        "Sections 5.2 and 6", FREQUENCY, lambda d: d.t_db, "{:.1f} dB",
    ),
    _Comparison(
        "Frequency-domain designs need less control: a smaller peak after a setpoint step.",
        "Sections 5.2 and 6", FREQUENCY, lambda d: d.first_control, "{:.0f}", bounded=True,
    ),
    _Comparison(
        "Time-domain designs suppress load disturbances better: smaller IAE after a load step.",
        "Sections 5.2 and 6", TIME, lambda d: d.load_iae, "{:.2f}",
    ),
    _Comparison(
        "Time-domain designs have the smaller |S| at low frequencies: |S(0.01j)|.",
        "Section 5.2", TIME, lambda d: d.s_db, "{:.1f} dB",
    ),
)  # fmt: skip


def _compared(comparison: _Comparison, printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> Claim:
    def holds(pairs: tuple[Pair, ...]) -> dict[str, bool]:
        return {p.process: _values(comparison, p)[0] < _values(comparison, p)[1] for p in pairs}

    parts = [
        f"{pair.process} {comparison.form.format(_values(comparison, pair)[0])} against "
        f"{comparison.form.format(_values(comparison, pair)[1])}"
        for pair in printed
    ]
    of_ours = {} if comparison.bounded else holds(ours)
    return Claim(comparison.text, comparison.place, holds(printed), of_ours, "; ".join(parts))


def _values(comparison: _Comparison, pair: Pair) -> tuple[float, float]:
    """Of the kind that is said to have less, and of the other."""
    both = comparison.measure(pair.frequency), comparison.measure(pair.time)
    return both if comparison.less == FREQUENCY else both[::-1]


def _same_overshoot(printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> Claim:
    def holds(pairs: tuple[Pair, ...]) -> dict[str, bool]:
        return {pair.process: pair.frequency.spread <= SAME_LEVEL for pair in pairs}

    says = "; ".join(
        f"{p.process} {min(p.frequency.overshoots):.1f} to {max(p.frequency.overshoots):.1f} %" for p in printed
    )
    text = f"Their overshoot stays at the same level (within {SAME_LEVEL:g} points)."
    return Claim(text, "Section 3.3", holds(printed), holds(ours), says)


def _slightly_poorer(printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> Claim:
    def ratios(pairs: tuple[Pair, ...]) -> dict[str, float]:
        return {pair.process: pair.frequency.load_iae / pair.time.load_iae for pair in pairs}

    def holds(pairs: tuple[Pair, ...]) -> dict[str, bool]:
        return {process: ratio <= SLIGHTLY for process, ratio in ratios(pairs).items()}

    says = "; ".join(f"{process} {ratio:.1f} times" for process, ratio in ratios(printed).items())
    text = f"Frequency-domain designs answer a load only slightly worse: with at most {SLIGHTLY:g} times the IAE."
    return Claim(text, "Section 5.2", holds(printed), holds(ours), says)


def _best_index() -> Claim:
    holds, parts = {}, []
    for process in PROCESSES:
        index = printed_tuning(process).index
        found = {name: exact_figures(printed_tuning(process, name).loop, name) for name in INDICES}
        ranks = tuple(_rank(found, index, measure) for measure in ("overshoot_pct", "rise_time"))
        holds[process] = max(ranks) <= BETTER_HALF
        parts.append(f"{process} {index}: overshoot rank {ranks[0]}, rise time rank {ranks[1]}")
    text = (
        "Tuning for ITAE (IAE for P1) gives low overshoot together with a fast response: among the lowest "
        f"{BETTER_HALF} of the seven in both."
    )
    return Claim(text, "Section 4.2", holds, {}, "; ".join(parts))


def _rank(found: Mapping[str, StepFigures], index: str, measure: str) -> int:
    values = {name: float(getattr(figures, measure)) for name, figures in found.items()}
    return 1 + sum(value < values[index] for value in values.values())


def _powers() -> Claim:
    text = "Higher powers of the error prevent a large overshoot: tuned for ISE it is smaller than for IAE."
    return _between_indices(text, (("ISE", "IAE"),), lambda step: overshoot_pct(step.output), "{:.1f} %")


def _time_weights() -> Claim:
    text = (
        "Weights that grow with time shorten the settling (to 2 %): tuned for ITAE it is sooner than for IAE, and for "
        "ITSE than for ISE."
    )
    pairs = ("ITAE", "IAE"), ("ITSE", "ISE")
    return _between_indices(text, pairs, lambda step: settling_time(step.time, step.output), "{:.1f} s")


def _between_indices(
    text: str, pairs: tuple[tuple[str, str], ...], measure: Callable[[Response], float], form: str
) -> Claim:
    """That the controllers tuned for one index have less of something than those for another."""
    holds, parts = {}, []
    for process in PROCESSES:
        found = {
            index: measure(step_response(printed_tuning(process, index).loop, LONG_HORIZON))
            for pair in pairs
            for index in pair
        }
        holds[process] = all(found[less] < found[more] for less, more in pairs)
        shown = (f"{form.format(found[less])} against {form.format(found[more])}" for less, more in pairs)
        parts.append(f"{process} {' and '.join(shown)}")
    return Claim(text, "Section 4.1", holds, {}, "; ".join(parts))


def _sum() -> Claim:
    holds, parts = {}, []
    for process in PROCESSES:
        loop = printed_tuning(process, "SUM").loop
        better = [
            index
            for index in INDICES[:-1]
            if exact_figures(loop, index).value < exact_figures(printed_tuning(process, index).loop, index).value
        ]
        holds[process] = not better
        parts.append(f"{process} better for {', '.join(better) or 'none'}")
    text = "Minimising the sum of all indices gives a worse value of each index than minimising that index."
    return Claim(text, "Section 4.1", holds, {}, "The sum's controller: " + "; ".join(parts))


def _accurate() -> Claim:
    errors = {p: {n: h2_error_of(printed_model(p, n)) for n in ("soptd", "nioptd1", "nioptd2")} for p in PROCESSES}
    holds = {p: found["nioptd2"] == min(found.values()) for p, found in errors.items()}
    says = "; ".join(f"{p} {found['nioptd2']:.4f} against {found['soptd']:.4f} of SOPTD" for p, found in errors.items())
    text = "Of the printed models the NIOPTD-II is the most accurate, by the H2 norm of the error."
    return Claim(text, "Sections 3.2 and 5.3", holds, {}, says)


def _stable() -> Claim:
    loops = {p: [printed_design(p).loop, *(printed_tuning(p, index).loop for index in INDICES)] for p in PROCESSES}
    stable = {p: [stability(loop).stable for loop in found] for p, found in loops.items()}
    says = "; ".join(f"{p} {sum(found)} of {len(found)} loops are stable" for p, found in stable.items())
    text = "The loops are stable (as continuous loops; see the erratum on P4 ISE for the sampled one)."
    return Claim(text, "Sections 4.1 and 5.3", {p: all(found) for p, found in stable.items()}, {}, says)


def claims_table(found: tuple[Claim, ...]) -> Table:
    """The claims and their verdicts."""
    columns = (
        Column("claim"), Column("where"), Column("paper's designs"), Column("our designs"),
        Column("figures of the paper's", under=True),
    )  # fmt: skip
    rows = tuple(
        (claim.text, claim.place, claim.verdict, _count(claim.ours) if claim.ours else "", claim.says)
        for claim in found
    )
    note = (
        "By exact simulation with the full processes. Our designs have the same bound on the control, so that "
        "the methods are compared and not how far each was driven; its peaks, all at the bound, are not."
    )
    return Table("claims", "Which conclusions hold", note, columns, rows)
