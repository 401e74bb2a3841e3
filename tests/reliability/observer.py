"""An observer that shares no code with what it observes: it writes down what a graph says, and when.

``observer.py FILE SPEC...``; a spec is ``topic:package/msg/Type:field[,field...]``. One line of JSON for each message:
[monotonic time [s], topic, fields...]. Changes of parameters (``/parameter_events``) are written, too.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

LONGEST = 7200.0  # [s]
# Best effort hears everybody; depth: what comes while this process is not given the processor.
QOS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Observer(Node):
    """Writes a line for each message of each topic."""

    def __init__(self, file: Any, specs: list[str]) -> None:
        super().__init__("observer")
        self._file = file
        for spec in specs:
            topic, kind, fields = spec.split(":")
            package, _, name = kind.split("/")
            message_type = getattr(importlib.import_module(f"{package}.msg"), name)
            self.create_subscription(message_type, topic, self._writer(topic, fields.split(",")), QOS)
        self.create_subscription(ParameterEvent, "/parameter_events", self._write_event, 1000)
        self._write("observer", True)

    def _writer(self, topic: str, fields: list[str]) -> Any:
        return lambda message: self._write(topic, *(getattr(message, field) for field in fields))

    def _write_event(self, event: ParameterEvent) -> None:
        changed = {
            p.name: parameter_value_to_python(p.value) for p in (*event.new_parameters, *event.changed_parameters)
        }
        self._write(
            "/parameter_events", event.node, {k: v for k, v in changed.items() if isinstance(v, int | float | str)}
        )

    def _write(self, topic: str, *fields: Any) -> None:
        self._file.write(json.dumps([time.monotonic(), topic, *fields]) + "\n")


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a signal ends it: each line is whole
    with Path(sys.argv[1]).open("w", buffering=1) as file:
        executor = EventsExecutor()
        executor.add_node(Observer(file, sys.argv[2:]))
        executor.spin_until_future_complete(Future(), timeout_sec=LONGEST)


if __name__ == "__main__":
    main()
