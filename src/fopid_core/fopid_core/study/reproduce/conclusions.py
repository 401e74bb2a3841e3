"""The paper's conclusions as numbers: both kinds of design side by side, simulated exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from fopid_core.design.control_peak import first_control
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.study.reports.loop_figures import ISO_GAINS
from fopid_core.study.reproduce.facts import (
    HORIZON,
    PROCESSES,
    S_MAX,
    T_MAX,
    printed_design,
    printed_tuning,
)
from fopid_core.study.reproduce.table import Cell, Column, Table
from fopid_core.study.reproduce.time_table import PRACTICAL_MS, PRACTICAL_U

LONG_HORIZON = 200.0
"""On which the slowest of the loops has shown its overshoot [s]."""
FREQUENCY, TIME = "frequency", "time"


@dataclass(frozen=True)
class DesignFigures:
    """What section 5 compares, exactly.

    Attributes
    ----------
    overshoots : tuple of float
        For each loop gain of ``ISO_GAINS`` [%].
    t_db, s_db : float
        |T(10j)| and |S(0.01j)| [dB].
    first_control : float
        Right after a unit step of the setpoint, run at 10 ms.
    load_iae : float
        After a unit step of the load, over 50 s.
    ms : float
    """

    controller: Fopid
    overshoots: tuple[float, ...]
    t_db: float
    s_db: float
    first_control: float
    load_iae: float
    ms: float

    @property
    def spread(self) -> float:
        """Of the overshoots [points]."""
        return max(self.overshoots) - min(self.overshoots)


def design_figures(process: str, controller: Fopid) -> DesignFigures:
    """The figures of a controller.

    Examples
    --------
    >>> found = design_figures("P1", printed_design("P1").controller)
    >>> round(found.t_db, 1), round(found.spread, 1)
    (-53.3, 3.5)
    """
    loop = Loop(read_process(process), controller)
    load = step_response(loop, HORIZON, "load")
    return DesignFigures(
        controller,
        tuple(_overshoot(loop, gain) for gain in ISO_GAINS),
        _db(loop.complementary_sensitivity(1j * T_MAX.frequency).item()),
        _db(loop.sensitivity(1j * S_MAX.frequency).item()),
        float(first_control(np.array([controller.gains]), PAPER_STEP)[0]),
        indices(load.time, load.error).iae,
        margins(loop).ms,
    )


def _overshoot(loop: Loop, gain: float) -> float:
    """With another loop gain [%]; infinite when it makes the loop unstable."""
    scaled = Loop(loop.process.scaled(gain), loop.controller)
    return overshoot_pct(step_response(scaled, LONG_HORIZON).output) if stability(scaled).stable else math.inf


def _db(value: complex) -> float:
    return 20.0 * math.log10(abs(value))


def our_frequency_design(process: str) -> Fopid:
    """For the specification of Table 3 without its bounds; the control right after the step at most 20."""
    asked = printed_design(process)
    request = TuningRequest(read_process(process), phase_margin=asked.phase_margin, crossover=asked.crossover)
    return _controller(request)


def our_time_design(process: str) -> Fopid:
    """For the index of the design that section 5 compares, with Ms <= 1.6 and the same bound on the control."""
    index = printed_tuning(process).index.lower()
    request = TuningRequest(
        read_process(process), method="time", index=index, horizon=HORIZON, ms_max=PRACTICAL_MS, u_max=PRACTICAL_U
    )
    return _controller(request)


def _controller(request: TuningRequest) -> Fopid:
    controller = tune(request).controller
    assert controller is not None
    return controller


@dataclass(frozen=True)
class Pair:
    """Both kinds of design for one process."""

    process: str
    frequency: DesignFigures
    time: DesignFigures


@cache
def printed_pairs() -> tuple[Pair, ...]:
    """The paper's designs that section 5 compares."""
    return tuple(
        Pair(
            process,
            design_figures(process, printed_design(process).controller),
            design_figures(process, printed_tuning(process).controller),
        )
        for process in PROCESSES
    )


def our_pairs() -> tuple[Pair, ...]:
    """Our designs for the same purposes, both with a control of at most 20."""
    return tuple(
        Pair(p, design_figures(p, our_frequency_design(p)), design_figures(p, our_time_design(p))) for p in PROCESSES
    )


def figures_table(printed: tuple[Pair, ...], ours: tuple[Pair, ...]) -> Table:
    """Both methods on all four processes, the paper's designs and ours."""
    columns = (
        Column("process"), Column("design"),
        *(Column(f"overshoot at gain ×{gain:g}", "%", ".1f") for gain in ISO_GAINS),
        Column("spread", "points", ".1f"), Column("|T| at 10 rad/s", "dB", ".1f"),
        Column("|S| at 0.01 rad/s", "dB", ".1f"), Column("peak control", form=".1f"),
        Column("IAE of a load step", form=".3f"), Column("Ms", form=".2f"),
    )  # fmt: skip
    note = (
        "Exact responses. Peak control: right after a unit setpoint step, of the controller run at 10 ms (an ideal "
        f"derivative makes it infinite). IAE: over {HORIZON:g} s, after a unit step of the load. Our time-domain "
        f"designs have Ms ≤ {PRACTICAL_MS:g}; both of ours keep the control within {PRACTICAL_U:g}."
    )
    rows = [
        _cells(pair.process, f"{who}, {kind}", getattr(pair, kind))
        for pairs in zip(printed, ours, strict=True)
        for who, pair in zip(("paper", "ours"), pairs, strict=True)
        for kind in (FREQUENCY, TIME)
    ]
    return Table("conclusions", "What the conclusions rest on", note, columns, tuple(rows))


def _cells(process: str, design: str, found: DesignFigures) -> tuple[Cell, ...]:
    return (
        process, design, *found.overshoots, found.spread, found.t_db, found.s_db, found.first_control, found.load_iae,
        found.ms,
    )  # fmt: skip
