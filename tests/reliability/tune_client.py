"""One of many who ask for a tuning: ``tune_client.py COUNT SEED``; prints what the answers were, in JSON."""

from __future__ import annotations

import json
import random
import sys
import time

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from fopid_msgs.srv import Tune

PATIENCE = 60.0
"""An answer that takes longer counts as none [s]."""

if __name__ == "__main__":
    count, seed = map(int, sys.argv[1:])
    draw = random.Random(seed)
    rclpy.init()
    node, executor = Node(f"client_{seed}"), EventsExecutor()
    executor.add_node(node)
    client = node.create_client(Tune, "fopid_tuner/tune")
    while not client.service_is_ready():
        executor.spin_until_future_complete(Future(), timeout_sec=0.1)
    executor.spin_until_future_complete(Future(), timeout_sec=1.0)  # the service may find this client a little later
    answers: dict[str, int] = {"tuned": 0, "busy": 0, "refused": 0, "none": 0}
    slowest = 0.0
    for _ in range(count):
        wanted = Tune.Request(phase_margin=draw.uniform(0.9, 1.4), crossover=draw.uniform(3.0, 8.0))
        if draw.random() < 0.1:
            wanted.process = draw.choice(["1/(s", "s/(s+1)", "", "1/0", "1/(s+1)^200"])
        asked = time.monotonic()
        future = client.call_async(wanted)
        executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        slowest = max(slowest, time.monotonic() - asked)
        if not future.done():
            answers["none"] += 1
        elif future.result().success:
            answers["tuned"] += 1
        else:
            answers["busy" if future.result().message.startswith("busy") else "refused"] += 1
            executor.spin_until_future_complete(Future(), timeout_sec=draw.uniform(0.0, 0.2))
    print(json.dumps({**answers, "slowest": slowest}), flush=True)
