"""The verb ``fopid identify``."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json
from fopid_core.cli.output import emit

if TYPE_CHECKING:
    from fopid_core.design.identification.frequency_response import FrequencyResponse
    from fopid_core.design.identification.identified_model import IdentifiedModel


@click.command("identify", context_settings=ARGUMENTS)
@click.argument("record", type=click.Path(path_type=Path))
@click.option(
    "--template",
    default="all",
    show_default=True,
    help="foptd, soptd, nioptd1, nioptd2, rational:N/M, unstable:N, all.",
)
@click.option("--control-before", type=float, metavar="X", help="The control at rest before the record, if known.")
@click.option("--from", "first", type=float, default=-math.inf, metavar="S", help="Use the record from here on.")
@click.option("--to", "last", type=float, default=math.inf, metavar="S", help="Use the record up to here.")
@click.option("--namespace", metavar="NAME", help="Which loop, when a bag holds several.")
@click.option(
    "--columns", metavar="PV,OP,SP", help="Of a csv file: names or numbers of its columns; the fourth is time."
)
@click.option("--plot", type=NewFile(picture=True), metavar="FILE", help="Draw measurement and model: png, svg, pdf.")
@as_json
def identify_verb(
    record: Path,
    template: str,
    control_before: float | None,
    first: float,
    last: float,
    namespace: str | None,
    columns: str | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Learn the process from a record: a csv file with time, control, measurement, or a bag."""
    from fopid_core.design.identification.frequency_response import frequency_response
    from fopid_core.design.identification.identify import identify
    from fopid_core.design.identification.noise import sensor_noise
    from fopid_core.design.response_verification import checked, doubt_of
    from fopid_core.study.records import read_record

    signals = read_record(record, namespace, control_before, columns)
    signals = signals.part(first, last) if (first, last) != (-math.inf, math.inf) else signals
    sensor = sensor_noise(signals)
    found = checked(signals, identify(signals, template, noise=sensor.level if sensor.at_rest else 0.0), template)
    behind = found.behind_actuator(signals)
    seen = frequency_response(behind)
    if plot and found.best:
        from fopid_core.cli.plots import plot_fit

        plot_fit(found.best, behind, plot, seen)
    models = [_rows(model) for model in found.models]
    best = found.best
    doubt = doubt_of(behind, best) if found.success and best else ""
    verdict = {
        "success": found.success,
        "message": "; ".join(told for told in (found.message, doubt) if told),
        "template": best.template if best else None,
        "process": str(best.process) if best else None,
        "fit_pct": best.fit_pct if best else None,
        "sample_time": signals.sample_time,
        "noise_at_rest": sensor.level,
        "quantisation": sensor.step,
        "control_limits": [signals.control_min, signals.control_max],
        "rows_left_out": signals.left_out,
        "control_late": signals.late,
        "plot": str(plot) if plot and best else None,
        "elapsed_s": found.elapsed,
    }
    tables: list[tuple[str, Mapping[str, Any]]] = [
        (f"{model.template}, beside each number its standard deviation", _table(model)) for model in found.models
    ]
    shown = verdict | {"process": _readable(best)}
    response = _response(seen, best)
    if seen.known.any():
        tables.append(("Frequency response without a model: gain and angle, 95 %", _shown(response)))
    emit(
        verdict | {"models": models, "frequency_response": response},
        [*tables, ("Identified" if found.success else "Refused", shown)],
        as_json,
    )
    if not found.success:
        click.get_current_context().exit(CANNOT_BE_MET)


def _response(seen: FrequencyResponse, best: IdentifiedModel | None) -> dict[str, Any]:
    """What the record shows without a model, and where the model leaves its regions."""
    outside = seen.outside(best.process) if best else [None] * seen.frequency.size
    points = [
        {"frequency": w, "real": g.real, "imag": g.imag, "radius": r, "model_outside": bool(out) if best else None}
        for w, g, r, out, known in zip(
            seen.frequency.tolist(), seen.response.tolist(), seen.radius.tolist(), outside, seen.known, strict=True
        )
        if known
    ]
    unknown = seen.frequency[~seen.known].tolist()
    return {"points": points, "not_known": unknown, "sample_time": seen.sample_time, "memory": seen.memory,
            "reason": seen.reason}  # fmt: skip


def _shown(response: Mapping[str, Any]) -> dict[str, str]:
    rows = {}
    for point in response["points"]:
        value = complex(point["real"], point["imag"])
        size, radius = abs(value), point["radius"]
        angle, spread = math.degrees(cmath.phase(value)), math.degrees(math.asin(radius / size))
        beside = ", the model is outside" if point["model_outside"] else ""
        rows[f"{point['frequency']:.3g} rad/s"] = f"{size:.3g} ± {radius:.2g}, {angle:.1f} ± {spread:.2g} deg{beside}"
    return rows


def _readable(model: IdentifiedModel | None) -> str | None:
    """The process with as many digits as people read."""
    if model is None:
        return None
    return str(model.structure.process_of({name: float(f"{value:.5g}") for name, value in model.parameters.items()}))


def _rows(model: IdentifiedModel) -> dict[str, Any]:
    return {
        "template": model.template,
        "process": str(model.process),
        "parameters": dict(model.parameters),
        "deviations": dict(model.deviations),
        "fit_pct": model.fit_pct,
        "white": model.whiteness.white,
        "white_p_value": model.whiteness.p_value,
        "noise": model.noise,
        "crossover": model.crossover,
        "deviation_at_crossover": model.deviation,
    }


def _table(model: IdentifiedModel) -> dict[str, Any]:
    rows: dict[str, Any] = {
        name: f"{value:.5g} ± {model.deviations[name]:.2g}" for name, value in model.parameters.items()
    }
    return rows | {
        "fit on held-back samples [%]": model.fit_pct,
        "residual": f"{'white' if model.whiteness.white else 'not white'}, {model.noise:.3g}",
        "uncertainty at crossover [%]": 100.0 * model.deviation,
    }
