"""Runs an experiment with the nodes of a loop, records it, writes the report."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy._rclpy_pybind11 import RCLError
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from fopid_core.errors import InputError
from fopid_core.study.bags.provenance import provenance
from fopid_core.study.experiments.experiment import Experiment, read_experiment, run_folder
from fopid_core.study.reports.completeness import EVERY_SAMPLE
from fopid_msgs.msg import ExperimentPhase, FopidState, ScalarStamped, TuningResult
from fopid_ros.common.arguments import parse
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.common.middleware import prepare_middleware
from fopid_ros.experiment.node import ExperimentNode, StopRequestedError, ask_for_prompt_acknowledgements
from fopid_ros.experiment.recording import BAG_PACKAGES, start_recording
from fopid_ros.experiment.with_nodes import interruptible, run_with_nodes

REPORT_PACKAGES = BAG_PACKAGES | {"matplotlib", "plotly"}
TABLE_WIDTH = 120  # columns the table needs; a narrower terminal wraps it

TOPICS: dict[str, tuple[str, type]] = {
    "setpoint": ("setpoint", ScalarStamped), "disturbance": ("disturbance", ScalarStamped),
    "measurement": ("measurement", ScalarStamped), "control": ("control", ScalarStamped),
    "state": ("fopid_controller/state", FopidState), "tunings": ("fopid_tuner/result", TuningResult),
    "phases": ("experiment/phase", ExperimentPhase), "parameters": ("/parameter_events", ParameterEvent),
    "diagnostics": ("/diagnostics", DiagnosticArray),
}  # fmt: skip
"""Topic and type of everything that an experiment file may ask to record."""


def recorded_topics(experiment: Experiment) -> dict[str, type]:
    """What goes into the bag."""
    return dict(TOPICS[name] for name in experiment.recorded)


def metadata(experiment: Experiment) -> dict[str, str]:
    """What the bag says of itself."""
    return {
        "experiment": experiment.to_yaml(),
        "process": experiment.process,
        "sample_time": repr(experiment.sample_time),
        **provenance(),
    }


def run_phases(node: ExperimentNode, console: Console) -> None:
    """All phases, with a progress bar on stderr."""
    columns = (TextColumn("{task.description:28}"), BarColumn(), TextColumn("{task.completed:.0f} of {task.total:g} s"),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console, transient=False) as bar:
        task = bar.add_task("waiting for the nodes", total=node.experiment.duration)
        node.find_loop()
        boundaries = pairwise(node.experiment.boundaries)
        for phase, (first, end) in zip(node.experiment.phases, boundaries, strict=True):
            bar.update(task, description=f"tuning ({phase.tune.method})" if phase.tune else phase.name)
            node.begin_phase(phase)
            bar.update(task, description=phase.name)
            node.run_phase(first, end, lambda now: bar.update(task, completed=now))
        bar.update(task, completed=node.experiment.duration, description="done")
    node.drain(node.experiment.boundaries[-1])
    node.refuse_other_loops()


def conduct(experiment: Experiment, folder: Path, console: Console) -> int:
    """Run an experiment with the nodes that are on the graph and record it into ``folder/bag``.

    Returns
    -------
    int
        Exit code: 0 done, 2 could not be done or recorded, 3 done but a tuning found nothing to apply, 130
        interrupted. The bag is closed in every case.
    """
    node = ExperimentNode(experiment)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: node.interrupt())
    latched = [topic for topic, _ in (TOPICS["tunings"], TOPICS["phases"]) if topic in recorded_topics(experiment)]
    qos = dict.fromkeys(latched, latched_qos(depth=100))
    recorder = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "experiment.yaml").write_text(experiment.to_yaml(), encoding="utf-8")
        recorder = start_recording(
            node, folder / "bag", recorded_topics(experiment), qos=qos, metadata=metadata(experiment),
            tell=lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True),
        )  # fmt: skip
        every_sample = [TOPICS[name][0] for name in EVERY_SAMPLE if name in experiment.recorded]
        node.recorded, node.listening = partial(recorder.reached, every_sample), recorder.listening
        run_phases(node, console)
        recorder.close()
        for reason in node.not_applied:
            console.print(f"warning: {reason}", highlight=False, soft_wrap=True)
        if not (folder / "bag").exists():
            return 2
        return 3 if node.not_applied else 0
    except InputError as error:
        console.print(f"error: {error}", highlight=False, soft_wrap=True)
        return 2
    except OSError as error:
        console.print(f"error: folder {str(folder)!r}: {error.strerror}", highlight=False, soft_wrap=True)
        return 2
    except StopRequestedError:
        console.print("interrupted", highlight=False)
        return 130
    finally:
        if recorder is not None:
            recorder.close()
        node.destroy_node()


def show_results(folder: Path, console: Console) -> None:
    """Print the table and write the report."""
    from fopid_core.study.bags.bag import read_bag
    from fopid_core.study.reports.report import write_report
    from fopid_core.study.reports.segment_table import segment_table
    from fopid_core.study.reports.segments import segments

    with console.status("writing the report"):
        run = read_bag(folder / "bag")
        page, picture = write_report([run], folder / "report.html")
    print(segment_table(segments(run), width=max(TABLE_WIDTH, console.width)))
    for name, path in (("bag", folder / "bag"), ("report", page), ("picture", picture)):
        print(f"{name:8} {path}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="experiment", description="Run an experiment with the nodes of a loop.")
    parser.add_argument("file", type=Path, help="experiment file (YAML)")
    parser.add_argument("--out", type=Path, help="folder for bag and report (runs/NAME-TIME)")
    parser.add_argument("--start-nodes", action="store_true", help="start plant, controller and tuner, and end them")
    parser.add_argument("--no-report", action="store_true", help="record only")
    return parser


def _with_nodes(experiment: Experiment, options: argparse.Namespace, ros_options: Sequence[str]) -> int:
    """Have a parent start the nodes and this command once more, and watch over them."""
    folder = options.out or run_folder(experiment.name)
    record_only = ["--no-report"] if options.no_report else []
    return interruptible(lambda: run_with_nodes(experiment, folder, record_only, ros_options))


def _ros_options(given: Sequence[str]) -> list[str]:
    """What stands between ``--ros-args`` and ``--``, or the end."""
    behind = given[given.index("--ros-args") + 1 :] if "--ros-args" in given else []
    return list(behind[: behind.index("--")] if "--" in behind else behind)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``experiment``."""
    given = list(sys.argv[1:] if args is None else args)
    options = parse(_parser(), given)
    console = Console(stderr=True)
    try:
        experiment = read_experiment(options.file)
        if options.start_nodes:
            return _with_nodes(experiment, options, _ros_options(given))
        prepare_middleware()
        ask_for_prompt_acknowledgements()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except (InputError, RCLError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    folder = options.out or run_folder(experiment.name)
    try:
        code = conduct(experiment, folder, console)
    finally:
        rclpy.try_shutdown()
    if code in (0, 3) and not options.no_report and {"measurement", "control"} <= set(experiment.recorded):
        try:
            show_results(folder, console)
        except ModuleNotFoundError as error:
            absent = (error.name or "").partition(".")[0]
            if absent not in REPORT_PACKAGES:
                raise
            hint = "pip install 'fopid_ros[bags]'"
            console.print(f"no report, since the Python package {absent} is not installed; allowed: {hint}",
                          markup=False, highlight=False, soft_wrap=True)  # fmt: skip
            print(f"{'bag':8} {folder / 'bag'}")
        except InputError as error:
            console.print(f"error: {error}", highlight=False, soft_wrap=True)
            return 2
    return code


if __name__ == "__main__":
    sys.exit(main())
