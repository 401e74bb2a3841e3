"""Requests that nobody sensible sends, to every service of every node, and parameters set to anything while it runs."""

from __future__ import annotations

import json
import math
import random
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from action_msgs.srv import CancelGoal
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from std_srvs.srv import SetBool

from ..share import share_of
from .odd import NUMBERS, TEXTS
from .record import outside_limits, settled_at
from .rig import LIMITS, SETPOINT, Rig

REQUESTS, CLIENTS = 3000, 10
NODES = ("plant_simulator", "fopid_controller", "fopid_tuner")
KINDS = {
    ParameterType.PARAMETER_BOOL: ("bool_value", (True, False)),
    ParameterType.PARAMETER_INTEGER: ("integer_value", (0, 1, -1, 2**63 - 1, -(2**63))),
    ParameterType.PARAMETER_DOUBLE: ("double_value", NUMBERS),
    ParameterType.PARAMETER_STRING: ("string_value", TEXTS),
    ParameterType.PARAMETER_BYTE_ARRAY: ("byte_array_value", ([b"\xff"] * 1_000,)),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double_array_value", ([math.nan], [1.0] * 1_000_000)),
    ParameterType.PARAMETER_STRING_ARRAY: ("string_array_value", (["x"] * 10_000,)),
    ParameterType.PARAMETER_NOT_SET: (None, (None,)),
    99: (None, (None,)),
}


def is_back(rig: Rig, began: float) -> None:
    """The nodes live, nothing went wrong within, the control kept its limits, and the loop is at its setpoint."""
    back = time.monotonic()
    rig.wait(lambda: settled_at(rig.samples("measurement", back), SETPOINT, 0.05, 0.5), "the loop is back", 30.0)
    assert not outside_limits(rig.samples("control", began), *LIMITS)
    assert all(node.poll() is None for node in rig.nodes.values()), rig.logs()
    for node in rig.nodes.values():
        log = node.log.read_text()
        assert "internal error" not in log, log[:3000]
        assert "Traceback" not in log, log[:3000]


def longest_gap(rig: Rig, began: float) -> float:
    """Between two controls [s]."""
    return max(after[0] - former[0] for former, after in pairwise(rig.samples("control", began)))


def test_ten_who_ask_every_service_for_anything(rig: Rig, figures: Callable[..., None]) -> None:
    each, began = share_of(REQUESTS // CLIENTS), time.monotonic()
    command = [sys.executable, "-m", "tests.reliability.hostile_client", str(each)]
    how = {"cwd": Path(__file__).parents[2], "env": rig.graph.environment, "stdout": subprocess.PIPE, "text": True}
    clients = [subprocess.Popen([*command, str(seed), *NODES, "dashboard"], **how) for seed in range(CLIENTS)]
    rig.wait(lambda: all(client.poll() is not None for client in clients), "all clients", 1500.0)
    answers = [json.loads(client.stdout.read().splitlines()[-1]) for client in clients]
    gap = longest_gap(rig, began)
    rig.graph.call(CancelGoal, "fopid_tuner/autotune/_action/cancel_goal")
    rig.graph.call(SetBool, "fopid_controller/set_auto", SetBool.Request(data=True))
    for fault in ("silent", "unreadable"):
        assert [one for answer in answers for one in answer[fault]] == [], fault
    is_back(rig, began)
    seconds, service = max(answer["slowest"] for answer in answers)
    figures(
        "fault-5-requests",
        fault=f"{each * CLIENTS} senseless requests to {answers[0]['services']} services, ten at once",
        seen=f"all answered, slowest {seconds:.1f} s (`{service}`); no internal error; longest gap between controls "
        f"{gap:.2f} s; within limits, at the setpoint at the end",
    )  # fmt: skip


def parameters_of(rig: Rig, node: str) -> dict[str, ParameterValue]:
    names = rig.graph.call(ListParameters, f"{node}/list_parameters").result.names
    values = rig.graph.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names)).values
    return dict(zip(names, values, strict=True))


def test_every_parameter_set_to_anything_while_it_runs(rig: Rig, figures: Callable[..., None]) -> None:
    began, draw, taken, refused = time.monotonic(), random.Random(7), 0, 0
    cases = [
        (node, name, kind, value)
        for node in NODES for name in parameters_of(rig, node)
        for kind, (_, values) in KINDS.items() for value in values
    ]  # fmt: skip
    before = {node: parameters_of(rig, node) for node in NODES}

    def put(node: str, name: str, value: ParameterValue) -> Any:
        request = SetParametersAtomically.Request(parameters=[Parameter(name=name, value=value)])
        return rig.graph.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request).result

    for node, name, kind, value in draw.sample(cases, share_of(len(cases))):
        field = KINDS[kind][0]
        result = put(node, name, ParameterValue(type=kind, **({field: value} if field else {})))
        if result.successful:
            taken += 1
            result = put(node, name, before[node][name])
            assert result.successful, f"{node}: {name} = {str(value)[:50]}, and back: {result.reason}"
        else:
            refused += 1
            assert 0 < len(result.reason) < 1_000, f"{node}: {name} = {str(value)[:50]}: {result.reason[:2000]}"
            assert "\n" not in result.reason, f"{node}: {name} = {str(value)[:50]}: {result.reason}"
            assert "internal error" not in result.reason, f"{node}: {name} = {str(value)[:50]}"
    for node in NODES:
        now = parameters_of(rig, node)
        assert {name: value for name, value in before[node].items() if now[name] != value} == {}
    is_back(rig, began)
    gap = longest_gap(rig, began)
    figures(
        "fault-6-parameters",
        fault=f"parameters of three nodes set to anything, {taken + refused} times, while they run",
        seen=f"{taken} taken and put back, {refused} refused in one line; no internal error; longest gap between "
        f"controls {gap:.2f} s; within limits, at the setpoint at the end",
    )  # fmt: skip
