"""The verbs that choose: ``fopid reduce`` and ``fopid tune frequency | time | rule``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, Verbs, as_json, process_argument
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.specification import Bound, TuningRequest, TuningResult

certify_option = click.option("--certify", "certified", is_flag=True, help="Prove it, too; else it is no success.")
bound_metavar = "DB@RAD_S"


@click.command("reduce", context_settings=ARGUMENTS)
@process_argument
@click.option("--template", default="all", show_default=True, help="foptd, soptd, nioptd1, nioptd2 or all.")
@click.option("--keep-gain", is_flag=True, help="Keep the steady-state gain exactly.")
@as_json
def reduce_verb(process: str, template: str, keep_gain: bool, as_json: bool) -> None:
    """The nearest low-order models in the H2 norm, and which to use."""
    from fopid_core.design.reduction import preferred, reduce, reduce_all
    from fopid_core.model.process import read_process

    full = read_process(process)
    models = reduce_all(full, keep_gain) if template == "all" else (reduce(full, template, keep_gain),)
    choice = preferred(models)
    rows = [
        {
            "template": model.template,
            "process": str(model.process),
            "parameters": dict(model.parameters),
            "h2_error": model.h2_error,
            "relative_error": model.relative_error,
            "elapsed_s": model.elapsed,
        }
        for model in models
    ]
    tables: list[tuple[str, Mapping[str, Any]]] = [
        (model.template, {**model.parameters, "H2 error": model.h2_error}) for model in models
    ]
    tables.append(("Preferred", {choice.model.template: choice.reason}))
    emit({"models": rows, "preferred": choice.model.template, "reason": choice.reason}, tables, as_json)


@click.group("tune", cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
def tune_group() -> None:
    """Choose the controller's five numbers, and verify the loop."""


@tune_group.command("frequency", context_settings=ARGUMENTS)
@process_argument
@click.option("--phase-margin", type=float, metavar="DEG", help="60 degrees when not given.")
@click.option("--crossover", type=float, metavar="RAD_S", help="Chosen from the process when not given.")
@click.option("--t-max", metavar=bound_metavar, help="|T| at most this from that frequency on, as -40@10.")
@click.option("--s-max", metavar=bound_metavar, help="|S| at most this up to that frequency, as -40@0.01.")
@click.option("--via", default="none", show_default=True, help="Template to reduce to first, or none.")
@click.option("--criterion", default="peaks", show_default=True, help="What is best: peaks, ms or flatness.")
@click.option("--u-max", type=float, metavar="X", help="Bound on the control at a setpoint step; 20 over the gain.")
@click.option("--sample-time", type=float, default=0.01, show_default=True, help="Of the controller as it runs [s].")
@click.option("--solver", default="square", show_default=True, help="square, or paper or monje for comparison.")
@certify_option
@as_json
def frequency_verb(
    process: str,
    phase_margin: float | None,
    t_max: str | None,
    s_max: str | None,
    certified: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Meet phase margin, crossover and flat phase, and bounds on |T| and |S|."""
    from fopid_core.design.specification import TuningRequest
    from fopid_core.model.process import read_process

    request = TuningRequest(
        read_process(process),
        phase_margin=None if phase_margin is None else _radians(phase_margin),
        t_max=_bound("t-max", t_max),
        s_max=_bound("s-max", s_max),
        **options,
    )
    _tune(request, certified, as_json)


@tune_group.command("time", context_settings=ARGUMENTS)
@process_argument
@click.option(
    "--index", default="itae", show_default=True, help="iae, ise, itae, itse, istes, istse, sum, energy or zamani."
)
@click.option("--horizon", type=float, metavar="S", help="Chosen from the process when not given [s].")
@click.option("--ms-max", type=float, metavar="X", help="Bound on max |S|; 1.6 when not given, inf for none.")
@click.option(
    "--u-max", type=float, metavar="X", help="Bound on the control's peak; 20 over the process's gain when not given."
)
@click.option("--noise-max", type=float, metavar="X", help="Bound on the gain from measurement noise to control.")
@click.option("--mt-max", type=float, metavar="X", help="Bound on max |T|.")
@click.option("--rate-max", type=float, metavar="X", help="Bound on the control's moves per second at a setpoint step.")
@click.option("--noise-density", type=float, metavar="X", help="Of the measurement's noise [unit^2/Hz].")
@click.option("--noise-rms-max", type=float, metavar="X", help="Bound on the control that this noise makes.")
@click.option("--input", default="setpoint", show_default=True, help="Whose step counts: setpoint, load or both.")
@click.option("--load-weight", type=float, default=1.0, show_default=True, help="Of the load's index, for both.")
@click.option(
    "--structure", metavar="NAME", help="p, pi, pd, pid, fopi, fopd or fopid; else the simplest nearly as good."
)
@click.option("--filter-order", type=int, default=0, show_default=True, help="Of the measurement's filter: 0, 1 or 2.")
@click.option("--two-degrees/--one-degree", default=None, help="Choose the setpoint's weights as well, or keep them 1.")
@click.option("--sample-time", type=float, default=0.01, show_default=True, help="Of the controller as it runs [s].")
@click.option("--start", metavar="KP,KI,KD,LAM,MU", help="A further point to begin from.")
@click.option(
    "--fix", multiple=True, metavar="NAME=VALUE", help="Keep kp, ki, kd, lam, mu or filter_time; may be repeated."
)
@click.option("--bound", multiple=True, metavar="NAME=LOW,HIGH", help="Range of one of the five; may be repeated.")
@click.option("--weight", multiple=True, metavar="PART=VALUE", help="Of sum, energy or zamani; may be repeated.")
@click.option("--solver", default="gauss-newton", show_default=True, help="Or nelder-mead, differential-evolution.")
@click.option("--seed", type=int, default=0, show_default=True, help="The same seed gives the same answer.")
@click.option("--timeout", type=float, metavar="S", help="Give the best found after this long [s].")
@certify_option
@as_json
def time_verb(process: str, start: str | None, certified: bool, as_json: bool, **options: Any) -> None:
    """Minimise an index of the response to a setpoint step, a load step or both, under bounds."""
    from fopid_core.design.specification import TuningRequest
    from fopid_core.model.fopid import read_gains
    from fopid_core.model.process import read_process

    pairs: dict[str, Any] = {
        "fixed": {name: _number(name, value) for name, value in _pairs("fix", options.pop("fix"))},
        "bounds": {name: _range(name, value) for name, value in _pairs("bound", options.pop("bound"))},
        "weights": {name: _number(name, value) for name, value in _pairs("weight", options.pop("weight"))},
    }
    begin = None if start is None else read_gains(start)
    _tune(TuningRequest(read_process(process), method="time", start=begin, **pairs, **options), certified, as_json)


@tune_group.command("rule", context_settings=ARGUMENTS)
@process_argument
@click.option("--rule", metavar="NAME", help="valerio-1, fmigo, padula-visioli-..., simc-pi, amigo-pi, amigo-pid, ...")
@click.option("--crossover", type=float, metavar="RAD_S", help="For dominant-poles: their natural frequency.")
@certify_option
@as_json
def rule_verb(process: str, rule: str | None, crossover: float | None, certified: bool, as_json: bool) -> None:
    """Read the numbers off a published rule."""
    from fopid_core.design.specification import TuningRequest
    from fopid_core.model.process import read_process

    _tune(TuningRequest(read_process(process), method="rule", rule=rule, crossover=crossover), certified, as_json)


def _tune(request: TuningRequest, certified: bool, as_json: bool) -> None:
    """Tune with a progress bar on stderr, write the result, leave with the exit status of the contract."""
    from fopid_core.design.tuner import tune

    with progress(request.method) as told:
        result = tune(request, told)
    data = _result_rows(result)
    if certified:
        _add_certificate(data, request, result)
    parts = {
        "gains": "Gains",
        "filter": "Filter of the measurement",
        "setpoint_weights": "Weights of the setpoint",
        "achieved": "Achieved",
        "running": "As it runs",
    }
    rest = {name: value for name, value in data.items() if name not in parts}
    tables = [(title, data[name]) for name, title in parts.items() if data[name]]
    emit(data, [*tables, ("Tuning", rest)], as_json)
    if not data["success"]:
        click.get_current_context().exit(CANNOT_BE_MET)


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
    return {**rows, "phase_margin_deg": math.degrees(margin), "gain_margin_db": 20.0 * math.log10(gain)}


def _radians(degrees: float) -> float:
    if not 0.0 < degrees < 180.0:
        raise InputError(f"phase-margin = {degrees:g}; allowed: above 0 and below 180 degrees")
    return math.radians(degrees)


def _bound(name: str, text: str | None) -> Bound | None:
    """A bound from ``-40@10``."""
    from fopid_core.design.specification import Bound

    if text is None:
        return None
    level, separator, frequency = text.partition("@")
    if not separator:
        raise InputError(f"{name} = {text!r}; allowed: {bound_metavar}, for instance -40@10")
    return Bound(_number(name, level), _number(name, frequency))


def _pairs(option: str, texts: tuple[str, ...]) -> list[tuple[str, str]]:
    pairs = []
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator:
            raise InputError(f"{option} = {text!r}; allowed: NAME=VALUE")
        pairs.append((name.strip(), value))
    return pairs


def _range(name: str, text: str) -> tuple[float, float]:
    low, separator, high = text.partition(",")
    if not separator:
        raise InputError(f"bound {name} = {text!r}; allowed: LOW,HIGH")
    return _number(name, low), _number(name, high)


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name} = {text!r}; allowed: a number") from None
