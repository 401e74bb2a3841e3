"""The work of a survey: every structure on one process, each at its best under the same bounds."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from fopid_core.design import defaults
from fopid_core.design.sampled_loop import running
from fopid_core.design.specification import STRUCTURES as KEPT
from fopid_core.design.specification import TuningRequest
from fopid_core.design.time.problem import enough_points
from fopid_core.design.time.proposal import bounds_of, settling_horizon, time_specification
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import TimeDesign, tune_time
from fopid_core.design.verification import checks
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability
from fopid_core.runtime.settings import as_designed
from fopid_core.study.verdict.as_it_runs import SampledLoad
from fopid_core.study.verdict.columns import CONTROLLERS, HIGH_ORDER, SCHEMA, STRUCTURES
from fopid_core.study.verdict.high_order import high_order
from fopid_core.study.verdict.survey import Bounds, Case

TICK = 0.05
"""Of the running controllers, in radians of the loop's speed."""
HORIZONS = 2.0
"""How much longer a load step counts than a loop takes to settle: no design gains by a tail that is not seen."""


@dataclass(frozen=True)
class Setting:
    """What a process's own time and gain make of the bounds."""

    process: Process
    speed: float
    gain: float
    specification: TimeSpecification

    @staticmethod
    def of(process: Process, bounds: Bounds, filter_order: int) -> Setting:
        """Times in units of the fastest loop that the process or the bound on noise allows."""
        gain = defaults.process_gain(process)
        speed = min(
            defaults.natural_crossover(process, defaults.PHASE_MARGIN), _unit_gain(process, bounds.noise / gain)
        )
        request = TuningRequest(
            process, "time", index="iae", input="load", ms_max=bounds.ms_max, mt_max=bounds.mt_max,
            noise_max=bounds.noise / abs(gain), u_max=math.inf, filter_order=filter_order, two_degrees=False,
            sample_time=TICK / speed, horizon=HORIZONS * settling_horizon(process, speed),
        )  # fmt: skip
        return Setting(process, speed, gain, time_specification(request))


def _unit_gain(process: Process, gain: float) -> float:
    """The frequency from which on a gain times the process is below 1 [rad/s]."""
    w = np.geomspace(1e-7, 1e7, 1401)
    with np.errstate(all="ignore"):
        above = np.flatnonzero(np.abs(gain * process(1j * w)) >= 1.0)
    return float(w[above[-1]]) if above.size else math.inf


def case_rows(number: int, case: Case, filter_order: int, again: bool, high: bool) -> pa.Table:
    """The rows of one process, one for each of ``CONTROLLERS``; what cannot be done says why.

    Parameters
    ----------
    number : int
    case : Case
    filter_order : int
    again : bool
        Whether every structure is searched a second time.
    high : bool
        Whether the controller of high order is looked for.
    """
    common: dict[str, Any] = {"case": number, "kind": case.kind, "process": case.process}
    try:
        setting = Setting.of(read_process(case.process), case.bounds, filter_order)
        rows = _rows(setting, again, high)
    except (ArithmeticError, ValueError) as error:
        rows = {name: {"status": "failed", "reason": " ".join(str(error).split())} for name in CONTROLLERS}
    listed = [{**dict.fromkeys(SCHEMA.names), **common, **rows[name], "controller": name} for name in CONTROLLERS]
    for row in listed:
        for name, value in row.items():
            if isinstance(value, float) and not math.isfinite(value):
                row[name] = None
    return pa.Table.from_pylist(listed, schema=SCHEMA)


def _rows(setting: Setting, again: bool, high: bool) -> dict[str, dict[str, Any]]:
    asked = setting.specification
    common = {
        "speed": setting.speed, "process_gain": setting.gain, "horizon": asked.horizon,
        "sample_time": asked.sample_time,
    }  # fmt: skip
    load = SampledLoad(setting.process, asked.sample_time, asked.horizon)
    rows, designs = {}, _designs(setting)
    for name in STRUCTURES:
        design, took = designs[name]
        rows[name] = {**common, "elapsed_s": took, **_row(setting, design, load)}
        if again:
            other = tune_time(setting.process, replace(asked, fixed=KEPT[name]), seed=1)
            rows[name]["iae_again"] = other.cost if other is not None and other.met else None
    rows[HIGH_ORDER] = {**common, **(_high_order(setting, designs["fopid"][0]) if high else {"status": "left out"})}
    return rows


def _designs(setting: Setting) -> dict[str, tuple[TimeDesign | None, float]]:
    """The best of each structure, and the processor time it took [s]; none is worse than what it contains."""
    process, asked = setting.process, setting.specification
    begun = time.process_time()
    whole = tune_time(process, asked)
    first = time.process_time() - begun
    found: dict[str, tuple[TimeDesign | None, float]] = {}
    for name in ("pi", "pid", "fopi"):
        begun = time.process_time()
        kept = replace(asked, fixed=KEPT[name])
        near = [whole.simpler[name][1]] if whole is not None and name in whole.simpler else []
        near += [found["pi"][0].variables] if name != "pi" and found["pi"][0] is not None else []
        design = tune_time(process, kept, near=near) if near else None
        if design is None or not design.met:
            design = tune_time(process, kept) or design
        found[name] = design, time.process_time() - begun
    begun = time.process_time()
    near = [design.variables for design in (whole, found["pid"][0], found["fopi"][0]) if design is not None]
    best = tune_time(process, asked, near=near) if near else None
    found["fopid"] = best or whole, first + time.process_time() - begun
    return found


def _row(setting: Setting, design: TimeDesign | None, load: SampledLoad) -> dict[str, Any]:
    if design is None:
        return {"status": "no design", "reason": "no stable controller found"}
    loop = Loop(setting.process, design.controller, design.filter)
    if not stability(loop).stable:
        return {"status": "no design", "reason": "not stable for certain"}
    found = {check.name: check for check in checks(loop, bounds_of(setting.specification))}
    broken = [str(check) for check in found.values() if not check.holds]
    row: dict[str, Any] = dict(zip(("kp", "ki", "kd", "lam", "mu"), design.controller.gains, strict=True))
    row |= {
        "status": "a bound broken" if broken else "ok", "reason": "; ".join(broken) or None,
        "filter_time": design.filter.time, "iae_load": design.cost, "final_error": design.final_error,
        "ms": found["max |S|"].value, "mt": found["max |T|"].value, "noise_gain": found["noise gain"].value,
    }  # fmt: skip
    runs = running(setting.process, design.controller, setting.specification.sample_time, design.filter)
    row |= {"running_stable": runs.stable, "running_ms": runs.ms}
    if runs.stable and design.controller.ki:
        settings = as_designed(design.controller, setting.specification.sample_time, design.filter, design.weights)
        row["running_iae"] = load.iae(settings)
    return row


def _high_order(setting: Setting, fractional: TimeDesign | None) -> dict[str, Any]:
    """Poles and order as those that the fractional controller runs with."""
    asked = setting.specification
    if fractional is None or not fractional.met or not fractional.controller.ki:
        return {"status": "no design", "reason": "no fractional controller with integral action to begin from"}
    begun = time.process_time()
    loop = Loop(setting.process, fractional.controller, fractional.filter)
    band = as_designed(fractional.controller, asked.sample_time, fractional.filter, fractional.weights).active_band
    limits = (asked.ms_max, asked.mt_max, asked.noise_max)
    found = high_order(
        loop, band.lag_poles(), limits, asked.horizon, setting.speed, setting.gain, math.pi / asked.sample_time,
        enough_points(asked.horizon * defaults.natural_crossover(setting.process, defaults.PHASE_MARGIN)),
    )  # fmt: skip
    took = {"elapsed_s": time.process_time() - begun}
    if found is None:
        return {"status": "no design", "reason": "the fractional design cannot be followed to this order", **took}
    return {
        "status": "ok" if found.is_within else "a bound broken", "iae_load": found.iae, "ms": found.ms, "mt": found.mt,
        "noise_gain": found.noise_gain, "filter_time": found.filter_time, "final_error": found.final_error, **took,
    }  # fmt: skip
