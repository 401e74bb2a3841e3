"""A loop of the four nodes in processes of their own, with an observer beside it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fopid_ros.experiment.child_processes import ros_arguments

from ..ros.conftest import SETTLE, Graph
from ..ros.node_process import NodeProcess
from .record import Record, Sample

PROCESS = "1/((0.1s+1)(0.03s+1))"
SETPOINT = 1.0
LIMITS = (-0.5, 2.5)
GAINS = {"kp": 0.8, "ki": 6.0}
FLOAT = "std_msgs/msg/Float64"
OBSERVED = (
    f"measurement:{FLOAT}:data", f"control:{FLOAT}:data",
    "fopid_controller/state:fopid_msgs/msg/FopidState:feedforward,stale,measurement_age",
)  # fmt: skip
STATE = "fopid_controller/state"
SIGNAL_TYPES = {f"{signal}.{key}": value for signal in ("measurement", "control")
                for key, value in (("type", FLOAT), ("field", "data"))}  # fmt: skip


def parameters_of(folder: Path) -> dict[str, Mapping[str, object]]:
    """Of each node: plain numbers as signals, gains that outlive their process."""
    return {
        "plant_simulator": {"process": PROCESS, **SIGNAL_TYPES},
        "fopid_controller": {
            **GAINS, **SIGNAL_TYPES, "setpoint.initial": SETPOINT, "control_min": LIMITS[0], "control_max": LIMITS[1],
            "retain": True, "directory": str(folder),
        },
        "fopid_tuner": {"process": PROCESS, **SIGNAL_TYPES},
    }  # fmt: skip


class Rig:
    """The loop; ``wait`` lets it run until something has happened in the observer's record."""

    def __init__(self, graph: Graph, folder: Path) -> None:
        self.graph, self._folder, self._parameters = graph, folder, parameters_of(folder)
        self._started = 0
        self.record = Record(folder / "record")
        script = [sys.executable, str(Path(__file__).with_name("observer.py")), str(folder / "record"), *OBSERVED]
        self._observer = subprocess.Popen(script, env=graph.environment)
        self.nodes: dict[str, NodeProcess] = {}

    def begin(self) -> None:
        """Start all nodes, and wait until the loop runs."""
        for name in (*self._parameters, "dashboard"):
            self.start(name)
        self.wait(lambda: self.record.of(STATE), "the loop", 60.0)
        self.graph.spin(SETTLE)

    def start(self, name: str) -> None:
        """Start a node, once more if it has ended."""
        arguments = ["--port", "0"] if name == "dashboard" else ros_arguments(self._parameters[name])
        self._started += 1
        log = self._folder / f"{name}-{self._started}.log"
        self.nodes[name] = NodeProcess(name, arguments, self.graph.environment, log)

    def wait(self, happened: Callable[[], Any], what: str, patience: float) -> Any:
        """What ``happened`` gives at last."""
        deadline = time.monotonic() + patience
        while not (found := happened()):
            assert time.monotonic() < deadline, f"{what} within {patience} s; logs: {self.logs()}"
            self.graph.spin(0.05)
            self.record.update()
        return found

    def logs(self) -> str:
        """The end of what each node's newest process has said."""
        return "\n".join(f"{name}: {node.log.read_text()[-1500:]}" for name, node in self.nodes.items())

    def samples(self, topic: str, since: float) -> list[Sample]:
        return [(line[0], line[1]) for line in self.record.of(topic, since)]

    def close(self) -> None:
        """End all processes."""
        for node in self.nodes.values():
            node.send_signal(signal.SIGCONT)
            node.terminate()
        for node in self.nodes.values():
            try:
                node.wait(10)
            except subprocess.TimeoutExpired:
                node.kill()
        self._observer.terminate()
        self._observer.wait(10)
