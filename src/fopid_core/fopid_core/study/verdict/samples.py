"""What takes too long for every process of a survey: the limit of all linear controllers, and the paper's question."""

from __future__ import annotations

from typing import Any

import numpy as np

from fopid_core.design import defaults
from fopid_core.design.comparison.measures import GAINS
from fopid_core.design.control_peak import first_control
from fopid_core.design.limit.limit import limit
from fopid_core.design.specification import TuningRequest
from fopid_core.design.time.proposal import settling_horizon
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.study.verdict.statistics import Case, is_known
from fopid_core.study.verdict.survey import Bounds

CELLS = 100
"""Of the limit's grid."""


def limit_row(case: Case, bounds: Bounds) -> dict[str, Any] | None:
    """The limit beside the designs, or None where one of them or the limit is not known."""
    names = ("pi", "pid", "fopid")
    if not all(is_known(case[name]) for name in names):
        return None
    row = case["fopid"]
    process = read_process(row["process"])
    try:
        found = limit(
            process, ms_max=bounds.ms_max, mt_max=bounds.mt_max, noise_max=bounds.noise / abs(row["process_gain"]),
            sample_time=row["sample_time"], cells=CELLS,
        )  # fmt: skip
    except InputError:
        return None  # an unstable process, or one that the solver does not like
    high = case["high order"]
    reached = {name: case[name]["iae_load"] for name in names}
    return {
        "case": row["case"], "kind": row["kind"], "limit": found.bound, "error": found.resolution_error, **reached,
        "high order": high["iae_load"] if is_known(high) else None,
    }  # fmt: skip


def paper_row(case: Case) -> dict[str, Any] | None:
    """The paper's comparison on another process: a design by frequency and one by ITAE, or None where one fails."""
    process = read_process(case["pid"]["process"])
    horizon = settling_horizon(process)
    try:
        designs = {
            "frequency": tune(TuningRequest(process)),
            "time": tune(TuningRequest(process, "time", index="itae", structure="fopid")),
        }
        found = {
            kind: _figures(process, result.controller, horizon)
            for kind, result in designs.items()
            if result.success and result.controller is not None
        }
    except InputError:
        return None
    if len(found) < 2:
        return None
    flat = {f"{name} by {kind}": value for kind, figures in found.items() for name, value in figures.items()}
    return {"case": case["pid"]["case"], "kind": case["pid"]["kind"], **flat}


def _figures(process: Process, controller: Fopid, horizon: float) -> dict[str, float]:
    """What section 5 of the paper compares."""
    loops = [Loop(process.scaled(gain), controller) for gain in GAINS]
    stable = all(stability(loop).stable for loop in loops)
    overshoots = [overshoot_pct(step_response(loop, horizon).output) for loop in loops] if stable else [0.0, np.inf]
    load = step_response(Loop(process, controller), horizon, "load")
    tick = defaults.natural_crossover(process, defaults.PHASE_MARGIN)
    return {
        "spread": max(overshoots) - min(overshoots),
        "load IAE": indices(load.time, load.error).iae,
        "peak": abs(float(first_control(np.array([controller.gains]), 0.05 / tick)[0])),
    }
