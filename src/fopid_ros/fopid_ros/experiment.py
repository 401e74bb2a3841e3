"""The experiment node: leads a loop through the phases of an experiment, records it, writes the report."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from fopid_core.errors import InputError
from fopid_core.study.experiment import Experiment, Phase, TuneCall, read_experiment, run_folder
from fopid_msgs.msg import ExperimentPhase, FopidState, ScalarStamped, TuningResult
from fopid_msgs.srv import Advance, Tune
from fopid_ros.node import check_domain, latched_qos
from fopid_ros.recorder import Recorder
from fopid_ros.signals import header_stamp

DISCOVERY_TIME = 15.0  # how long the other nodes may take to appear [s]
SLICE = 0.02  # [s] between two looks at the loop
NAME_TIME = 3.0  # how long the name of a publisher's node may take to be known [s]
STALL_TIME = 10.0  # lockstep without progress for this long has stalled [s]
TABLE_WIDTH = 120  # columns the table needs; a narrower terminal wraps it
TUNING_TIME = 120.0  # how long a tuning may take [s]


class StopRequestedError(Exception):
    """Ctrl-C or a request to terminate."""


def publisher_names(node: Node, topic: str) -> list[str]:
    """Who publishes a topic; a publisher is found a moment before the name of its node is."""
    deadline = time.monotonic() + NAME_TIME
    while True:
        infos = node.get_publishers_info_by_topic(topic)
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)
        if time.monotonic() > deadline or not any("_UNKNOWN_" in name for name in names):
            return names
        time.sleep(SLICE)


def refuse_other_loops(node: Node, allowed: int) -> None:
    """Two plants or controllers on the same topics would drive each other's loop.

    Raises
    ------
    InputError
        If more than ``allowed`` nodes publish the measurement or the control, naming them.
    """
    for topic in ("measurement", "control"):
        names = publisher_names(node, topic)
        if len(names) > allowed:
            domain = node.context.get_domain_id()
            raise InputError(
                f"domain {domain} is in use: {topic!r} is published by {', '.join(names)}; "
                f"allowed: one loop. Set ROS_DOMAIN_ID, or a namespace of its own for each loop"
            )


class ExperimentNode(Node):
    """Publishes setpoint and disturbance, calls the tuner, lets the plant advance in lockstep."""

    def __init__(self, experiment: Experiment) -> None:
        lockstep = experiment.trigger == "lockstep"
        use_sim_time = Parameter("use_sim_time", value=lockstep)
        super().__init__("experiment", parameter_overrides=[use_sim_time])
        self.experiment = experiment
        self.lockstep = lockstep
        qos = latched_qos()
        self._setpoint = self.create_publisher(ScalarStamped, "setpoint", qos)
        self._disturbance = self.create_publisher(ScalarStamped, "disturbance", qos)
        self._phase = self.create_publisher(ExperimentPhase, "experiment/phase", latched_qos(depth=100))
        self._advance = self.create_client(Advance, "plant_simulator/advance")
        self._tune = self.create_client(Tune, "fopid_tuner/tune")
        self._plant = AsyncParameterClient(self, "plant_simulator")
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        self._interrupted = False
        self.not_applied: list[str] = []
        self._time_ns = 0

    def interrupt(self) -> None:
        """Leave at the next look at the loop."""
        self._interrupted = True

    def spin(self, seconds: float, future: Future | None = None) -> bool:
        """Serve messages for a while, or until a future is done; whether it is."""
        future = future or Future()
        self._executor.spin_until_future_complete(future, timeout_sec=seconds)
        if self._interrupted:
            raise StopRequestedError
        return bool(future.done())

    def _call(self, future: Future, what: str, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not self.spin(SLICE, future):
            if time.monotonic() > deadline:
                raise InputError(f"{what} did not answer within {timeout:g} s")
        return future.result()

    def find_loop(self) -> None:
        """Wait for the nodes that the experiment needs.

        Raises
        ------
        InputError
            Naming the node that is not there.
        """
        wanted = {
            "no plant answers: nobody publishes 'measurement'; start plant_simulator":
                lambda: self.count_publishers("measurement") > 0,
            "no controller to talk to: nobody publishes 'control'; start fopid_controller":
                lambda: self.count_publishers("control") > 0 and self._setpoint.get_subscription_count() > 1,
        }  # fmt: skip
        if self.lockstep:
            wanted["the plant is not in lockstep: no service plant_simulator/advance"] = self._advance.service_is_ready
        if any(phase.tune for phase in self.experiment.phases):
            wanted["no tuner answers: no service fopid_tuner/tune; start fopid_tuner"] = self._tune.service_is_ready
        deadline = time.monotonic() + DISCOVERY_TIME
        for missing, is_there in wanted.items():
            while not is_there():
                if time.monotonic() > deadline:
                    raise InputError(f"{missing} (domain {self.context.get_domain_id()})")
                self.spin(SLICE)
        refuse_other_loops(self, allowed=1)

    def begin_phase(self, phase: Phase) -> None:
        """Make the changes a phase starts with; in lockstep all are in place before the loop goes on."""
        if phase.tune is not None:
            self.tune(phase.tune)
        for value, publisher in ((phase.setpoint, self._setpoint), (phase.disturbance, self._disturbance)):
            if value is not None:
                message = ScalarStamped(value=value)
                self._stamp(message)
                publisher.publish(message)
                if self.lockstep and not publisher.wait_for_all_acked(Duration(seconds=5)):
                    raise InputError(f"{publisher.topic_name} was not taken by all who listen within 5 s")
        if phase.gain_factor is not None:
            change = self._plant.set_parameters_atomically([Parameter("gain_factor", value=phase.gain_factor)])
            self._call(change, "plant_simulator", 5.0)
        marker = ExperimentPhase(name=phase.name, description=describe(phase))
        self._stamp(marker)
        self._phase.publish(marker)

    def _stamp(self, message: Any) -> None:
        header_stamp(message.header, self._time_ns if self.lockstep else self.get_clock().now().nanoseconds)

    def tune(self, call: TuneCall) -> None:
        """Have the tuner tune and apply; when it does not, the loop goes on with the gains it has."""
        request = Tune.Request(
            method=call.method, phase_margin=math.radians(call.phase_margin_deg), crossover=call.crossover,
            index=call.index, ms_max=call.ms_max, u_max=call.u_max, horizon=call.horizon, via=call.via,
            rule=call.rule, apply=True,
        )  # fmt: skip
        response: Tune.Response = self._call(self._tune.call_async(request), "fopid_tuner", TUNING_TIME)
        if not response.applied:
            self.not_applied.append(f"tuning by {call.method}: {'; '.join([response.message, *response.unmet])}")

    def run_until(self, end: float, progress: Any) -> None:
        """Let the loop run until ``end`` seconds after its start."""
        if not self.lockstep:
            self._run_realtime(end, progress)
            return
        last, last_moved = -1.0, time.monotonic()
        while True:
            answer = self._call(self._advance.call_async(Advance.Request(until=end)), "plant_simulator", 5.0)
            progress(answer.time)
            self._time_ns = round(answer.time * 1e9)
            if answer.success:
                return
            if answer.time > last:
                last, last_moved = answer.time, time.monotonic()
            elif time.monotonic() - last_moved > STALL_TIME:
                raise InputError(
                    f"the loop stands still at {answer.time:g} s, {answer.message}: does the controller answer?"
                )
            self.spin(SLICE)

    def _run_realtime(self, end: float, progress: Any) -> None:
        if not hasattr(self, "_begun"):
            self._begun = time.monotonic()
        while (elapsed := time.monotonic() - self._begun) < end:
            progress(elapsed)
            self.spin(min(SLICE, end - elapsed + 1e-3))

    def drain(self) -> None:
        """Serve what is still on its way."""
        self.spin(0.3)


def describe(phase: Phase) -> str:
    """What a phase starts with, for people."""
    parts = [f"tune by {phase.tune.method}"] if phase.tune else []
    for name in ("setpoint", "disturbance", "gain_factor"):
        value = getattr(phase, name)
        if value is not None:
            parts.append(f"{name.replace('_', ' ')} {value:g}")
    return ", ".join(parts)


def recorded_topics() -> dict[str, type]:
    """What goes into the bag."""
    return {
        "setpoint": ScalarStamped, "disturbance": ScalarStamped, "measurement": ScalarStamped,
        "control": ScalarStamped, "fopid_controller/state": FopidState, "fopid_tuner/result": TuningResult,
        "experiment/phase": ExperimentPhase, "/parameter_events": ParameterEvent, "/diagnostics": DiagnosticArray,
    }  # fmt: skip


def metadata(experiment: Experiment) -> dict[str, str]:
    """What the bag says of itself."""
    return {
        "experiment": experiment.to_yaml(),
        "process": experiment.process,
        "sample_time": repr(experiment.sample_time),
        "versions": ", ".join(f"{name} {version(name)}" for name in ("fopid_core", "fopid_ros", "numpy", "scipy")),
    }


def run_phases(node: ExperimentNode, console: Console) -> None:
    """All phases, with a progress bar on stderr."""
    columns = (TextColumn("{task.description:28}"), BarColumn(), TextColumn("{task.completed:.0f} of {task.total:g} s"),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console, transient=False) as bar:
        task = bar.add_task("waiting for the nodes", total=node.experiment.duration)
        node.find_loop()
        end = 0.0
        for phase in node.experiment.phases:
            bar.update(task, description=f"tuning ({phase.tune.method})" if phase.tune else phase.name)
            node.begin_phase(phase)
            bar.update(task, description=phase.name)
            end += phase.duration
            node.run_until(end, lambda now: bar.update(task, completed=now))
        bar.update(task, completed=node.experiment.duration, description="done")
    node.drain()


def conduct(experiment: Experiment, folder: Path, console: Console) -> int:
    """Run an experiment with the nodes that are on the graph and record it into ``folder/bag``.

    Returns
    -------
    int
        Exit code: 0 done, 2 could not be done, 3 done but a tuning found nothing to apply, 130 interrupted. The
        bag is closed in every case.
    """
    node = ExperimentNode(experiment)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: node.interrupt())
    qos = {"fopid_tuner/result": latched_qos(depth=100), "experiment/phase": latched_qos(depth=100)}
    recorder = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "experiment.yaml").write_text(experiment.to_yaml(), encoding="utf-8")
        recorder = Recorder(node, folder / "bag", recorded_topics(), qos=qos, metadata=metadata(experiment),
                            on_failure=lambda text: console.print(f"warning: {text}"))  # fmt: skip
        run_phases(node, console)
        for reason in node.not_applied:
            console.print(f"warning: {reason}", highlight=False, soft_wrap=True)
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
    from fopid_core.study.bag import read_bag
    from fopid_core.study.report import write_report
    from fopid_core.study.segment_table import segment_table
    from fopid_core.study.segments import segments

    with console.status("writing the report"):
        run = read_bag(folder / "bag")
        page, picture = write_report([run], folder / "report.html")
    out = Console(width=max(TABLE_WIDTH, Console().width))
    out.print(segment_table(segments(run), width=out.width))
    for name, path in (("bag", folder / "bag"), ("report", page), ("picture", picture)):
        print(f"{name:8} {path}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="experiment", description="Run an experiment with the nodes of a loop.")
    parser.add_argument("file", type=Path, help="experiment file (YAML)")
    parser.add_argument("--out", type=Path, help="folder for bag and report (runs/NAME-TIME)")
    parser.add_argument("--no-report", action="store_true", help="record only")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``experiment``."""
    given = list(sys.argv[1:] if args is None else args)
    options = _parser().parse_args(remove_ros_args(["experiment", *given])[1:])
    console = Console(stderr=True)
    try:
        experiment = read_experiment(options.file)
        check_domain()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except (InputError, RCLError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    folder = options.out or run_folder(experiment.name)
    try:
        code = conduct(experiment, folder, console)
    finally:
        rclpy.try_shutdown()
    if code in (0, 3) and not options.no_report:
        try:
            show_results(folder, console)
        except InputError as error:
            console.print(f"error: {error}", highlight=False, soft_wrap=True)
            return 2
    return code


if __name__ == "__main__":
    sys.exit(main())
