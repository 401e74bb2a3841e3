"""The command ``fopid``: what people and other programs type.

Every verb takes ``--json`` and then writes exactly one JSON object to stdout. Exit status: 0 done; 2 bad input, one
line on stderr; 3 well-formed but cannot be met.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.campaign import campaign_verb
from fopid_core.cli.certify import certify_verb
from fopid_core.cli.compare import compare_verb
from fopid_core.cli.design import design_verb
from fopid_core.cli.explore import explore_verb
from fopid_core.cli.export import export_verb
from fopid_core.cli.extras import missing
from fopid_core.cli.front import front_verb
from fopid_core.cli.identify import identify_verb
from fopid_core.cli.limit import limit_verb
from fopid_core.cli.options import (
    ARGUMENTS,
    BAD_INPUT,
    Verbs,
    as_json,
    loop_options,
    plot_option,
    process_argument,
    read_loop,
)
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.cli.replay import replay_verb
from fopid_core.cli.report import repair_verb, report_verb
from fopid_core.cli.reproduce import reproduce_verb
from fopid_core.cli.schedule import schedule_verb
from fopid_core.cli.simulate import simulate_verb
from fopid_core.cli.tune import reduce_verb, tune_group
from fopid_core.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from fopid_core.model.evaluation import Method, StepMeasures
    from fopid_core.model.margins import Margins
    from fopid_core.model.response import Source


class OneLineErrors(Verbs):
    """A group whose errors are one line on stderr, without usage text or traceback."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run, and leave with the exit status of the contract."""
        kwargs["standalone_mode"] = False
        try:
            sys.exit(super().main(*args, **kwargs) or 0)
        except (InputError, click.ClickException) as error:
            message = error.format_message() if isinstance(error, click.ClickException) else str(error)
            if isinstance(error, click.UsageError):
                message = _unknown_option(error, kwargs.get("args") or (args[0] if args else sys.argv[1:])) or message
            click.echo(f"fopid: {' '.join(message.split())}", err=True)
            sys.exit(BAD_INPUT)
        except ModuleNotFoundError as error:
            line = missing(error)
            if line is None:
                raise
            click.echo(f"fopid: {line}", err=True)
            sys.exit(BAD_INPUT)
        except click.Abort:
            sys.exit(130)


def _unknown_option(error: click.UsageError, given: Sequence[str]) -> str:
    """A line on the first option that the verb does not have; a process may begin with a minus sign, not with two."""
    if error.ctx is None:
        return ""
    known = [name for option in error.ctx.command.params for name in option.opts if name.startswith("--")]
    words = [word.partition("=")[0] for word in given if word.startswith("--")]
    unknown = next((word for word in words if word not in (*known, "--help", "--")), None)
    if unknown is None:
        return ""
    return f"no option {unknown}; allowed: {', '.join(known) or 'none'}{did_you_mean(unknown, known)}"


horizon_option = click.option("--horizon", type=float, metavar="S", help="Last instant [s]; chosen from the loop.")


@click.group(cls=OneLineErrors, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fopid_core", prog_name="fopid")
def main() -> None:
    """Fractional-order PID control: C(s) = kp + ki s^-lam + kd s^mu.

    PROCESS is P1 ... P4, a transfer function such as "9/((s+1)(s^2+2s+9))" or "1/(s^1.2+1)*exp(-0.5s)", or a YAML
    file with the key process.
    """


main.add_command(reduce_verb)
main.add_command(tune_group)
main.add_command(report_verb)
main.add_command(schedule_verb)
main.add_command(repair_verb)
main.add_command(reproduce_verb)
main.add_command(identify_verb)
main.add_command(design_verb)
main.add_command(replay_verb)
main.add_command(export_verb)
main.add_command(explore_verb)
main.add_command(simulate_verb)
main.add_command(certify_verb)
main.add_command(compare_verb)
main.add_command(front_verb)
main.add_command(limit_verb)
main.add_command(campaign_verb)


@main.command("evaluate", context_settings=ARGUMENTS)
@process_argument
@loop_options
@horizon_option
@click.option(
    "--method", type=click.Choice(["exact", "gl1"]), default="exact", help="Exact, or sampled as in the paper."
)
@click.option("--step", "sample_time", type=float, default=0.01, show_default=True, metavar="S", help="For gl1 [s].")
@as_json
def evaluate_verb(
    process: str, horizon: float | None, method: Method, sample_time: float, as_json: bool, **controller: Any
) -> None:
    """Judge a controller: stability, margins, indices of a setpoint step."""
    from fopid_core.model.evaluation import evaluate

    judged = evaluate(read_loop(process, **controller), horizon, method, sample_time)
    step, margins = _step_rows(judged.step), _margin_rows(judged.margins)
    verdict = {key: value for key, value in asdict(judged.stability).items() if key != "margin"}
    if judged.stability.unstable_poles < 0:
        verdict["unstable_poles"] = None
    peaks = {"ms": judged.margins.ms, "mt": judged.margins.mt}
    context: dict[str, Any] = {
        "method": method,
        "horizon": judged.horizon,
        "steady_state_error": judged.steady_state_error,
    }
    context |= {"step_reason": judged.step_reason or None}
    data = {**verdict, **peaks, "margins": margins, **step, **context}
    indices, doubts = step.pop("indices"), step.pop("indices_accuracy")
    known = {name: value is not None and math.isfinite(value) for name, value in doubts.items()}
    rows = indices | {name: f"{indices[name]:.6g} ± {doubts[name]:.1g}" for name in indices if known[name]}
    emit(data, [("Loop", {**verdict, **peaks, **margins}), ("Setpoint step", {**context, **step, **rows})], as_json)


def _margin_rows(margins: Margins) -> dict[str, Any]:
    gain = margins.gain_margin
    return {
        "phase_margin_deg": math.degrees(margins.phase_margin),
        "crossover": margins.crossover,
        "phase_slope": margins.phase_slope,
        "gain_margin": gain,
        "gain_margin_db": 20.0 * math.log10(gain) if gain > 0.0 else -math.inf,
        "phase_crossover": margins.phase_crossover,
        "delay_margin": margins.delay_margin,
        "jitter_margin": margins.jitter_margin,
        "ms_frequency": margins.ms_frequency,
        "mt_frequency": margins.mt_frequency,
        "crossovers": list(margins.crossovers),
        "phase_crossovers": list(margins.phase_crossovers),
    }


def _step_rows(step: StepMeasures | None) -> dict[str, Any]:
    from fopid_core.model.evaluation import StepMeasures
    from fopid_core.model.indices import INDEX_NAMES

    if step is None:
        none = dict.fromkeys((*INDEX_NAMES, "sum"))
        return dict.fromkeys(StepMeasures.__dataclass_fields__) | {"indices": none, "indices_accuracy": none}
    both = {name: getattr(step, name) for name in ("indices", "indices_accuracy")}
    return {**asdict(step), **{name: {**asdict(part), "sum": part.weighted_sum()} for name, part in both.items()}}


@main.command("step", context_settings=ARGUMENTS)
@process_argument
@loop_options
@horizon_option
@click.option(
    "--input", "source", type=click.Choice(["setpoint", "load"]), default="setpoint", help="Where the step comes in."
)
@click.option("--points", type=int, default=501, show_default=True, metavar="N", help="Evenly spaced instants.")
@plot_option
@as_json
def step_verb(
    process: str, horizon: float | None, source: Source, points: int, plot: Path | None, as_json: bool,
    **controller: Any,
) -> None:  # fmt: skip
    """The response to a unit step of the setpoint or the load."""
    from fopid_core.cli.plots import plot_response
    from fopid_core.model.evaluation import on_default_horizon
    from fopid_core.model.response import step_response

    loop = read_loop(process, **controller)
    respond = partial(step_response, source=source, points=points)
    response = on_default_horizon(loop, respond) if horizon is None else respond(loop, horizon)
    if plot:
        plot_response(response, f"{loop.controller} on {loop.process}, {source} step", plot)
    data = asdict(response) | {"plot": str(plot) if plot else None}
    rows = {"horizon": float(response.time[-1]), "last output": float(response.output[-1]), "plot": data["plot"]}
    rows |= {key: data[key] for key in ("accuracy", "control_accuracy", "control_impulse")}
    emit(data, [(f"Response to a {source} step", rows)], as_json)


@main.command("region", context_settings=ARGUMENTS)
@process_argument
@click.option("--orders", default="1,1", show_default=True, metavar="LAM,MU", help="The controller's two orders.")
@click.option("--kd", type=float, default=0.0, show_default=True, help="The derivative gain, kept fixed.")
@click.option("--points", type=int, default=60, show_default=True, metavar="N", help="Of the grid, along each side.")
@plot_option
@as_json
def region_verb(process: str, orders: str, kd: float, points: int, plot: Path | None, as_json: bool) -> None:
    """The stabilising kp and ki for fixed orders."""
    from fopid_core.cli.plots import plot_region
    from fopid_core.model.fopid import read_gains
    from fopid_core.model.process import read_process
    from fopid_core.model.stability_region import stability_region

    if orders.count(",") != 1:
        raise InputError(f"orders {orders!r}; allowed: two numbers LAM,MU")
    controller = read_gains(f"0,0,{kd},{orders}")
    region = stability_region(read_process(process), controller, resolution=points)
    if plot:
        plot_region(region, f"{process}: lam = {controller.lam:g}, mu = {controller.mu:g}, kd = {kd:g}", plot)
    border = region.curve[:, region.border]
    data = {
        "lam": controller.lam, "mu": controller.mu, "kd": kd, "kp": region.x, "ki": region.y, "stable": region.stable,
        "curve": {"frequency": region.frequency, "kp": region.curve[0], "ki": region.curve[1], "border": region.border},
        "plot": str(plot) if plot else None,
    }  # fmt: skip
    rows = {
        "stable part of the view": f"{region.stable.mean():.1%}",
        "kp in view": (float(region.x[0]), float(region.x[-1])),
        "ki in view": (float(region.y[0]), float(region.y[-1])),
        "highest kp on the border": float(border[0].max(initial=-math.inf)),
        "highest ki on the border": float(border[1].max(initial=-math.inf)),
        "plot": data["plot"],
    }
    emit(data, [("Region of stabilising gains", rows)], as_json)


@main.command("benchmark", context_settings=ARGUMENTS)
@click.option("--quick", is_flag=True, help="Leave out the baseline's tuning, which takes most of the time.")
@as_json
def benchmark_verb(quick: bool, as_json: bool) -> None:
    """Measure how fast the core is, each figure beside its baseline."""
    from fopid_core.study.benchmarks.benchmark import benchmark

    with progress("benchmark") as told:
        figures = benchmark(told, not quick)
    rows = [asdict(figure) | {"ratio": figure.ratio} for figure in figures]
    emit({"figures": rows}, [("Benchmark", {figure.name: str(figure) for figure in figures})], as_json)


if __name__ == "__main__":
    main()
