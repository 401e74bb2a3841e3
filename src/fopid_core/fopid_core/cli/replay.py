"""The verb ``fopid replay``: what other gains would have done on a recorded day."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json, filter_option
from fopid_core.cli.output import emit, write_file
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.identification.record import Record
    from fopid_core.runtime.settings import ControllerSettings
    from fopid_core.study.replay import Replay

NAMES = ("kp", "ki", "kd", "lam", "mu")


@click.command("replay", context_settings=ARGUMENTS)
@click.argument("record", type=click.Path(path_type=Path))
@click.option("--gains", metavar="KP,KI,KD,LAM,MU", help="To be replayed; tuned from the record when not given.")
@filter_option
@click.option("--setpoint-weights", metavar="B,C", help="In the P and the D part; 1,1 when not given.")
@click.option("--control-min", type=float, default=-math.inf, metavar="X", help="Lower limit of the control.")
@click.option("--control-max", type=float, default=math.inf, metavar="X", help="Upper limit of the control.")
@click.option("--control-rate-max", type=float, default=math.inf, metavar="X", help="Its moves per second at most.")
@click.option("--from", "first", type=float, default=-math.inf, metavar="S", help="Use the record from here on.")
@click.option("--to", "last", type=float, default=math.inf, metavar="S", help="Use the record up to here.")
@click.option("--namespace", metavar="NAME", help="Which loop, when a bag holds several.")
@click.option(
    "--columns", metavar="PV,OP,SP", help="Of a csv file: names or numbers of its columns; the fourth is time."
)
@click.option("--plot", type=NewFile(picture=True), metavar="FILE", help="Draw it: png, svg or pdf.")
@click.option("--out", type=NewFile(), metavar="FILE", help="All signals with their bands, as csv.")
@as_json
def replay_verb(
    record: Path,
    gains: str | None,
    slow: str | None,
    setpoint_weights: str | None,
    control_min: float,
    control_max: float,
    control_rate_max: float,
    first: float,
    last: float,
    namespace: str | None,
    columns: str | None,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """What other gains would have done on a recorded day: a csv file with a setpoint, or a bag; no experiment."""
    from fopid_core.study.records import refuse_limits_beside
    from fopid_core.study.replay import replay

    limits = {"control_min": control_min, "control_max": control_max, "control_rate_max": control_rate_max}
    settings = _settings(gains, slow, setpoint_weights, limits)
    signals, ran = _read(record, namespace, columns)
    if ran is not None:
        settings = _as_it_ran(ran, settings, slow, setpoint_weights, limits)
    signals = signals.part(first, last) if (first, last) != (-math.inf, math.inf) else signals
    refuse_limits_beside(signals, control_min, control_max)
    if gains is None:
        signals = _within(signals, limits)
    found = replay(signals, settings, tuned=gains is None)
    if plot and found.success:
        from fopid_core.cli.plots import plot_replay

        plot_replay(found, signals, plot)
    if out and found.success:
        _write(found, signals, out)
    best = found.identified.best
    facts: dict[str, Any] = {
        "success": found.success,
        "message": found.message,
        "process": str(best.process) if best else None,
        "fit_pct": best.fit_pct if best else None,
        "gains": None if found.gains is None else dict(zip(NAMES, found.gains.gains, strict=True)),
        "beyond_recorded_control_pct": 100.0 * found.beyond if found.success else None,
        "rows_left_out": signals.left_out,
    }
    ends = {"before": found.before, "after": found.after, "after_low": found.after_low, "after_high": found.after_high}
    rows = {name: None if each is None else asdict(each) for name, each in ends.items()}
    files = {"plot": str(plot) if plot and found.success else None, "out": str(out) if out and found.success else None}
    tables: list[tuple[str, Any]] = [("Replayed" if found.success else "Refused", facts)]
    tables += [(name.replace("_", " "), each) for name, each in rows.items() if each]
    emit({**facts, **rows, **files, "elapsed_s": found.elapsed}, tables, as_json)
    if not found.success:
        click.get_current_context().exit(CANNOT_BE_MET)


def _settings(
    gains: str | None, slow: str | None, weights: str | None, limits: dict[str, float]
) -> ControllerSettings | None:
    """The controller to replay, or None for one that is to be tuned."""
    from fopid_core.cli.options import read_loop
    from fopid_core.model.fopid import Fopid
    from fopid_core.runtime.settings import ControllerSettings, as_designed

    if gains is None:
        given = [name for name, value in {"filter": slow, "setpoint-weights": weights}.items() if value is not None]
        if given:
            raise InputError(f"{given[0]} without gains; allowed: with --gains")
        is_limited = any(math.isfinite(value) for value in limits.values())
        return _limited(ControllerSettings(Fopid(0.0)), limits) if is_limited else None
    loop = read_loop("1", gains, slow, weights)
    return _limited(as_designed(loop.controller, 1.0, loop.filter, loop.weights), limits)


def _within(signals: Record, limits: Mapping[str, float]) -> Record:
    """The record with limits that are given, for the gains that are tuned on it."""
    given: dict[str, Any] = {name: value for name, value in limits.items() if math.isfinite(value)}
    return replace(signals, **given)


def _limited(settings: ControllerSettings, limits: dict[str, float]) -> ControllerSettings:
    low, high = limits.get("control_min", settings.control_min), limits.get("control_max", settings.control_max)
    fastest = limits.get("control_rate_max", settings.control_rate_max)
    inside = min(max(0.0, low), high)
    return replace(settings, control_min=low, control_max=high, control_rate_max=fastest, safe_control=inside)


def _read(path: Path, namespace: str | None, columns: str | None) -> tuple[Record, ControllerSettings | None]:
    """The signals, and of a bag the settings of the controller that ran."""
    from fopid_core.model.fopid import Fopid
    from fopid_core.study.records import read_record, record_of_run, settings_of_run

    if path.suffix.lower() == ".csv":
        return read_record(path, namespace, None, columns), None
    from fopid_core.study.bags.bag import read_bag

    run = read_bag(path, namespace)
    return record_of_run(run), settings_of_run(run, Fopid(0.0))


def _as_it_ran(
    ran: ControllerSettings, asked: ControllerSettings | None, slow: str | None, weights: str | None,
    limits: dict[str, float],
) -> ControllerSettings:  # fmt: skip
    """The controller that ran, with what was asked for in its place."""
    if asked is None:
        return ran
    changed: dict[str, Any] = {"gains": asked.gains}
    if slow is not None:
        changed |= {name: getattr(asked, name) for name in ("measurement_filter_order", "measurement_filter_time")}
    if weights is not None:
        changed |= {name: getattr(asked, name) for name in ("setpoint_weight", "derivative_setpoint_weight")}
    return _limited(replace(ran, **changed), {name: value for name, value in limits.items() if math.isfinite(value)})


def _write(found: Replay, record: Record, path: Path) -> None:
    from fopid_core.study.replay import evenly

    even, y, u = evenly(record), found.measurement, found.control
    if y is None or u is None:
        return
    columns = {
        "time": found.time, "setpoint": found.setpoint, "measurement": even.measurement, "control": even.control,
        "replayed_measurement": y.expected, "measurement_low": y.low, "measurement_high": y.high,
        "replayed_control": u.expected, "control_low": u.low, "control_high": u.high,
    }  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    write_file("out", path, text.getvalue())
