"""Tables 4 to 7: the printed time-domain designs as the paper computed them, exactly, and against our own tuning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from fopid_core.design.control_peak import first_control
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.design.tuner import tune
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.fopid import Fopid
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.indices import Indices, indices, overshoot_pct, rise_time_to_100
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.study.reproduce.facts import HORIZON, PrintedTuning
from fopid_core.study.reproduce.table import Cell, Column, Table, percent

PRACTICAL_MS, PRACTICAL_U = 1.6, 20.0
"""Bounds on max |S| and on the control right after the step, of the controller run at 10 ms."""
INDEX_TOLERANCE = 0.025
"""Relative; how near GL's index is expected to be to the printed one."""
KEPT = 1.0 + 1e-6
"""A bound that is exceeded by less is kept."""
ROUNDING = 5e-5
"""Of the printed gains, orders and indices, which have four decimals."""


@dataclass(frozen=True)
class StepFigures:
    """The three figures of a row: the index, the overshoot [%] and the time to reach the setpoint [s]."""

    value: float
    overshoot_pct: float
    rise_time: float


@dataclass(frozen=True)
class TimeRow:
    """A row of Tables 4 to 7, computed.

    Attributes
    ----------
    printed : PrintedTuning
    gl, exact : StepFigures
        By first-order Gruenwald-Letnikov differences at 0.01 s, and without discretisation.
    rounding : float
        By how much the index can differ, relatively, for the rounding of what is printed (first order).
    ms, first_control : float
        max |S| and the control right after the step when run at 10 ms.
    within : TuningResult
        Our tuning for the same index with neither larger than the printed controller's, however few would trust it.
    practical : TuningResult
        Our tuning with ms <= 1.6 and a control of at most 20.
    """

    printed: PrintedTuning
    gl: StepFigures
    exact: StepFigures
    rounding: float
    ms: float
    first_control: float
    within: TuningResult
    practical: TuningResult

    @property
    def index_reproduced(self) -> bool:
        """Whether GL's index is as near to the printed one as expected."""
        return abs(self.gl.value / self.printed.value - 1.0) <= INDEX_TOLERANCE

    @property
    def beaten(self) -> bool:
        """Whether our tuning is better with neither Ms nor the control larger than the printed controller's.

        As continuous loops, which the paper compares; whether ours also runs at 10 ms is another question.
        """
        ours = self.within.controller
        if ours is None or not self.within.cost < self.exact.value:
            return False
        ms = margins(Loop(self.printed.loop.process, ours)).ms
        kick = float(first_control(np.array([ours.gains]), PAPER_STEP)[0])
        return ms <= self.ms * KEPT and kick <= self.first_control * KEPT

    @property
    def overshoot_reproduced(self) -> bool:
        """Whether GL's overshoot has the printed digits."""
        return f"{self.gl.overshoot_pct:.1f}" == f"{self.printed.overshoot_pct:.1f}"

    @property
    def rise_reproduced(self) -> bool:
        """Whether GL's rise time has the printed digits."""
        return f"{self.gl.rise_time:.2f}" == f"{self.printed.rise_time:.2f}"


def index_value(found: Indices, index: str) -> float:
    """An index by the paper's name, ``SUM`` for eq. (30) with equal weights.

    Examples
    --------
    >>> index_value(Indices(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "SUM")
    21.0
    """
    return found.weighted_sum() if index == "SUM" else float(getattr(found, index.lower()))


def gl_figures(loop: Loop, index: str) -> StepFigures:
    """As the paper computed them: trapezoid rule, and the first sample at or above the setpoint."""
    measured, overshoot, rise = _by_gl(loop)
    return StepFigures(index_value(measured, index), overshoot, rise)


def exact_figures(loop: Loop, index: str, horizon: float = HORIZON) -> StepFigures:
    """Without discretisation."""
    measured, overshoot, rise = _exactly(loop, horizon)
    return StepFigures(index_value(measured, index), overshoot, rise)


@cache
def _by_gl(loop: Loop) -> tuple[Indices, float, float]:
    response = gl1_response(loop, HORIZON, PAPER_STEP)
    above = response.output >= 1.0
    rise = float(response.time[np.argmax(above)]) if above.any() else float("nan")
    return indices(response.time, response.error), overshoot_pct(response.output), rise


@cache
def _exactly(loop: Loop, horizon: float) -> tuple[Indices, float, float]:
    response = step_response(loop, horizon)
    rise = rise_time_to_100(response.time, response.output)
    return indices(response.time, response.error), overshoot_pct(response.output), rise


def rounding_effect(printed: Fopid, value: Callable[[Fopid], float]) -> float:
    """By how much a value can change when the five printed numbers change by half a unit of their last digit.

    Examples
    --------
    >>> round(rounding_effect(Fopid(1.0, 1.0, 1.0), lambda gains: 2.0 * gains.kp - gains.ki), 6)
    0.00015
    """
    gains = np.array(printed.gains)
    changes = ROUNDING * np.eye(5)
    return float(sum(abs(value(Fopid(*(gains + d))) - value(Fopid(*(gains - d)))) for d in changes) / 2.0)


def rounding_of_index(printed: PrintedTuning) -> float:
    """By how much GL's index can differ from the printed one, relatively, because all is rounded to four decimals."""
    process = read_process(printed.process)
    effect = rounding_effect(printed.controller, lambda gains: gl_figures(Loop(process, gains), printed.index).value)
    return (effect + ROUNDING) / printed.value


def time_row(printed: PrintedTuning) -> TimeRow:
    """A row, computed."""
    process, loop, index = read_process(printed.process), printed.loop, printed.index
    ms = margins(loop).ms
    kick = float(first_control(np.array([printed.controller.gains]), PAPER_STEP)[0])

    def tuned(ms_max: float, u_max: float, start: Fopid | None, structure: str | None = None) -> TuningResult:
        return tune(
            TuningRequest(
                process, method="time", index=index.lower(), horizon=HORIZON, ms_max=ms_max, u_max=u_max, start=start,
                structure=structure,
            )
        )  # fmt: skip

    return TimeRow(
        printed, gl_figures(loop, index), exact_figures(loop, index), rounding_of_index(printed), ms, kick,
        tuned(ms, kick, printed.controller, "fopid"), tuned(PRACTICAL_MS, PRACTICAL_U, None),
    )  # fmt: skip


def remark(row: TimeRow) -> str:
    """Where printed, GL and exact figures differ."""
    return f"{_gl_remark(row)}. {_exact_remark(row)}"


def _gl_remark(row: TimeRow) -> str:
    printed, gl, parts = row.printed, row.gl, []
    gap = gl.value / printed.value - 1.0
    if abs(gap) > row.rounding:
        parts.append(f"index {percent(gap, '+.2f')} (rounding explains {percent(row.rounding, '.2f')})")
    if not row.overshoot_reproduced:
        parts.append(f"overshoot {gl.overshoot_pct:.1f} % for {printed.overshoot_pct:.1f} %")
    if not row.rise_reproduced:
        steps = round(abs(gl.rise_time - printed.rise_time) / PAPER_STEP)
        parts.append(f"rise time {gl.rise_time:.2f} s for {printed.rise_time:.2f} s ({steps} of its steps)")
    return "GL differs from print: " + ", ".join(parts) if parts else "GL gives what is printed"


def _exact_remark(row: TimeRow) -> str:
    printed, exact, parts = row.printed, row.exact, []
    if abs(exact.value / printed.value - 1.0) > 0.01:
        parts.append(f"index {percent(exact.value / printed.value - 1.0, '+.1f')}")
    if abs(exact.overshoot_pct - printed.overshoot_pct) > 0.5:
        parts.append(f"overshoot {exact.overshoot_pct:.1f} %")
    if abs(exact.rise_time - printed.rise_time) > 0.05 * printed.rise_time:
        parts.append(f"rise time {exact.rise_time:.3g} s")
    return "Exact: " + ", ".join(parts) if parts else "Exact figures are near"


def outside(rows: tuple[TimeRow, ...]) -> str:
    """Which rows GL does not give as printed."""
    found = {
        f"the index within {percent(INDEX_TOLERANCE, 'g')}": [row for row in rows if not row.index_reproduced],
        "the overshoot to the digit": [row for row in rows if not row.overshoot_reproduced],
        "the rise time to the digit": [row for row in rows if not row.rise_reproduced],
    }
    parts = [
        f"{what} for {', '.join(f'{row.printed.process} {row.printed.index}' for row in off) or 'none'}"
        for what, off in found.items()
    ]
    return f"GL misses {'; '.join(parts)}."


def compared_table(number: int, rows: tuple[TimeRow, ...]) -> Table:
    """Printed, GL and exact side by side, for one process."""
    measures, kinds = (
        (("index", "", ".4f"), ("overshoot", "%", ".1f"), ("rise time", "s", ".2f")),
        ("printed", "GL", "exact"),
    )
    columns = (
        Column("tuned for"), *(Column(name, form=".4f") for name in ("kp", "ki", "kd", "λ", "μ")),
        *(Column(f"{name} {kind}", unit, form) for name, unit, form in measures for kind in kinds),
        Column("what it means", under=True),
    )  # fmt: skip
    process = rows[0].printed.process
    note = (
        "GL: first-order Grünwald-Letnikov differences at 0.01 s, as the paper computed. Exact: no discretisation. "
        f"Indices over {HORIZON:g} s; rise time: when the output first reaches the setpoint."
    )
    title = f"Table {number}: time-domain designs for {process}"
    return Table(f"table{number}", title, note, columns, tuple(_compared_cells(row) for row in rows))


def _compared_cells(row: TimeRow) -> tuple[Cell, ...]:
    kinds = (row.printed, row.gl, row.exact)
    figures = [getattr(kind, name) for name in ("value", "overshoot_pct", "rise_time") for kind in kinds]
    return row.printed.index, *row.printed.controller.gains, *figures, remark(row)


def tuned_table(number: int, rows: tuple[TimeRow, ...]) -> Table:
    """Our own tuning for the same index under stated bounds, for one process."""
    process = rows[0].printed.process
    columns = (
        Column("tuned for"), Column("Ms of the printed one", form=".2f"), Column("its control", form=".1f"),
        Column("its exact index", form=".4f"), Column("our index within the same", form=".4f"),
        Column("ours / printed", form=".3f"), Column("our index, Ms ≤ 1.6, |u| ≤ 20", form=".4f"),
        Column("ours within the same", under=True), Column("ours with Ms ≤ 1.6, |u| ≤ 20", under=True),
    )  # fmt: skip
    note = (
        "Ms and the control right after the step, run at 10 ms, of the printed controller are the bounds of our first "
        "tuning; the second has bounds that one would choose. Exact indices over 50 s."
    )
    title = f"Table {number}: our tuning for {process} under bounds"
    return Table(f"table{number}_ours", title, note, columns, tuple(_tuned_cells(row) for row in rows))


def _tuned_cells(row: TimeRow) -> tuple[Cell, ...]:
    return (
        row.printed.index, row.ms, row.first_control, row.exact.value, row.within.cost,
        row.within.cost / row.exact.value, row.practical.cost, _design(row.within), _design(row.practical),
    )  # fmt: skip


def _design(result: TuningResult) -> str:
    if result.controller is None:
        return result.message
    gains = zip(("kp", "ki", "kd", "λ", "μ"), result.controller.gains, strict=True)
    text = ", ".join(f"{name} {value:.4f}" for name, value in gains)
    return text if result.success else f"{text} (not met: {'; '.join(result.unmet)})"
