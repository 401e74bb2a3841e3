"""An experiment together with nodes of its own: started before it, watched over, ended with it."""

from __future__ import annotations

import fcntl
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fopid_core.errors import InputError
from fopid_ros.experiment.child_processes import INTERRUPTS, Children, command, interrupts_held, ros_arguments

if TYPE_CHECKING:
    from fopid_core.study.experiments.experiment import Experiment

_INTERRUPTS: list[int] = []
"""Those that came: what they raise is lost where Python ignores exceptions, as in the callbacks of imports."""


def node_parameters(experiment: Experiment) -> dict[str, dict[str, object]]:
    """Parameters of the three nodes an experiment runs with, by executable."""
    lockstep = experiment.trigger == "lockstep"
    common = {"sample_time": experiment.sample_time, "trigger": experiment.trigger}
    plant = {**common, "process": experiment.process, **experiment.plant}
    if lockstep:
        plant["advance_until"] = 0.0
    simulated = {"use_sim_time": lockstep}
    tuner = {**simulated, "process": experiment.process, "sample_time": experiment.sample_time}
    if lockstep:
        tuner["history"] = 0.0  # nobody asks it to learn from the loop, and listening would slow the loop down
    return {
        "plant_simulator": plant,
        "fopid_controller": {**common, **simulated, **experiment.gains, **experiment.controller},
        "fopid_tuner": tuner,
    }


def start_nodes(
    children: Children, experiment: Experiment, environment: dict[str, str], more: Sequence[str] = ()
) -> None:
    """Start plant, controller and tuner; ``more`` are further ROS arguments of each."""
    for executable, parameters in node_parameters(experiment).items():
        arguments = [*ros_arguments(parameters), "--log-level", "warn", *more]
        children.start(executable, [command(executable), *arguments], environment)


def _environment() -> dict[str, str]:
    """ROS stays on this machine; small matrices need one thread."""
    chosen = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OPENBLAS_NUM_THREADS": "1"}
    return {name: os.environ.get(name, value) for name, value in chosen.items()}


@contextmanager
def only_demonstration(domain: str) -> Iterator[None]:
    """Hold a lock, so that two demonstrations on one domain of this machine do not drive each other's loop.

    Raises
    ------
    InputError
        If another one holds it.
    """
    path = Path(tempfile.gettempdir(), f"fopid_demo-{os.getuid()}-domain-{domain}.lock")
    with path.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"ROS_DOMAIN_ID = {domain} is in use by another demonstration; allowed: a domain of its own"
            ) from None
        yield


def _watch(children: Children) -> int:
    """Until the experiment ends; a node that ends before it ends the demonstration.

    An interrupt is heard between two looks: in the midst of one it could leave the lock of a child taken for ever.
    """
    with interrupts_held():
        while (ended := children.ended()) is None:
            if _INTERRUPTS or signal.sigtimedwait(INTERRUPTS, 0.05) is not None:
                raise KeyboardInterrupt
    name, code = ended
    if name != "experiment":
        print(f"error: {name} ended with code {code}; see its message above", file=sys.stderr)
        return 2
    return code


def interruptible(work: Callable[[], int]) -> int:
    """Exit code of some work: 2 for bad input, in one line, 130 when it is interrupted or told to end."""
    for number in INTERRUPTS:
        signal.signal(number, _raise_interrupt)
    try:
        return work()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def run_with_nodes(
    experiment: Experiment, folder: Path, options: Sequence[str] = (), ros_options: Sequence[str] = ()
) -> int:
    """Run an experiment with nodes of its own.

    Parameters
    ----------
    experiment : Experiment
    folder : Path
        A new one.
    options : sequence of str
        Further ones of the command ``experiment``.
    ros_options : sequence of str
        What stands behind ``--ros-args``, for all nodes: a namespace, remappings.

    Raises
    ------
    InputError
        If the folder cannot be made, or the domain is in use by another such run on this machine.
    """
    with only_demonstration(os.environ.get("ROS_DOMAIN_ID", "0")), Children() as children:
        file = _write(experiment, folder)
        environment = _environment()
        start_nodes(children, experiment, environment, ros_options)
        conductor = [command("experiment"), str(file), "--out", str(folder), *options, "--ros-args", *ros_options]
        children.start("experiment", conductor, environment)
        return _watch(children)


def _write(experiment: Experiment, folder: Path) -> Path:
    """The experiment's file in a new folder."""
    file = folder / "experiment.yaml"
    try:
        folder.mkdir(parents=True)
        file.write_text(experiment.to_yaml(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"folder {str(folder)!r}: {error.strerror}; allowed: a new folder") from None
    return file


def _raise_interrupt(number: int, frame: object) -> None:
    _INTERRUPTS.append(number)
    raise KeyboardInterrupt
