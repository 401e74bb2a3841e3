"""Figures 9 and 10: a step of the setpoint, then one of the load, and the control that answers them."""

from __future__ import annotations

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.loop import Loop
from fopid_core.model.response import Response, Source, step_response
from fopid_core.study.plotly_parts import BLUE, RED
from fopid_core.study.reproduce.drawing import Curve, Mark, Panel, PaperFigure, thinned
from fopid_core.study.reproduce.facts import PROCESSES, printed_design, printed_tuning
from fopid_core.study.reproduce.time_figures import TIME_LABEL, VISIBLE, with_legend

LOAD_AT = {"P1": 40.0, "P2": 20.0, "P3": 100.0, "P4": 15.0}
"""When the load comes [s]; as long again is shown."""

_POINTS = 2000  # up to the load
_KICK = 0.01  # of the window: its first part, whose control may be out of all proportion


def setpoint_then_load(loop: Loop, load_at: float, sampled: bool) -> tuple[Floats, Floats, Floats]:
    """Time, output and control: a unit step of the setpoint at 0 and one of the load at ``load_at`` [s].

    Examples
    --------
    >>> time, output, _ = setpoint_then_load(printed_tuning("P2").loop, 20.0, sampled=True)
    >>> float(time[-1]), round(float(output[-1]), 2)
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
    return setpoint.time, output, control


def figure_9() -> PaperFigure:
    """Responses to a step of the setpoint and of the load."""
    caption = "Unit step of the setpoint at 0 and of the load at the mark, both kinds of design"
    remark = "Only for P2 has the frequency-domain design the smaller IAE after the load, though not the smaller peak."
    return PaperFigure(9, caption, remark, tuple(_outputs(process) for process in PROCESSES))


def _outputs(process: str) -> Panel:
    curves = []
    for kind, loop, colour in _designs(process):
        time, output, _ = setpoint_then_load(loop, LOAD_AT[process], sampled=False)
        curves.append(Curve(*_thinned(time, output), kind, colour))
        sampled_time, sampled, _ = setpoint_then_load(loop, LOAD_AT[process], sampled=True)
        if np.max(np.abs(np.interp(sampled_time, time, output) - sampled)) > VISIBLE:
            curves.append(Curve(*_thinned(sampled_time, sampled), f"{kind}, GL", colour, "dot", False))
    return Panel(process, TIME_LABEL, "output", with_legend(tuple(curves)), marks=(_load_mark(process),))


def figure_10() -> PaperFigure:
    """Control signals of the same."""
    firsts, panels = [], []
    for process in PROCESSES:
        panel, kicks = _controls(process)
        panels.append(panel)
        firsts.append(f"{process} {kicks[0]:.0f} and {kicks[1]:.0f}")
    caption = "Control signals of the same, from GL at 0.01 s"
    remark = (
        f"First values, frequency and time, far above the axes: {', '.join(firsts)}. They belong to steps of 0.01 s; "
        "an ideal derivative makes them infinite."
    )
    return PaperFigure(10, caption, remark, tuple(panels))


def _controls(process: str) -> tuple[Panel, list[float]]:
    curves, kicks, shown = [], [], []
    for kind, loop, colour in _designs(process):
        time, _, control = setpoint_then_load(loop, LOAD_AT[process], sampled=True)
        kicks.append(float(control[0]))
        later = control[time > _KICK * time[-1]]
        shown += [float(later.min()), float(later.max())]
        curves.append(Curve(*_thinned(time, control), kind, colour))
    room = 0.1 * (max(shown) - min(shown))
    y_range = min(shown) - room, max(shown) + room
    marks = (_load_mark(process),)
    return Panel(process, TIME_LABEL, "control", tuple(curves), y_range=y_range, marks=marks), kicks


def _thinned(time: Floats, signal: Floats) -> tuple[Floats, Floats]:
    """Fewer samples, close together after both steps."""
    change = time.size // 2
    before, after = thinned(time[:change], signal[:change]), thinned(time[change:], signal[change:])
    return np.concatenate((before[0], after[0])), np.concatenate((before[1], after[1]))


def _designs(process: str) -> tuple[tuple[str, Loop, str], tuple[str, Loop, str]]:
    return ("frequency", printed_design(process).loop, BLUE), ("time", printed_tuning(process).loop, RED)


def _load_mark(process: str) -> Mark:
    return Mark(LOAD_AT[process], "load")
