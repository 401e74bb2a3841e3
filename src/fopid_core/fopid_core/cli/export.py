"""The verb ``fopid export``: the discretised controller as C."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from fopid_core import safe_yaml
from fopid_core.cli.options import ARGUMENTS, as_json, filter_option, read_filter, read_weights, weights_option
from fopid_core.cli.output import emit
from fopid_core.errors import InputError


@click.command("export", context_settings=ARGUMENTS)
@click.option("--gains", metavar="KP,KI,KD,LAM,MU", help="The controller's five numbers.")
@filter_option
@weights_option
@click.option("--params", type=click.Path(path_type=Path), metavar="FILE",
              help="A parameter file of the controller node, as ~/save_gains writes it.")  # fmt: skip
@click.option("--sample-time", type=float, metavar="S", help="Time between ticks [s]; 0.01.")
@click.option("--limits", metavar="LOW,HIGH", help="Of the control.")
@click.option("--set", "more", multiple=True, metavar="NAME=VALUE",
              help="Another parameter by its name in the node, such as antiwindup=none.")  # fmt: skip
@click.option("--name", default="fopid_controller", show_default=True, help="Of the files and of every name in C.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, metavar="DIR")
@as_json
def export_verb(
    gains: str | None,
    slow: str | None,
    setpoint_weights: str | None,
    params: Path | None,
    sample_time: float | None,
    limits: str | None,
    more: tuple[str, ...],
    name: str,
    out: Path,
    as_json: bool,
) -> None:
    """Write the controller as a C header without dependencies, and a C program with its test vectors."""
    from fopid_core.runtime.c_export import c_header, c_test
    from fopid_core.study.experiments.loop_parameters import controller_settings

    parameters = _from_file(params) if params else {}
    parameters |= _typed(gains, limits, more)
    if slow is not None:
        measured = read_filter(slow)
        parameters |= {"measurement_filter_order": measured.order, "measurement_filter_time": measured.time}
    if setpoint_weights is not None:
        weights = read_weights(setpoint_weights)
        parameters |= {"setpoint_weight": weights.proportional, "derivative_setpoint_weight": weights.derivative}
    if not parameters.keys() & {"kp", "ki", "kd"}:
        raise InputError("gains missing; allowed: --gains KP,KI,KD,LAM,MU or --params FILE that holds kp, ki or kd")
    if parameters.get("schedule_file"):
        raise InputError(
            f"schedule_file = {parameters['schedule_file']!r}; allowed: none, one set of gains is exported"
        )
    if sample_time is None:
        sample_time = parameters.get("sample_time", 0.01)
    settings = controller_settings(parameters, sample_time)
    files = {f"{name}.h": c_header(settings, name), f"{name}_test.c": c_test(settings, name)}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (out / file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"out {out}: {error.strerror}") from None
    header, test = (out / file for file in files)
    numbers = {key: getattr(settings.gains, key) for key in ("kp", "ki", "kd", "lam", "mu")}
    compiled = f"cc -std=c99 {test} -o {test.with_suffix('')} && {test.with_suffix('')}"
    data = {"header": str(header), "test": str(test), "name": name, "sample_time": sample_time, "gains": numbers}
    data |= {"control_min": settings.control_min, "control_max": settings.control_max, "try": compiled}
    emit(data, [("Exported", {**data, "gains": str(settings.gains)})], as_json)


def _typed(gains: str | None, limits: str | None, more: tuple[str, ...]) -> dict[str, Any]:
    """The parameters that stand on the command line."""
    from fopid_core.model.fopid import read_gains

    typed: dict[str, Any] = {}
    if gains is not None:
        controller = read_gains(gains)
        typed |= {field.name: getattr(controller, field.name) for field in fields(controller)}
    if limits is not None:
        low, comma, high = limits.partition(",")
        if not comma:
            raise InputError(f"limits {limits!r}; allowed: two numbers LOW,HIGH")
        typed |= {"control_min": _number("limits", low), "control_max": _number("limits", high)}
    for one in more:
        name, equals, value = one.partition("=")
        if not equals:
            raise InputError(f"set {one!r}; allowed: NAME=VALUE")
        typed[name] = _read(name, value)
    return typed


def _from_file(path: Path) -> dict[str, Any]:
    """What a ROS parameter file says of the one node that has gains."""
    try:
        content = safe_yaml.load(safe_yaml.read_text(path))
    except (OSError, ValueError) as error:
        raise InputError(f"params {path}: {' '.join(str(error).split())}") from None
    nodes = content.values() if isinstance(content, dict) else ()
    found = [node["ros__parameters"] for node in nodes if isinstance(node, dict) and "ros__parameters" in node]
    with_gains = [_flat(parameters) for parameters in found if isinstance(parameters, dict) and "kp" in parameters]
    if len(with_gains) != 1:
        raise InputError(f"params {path}: {len(with_gains)} nodes with kp under ros__parameters; allowed: one")
    return {name: _read(name, value) for name, value in with_gains[0].items()}


def _flat(parameters: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Nested names joined by dots, as ROS reads them."""
    flat: dict[str, Any] = {}
    for name, value in parameters.items():
        flat |= _flat(value, f"{before}{name}.") if isinstance(value, dict) else {f"{before}{name}": value}
    return flat


_OF_EVERY_NODE = {"trigger", "use_sim_time", "start_type_description_service"}


def _read(name: str, value: Any) -> Any:
    from fopid_core.study.experiments.loop_parameters import CONTROLLER_KEYS

    kinds = {**CONTROLLER_KEYS, "sample_time": float}
    if name not in kinds and name not in _OF_EVERY_NODE and not name.startswith("qos_overrides."):
        raise InputError(f"parameter {name!r}; allowed: {', '.join(kinds)}")
    kind = kinds.get(name)
    if kind is bool:
        return _truth(name, value)
    return _number(name, value, kind) if kind in (float, int) else value


def _number(name: str, value: Any, kind: type = float) -> Any:
    try:
        return kind(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {value!r}; allowed: a {'whole ' if kind is int else ''}number") from None


def _truth(name: str, value: Any) -> bool:
    words = {"true": True, "false": False}
    if str(value).lower() not in words:
        raise InputError(f"{name} = {value!r}; allowed: true, false")
    return words[str(value).lower()]
