"""Table 3: what the printed frequency-domain designs really meet, and our designs for the same specification."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.design.tuner import tune
from fopid_core.design.verification import achieved
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response
from fopid_core.study.reproduce.facts import S_MAX, T_MAX, PrintedDesign, printed_designs
from fopid_core.study.reproduce.table import Cell, Column, Table

SETTLED = 25.0
"""Times 1 / crossover after which a step response is over."""


@dataclass(frozen=True)
class LoopAtCrossover:
    """A loop seen at the crossover that was asked for, and on the bands of the bounds.

    ``gain`` is |L|; ``phase_margin`` [rad], also with the delay left out; ``slope`` is w d arg L / dw [rad];
    ``t_db`` and ``s_db`` are the largest |T| and |S| on their bands [dB].
    """

    gain: float
    phase_margin: float
    phase_margin_without_delay: float
    slope: float
    t_db: float
    s_db: float
    ms: float
    overshoot_pct: float


@dataclass(frozen=True)
class OurDesign:
    """A design of ours for the specification of a row, on the full process or on the paper's model."""

    printed: PrintedDesign
    made_on: str
    bounded: bool
    result: TuningResult


def loop_at_crossover(process: Process, printed: PrintedDesign) -> LoopAtCrossover:
    """A printed controller on a process.

    Examples
    --------
    >>> row = printed_designs()[0]
    >>> found = loop_at_crossover(row.model, row)
    >>> round(found.gain, 3), round(math.degrees(found.phase_margin), 1)
    (1.0, 75.5)
    """
    loop, s = Loop(process, printed.controller), 1j * printed.crossover
    measured = achieved(loop, T_MAX, S_MAX)
    slope = printed.crossover * float(loop.logarithmic_derivative(s).real)
    overshoot = overshoot_pct(step_response(loop, SETTLED / printed.crossover).output)
    return LoopAtCrossover(
        float(abs(loop(s))), phase_margin_at(process, printed.controller, printed.crossover),
        phase_margin_at(process.without_delay(), printed.controller, printed.crossover),
        slope, measured.t_db, measured.s_db, measured.ms, overshoot,
    )  # fmt: skip


def phase_margin_at(process: Process, controller: Fopid, crossover: float) -> float:
    """The angle from -1 to L at a frequency [rad], eq. (1), whatever |L| is there."""
    return math.pi + cmath.phase(Loop(process, controller)(1j * crossover).item())


def our_designs(printed: PrintedDesign) -> Iterator[OurDesign]:
    """For the same phase margin and crossover: with both bounds on the model and on the process, and without."""
    model, process = printed.model, read_process(printed.process)
    for made_on, on, bounded in (
        ("paper's model", model, True),
        ("process", process, True),
        ("process", process, False),
    ):
        request = TuningRequest(
            on, phase_margin=printed.phase_margin, crossover=printed.crossover,
            t_max=T_MAX if bounded else None, s_max=S_MAX if bounded else None,
        )  # fmt: skip
        yield OurDesign(printed, made_on, bounded, tune(request))


def printed_table() -> Table:
    """Table 3 with what its loops do, on the paper's model and on the full process."""
    columns = (
        Column("process"), Column("on"), *(Column(name, form=".4f") for name in ("kp", "ki", "kd", "λ", "μ")),
        Column("ωgc", "rad/s", ".1f"), Column("|L| there", form=".4f"), Column("margin printed", "°", ".0f"),
        Column("phase margin", "°", ".2f"), Column("without delay", "°", ".2f"),
        Column("ω·slope of phase", "rad", "z.3f"), Column("|T| for ω ≥ 10", "dB", ".1f"),
        Column("|S| for ω ≤ 0.01", "dB", ".1f"), Column("Ms", form=".2f"), Column("overshoot", "%", ".1f"),
        Column("what it means", under=True),
    )  # fmt: skip
    rows = [row for printed in printed_designs() for row in _printed_rows(printed)]
    note = (
        "The paper asks for a phase margin of 80°, a flat phase at the crossover, |T| ≤ −40 dB from 10 rad/s up and "
        "|S| ≤ −40 dB up to 0.01 rad/s. The overshoot is that of the exact step response."
    )
    return Table("table3", "Table 3: frequency-domain designs as printed", note, columns, tuple(rows))


def _printed_rows(printed: PrintedDesign) -> Iterator[tuple[Cell, ...]]:
    model, process = printed.model, read_process(printed.process)
    for name, on in (("paper's model", model), ("process", process)):
        found = loop_at_crossover(on, printed)
        yield (
            printed.process, name, *printed.controller.gains, printed.crossover, found.gain,
            math.degrees(printed.phase_margin), math.degrees(found.phase_margin),
            math.degrees(found.phase_margin_without_delay), found.slope, found.t_db, found.s_db, found.ms,
            found.overshoot_pct, remark(printed, found),
        )  # fmt: skip


def remark(printed: PrintedDesign, found: LoopAtCrossover) -> str:
    """What of the specification is not met, and by how much."""
    short = math.degrees(printed.phase_margin - found.phase_margin)
    parts = [f"{short:.1f}° short of the phase margin"]
    for name, value, bound in (("|T|", found.t_db, T_MAX), ("|S|", found.s_db, S_MAX)):
        if value > bound.db:
            parts.append(f"{name} {value - bound.db:.1f} dB above its bound")
    return "; ".join(parts)


def our_table(designs: tuple[OurDesign, ...]) -> Table:
    """Our designs, and which bounds can be met."""
    columns = (
        Column("process"), Column("made on"), Column("bounds"),
        *(Column(name, form=".4f") for name in ("kp", "ki", "kd", "λ", "μ")), Column("phase margin", "°", ".2f"),
        Column("|T| for ω ≥ 10", "dB", ".1f"), Column("|S| for ω ≤ 0.01", "dB", ".1f"), Column("Ms", form=".2f"),
        Column("what can be met", under=True),
    )  # fmt: skip
    note = (
        "For the same phase margin, crossover and flat phase, the whole plane of orders searched with gains of one "
        "sign: with both bounds, or without them (then |u| at most 20 right after the step). Margins and peaks are "
        "those on the system named."
    )
    rows = tuple(_our_cells(design) for design in designs)
    return Table("table3_ours", "Table 3: our designs for the same specification", note, columns, rows)


def _our_cells(design: OurDesign) -> tuple[Cell, ...]:
    controller = design.result.controller
    assert controller is not None
    on = read_process(design.printed.process) if design.made_on == "process" else design.printed.model
    found = achieved(Loop(on, controller), T_MAX, S_MAX)
    met = "all met" if design.result.success else "; ".join(design.result.unmet)
    return (
        design.printed.process, design.made_on, "both" if design.bounded else "none", *controller.gains,
        math.degrees(found.phase_margin), found.t_db, found.s_db, found.ms, met,
    )  # fmt: skip
