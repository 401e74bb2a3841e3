"""What the nodes that only listen cost beside a running loop, and the memory of each, beside a bare node's."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.benchmarks.cpu import cpu_seconds, serve
from fopid_ros.experiment.child_processes import Children, command, ros_arguments

LOOP = ("plant_simulator", "fopid_controller")
STDERR = 2
"""The dashboard tells its address, and stdout is for the figures."""
LISTENERS = {"fopid_tuner": "bare_listener", "dashboard": "bare_state_listener"}
"""Nodes that listen, and the bare node with the same subscriptions."""
WARM_UP = 5.0  # [s]


class Listener(Node):
    """Hears the loop's signals and does nothing with them."""

    def __init__(self) -> None:
        super().__init__("bare_listener")
        for name in ("setpoint", "measurement", "control"):
            self.create_subscription(ScalarStamped, name, self._ignore, 1000)

    def _ignore(self, message: ScalarStamped) -> None:
        pass


class StateListener(Node):
    """Hears the controller's state and does nothing with it."""

    def __init__(self) -> None:
        super().__init__("bare_state_listener")
        self.create_subscription(FopidState, "fopid_controller/state", self._ignore, 1000)

    def _ignore(self, message: FopidState) -> None:
        pass


@dataclass(frozen=True)
class Cost:
    """What a process takes.

    Attributes
    ----------
    share : float
        Of a core.
    resident, private : float
        Memory [MB]: all that is in RAM, and what no other process can share.
    """

    share: float
    resident: float
    private: float


def memory(process_id: int) -> tuple[float, float]:
    """Memory in RAM, and the part of it that no file backs [MB]."""
    lines = Path(f"/proc/{process_id}/status").read_text().splitlines()
    kilobytes = {line.split(":")[0]: line.split()[1] for line in lines if line.startswith(("VmRSS", "RssAnon"))}
    return int(kilobytes["VmRSS"]) / 1e3, int(kilobytes["RssAnon"]) / 1e3


def idle_costs(
    gains: dict[str, float], seconds: float, until: Callable[[Executor, Callable[[], bool], str], None]
) -> dict[str, Cost]:
    """Costs of the nodes of a loop at 100 Hz and of the bare nodes, all measured at the same time, by name.

    ``until`` spins an executor until a condition holds.
    """
    node, executor = Node("bench_idle"), EventsExecutor()
    executor.add_node(node)
    bare = [sys.executable, "-m", "fopid_ros.benchmarks.idle"]
    own: tuple[dict[str, object], ...] = ({"process": "P1"}, {**gains, "setpoint.initial": 1.0})
    with Children() as children:
        for name, parameters in zip(LOOP, own, strict=True):
            children.start(name, [command(name), *ros_arguments(parameters), "--log-level", "warn"])
        children.start("fopid_tuner", [command("fopid_tuner"), *ros_arguments({"process": "P1"})])
        children.start("dashboard", [command("dashboard"), "--port", "0"], stdout=STDERR)
        for name in LISTENERS.values():
            children.start(name, [*bare, name])
        heard = lambda: min(node.count_subscribers(t) for t in ("/control", "/fopid_controller/state")) > 1  # noqa: E731
        until(executor, heard, "the nodes of the loop")
        executor.spin_until_future_complete(Future(), timeout_sec=WARM_UP)
        ids = children.process_ids()
        before = {name: cpu_seconds(process_id) for name, process_id in ids.items()}
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)
        costs = {name: Cost((cpu_seconds(process_id) - before[name]) / seconds, *memory(process_id))
                 for name, process_id in ids.items()}  # fmt: skip
    node.destroy_node()
    return costs


if __name__ == "__main__":
    sys.exit(serve({"bare_listener": Listener, "bare_state_listener": StateListener}[sys.argv[1]]))
