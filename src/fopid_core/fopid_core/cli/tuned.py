"""What ``fopid tune`` shows: the design, what it does to steps of setpoint and load, and what the gains before did."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fopid_core.cli.output import emit, text

if TYPE_CHECKING:
    from fopid_core.design.recorded_tuning import RecordedTuning
    from fopid_core.design.specification import TuningRequest, TuningResult
    from fopid_core.model.fopid import Fopid
    from fopid_core.model.loop import Loop

STEPS = (
    "overshoot_pct", "rise_time", "settling_time", "iae_setpoint", "iae_load", "control_peak", "total_variation",
    "ms", "mt", "noise_gain", "delay_margin",
)  # fmt: skip
"""What is shown of the steps, by the names of ``comparison.measures.Row``."""
FILTER_FORMS = {1: "1/(1 + T s)", 2: "1/(1 + T s + (T s)^2/2)"}
"""By order, T is the time."""
SHORTER = (1.0, 0.5, 0.25, 0.125)
"""Of the usual horizon, until the responses are known."""
SETTLED_TIMES = 2.5
"""Of the settling time at a setpoint step: so long a load can be seen to go as well."""


def show(
    request: TuningRequest,
    result: TuningResult,
    before: Fopid | None,
    certified: bool,
    plot: Path | None,
    as_json: bool,
    recorded: RecordedTuning | None = None,
) -> bool:
    """Write a tuning to stdout, and its picture; whether it is a success.

    Parameters
    ----------
    request, result
        What was asked, and what came of it.
    before : Fopid, optional
        Gains to compare with.
    certified : bool
        Whether a proof belongs to it.
    plot : Path, optional
        Draw the steps.
    as_json : bool
    recorded : RecordedTuning, optional
        What it rests on, where the process was learnt.
    """
    from fopid_core.model.loop import Loop

    data = _result_rows(result)
    if recorded is not None:
        data |= _record_rows(recorded)
    if certified:
        _add_certificate(data, request, result)
    loops = {
        "before": None if before is None else Loop(request.process, before),
        "after": None if result.controller is None
        else Loop(request.process, result.controller, result.filter, result.weights),
    }  # fmt: skip
    known = {name: loop for name, loop in loops.items() if loop is not None}
    steps = _steps(known, request.sample_time)
    data["steps"] = steps.get("after")
    data["before"] = None if before is None else {"gains": asdict(before), "steps": steps["before"]}
    data["plot"] = _plot(known, steps, request, plot) if plot and known else None
    emit(data, _tables(data, steps), as_json)
    return bool(data["success"])


def show_refused(recorded: RecordedTuning, as_json: bool) -> bool:
    """Write why nothing could be designed from a record; it is no success."""
    data = {"success": False, "message": recorded.message, "gains": None, **_record_rows(recorded)}
    emit(data, [("Refused", {"message": recorded.message})], as_json)
    return False


def _record_rows(recorded: RecordedTuning) -> dict[str, Any]:
    """What the record said: the process, and what bounded the design."""
    best, noise = recorded.identified.best, recorded.noise
    level = recorded.bounds.noise if recorded.bounds else noise.level
    return {
        "record": {
            "process": None if best is None else str(best.process),
            "template": None if best is None else best.template,
            "fit_pct": None if best is None else best.fit_pct,
            "noise": level,
            "noise_at_rest": noise.at_rest,
            "quantisation": noise.step,
            "taken": dict(recorded.taken),
        }
    }


def _steps(loops: dict[str, Loop], sample_time: float) -> dict[str, dict[str, float | bool]]:
    """What unit steps of setpoint and load show, over one horizon for all loops."""
    from fopid_core.design.comparison.candidates import Candidate
    from fopid_core.design.comparison.measures import measured
    from fopid_core.design.specification import Bounds
    from fopid_core.model.evaluation import default_horizon

    longest = max((default_horizon(loop) for loop in loops.values()), default=math.nan)
    found: dict[str, dict[str, float | bool]] = {}
    for share in SHORTER:  # what takes long beside a fast filter is known for a while only
        bounds = Bounds(sample_time=sample_time, horizon=share * longest)
        for name, loop in loops.items():
            row = measured(Candidate("", "", loop), bounds, 1.0 / bounds.horizon)
            found[name] = {"horizon": bounds.horizon, "stable": row.stable} | {key: getattr(row, key) for key in STEPS}
        if not any(steps["stable"] and math.isnan(steps["iae_setpoint"]) for steps in found.values()):
            break
    return found


def _plot(loops: dict[str, Loop], steps: dict[str, dict[str, float | bool]], request: TuningRequest, file: Path) -> str:
    """Draw the loops that are stable, as far as there is something to see."""
    from fopid_core.cli.plots import plot_steps
    from fopid_core.model.stability import stability

    stable = {name: loop for name, loop in loops.items() if stability(loop).stable}
    settled = max((steps[name]["settling_time"] for name in stable), default=math.nan)
    horizon = next(steps[name]["horizon"] for name in loops)
    if math.isfinite(settled):
        horizon = min(horizon, SETTLED_TIMES * settled + request.process.delay)
    plot_steps(stable, horizon, request.sample_time, str(request.process), file)
    return str(file)


def _tables(data: dict[str, Any], steps: dict[str, dict[str, float | bool]]) -> list[tuple[str, dict[str, Any]]]:
    """What people see; what was neither asked for nor is in use is left out."""
    tables: list[tuple[str, dict[str, Any]]] = []
    if data["gains"]:
        tables.append(("Gains", _side_by_side(data["before"] and data["before"]["gains"], data["gains"])))
    if data["filter"]["order"]:
        form = FILTER_FORMS[data["filter"]["order"]]
        tables.append(("Filter of the measurement", {**data["filter"], "form": form}))
    if set(data["setpoint_weights"].values()) != {1.0}:
        tables.append(("Weights of the setpoint", data["setpoint_weights"]))
    if "after" in steps:
        tables.append(("Unit steps", _side_by_side(steps.get("before"), steps["after"])))
    if data["achieved"]:
        asked = {name: value for name, value in data["achieved"].items() if not _is_unknown(value)}
        tables.append(("Achieved", {name: value for name, value in asked.items() if name not in STEPS}))
    if data["running"]:
        tables.append(("As it runs", {name: value for name, value in data["running"].items() if value != ""}))
    if "record" in data:
        rows = dict(data["record"])
        tables.append(("From the record", rows | rows.pop("taken")))
    shown = ("success", "message", "method", "structure", "stable", "unstable_poles", "unmet", "at_edge", "cost",
             "evaluations", "elapsed_s", "certificate", "plot")  # fmt: skip
    tables.append(("Tuning", {name: data[name] for name in shown if name in data}))
    return tables


def _side_by_side(before: dict[str, Any] | None, after: dict[str, Any]) -> dict[str, Any]:
    """``before -> after`` in each row, where there is a before."""
    if not before:
        return after
    return {
        name: f"{text(before[name])} -> {text(after[name])}" if name != "horizon" else after[name] for name in after
    }


def _is_unknown(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _add_certificate(data: dict[str, Any], request: TuningRequest, result: TuningResult) -> None:
    """The proof of a design; without one it is no success."""
    from fopid_core.cli.certify import certificate_rows
    from fopid_core.design.certified_tuning import certify_tuning

    found = certify_tuning(request, result)
    data["certificate"] = None if found is None else certificate_rows(found)
    if data["success"] and (found is None or found.certified is not True):
        data["success"] = False
        data["unmet"] = [*data["unmet"], f"certificate: {'no design' if found is None else found.reason}"]


def _result_rows(result: TuningResult) -> dict[str, Any]:
    achieved = None if result.achieved is None else asdict(result.achieved)
    if achieved is not None:
        achieved = {"phase_margin_deg": math.degrees(achieved.pop("phase_margin")), **achieved}
    return {
        "success": result.success,
        "message": result.message,
        "method": result.method,
        "structure": result.structure or None,
        "gains": None if result.controller is None else asdict(result.controller),
        "filter": asdict(result.filter),
        "setpoint_weights": asdict(result.weights),
        "achieved": achieved,
        "running": _running_rows(result),
        "stable": result.stable,
        "unstable_poles": result.unstable_poles if result.unstable_poles >= 0 else None,
        "unmet": list(result.unmet),
        "at_edge": list(result.at_edge),
        "cost": result.cost,
        "evaluations": result.evaluations,
        "elapsed_s": result.elapsed,
    }


def _running_rows(result: TuningResult) -> dict[str, Any] | None:
    """What the sampled, held loop does; the key ``running`` of the contract."""
    if result.running is None:
        return None
    rows = asdict(result.running)
    margin, gain = rows.pop("phase_margin"), rows.pop("gain_margin")
    return {**rows, "phase_margin_deg": math.degrees(margin), "gain_margin_db": float(20.0 * np.log10(gain))}
