"""One who asks the services of some nodes for anything; prints the counts.

``python -m tests.reliability.hostile_client COUNT SEED NODE...``
"""

from __future__ import annotations

import importlib
import json
import random
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from .odd import filled

PATIENCE = 60.0
"""An answer that takes longer counts as none [s]."""
LONGEST = 2_500
"""Characters of a message: it may show a process, of up to 2,000."""
NOT_HERE = ("set_parameters", "set_parameters_atomically")
"""Parameters are tried one by one elsewhere."""
AWAITED = ("get_result",)
"""Answered when the goal ends."""


def service_kind(text: str) -> Any:
    """``package/srv/Name``, or the services that an action is made of."""
    package, folder, name = text.split("/")
    module = importlib.import_module(f"{package}.{folder}")
    if folder == "srv":
        return getattr(module, name)
    action, _, part = name.rpartition("_")
    return getattr(getattr(module, action).Impl, f"{part}Service")


def clients(node: Node, executor: Executor, names: list[str]) -> dict[str, Any]:
    """Of every service that the nodes have."""
    found: dict[str, Any] = {}
    for name in names:
        services: list[tuple[str, list[str]]] = []
        while not any(kind == "lifecycle_msgs/srv/ChangeState" for _, (kind, *_) in services):
            executor.spin_until_future_complete(Future(), timeout_sec=0.2)
            if name in node.get_node_names():
                services = node.get_service_names_and_types_by_node(name, "/")
            if name == "dashboard" and services:
                break
        for topic, (kind, *_) in services:
            if topic.rpartition("/")[2] not in NOT_HERE:
                found[topic] = node.create_client(service_kind(kind), topic)
    for client in found.values():
        while not client.service_is_ready():
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)
    executor.spin_until_future_complete(Future(), timeout_sec=1.0)  # a service may find this client a little later
    return found


def tamed(request: Any) -> Any:
    """What would be a sane wish of somebody mad is left out: to apply gains for another process, to end the node."""
    for wish in ("apply", "adopt"):
        if hasattr(request, wish):
            setattr(request, wish, False)
    if hasattr(request, "goal"):
        request.goal.gains = type(request.goal.gains)()  # to be tried though they are not verified
    if hasattr(request, "transition") and request.transition.id < 10:
        request.transition.id = 200
    return request


if __name__ == "__main__":
    count, seed = map(int, sys.argv[1:3])
    draw = random.Random(seed)
    rclpy.init()
    node, executor = Node(f"hostile_{seed}"), EventsExecutor()
    executor.add_node(node)
    asked_of = clients(node, executor, sys.argv[3:])
    answers, slowest = {"answered": 0, "none": 0}, (0.0, "")
    silent: list[str] = []
    unreadable: list[str] = []
    for _ in range(count):
        topic = draw.choice(list(asked_of))
        request = tamed(filled(draw, asked_of[topic].srv_type.Request()))
        asked = time.monotonic()
        future = asked_of[topic].call_async(request)
        patience = 0.1 if topic.rpartition("/")[2] in AWAITED else PATIENCE
        executor.spin_until_future_complete(future, timeout_sec=patience)
        slowest = max(slowest, (time.monotonic() - asked, topic))
        if future.done() or patience < PATIENCE:
            answers["answered"] += 1
        else:
            answers["none"] += 1
            silent.append(f"{topic}: {str(request)[:300]}")
        told = getattr(future.result(), "message", "") if future.done() else ""
        if len(told) > LONGEST or "\n" in told or "internal error" in told:
            unreadable.append(f"{topic}: {told[:300]} ({len(told)} characters)")
    told = {"silent": silent, "unreadable": unreadable, "services": len(asked_of)}
    print(json.dumps({**answers, "slowest": slowest, **told}), flush=True)
