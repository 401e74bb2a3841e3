"""Checks of what is wrong in Tables 4 to 7, in the method behind them and in what is said about them."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.data import paper_tables
from fopid_core.errors import InputError
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.indices import rise_time
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from fopid_core.study.reproduce.errata_equations import Finding
from fopid_core.study.reproduce.facts import (
    HORIZON,
    INDICES,
    PROCESSES,
    PrintedTuning,
    printed_tuning,
    printed_tunings,
)
from fopid_core.study.reproduce.recursion import recursive_index
from fopid_core.study.reproduce.table import percent
from fopid_core.study.reproduce.time_table import exact_figures, gl_figures, rounding_of_index

_RUN = 500
"""Samples of a run: 5 s."""
_NOTED = 0.005
"""Relative difference of an index from which on it is listed."""


def first_order_differences() -> Finding:
    """The printed figures against GL at 10 ms and against the exact ones."""
    gl = [_distance(t, gl_figures(t.loop, t.index).value) for t in printed_tunings()]
    exact = [_distance(t, exact_figures(t.loop, t.index).value) for t in printed_tunings()]
    typical, largest = (percent(float(np.median(d)), ".2f") for d in (gl, exact)), (max(gl), max(exact))
    says = (
        f"Median distance of the printed index from first-order GL at 0.01 s and from the exact one: "
        f"{' and '.join(typical)}; the largest: {' and '.join(percent(d, '.0f') for d in largest)}."
    )
    return Finding(says, bool(np.median(gl) < 0.2 * np.median(exact)))


def _distance(tuning: PrintedTuning, value: float) -> float:
    return abs(value / tuning.value - 1.0)


def step_of_p4_ise() -> Finding:
    """P4 tuned for ISE: rises in one or two of the paper's steps."""
    tuning = printed_tuning("P4", "ISE")
    gl, exact = gl_figures(tuning.loop, "ISE"), exact_figures(tuning.loop, "ISE")
    ms = margins(tuning.loop).ms
    says = (
        f"GL at 0.01 s: overshoot {gl.overshoot_pct:.1f} %, ISE {gl.value:.4f}, rise time {gl.rise_time:.2f} s, two "
        f"steps. Exact: overshoot {exact.overshoot_pct:.0f} %, ISE {exact.value:.4f}, rise time "
        f"{exact.rise_time:.3f} s; max |S| is {ms:.1f}. {_run_of(tuning)}"
    )
    return Finding(says, exact.overshoot_pct > 10.0 * gl.overshoot_pct)


def _run_of(tuning: PrintedTuning) -> str:
    """What a sampled controller with the held plant makes of it."""
    controller = FopidController(ControllerSettings(tuning.controller, sample_time=PAPER_STEP))
    plant = Plant(PlantSettings(read_process(tuning.process), sample_time=PAPER_STEP))
    try:
        diverged = bool(np.abs(simulate(controller, plant, _RUN, lambda _: 1.0).measurement).max() > 1e6)
    except InputError:
        diverged = True
    return f"Run at 10 ms, with the control held between samples, the loop {'diverges' if diverged else 'is stable'}."


def overshoots_of_p4() -> Finding:
    """The other two fast rows of Table 7."""
    parts, confirmed = [], True
    for index in ("IAE", "SUM"):
        tuning = printed_tuning("P4", index)
        exact = exact_figures(tuning.loop, index).overshoot_pct
        parts.append(f"{index}: {exact:.1f} % for {tuning.overshoot_pct:.1f} % printed")
        confirmed &= exact > 2.0 * tuning.overshoot_pct
    return Finding(f"Exact overshoot of P4: {', '.join(parts)}.", confirmed)


def overshoot_of_p3_itae() -> Finding:
    """Table 6, ITAE: the decimal point."""
    tuning = printed_tuning("P3", "ITAE")
    gl, exact = gl_figures(tuning.loop, "ITAE"), exact_figures(tuning.loop, "ITAE")
    says = f"Overshoot by GL {gl.overshoot_pct:.2f} %, exact {exact.overshoot_pct:.2f} %; printed 9.0 %."
    return Finding(says, f"{gl.overshoot_pct:.1f}" == "0.9")


def sum_of_p4() -> Finding:
    """Table 7, the sum of all indices."""
    tuning = printed_tuning("P4", "SUM")
    gl, exact = gl_figures(tuning.loop, "SUM"), exact_figures(tuning.loop, "SUM")
    says = f"Sum of the six indices of that row: GL {gl.value:.4f}, exact {exact.value:.4f}; printed {tuning.value}."
    return Finding(says, abs(gl.value / tuning.value - 1.0) > 0.1)


def rounding_errors() -> Finding:
    """ITAE and ISTES of P1 without the rounding errors of a recursion in double precision, and with them."""
    rows = [printed_tuning(process, index) for process, index in (("P1", "ITAE"), ("P1", "ISTES"), ("P3", "ISTES"))]
    found = [(t, gl_figures(t.loop, t.index).value, recursive_index(t)) for t in rows]
    parts = [f"{t.index} of {t.process} {true:.5g}, {rounded:.5g}, {t.value:.5g}" for t, true, rounded in found]
    says = (
        "GL at 0.01 s without rounding errors, as a recursion in double precision (summed from the newest term on), "
        f"and printed: {'; '.join(parts)}."
    )
    explained = [_distance(t, rounded) < 1e-4 < _distance(t, true) for t, true, rounded in found[:2]]
    return Finding(says, all(explained))


def rows_not_reproduced() -> Finding:
    """Rows whose index does not come from their printed gains."""
    parts = []
    for tuning in printed_tunings():
        value = gl_figures(tuning.loop, tuning.index).value
        gap = value / tuning.value - 1.0
        if abs(gap) > _NOTED and abs(gap) > (of_gains := rounding_of_index(tuning)):
            of_recursion = abs(recursive_index(tuning) - value) / tuning.value
            parts.append(
                f"{tuning.process} {tuning.index} {percent(gap, '+.1f')} "
                f"({percent(of_gains, '.1f')}, {percent(of_recursion, '.1f')})"
            )
    says = (
        f"GL at 0.01 s misses {len(parts)} of the 28 printed indices by more than half a per cent and by more than the "
        "rounding of the gains explains (in brackets, and what the rounding errors of a recursion make): "
        f"{', '.join(parts)}."
    )
    return Finding(says, len(parts) > 0)


def sums_below_their_parts() -> Finding:
    """A sum of six indices cannot be below the sum of their six minima."""
    parts, confirmed = [], False
    for process in PROCESSES:
        least = sum(printed_tuning(process, index).value for index in INDICES[:-1])
        printed = printed_tuning(process, "SUM").value
        if printed < least:
            confirmed = True
            parts.append(f"{process}: sum {printed:.4f}, its six minima together {least:.4f}")
    return Finding(f"By the printed figures alone: {'; '.join(parts)}.", confirmed)


def minima_beaten_in_their_own_table() -> Finding:
    """Rows that another row of the same table beats at their own index, by the paper's own method."""
    beaten = {}
    for process in PROCESSES:
        loops = {index: printed_tuning(process, index).loop for index in INDICES}
        for index in INDICES:
            values = {by: gl_figures(loop, index).value for by, loop in loops.items()}
            best = min(values, key=lambda by: values[by])
            if best != index:
                beaten[process, index] = values[index] / values[best], best
    (process, index), (share, by) = max(beaten.items(), key=lambda item: item[1][0])
    says = (
        f"{len(beaten)} of the 28 are beaten by another row of the same table, by GL at 0.01 s as well; most of all "
        f"{index} of {process}, whose 'minimum' is {share:.0f} times that of the controller tuned for {by}."
    )
    return Finding(says, len(beaten) > 0)


def gains_outside_the_box() -> Finding:
    """The search interval of section 4.1."""
    low, high = paper_tables()["search_box"]["gains"]
    outside = [t for t in printed_tunings() if not all(low <= gain <= high for gain in t.controller.gains[:3])]
    least = min(min(t.controller.gains[:3]) for t in printed_tunings())
    says = f"{len(outside)} of the 28 controllers have a gain below {low:g}; the smallest is {least:g}."
    return Finding(says, len(outside) > 0)


def rise_times() -> Finding:
    """Which rise time is meant."""
    first, usual = [], []
    for tuning in printed_tunings():
        response = gl1_response(tuning.loop, HORIZON, PAPER_STEP)
        first.append(abs(gl_figures(tuning.loop, tuning.index).rise_time - tuning.rise_time))
        usual.append(abs(rise_time(response.time, response.output) - tuning.rise_time))
    says = (
        f"The time of first reaching the setpoint (GL) is within {max(first):.2f} s of all 28 printed figures; the "
        f"rise from 10 to 90 % is up to {max(usual):.1f} s away."
    )
    return Finding(says, max(first) < 0.06 < max(usual))


def infinite_control() -> Finding:
    """The control right after a setpoint step with an ideal derivative."""
    loop = printed_tuning("P1").loop
    peaks = [gl1_response(loop, 1.0, step).control_peak for step in (1e-2, 1e-3)]
    exact = step_response(loop, 1.0).control_peak
    says = (
        f"Largest control of P1's time-domain design after a unit step: {peaks[0]:.0f} when computed in steps of "
        f"10 ms, {peaks[1]:.0f} in steps of 1 ms, {'infinite' if math.isinf(exact) else f'{exact:.0f}'} in truth."
    )
    return Finding(says, peaks[1] > 5.0 * peaks[0])
