"""Figures 1 and 8: what the designs look like in frequency."""

from __future__ import annotations

import numpy as np

from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.study.reports.plotly_parts import BLUE, GREY, RED
from fopid_core.study.reproduce.drawing import Curve, Mark, Panel, PaperFigure
from fopid_core.study.reproduce.facts import PROCESSES, PrintedDesign, printed_design, printed_designs, printed_tuning
from fopid_core.study.reproduce.frequency_table import phase_margin_at

FREQUENCY_LABEL = "ω [rad/s]"
_POINTS = 241


def figure_1() -> PaperFigure:
    """Open-loop Bode diagrams with the flat phase at the crossover."""
    margins = [np.degrees(phase_margin_at(d.model, d.controller, d.crossover)) for d in printed_designs()]
    remark = (
        "The phase is flat at the crossover, but at "
        + ", ".join(f"{m - 180.0:.1f}° ({d.process})" for m, d in zip(margins, printed_designs(), strict=True))
        + " and not at −100°, which it would be without the delay."
    )
    caption = (
        "Open loop of the printed controllers with the NIOPTD-II models they were designed on, and with the processes"
    )
    panels = tuple(panel for design in printed_designs() for panel in _bode(design))
    return PaperFigure(1, caption, remark, panels)


def _bode(design: PrintedDesign) -> tuple[Panel, Panel]:
    w = design.crossover * np.logspace(-2.0, 2.0, _POINTS)
    systems = (
        ("model", design.model, BLUE, "solid"),
        ("process", read_process(design.process), RED, "dash"),
        ("model without delay", design.model.without_delay(), GREY, "dot"),
    )
    responses = [(name, Loop(on, design.controller)(1j * w), colour, dash) for name, on, colour, dash in systems]
    magnitude = tuple(Curve(w, _db(r), name, colour, dash) for name, r, colour, dash in responses[:2])
    phase = tuple(Curve(w, _degrees(r), name, colour, dash) for name, r, colour, dash in responses)
    mark = (Mark(design.crossover, "crossover"),)
    return (
        Panel(f"{design.process}: magnitude", FREQUENCY_LABEL, "|L| [dB]", magnitude, log_x=True, marks=mark),
        Panel(f"{design.process}: phase", FREQUENCY_LABEL, "arg L [°]", phase, True, (-270.0, -60.0), mark),
    )


def figure_8() -> PaperFigure:
    """Sensitivity and complementary sensitivity of both kinds of design."""
    caption = "|S| and |T| of the frequency-domain and of the time-domain design, with the full process"
    remark = "Time-domain designs: IAE for P1, ITAE for the others. P2's has the larger |S| at low frequencies."
    return PaperFigure(8, caption, remark, tuple(_sensitivities(process) for process in PROCESSES))


def _sensitivities(process: str) -> Panel:
    w = np.logspace(-3.0, 3.0, _POINTS)
    curves = []
    for kind, loop, dash in (
        ("frequency", printed_design(process).loop, "solid"),
        ("time", printed_tuning(process).loop, "dash"),
    ):
        curves.append(Curve(w, _db(loop.sensitivity(1j * w)), f"|S| {kind}", RED, dash))
        curves.append(Curve(w, _db(loop.complementary_sensitivity(1j * w)), f"|T| {kind}", BLUE, dash))
    return Panel(process, FREQUENCY_LABEL, "magnitude [dB]", tuple(curves), True, (-80.0, 10.0))


def _db(response: Complexes) -> Floats:
    return np.asarray(20.0 * np.log10(np.abs(response)), dtype=float)


def _degrees(response: Complexes) -> Floats:
    return np.asarray(np.degrees(np.unwrap(np.angle(response))), dtype=float)
