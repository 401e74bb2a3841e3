"""The verdict in words and tables, whatever it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fopid_core.model.arrays import Booleans, Floats
from fopid_core.study.verdict.columns import HIGH_ORDER, STRUCTURES
from fopid_core.study.verdict.statistics import Case, Median, Row, is_known, median, reductions

WORTH = 0.05
"""A gain that a practitioner would look at."""
AGAIN = 0.01
"""Two searches agree when their costs differ by less, relative."""


def kinds(cases: Sequence[Case]) -> list[str]:
    """The kinds of process, in alphabetical order."""
    return sorted({case["pid"]["kind"] for case in cases})


def of_kind(cases: Sequence[Case], kind: str) -> list[Case]:
    """The processes of one kind."""
    return [case for case in cases if case["pid"]["kind"] == kind]


def reductions_by_kind(cases: Sequence[Case]) -> dict[str, Floats]:
    """By how much FOPID's load IAE is below PID's, for each kind where it is known."""
    found = {kind: reductions(of_kind(cases, kind), "fopid", "pid") for kind in kinds(cases)}
    return {kind: values for kind, values in found.items() if values.size}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def percent(found: Median) -> str:
    """A median with its interval in per cent.

    Examples
    --------
    >>> percent(Median(0.1234, 0.1, 0.15, 40)), percent(Median(0.2, float("nan"), float("nan"), 3))
    ('12.3 (10.0 to 15.0)', '20.0')
    """
    if found.count == 0:
        return "-"
    value = f"{100.0 * found.value:.1f}"
    return value if np.isnan(found.low) else f"{value} ({100.0 * found.low:.1f} to {100.0 * found.high:.1f})"


def share(values: Booleans) -> str:
    """Of true ones, in per cent."""
    return f"{100.0 * np.mean(values):.0f} %" if values.size else "-"


def verdict(cases: Sequence[Case], total: int, limits: Sequence[Row], paper: Sequence[Row]) -> str:
    """The generated part of the page.

    Parameters
    ----------
    cases : sequence of Case
        What is done of the survey.
    total : int
        How many processes it has.
    limits, paper : sequence of Row
        As ``samples`` makes them.
    """
    parts: list[str] = [
        _standing(cases, total), _short(cases), _by_kind(cases), _not_worth(cases), _orders(cases), _running(cases),
        _limits(limits), _paper(paper), _optima(cases),
    ]  # fmt: skip
    return "\n\n".join(parts)


def _standing(cases: Sequence[Case], total: int) -> str:
    whole = sum(all(is_known(case[name]) for name in STRUCTURES) for case in cases)
    return (
        f"**{len(cases):,} of the survey's {total:,} processes are in this page**, taken in an order drawn at random"
        f"{'' if len(cases) < total else ', that is all of them'}. All four structures keep the bounds and reject the "
        f"load on {whole:,} of them; a comparison below counts the processes on which both sides do."
    )


def _short(cases: Sequence[Case]) -> str:
    pairs = (
        ("pid", "pi", "PID against PI"), ("fopi", "pi", "FOPI against PI"), ("fopid", "pid", "FOPID against PID"),
        (HIGH_ORDER, "pid", "high order against PID"), (HIGH_ORDER, "fopid", "high order against FOPID"),
    )  # fmt: skip
    rows = []
    for better, than, words in pairs:
        values = reductions(cases, better, than)
        rows.append([words, str(values.size), percent(median(values)), share(values >= WORTH)])
    head = ["", "processes", "median reduction of load IAE [%] (95 % interval)", "at least 5 %"]
    return "## In short\n\n" + table(head, rows)


def _by_kind(cases: Sequence[Case]) -> str:
    rows = []
    found = reductions_by_kind(cases)
    for kind in sorted(found, key=lambda name: -float(np.median(found[name]))):
        own = of_kind(cases, kind)
        cells = [percent(median(reductions(own, better, than))) for better, than in
                 (("fopid", "pid"), ("fopi", "pi"), (HIGH_ORDER, "fopid"))]  # fmt: skip
        runs = percent(median(reductions(own, "fopid", "pid", "running_iae")))
        rows.append([kind, str(found[kind].size), cells[0], runs, cells[1], cells[2]])
    head = ["kind", "n", "FOPID against PID [%]", "the same as it runs [%]", "FOPI against PI [%]",
            "high order against FOPID [%]"]  # fmt: skip
    figure = "![Load IAE of FOPID below that of PID, by kind of process](verdict_reductions.png)"
    return f"## By kind of process\n\n{figure}\n\n{table(head, rows)}"


def _not_worth(cases: Sequence[Case]) -> str:
    values, runs = reductions(cases, "fopid", "pid"), reductions(cases, "fopid", "pid", "running_iae")
    fopi = reductions(cases, "fopi", "pi")
    found = reductions_by_kind(cases)
    medians = {kind: float(np.median(each)) for kind, each in found.items()}
    poor = [f"{kind} ({100.0 * value:.1f} %)" for kind, value in medians.items() if value < WORTH]
    return (
        "## Where it loses or is not worth it\n\n"
        f"- On {share(values < 0.01)} of the processes FOPID gains less than 1 %, on {share(values < WORTH)} less than "
        f"5 %. Every PID is a FOPID, so without ticks a loss can only be the search's.\n"
        f"- As it runs, sampled and band-limited, it loses to PID on {share(runs < 0.0)}.\n"
        f"- A fractional integral alone (FOPI) gains 1 % or more over PI on {share(fopi >= 0.01)}, 5 % or more on "
        f"{share(fopi >= WORTH)}.\n"
        f"- Kinds whose median gain is below 5 %: {', '.join(poor) or 'none'}."
    )


def _orders(cases: Sequence[Case]) -> str:
    rows = [case["fopid"] for case in cases if is_known(case["fopid"])]
    lam, mu = (np.array([row[name] for row in rows]) for name in ("lam", "mu"))

    def spread(values: Floats) -> str:
        low, middle, high = np.percentile(values, (10, 50, 90))
        return f"{middle:.3f}, eight of ten between {low:.3f} and {high:.3f}"

    return (
        "## What the orders tend to\n\n![Orders of the best FOPID](verdict_orders.png)\n\n"
        f"- lam: {spread(lam)}; within 0.02 of 1 on {share(np.abs(lam - 1.0) <= 0.02)}.\n"
        f"- mu: {spread(mu)}; above 1 on {share(mu > 1.0)}."
    )


def _running(cases: Sequence[Case]) -> str:
    rows = []
    for name in STRUCTURES:
        known = [case[name] for case in cases if is_known(case[name]) and case[name]["running_iae"]]
        dearer = np.array([row["running_iae"] / row["iae_load"] - 1.0 for row in known])
        higher = np.array([row["running_ms"] / row["ms"] - 1.0 for row in known])
        unstable = sum(case[name]["running_stable"] is False for case in cases if is_known(case[name]))
        rows.append([name.upper(), str(len(known)), percent(median(dearer)), percent(median(higher)),
                     f"{100.0 * np.percentile(higher, 95):.1f}", str(unstable)])  # fmt: skip
    head = ["", "n", "load IAE above the designed [%]", "Ms above the designed [%]", "its 95th percentile", "unstable"]
    return (
        "## As it runs\n\nThe process behind a hold, the controller's filter bank at ticks of 0.05 rad of the loop's "
        "speed.\n\n" + table(head, rows)
    )


def _limits(limits: Sequence[Row]) -> str:
    if not limits:
        return "## The limit of all linear controllers\n\nNot worked out in this run."
    rows: list[list[str]] = []
    for name in ("pi", "pid", "fopid", "high order"):
        known = [row for row in limits if row[name] and row["limit"]]
        times = median([row[name] / row["limit"] for row in known])
        rows.append([name.upper() if name != "high order" else name, str(times.count),
                     f"{times.value:.2f} ({times.low:.2f} to {times.high:.2f})"])  # fmt: skip
    closed = np.array([(row["pid"] - row["fopid"]) / (row["pid"] - row["limit"]) for row in limits])
    doubt = median([row["error"] / row["limit"] for row in limits if row["limit"]])
    beaten = sum(min(row[name] for name in ("pi", "pid", "fopid", "high order") if row[name]) < row["limit"]
                 for row in limits)  # fmt: skip
    return (
        f"## The limit of all linear controllers\n\n[The limit](limit.md) of {len(limits)} stable or integrating "
        f"processes, the first of the survey, on grids of 100 cells. Designs below it: {beaten}.\n\n"
        + table(["", "n", "load IAE, times the limit (95 % interval)"], rows)
        + f"\n\nFOPID closes {percent(median(closed))} % of what lies between PID and the limit. The limit is a lower "
        f"bound, and these grids are coarse: its estimated error has a median of {100.0 * doubt.value:.0f} % of it, so "
        "the share that is closed is at least this large."
    )


def _paper(paper: Sequence[Row]) -> str:
    if not paper:
        return "## The paper's conclusions\n\nNot looked at in this run."
    claims: dict[str, Callable[[Mapping[str, Any]], bool]] = {
        "designs by frequency spread the overshoot less when the gain is half to double":
            lambda row: row["spread by frequency"] < row["spread by time"],
        "time-domain designs reject loads better (IAE)":
            lambda row: row["load IAE by time"] < row["load IAE by frequency"],
        "time-domain designs ask for a larger control at the step":
            lambda row: row["peak by time"] > row["peak by frequency"],
    }  # fmt: skip
    rows = [[words, share(np.array([holds(row) for row in paper]))] for words, holds in claims.items()]
    return (
        f"## The paper's conclusions, beyond its four processes\n\nOn {len(paper)} processes of the survey: FOPID by "
        "frequency (60° at the natural crossover) and by ITAE of the setpoint step (max |S| at most 1.6), both with "
        "the defaults of `fopid tune`.\n\n" + table(["the paper says", "holds on"], rows)
    )


def _optima(cases: Sequence[Case]) -> str:
    again = [row for case in cases for row in case.values() if row["iae_again"] and row["iae_load"]]
    better = np.array([row["iae_again"] < (1.0 - AGAIN) * row["iae_load"] for row in again])
    counts = {name: dict.fromkeys(("ok", "a bound broken", "no design", "failed"), 0) for name in STRUCTURES}
    for case in cases:
        for name in STRUCTURES:
            counts[name][case[name]["status"]] += 1
    rows = [[name.upper(), *map(str, count.values())] for name, count in counts.items()]
    return (
        "## How good the optima are\n\n"
        f"Every bound was checked on the process itself by exact peaks. {len(again)} designs were searched a second "
        f"time from other random starts: the second search was better by more than 1 % on {share(better)}.\n\n"
        + table(["", "ok", "a bound broken", "no design", "failed"], rows)
    )
