"""Figures 9 and 10: a step of the setpoint, then one of the load, and the control that answers them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.loop import Loop
from fopid_core.model.response import Response, Source, step_response
from fopid_core.study.reports.plotly_parts import BLUE, RED
from fopid_core.study.reproduce.drawing import Curve, Mark, Panel, PaperFigure, thinned
from fopid_core.study.reproduce.facts import PROCESSES, printed_design, printed_tuning
from fopid_core.study.reproduce.time_figures import TIME_LABEL, VISIBLE, with_legend

LOAD_AT = {"P1": 40.0, "P2": 20.0, "P3": 100.0, "P4": 15.0}
"""When the load comes [s]; as long again is shown."""

_POINTS = 2000  # up to the load
_KICK = 0.01  # of the window: its first part, whose control may be out of all proportion


@dataclass(frozen=True)
class Run:
    """A step of the setpoint, then one of the load; all arrays have shape (n,), ``time`` is in s."""

    time: Floats
    output: Floats
    control: Floats


def setpoint_then_load(loop: Loop, load_at: float, sampled: bool) -> Run:
    """A unit step of the setpoint at 0 and one of the load at ``load_at`` [s], exactly or sampled by GL.

    Examples
    --------
    >>> run = setpoint_then_load(printed_tuning("P2").loop, 20.0, sampled=True)
    >>> float(run.time[-1]), round(float(run.output[-1]), 2)
    (40.0, 1.0)
    """

    def answer(horizon: float, source: Source) -> Response:
        if sampled:
            return gl1_response(loop, horizon, PAPER_STEP, source)
        return step_response(loop, horizon, source, round(_POINTS * horizon / load_at) + 1)

    setpoint, load = answer(2.0 * load_at, "setpoint"), answer(load_at, "load")
    late = setpoint.time.size - load.time.size
    output, control = setpoint.output.copy(), setpoint.control.copy()
    output[late:] += load.output
    control[late:] += load.control
    return Run(setpoint.time, output, control)


def figure_9() -> PaperFigure:
    """Responses to a step of the setpoint and of the load."""
    caption = "Unit step of the setpoint at 0 and of the load at the mark, both kinds of design"
    remark = "Only for P2 has the frequency-domain design the smaller IAE after the load, though not the smaller peak."
    return PaperFigure(9, caption, remark, tuple(_outputs(process) for process in PROCESSES))


def _outputs(process: str) -> Panel:
    curves = tuple(
        curve
        for kind, colour, exact, sampled in _runs(process)
        for curve in _curves(kind, colour, (exact.time, exact.output), (sampled.time, sampled.output), 0.0)
    )
    return Panel(process, TIME_LABEL, "output", with_legend(curves), marks=(_load_mark(process),))


def figure_10() -> PaperFigure:
    """Control signals of the same."""
    panels = tuple(_controls(process) for process in PROCESSES)
    firsts = ", ".join(
        f"{process} {' and '.join(f'{sampled.control[0]:.0f}' for *_, sampled in _runs(process))}"
        for process in PROCESSES
    )
    remark = (
        f"First values by GL at 0.01 s, frequency and time, far above the axes: {firsts}. They belong to that step; an "
        "ideal derivative makes them infinite."
    )
    return PaperFigure(10, "Control signals of the same", remark, panels)


def _controls(process: str) -> Panel:
    curves: list[Curve] = []
    shown: list[float] = []
    begin = _KICK * 2.0 * LOAD_AT[process]
    for kind, colour, exact, sampled in _runs(process):
        curves += _curves(kind, colour, (exact.time, exact.control), (sampled.time, sampled.control), begin)
        later = exact.control[exact.time > begin]
        shown += [float(later.min()), float(later.max())]
    room = 0.1 * (max(shown) - min(shown))
    y_range = min(shown) - room, max(shown) + room
    marks = (_load_mark(process),)
    return Panel(process, TIME_LABEL, "control", with_legend(tuple(curves)), y_range=y_range, marks=marks)


@cache
def _runs(process: str) -> tuple[tuple[str, str, Run, Run], ...]:
    """Kind, colour, and the exact and the sampled run of both designs."""
    designs = ("frequency", BLUE, printed_design(process).loop), ("time", RED, printed_tuning(process).loop)
    at = LOAD_AT[process]
    return tuple(
        (kind, colour, setpoint_then_load(loop, at, sampled=False), setpoint_then_load(loop, at, sampled=True))
        for kind, colour, loop in designs
    )


def _curves(
    kind: str, colour: str, exact: tuple[Floats, Floats], sampled: tuple[Floats, Floats], begin: float
) -> tuple[Curve, ...]:
    """The exact signal, and GL's where one can see the difference after ``begin`` [s]."""
    curve = Curve(*_thinned(*exact), kind, colour)
    late = sampled[0] > begin
    if np.max(np.abs(np.interp(sampled[0][late], *exact) - sampled[1][late])) < VISIBLE:
        return (curve,)
    return curve, Curve(*_thinned(*sampled), f"{kind}, GL", colour, "dot", False)


def _thinned(time: Floats, signal: Floats) -> tuple[Floats, Floats]:
    """Fewer samples, close together after both steps."""
    change = time.size // 2
    before, after = thinned(time[:change], signal[:change]), thinned(time[change:], signal[change:])
    return np.concatenate((before[0], after[0])), np.concatenate((before[1], after[1]))


def _load_mark(process: str) -> Mark:
    return Mark(LOAD_AT[process], "load")
