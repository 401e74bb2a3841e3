"""The verbs that choose: ``fopid reduce`` and ``fopid tune frequency | time | rule``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import (
    ARGUMENTS,
    CANNOT_BE_MET,
    Verbs,
    as_json,
    design_options,
    plot_option,
    process_argument,
)
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.specification import Bound
    from fopid_core.model.fopid import Fopid

bound_metavar = "DB@RAD_S"


def record_options(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Either a process or a record to learn it from; and the sample time, which a record says as well."""
    for option in reversed(
        (
            click.argument("process", required=False),
            click.option(
                "--record", type=click.Path(path_type=Path), metavar="FILE",
                help="In place of PROCESS: learn it, its noise, limits and sample time from a csv file or a bag.",
            ),
            click.option("--columns", metavar="PV,OP,SP", help="Of a csv file: names or numbers; the fourth is time."),
            click.option("--namespace", metavar="NAME", help="Which loop, when a bag holds several."),
            click.option("--template", default="all", show_default=True, help="What to learn, as identify takes it."),
            click.option("--control-min", type=float, metavar="X", help="Lower limit of the control in a record."),
            click.option("--control-max", type=float, metavar="X", help="Its upper limit."),
            click.option("--control-before", type=float, metavar="X", help="The control at rest before, if known."),
            click.option(
                "--sample-time", type=float, metavar="S",
                help="Of the controller as it runs [s]; 0.01, or the record's.",
            ),
        )
    ):  # fmt: skip
        verb = option(verb)
    return verb


def result_options(verb: Callable[..., Any]) -> Callable[..., Any]:
    """What is shown of a tuning."""
    verb = as_json(verb)
    verb = plot_option(verb)
    verb = click.option(
        "--before", metavar="KP,KI,KD,LAM,MU", help="Gains to compare with; those of --start when not given."
    )(verb)
    return click.option("--certify", "certified", is_flag=True, help="Prove it, too; else it is no success.")(verb)


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
@record_options
@click.option("--phase-margin", type=float, metavar="DEG", help="60 degrees when not given.")
@click.option("--crossover", type=float, metavar="RAD_S", help="Chosen from the process when not given.")
@click.option("--t-max", metavar=bound_metavar, help="|T| at most this from that frequency on, as -40@10.")
@click.option("--s-max", metavar=bound_metavar, help="|S| at most this up to that frequency, as -40@0.01.")
@click.option("--via", default="none", show_default=True, help="Template to reduce to first, or none.")
@click.option("--criterion", default="peaks", show_default=True, help="What is best: peaks, ms or flatness.")
@click.option("--u-max", type=float, metavar="X", help="Bound on the control at a setpoint step; 20 over the gain.")
@click.option("--solver", default="square", show_default=True, help="square, or paper or monje for comparison.")
@result_options
def frequency_verb(phase_margin: float | None, t_max: str | None, s_max: str | None, **given: Any) -> None:
    """Meet phase margin, crossover and flat phase, and bounds on |T| and |S|."""
    asked = {
        "phase_margin": None if phase_margin is None else _radians(phase_margin),
        "t_max": _bound("t-max", t_max),
        "s_max": _bound("s-max", s_max),
    }
    _tune("frequency", asked, given)


@tune_group.command("time", context_settings=ARGUMENTS)
@record_options
@click.option(
    "--index", default="itae", show_default=True, help="iae, ise, itae, itse, istes, istse, sum, energy or zamani."
)
@design_options("horizon", "ms_max", "u_max", "noise_max", "mt_max")
@click.option("--rate-max", type=float, metavar="X", help="Bound on the control's moves per second at a setpoint step.")
@click.option("--noise-density", type=float, metavar="X", help="Of the measurement's noise [unit^2/Hz].")
@click.option("--noise-rms-max", type=float, metavar="X", help="Bound on the control that this noise makes.")
@click.option(
    "--input",
    help="Whose step counts: setpoint, load or both; setpoint when not given, both for a record without a slow end.",
)
@click.option("--load-weight", type=float, help="Of the load's index, for both; 1 when not given.")
@click.option(
    "--structure", metavar="NAME", help="p, pi, pd, pid, fopi, fopd or fopid; else the simplest nearly as good."
)
@click.option(
    "--filter-order",
    type=int,
    help="Of the measurement's filter: 0, 1 or 2; when not given 0, or 2 for a noisy record and where 0 will not do.",
)
@click.option("--two-degrees/--one-degree", default=None, help="Choose the setpoint's weights as well, or keep them 1.")
@click.option("--start", metavar="KP,KI,KD,LAM,MU", help="A further point to begin from.")
@click.option(
    "--fix", multiple=True, metavar="NAME=VALUE", help="Keep kp, ki, kd, lam, mu or filter_time; may be repeated."
)
@click.option("--bound", multiple=True, metavar="NAME=LOW,HIGH", help="Range of one of the five; may be repeated.")
@click.option("--weight", multiple=True, metavar="PART=VALUE", help="Of sum, energy or zamani; may be repeated.")
@click.option("--solver", default="gauss-newton", show_default=True, help="Or nelder-mead, differential-evolution.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed gives the same answer."
)
@click.option("--timeout", type=float, metavar="S", help="Give the best found after this long [s].")
@result_options
def time_verb(
    start: str | None, fix: tuple[str, ...], bound: tuple[str, ...], weight: tuple[str, ...], before: str | None,
    **given: Any,
) -> None:  # fmt: skip
    """Minimise an index of the response to a setpoint step, a load step or both, under bounds."""
    from fopid_core.model.fopid import read_gains

    asked: dict[str, Any] = {
        "fixed": {name: _number(name, value) for name, value in _pairs("fix", fix)},
        "bounds": {name: _range(name, value) for name, value in _pairs("bound", bound)},
        "weights": {name: _number(name, value) for name, value in _pairs("weight", weight)},
        "start": None if start is None else read_gains(start),
    }
    _tune("time", asked, {**given, "before": before or start})


@tune_group.command("rule", context_settings=ARGUMENTS)
@record_options
@click.option("--rule", metavar="NAME", help="valerio-1, fmigo, padula-visioli-..., simc-pi, amigo-pi, amigo-pid, ...")
@click.option("--crossover", type=float, metavar="RAD_S", help="For dominant-poles: their natural frequency.")
@result_options
def rule_verb(**given: Any) -> None:
    """Read the numbers off a published rule."""
    _tune("rule", {}, given)


_OF_A_RECORD = ("columns", "namespace", "control_min", "control_max", "control_before")


def _tune(method: str, asked: dict[str, Any], given: dict[str, Any]) -> None:
    """Tune with a progress bar on stderr, write the result, leave with the exit status of the contract."""
    from fopid_core.cli.tuned import show
    from fopid_core.design.specification import TuningRequest
    from fopid_core.design.tuner import tune
    from fopid_core.model.fopid import read_gains
    from fopid_core.model.process import read_process

    process, record, before = (given.pop(name) for name in ("process", "record", "before"))
    shown = {name: given.pop(name) for name in ("certified", "plot", "as_json")}
    source = {name: given.pop(name) for name in _OF_A_RECORD}
    template = given.pop("template")
    options = {name: value for name, value in {**asked, **given}.items() if value is not None}
    gains = None if before is None else read_gains(before)
    if (process is None) == (record is None):
        raise InputError("process missing; allowed: PROCESS or --record FILE" if record is None
                         else f"process {process!r} beside --record; allowed: one of them")  # fmt: skip
    if record is not None:
        success = _tune_record(method, record, source, template, options, gains, shown)
    else:
        if unused := [name for name, value in source.items() if value is not None]:
            raise InputError(f"{unused[0].replace('_', '-')} without a record; allowed: with --record")
        request = TuningRequest(read_process(process), method, **options)
        with progress(method) as told:
            result = tune(request, told)
        success = show(request, result, gains, **shown)
    if not success:
        click.get_current_context().exit(CANNOT_BE_MET)


def _tune_record(
    method: str, file: Path, source: dict[str, Any], template: str, options: dict[str, Any], gains: Fopid | None,
    shown: dict[str, Any],
) -> bool:  # fmt: skip
    """Learn and tune from a record, and write what came of it; whether it is a success."""
    from fopid_core.cli.tuned import show, show_refused
    from fopid_core.design.recorded_tuning import tune_recorded
    from fopid_core.study.records import read_record, refuse_limits_beside

    signals = read_record(file, source["namespace"], source["control_before"], source["columns"])
    limits = {name: source[name] for name in ("control_min", "control_max") if source[name] is not None}
    refuse_limits_beside(signals, limits.get("control_min", -math.inf), limits.get("control_max", math.inf))
    with progress(method) as told:
        told(0.0, "learning the process, tuning, verifying on all that the record leaves possible")
        found = tune_recorded(replace(signals, **limits), method, options, template=template)
    tuning = None if found.tuned is None else found.tuned.tuning
    if tuning is None or found.request is None:
        return show_refused(found, shown["as_json"])
    result = replace(tuning, success=found.success, message=found.message)
    return show(found.request, result, gains, **shown, recorded=found)


def _radians(degrees: float) -> float:
    if not 0.0 < degrees < 180.0:
        raise InputError(f"phase-margin = {degrees:g} deg; allowed: up to 180, 0 and 180 not included")
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
