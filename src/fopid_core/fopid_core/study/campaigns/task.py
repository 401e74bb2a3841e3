"""The work of a campaign: the rows of one task."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.design.load_tail import TURNS
from fopid_core.design.specification import TuningResult
from fopid_core.design.time.proposal import DELAYS
from fopid_core.design.tuner import tune
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_core.study.campaigns.campaign import Campaign, Group, Task
from fopid_core.study.campaigns.columns import MEASURES, SCHEMA, VARIED
from fopid_core.study.campaigns.varied_loops import measure
from fopid_core.study.experiments.loop_parameters import GAINS
from fopid_core.study.experiments.tune_call import TuneCall


@dataclass(frozen=True)
class _Found:
    """A group's controller, and what the tuner said of it."""

    controller: Fopid | None
    met: bool | None = None
    unmet: str | None = None


def run_task(campaign: Campaign, task: Task) -> pa.Table:
    """The rows of one task; a run that cannot be done is a row that says why.

    Returns
    -------
    pyarrow.Table
        With the columns of ``SCHEMA``, one row per run.
    """
    groups, variations = campaign.groups, campaign.variations.table()
    parts = []
    for number in task.groups:
        rows = variations[task.first : task.end]
        columns = _rows(campaign, groups[number], rows)
        at = np.arange(task.first, task.end)
        columns |= {"run": number * len(variations) + at, "variation": at}
        parts.append(_table(columns, len(rows)))
    return pa.concat_tables(parts)


def _rows(campaign: Campaign, group: Group, variations: Floats) -> dict[str, Any]:
    """Columns of one group; a single value stands for all rows."""
    given = asdict(group.controller) if isinstance(group.controller, TuneCall) else {}
    columns: dict[str, Any] = {"process": group.process, "design": group.design}
    columns |= {name if name == "method" else f"asked_{name}": value or None for name, value in given.items()}
    columns |= dict(zip(VARIED, variations.T, strict=True))
    try:
        found = _found(group.process, group.controller, campaign.sample_time)
    except (ArithmeticError, ValueError) as error:
        return columns | {"status": "failed", "reason": f"tuning: {_line(error)}"}
    columns |= {"met": found.met, "unmet": found.unmet or None}
    if found.controller is None:
        return columns | {"status": "no design", "reason": found.unmet}
    columns |= dict(zip(GAINS, found.controller.gains, strict=True))
    process = read_process(group.process)
    columns["step_horizon"] = horizon = campaign.horizon or default_horizon(process)
    return columns | _measured(process, found.controller, variations, horizon, campaign.sample_time)


def default_horizon(process: Process) -> float:
    """As in time-domain tuning: some radians of the process's own frequency, or some delays [s]."""
    return max(TURNS / natural_crossover(process, PHASE_MARGIN), DELAYS * process.delay)


def _found(process: str, controller: Fopid | TuneCall, sample_time: float) -> _Found:
    if isinstance(controller, Fopid):
        return _Found(controller)
    result = _tuned(process, controller, sample_time)
    return _Found(result.controller, result.success, "; ".join(result.unmet) or ("" if result.success else "no design"))


@lru_cache(maxsize=1000)
def _tuned(process: str, call: TuneCall, sample_time: float) -> TuningResult:
    """Once per design and worker; without a timeout, so that it does not depend on the machine."""
    return tune(replace(call.request(read_process(process), sample_time), timeout=None))


def _measured(
    process: Process, controller: Fopid, variations: Floats, horizon: float, sample_time: float
) -> dict[str, Any]:
    """Status and measures of each run; where all together fail, each by itself."""
    try:
        stable, measures = measure(process, controller, variations, horizon, sample_time)
    except (ArithmeticError, ValueError) as error:
        if len(variations) == 1:
            return {"status": ["failed"], "reason": [_line(error)]}
        each = [_measured(process, controller, row[None], horizon, sample_time) for row in variations]
        return {name: _joined([one.get(name, [None]) for one in each]) for name in ("status", "reason", "stable",
                                                                                   *MEASURES)}  # fmt: skip
    return _judged(stable, measures)


def _joined(columns: list[Any]) -> list[Any]:
    return [value for column in columns for value in column]


def _judged(stable: Booleans, measures: Mapping[str, Floats]) -> dict[str, Any]:
    status = np.where(stable, "ok", "unstable").tolist()
    reason = [None if fine else "the closed loop is not stable" for fine in stable]
    return {"status": status, "reason": reason, "stable": stable, **measures}


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _table(columns: Mapping[str, Any], rows: int) -> pa.Table:
    return pa.table([_array(columns.get(field.name), field.type, rows) for field in SCHEMA], schema=SCHEMA)


def _array(values: Any, kind: pa.DataType, rows: int) -> pa.Array:
    if values is None or isinstance(values, (str, bool, float, int)):
        values = [values] * rows
    if kind == pa.float64():
        numbers = np.array([math.nan if value is None else value for value in values], dtype=np.float64)
        return pa.array(numbers, mask=np.isnan(numbers))
    return pa.array(values if isinstance(values, list) else values.tolist(), type=kind)
