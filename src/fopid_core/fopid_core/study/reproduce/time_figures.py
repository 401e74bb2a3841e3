"""Figures 2 to 7: step responses, exactly and, where one can see the difference, as the paper computed them."""

from __future__ import annotations

import numpy as np

from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.fopid import Fopid
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, RED
from fopid_core.study.reproduce.drawing import COLOURS, DOTTED_IS_GL, Curve, Panel, PaperFigure, thinned
from fopid_core.study.reproduce.facts import INDICES, PROCESSES, printed_design, printed_tuning

TIME_LABEL = "time [s]"
VISIBLE = 0.01
"""From this difference on, in units of the setpoint step, GL is drawn beside the exact response."""
GAINS = {0.5: GREEN, 1.0: BLUE, 2.0: RED}
"""Factors on the loop gain, and their colours."""
SLOW_WINDOW = {"P1": 60.0, "P2": 15.0, "P3": 150.0, "P4": 15.0}
"""In which the frequency-domain designs settle [s]."""
FAST_WINDOW = {"P1": 20.0, "P2": 10.0, "P3": 25.0, "P4": 8.0}
"""In which the time-domain designs settle [s]."""
GAIN_WINDOW = FAST_WINDOW | {"P4": 2.0}
"""In which they show what another loop gain does to them [s]."""
FIRST_WINDOW = {"P1": 4.0, "P2": 3.0, "P3": 5.0, "P4": 0.5}
"""In which most of them rise [s]."""

_POINTS = 4001


def step_curves(loop: Loop, window: float, name: str, colour: str) -> tuple[Curve, ...]:
    """The exact response, and GL's where one can see the difference.

    Examples
    --------
    >>> [curve.name for curve in step_curves(printed_tuning("P4", "ISE").loop, 0.5, "ISE", "red")]
    ['ISE', 'ISE, GL']
    """
    exact, sampled = step_response(loop, window, points=_POINTS), gl1_response(loop, window, PAPER_STEP)
    curve = Curve(*thinned(exact.time, exact.output), name, colour)
    distance = np.abs(np.interp(sampled.time, exact.time, exact.output) - sampled.output)
    if distance.max() < VISIBLE:
        return (curve,)
    return curve, Curve(*thinned(sampled.time, sampled.output), f"{name}, GL", colour, "dot", False)


def with_legend(curves: tuple[Curve, ...]) -> tuple[Curve, ...]:
    """The curves, and an entry in the legend for those of GL if there are any."""
    return curves if all(curve.in_legend for curve in curves) else (*curves, DOTTED_IS_GL)


def figure_2() -> PaperFigure:
    """Iso-damped responses of the frequency-domain designs."""
    panels = tuple(_iso_frequency(process) for process in PROCESSES)
    caption = (
        "Step responses of the frequency-domain designs at other loop gains, with the process, and (dashed, at the "
        "gain they were designed for) with the NIOPTD-II model"
    )
    remark = "The overshoot stays the same for P3 and nearly so for P1 and P4, but not for P2."
    return PaperFigure(2, caption, remark, panels)


def _iso_frequency(process: str) -> Panel:
    design, window = printed_design(process), SLOW_WINDOW[process]
    curves = _at_other_gains(read_process(process), design.controller, window)
    model = step_response(Loop(design.model, design.controller), window, points=_POINTS)
    dashed = Curve(*thinned(model.time, model.output), "gain ×1, model", BLUE, "dash")
    return Panel(process, TIME_LABEL, "output", with_legend((*curves, dashed)))


def _at_other_gains(process: Process, controller: Fopid, window: float) -> tuple[Curve, ...]:
    return tuple(
        curve
        for gain, colour in GAINS.items()
        for curve in step_curves(Loop(process.scaled(gain), controller), window, f"gain ×{gain:g}", colour)
    )


def index_figure(number: int, process: str) -> PaperFigure:
    """Figures 3 to 6: responses of the controllers tuned for each index, and how they begin."""
    windows = (("whole", FAST_WINDOW[process]), ("beginning", FIRST_WINDOW[process]))
    panels = tuple(
        Panel(f"{process}, {part}", TIME_LABEL, "output", with_legend(_of_all_indices(process, window)))
        for part, window in windows
    )
    both = [curve.name.removesuffix(", GL") for curve in panels[0].curves if not curve.in_legend]
    caption = f"Step responses of the controllers tuned for {process}, one for each index"
    named = "all" if len(both) == len(INDICES) else ", ".join(both)
    seen = f"GL differs by {VISIBLE:g} or more for {named}." if both else "GL lies on the exact curves."
    return PaperFigure(number, caption, f"{seen} What the paper shows is GL at 0.01 s.", panels)


def _of_all_indices(process: str, window: float) -> tuple[Curve, ...]:
    return tuple(
        curve
        for index, colour in zip(INDICES, COLOURS, strict=True)
        for curve in step_curves(printed_tuning(process, index).loop, window, index, colour)
    )


def figure_7() -> PaperFigure:
    """Loss of iso-damping in the time-domain designs."""
    panels = tuple(
        Panel(p, TIME_LABEL, "output", with_legend(_at_other_gains(read_process(p), tuning.controller, GAIN_WINDOW[p])))
        for p, tuning in ((p, printed_tuning(p)) for p in PROCESSES)
    )
    caption = "Step responses of the time-domain designs at other loop gains (IAE for P1, ITAE for the others)"
    remark = "The overshoot of P2 and P3 grows with the gain; that of P1 and P4 much less."
    return PaperFigure(7, caption, remark, panels)
