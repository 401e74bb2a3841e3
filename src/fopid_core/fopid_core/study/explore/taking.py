"""Gains to take along: parameters for the node, a Python program, a C header, a report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fopid_core.design.specification import one_of
from fopid_core.errors import InputError
from fopid_core.runtime.c_export import c_header
from fopid_core.study.experiments.loop_parameters import controller_settings
from fopid_core.study.page.requests import GainSet, gain_set, number, typed_process

KINDS = ("yaml", "python", "c")


def take(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The gains as text of a kind: yaml, python or c.

    Examples
    --------
    >>> print(take({"process": "P1", "gains": {"kp": 2, "ki": 0.5}, "kind": "yaml"})["text"])
    # For fopid_ros, and for `fopid export --params`. Process: 1/(s^3 + 3 s^2 + 3 s + 1)
    /**/fopid_controller:
      ros__parameters:
        kp: 2.0
        ki: 0.5
        kd: 0.0
        lam: 1.0
        mu: 1.0
    """
    kind = fields.get("kind")
    if not isinstance(kind, str):
        raise InputError(f"kind missing; allowed: {', '.join(KINDS)}")
    one_of("kind", kind, KINDS)
    process, one = typed_process(_text(fields)), gain_set(fields.get("gains"))
    parameters = _parameters(one)
    if kind == "yaml":
        return {"text": _yaml(str(process), parameters)}
    if kind == "python":
        return {"text": _python(str(process), one)}
    sample_time = number("sample_time", fields.get("sample_time", 0.01), 1e-9, 1e9)
    return {"text": c_header(controller_settings(parameters, sample_time))}


def report(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The report of the process: structures, gains in their forms, responses; one page of HTML."""
    from fopid_core.study.design_report import design_structures
    from fopid_core.study.design_report import report as design_report

    process = typed_process(_text(fields))
    one = gain_set(fields.get("gains"))
    facts = {"process": str(process), **{f"your {name}": value for name, value in _parameters(one).items()}}
    return {"text": design_report(process, design_structures(process, "iae", None, 0.01), None, facts)}


def _text(fields: Mapping[str, Any]) -> str:
    text = fields.get("process")
    if not isinstance(text, str):
        raise InputError("process missing; allowed: a text such as 1/(s+1)^3")
    return text


def _parameters(one: GainSet) -> dict[str, float | int]:
    """The controller's parameters, with names as its node has them."""
    found: dict[str, float | int] = {name: getattr(one.gains, name) for name in ("kp", "ki", "kd", "lam", "mu")}
    if not one.filter.is_idle:
        found |= {"measurement_filter_order": one.filter.order, "measurement_filter_time": one.filter.time}
    if one.weights.proportional != 1.0:
        found["setpoint_weight"] = one.weights.proportional
    if one.weights.derivative != 1.0:
        found["derivative_setpoint_weight"] = one.weights.derivative
    return found


def _yaml(process: str, parameters: Mapping[str, float | int]) -> str:
    lines = [f"# For fopid_ros, and for `fopid export --params`. Process: {process}", "/**/fopid_controller:",
             "  ros__parameters:", *(f"    {name}: {value!r}" for name, value in parameters.items())]  # fmt: skip
    return "\n".join(lines)


def _python(process: str, one: GainSet) -> str:
    more = [] if one.filter.is_idle else [f"filter={one.filter!r}"]
    more += [] if one.weights.proportional == one.weights.derivative == 1.0 else [f"weights={one.weights!r}"]
    imports = "from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights\n" if more else ""
    arguments = ", ".join([f"Process.parse({process!r})", repr(one.gains), *more])
    return (
        "from fopid_core.model.evaluation import evaluate\nfrom fopid_core.model.fopid import Fopid\n"
        "from fopid_core.model.loop import Loop\nfrom fopid_core.model.process import Process\n"
        f"{imports}\nloop = Loop({arguments})\njudged = evaluate(loop)\n"
        "print(judged.stability.reason, judged.margins.ms, judged.step)\n"
    )
