"""The verb ``fopid simulate``: an experiment without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, as_json
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.study.experiments.experiment import Experiment
    from fopid_core.study.experiments.simulate import Simulated
    from fopid_core.study.reports.run import Run


@click.command("simulate", context_settings=ARGUMENTS)
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--replay", type=click.Path(path_type=Path), metavar="BAG",
              help="Setpoint and disturbance from a recorded run; without FILE its experiment, too.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for trace.csv and the report.")
@as_json
def simulate_verb(file: Path | None, replay: Path | None, out: Path | None, as_json: bool) -> None:
    """Run an experiment without ROS: the numbers that the nodes give in lockstep."""
    from fopid_core.runtime.plant import TOLD_FROM
    from fopid_core.study.experiments.simulate import simulate_experiment
    from fopid_core.study.reports.segment_table import print_segments
    from fopid_core.study.reports.segments import segments

    experiment, recorded = _experiment(file, replay)
    with progress(experiment.name) as told:
        found = simulate_experiment(experiment, lambda what: told(0.0, what))
    measured = segments(found.as_run(out or Path(experiment.name)))
    data: dict[str, Any] = {"name": experiment.name, "process": experiment.process, "samples": found.trace.time.size,
                            "plant_accuracy": found.plant_accuracy}  # fmt: skip
    if found.plant_accuracy > TOLD_FROM:
        data["plant_delay"] = "Pade's; plant: {delay_model: exact} in the experiment is exact"
    if recorded is not None:
        data["largest_difference"] = _difference(found, recorded)
    written = _write(found, out) if out else {}
    rest = {"not_applied": list(found.not_applied), **written}
    trace = {**asdict(found.trace), "disturbance": found.disturbance} if as_json else {}
    tunings = [asdict(tuning) for tuning in found.tunings]
    rows = [asdict(segment) for segment in measured]
    emit({**data, **rest, "tunings": tunings, "segments": rows, **trace}, [("Simulation", {**data, **rest})], as_json)
    if not as_json:
        print_segments(measured)
    if found.not_applied:
        click.get_current_context().exit(CANNOT_BE_MET)


def _experiment(file: Path | None, replay: Path | None) -> tuple[Experiment, Run | None]:
    """What to run, and the recorded run whose signals it takes."""
    from fopid_core.study.bags.bag import read_bag
    from fopid_core.study.experiments.experiment import parse_experiment, read_experiment
    from fopid_core.study.experiments.simulate import replayed

    if file is None and replay is None:
        raise InputError("FILE is missing; allowed: an experiment file, or --replay BAG")
    recorded = read_bag(replay) if replay else None
    if recorded is None:
        return read_experiment(file or Path()), None
    if file is None and not recorded.experiment:
        raise InputError(f"bag {str(replay)!r} does not say which experiment it was; allowed: FILE with --replay")
    experiment = read_experiment(file) if file else parse_experiment(recorded.experiment)
    return replayed(experiment, recorded), recorded


def _difference(found: Simulated, recorded: Run) -> float | None:
    """Largest difference of the measurement from the recorded one; None where the runs differ in length."""
    import numpy as np

    signal = recorded.signals["measurement"]
    _, first = np.unique(signal.time, return_index=True)  # on a busy machine the plant sends a sample twice
    if first.size != found.trace.measurement.size:
        return None
    return float(np.max(np.abs(signal.value[first] - found.trace.measurement)))


def _write(found: Simulated, folder: Path) -> Mapping[str, str]:
    """The experiment, the trace and the report; what was written."""
    from fopid_core.study.experiments.stored import write_simulated
    from fopid_core.study.reports.report import write_report

    try:
        trace = write_simulated(found, folder)
    except OSError as error:
        raise InputError(f"out {str(folder)!r}: {error.strerror}; allowed: a folder to write into") from None
    page, image = write_report([found.as_run(folder)], folder / "report.html")
    return {"trace": str(trace), "report": str(page), "image": str(image)}
